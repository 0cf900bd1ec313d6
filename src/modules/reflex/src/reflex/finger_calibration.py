"""Finds the open position of the fingers: draws the tendons in, step by step, until each knuckle begins to turn.

The user opens the fingers first. The present encoder values are the encoders' zeros. Each round closes every finger
whose knuckle has not turned yet by a small step. The motors' zeros lie a slack before the point where it turned. The
calibration gives up on a bound of closing, time or load and on servos that do not answer, with a sentence. Pure:
packets and time [s] come in, targets [ticks] come out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reflex.calibration import FingerZeros, open_positions, zeros_here
from reflex.codec import StatePacket
from reflex.conversions import ENCODER_RAD, FINGERS, PI, SIGNS, TURN_TICKS, servo_fault
from reflex.settings import HandSettings

_JUMP_TICKS = 200
_TURN_TOLERANCE_TICKS = 40


@dataclass(frozen=True)
class CalibrationStep:
    """Result of a packet."""

    target: tuple[int, ...] | None = None  # positions to send [ticks], or None
    zeros: FingerZeros | None = None  # the result, when the calibration has succeeded
    failure: str = ""  # reason of a failure as a sentence, or empty


class FingerCalibration:
    """One calibration, from its first packet to its end."""

    def __init__(self, settings: HandSettings) -> None:
        self._settings = settings
        self._encoders: tuple[int, ...] = ()
        self._last_positions: tuple[int, ...] = ()
        self._start_time = 0.0
        self._round_time = 0.0
        self._origin: list[int] = []
        self._held: list[int | None] = [None] * 3

    def step(self, packet: StatePacket, loads: Sequence[float], now: float) -> CalibrationStep:
        """Handles the next packet, received at `now` [s], with the filtered loads [0.1 %] of the motors."""
        fault = servo_fault(packet.positions)
        if fault:
            return CalibrationStep(failure=fault)
        if not self._encoders:
            self._encoders, self._start_time, self._round_time = packet.encoders, now, now
            self._origin = list(packet.positions)
            self._last_positions = packet.positions
            return CalibrationStep(target=self._closer(packet))
        turned = self._follow_jumps(packet)
        self._last_positions = packet.positions
        if turned is None:
            return CalibrationStep(
                target=packet.positions, failure="A servo's position jumped: its reports cannot be trusted."
            )
        failure = self._bound_reached(packet, loads, now)
        if failure:
            return CalibrationStep(target=tuple(self._origin), failure=failure)
        for i in range(3):
            if self._held[i] is None and self._knuckle_turn(packet, i) > self._settings.calibration_moved:
                self._held[i] = packet.positions[i]
        held = [h for h in self._held if h is not None]
        if len(held) == len(self._held):
            slack = self._settings.calibration_slack
            zeros = zeros_here(self._encoders, (*held, packet.positions[3]), slack)
            return CalibrationStep(target=open_positions((*held, packet.positions[3]), slack), zeros=zeros)
        if turned or now - self._round_time >= self._settings.calibration_round:
            self._round_time = now
            return CalibrationStep(target=self._closer(packet))
        return CalibrationStep()

    def _closer(self, packet: StatePacket) -> tuple[int, ...]:
        step = self._settings.calibration_step
        closer = [packet.positions[i] + SIGNS[i] * step for i in range(3)]
        fingers = [new if held is None else held for new, held in zip(closer, self._held)]
        return (*fingers, self._origin[3])

    def _follow_jumps(self, packet: StatePacket) -> bool | None:
        """Whether a servo now counts from another turn; None after a jump that is no whole turn.

        The old target lies a turn away then, so the caller sends a new one at once.
        """
        turned = False
        for i, (raw, last) in enumerate(zip(packet.positions, self._last_positions)):
            jump = raw - last
            if abs(jump) <= _JUMP_TICKS:
                continue
            if abs(abs(jump) - TURN_TICKS) > _TURN_TOLERANCE_TICKS:
                return None
            turned = True
            self._origin[i] += jump
            held = self._held[i] if i < 3 else None
            if held is not None:
                self._held[i] = held + jump
        return turned

    def _knuckle_turn(self, packet: StatePacket, finger: int) -> float:
        """Returns how far the knuckle has closed since the start [rad], across the encoder's end."""
        turn = (self._encoders[finger] - packet.encoders[finger]) * ENCODER_RAD
        return (turn + PI) % (2 * PI) - PI

    def _bound_reached(self, packet: StatePacket, loads: Sequence[float], now: float) -> str:
        settings = self._settings
        for i, name in enumerate(FINGERS):
            closed = SIGNS[i] * (packet.positions[i] - self._origin[i])
            if closed > settings.calibration_max_closing - settings.calibration_step and self._held[i] is None:
                if self._knuckle_turn(packet, i) > settings.calibration_moved:
                    continue
                return f"Finger {name} was closed by {closed} ticks and its knuckle encoder did not turn."
            if abs(loads[i]) > settings.calibration_max_load:
                return f"Motor {name} has a load of {loads[i]:.0f} during the calibration: is it blocked?"
        if now - self._start_time > settings.calibration_max_time:
            waiting = ", ".join(name for name, held in zip(FINGERS, self._held) if held is None)
            return f"After {settings.calibration_max_time:g} s the knuckles of {waiting} had not turned."
        return ""
