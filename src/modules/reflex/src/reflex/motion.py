"""Goals of the motors, their limits, changes of speed, and the packets for them.

Goals are servo positions [ticks], so that a goal that stays is sent again unchanged. During a change of speed the hand
would read a target as a speed; the newest target waits. Pure: time [s] comes in, packets come out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reflex.codec import POSITION, VELOCITY, StatePacket, encode_mode, encode_target
from reflex.conversions import MOTORS, TURN_TICKS, all_joint_angles, raw_target, servo_fault, speed_units, ticks
from reflex.effort import EffortGuard
from reflex.reading import HandReading
from reflex.settings import HandSettings

# A servo at full speed needs a second for this many ticks.
_JUMP_TICKS = TURN_TICKS - 124

PAUSES_S = (0.020, 0.035, 0.035)
"""After each packet of a change of speed [s]."""


@dataclass(frozen=True)
class HandNote:
    """A sentence for the log; level is "info", "warning" or "error"."""

    level: str
    text: str


class MotorSpeedChange:
    """One change of the four joint speeds [rad/s], begun at `now` [s]: three packets with pauses between them.

    The hand reads targets as speeds in velocity mode, in which torque is off.

    Raises:
        ValueError: a speed is not finite.
    """

    def __init__(self, speeds: Sequence[float], now: float) -> None:
        units = [speed_units(i, speed) for i, speed in enumerate(speeds)]
        self._packets = [encode_mode(VELOCITY), encode_target(units), encode_mode(POSITION)]
        self._pauses = list(PAUSES_S)
        self._due = now
        self.done = False

    def step(self, now: float) -> tuple[bytes, ...]:
        """Returns the packet that is due, if one is; `done` is true one pause after the last."""
        if now < self._due:
            return ()
        if not self._packets:
            self.done = True
            return ()
        self._due = now + self._pauses.pop(0)
        return (self._packets.pop(0),)


class MotorGoals:
    """The goals of the four motors."""

    def __init__(self, settings: HandSettings) -> None:
        self._settings = settings
        self.guard = EffortGuard(settings)
        self._goals: tuple[int, ...] | None = None
        self._change: MotorSpeedChange | None = None
        self._waiting: tuple[int, ...] | None = None

    @property
    def changing_speed(self) -> bool:
        """Whether a change of speed is under way."""
        return self._change is not None

    def reset(self) -> None:
        """Drops goals, limits and a change of speed: torque is off."""
        self._goals = self._change = self._waiting = None
        self.guard.reset()

    def change_speed(self, speeds: Sequence[float], now: float) -> tuple[bytes, ...]:
        """Begins to set the joint speeds [rad/s] and returns the first packet.

        Raises:
            ValueError: a speed is not finite.
        """
        self._change = MotorSpeedChange(speeds, now)
        return self._change.step(now)

    def step(self, now: float) -> tuple[bytes, ...]:
        """Returns the packets that are due: those of a change of speed, then the target that waited for its end."""
        if self._change is None:
            return ()
        packets = self._change.step(now)
        if not self._change.done:
            return packets
        self._change = None
        waiting, self._waiting = self._waiting, None
        return packets if waiting is None else (*packets, *self.aim(waiting))

    def aim(self, positions: tuple[int, ...]) -> tuple[bytes, ...]:
        """Makes these positions [ticks] the goals, as they are.

        Raises:
            ValueError: they are not four positions that a packet can hold; the goals stay.
        """
        packet = encode_target(positions)
        self._goals = positions
        if self._change:
            self._waiting = positions
            return ()
        return (packet,)

    def command(
        self, angles: Sequence[float], positions: Sequence[int], zeros: np.ndarray
    ) -> tuple[tuple[bytes, ...], str]:
        """Makes finite joint angles [rad] the goals, within travel and the guard's bounds.

        Takes the servos' positions [ticks] and zeros [joint rad]; returns the packets and the reason of a refusal.
        """
        margin, travel = self._settings.travel_margin, self._settings.travel
        fault = servo_fault(positions)
        if fault:
            return (), fault
        for i, (name, angle) in enumerate(zip(MOTORS, all_joint_angles(positions, zeros))):
            if not -margin <= angle <= travel[i] + margin:
                return (), (
                    f"Motor {name} stands at {angle:.2f} rad by its calibration, outside of its travel "
                    f"0..{travel[i]:g} rad: calibrate the fingers."
                )
        try:
            goals = tuple(raw_target(i, angle, zeros[i]) for i, angle in enumerate(self.guard.clip(angles)))
        except ValueError as error:
            return (), f"The command was refused: {error}."
        return self.aim(goals), ""

    def protect(
        self, reading: HandReading, previous: StatePacket | None, zeros: np.ndarray, calibrated: bool
    ) -> tuple[tuple[bytes, ...], list[HandNote]]:
        """Holds or loosens motors that must stop.

        A motor whose servo suddenly counts from another turn would wind on to its old goal: it is held. An overloaded
        motor is loosened. The others keep their goals. `previous` is the packet before the reading, and `calibrated`
        says whether the zeros [joint rad] are this hand's own. Returns the packets and the news.
        """
        here = reading.packet.positions
        if servo_fault(here):
            return (), []
        goals, notes = list(self._goals or here), []
        if previous and not servo_fault(previous.positions):
            jumped = [i for i in range(4) if abs(here[i] - previous.positions[i]) > _JUMP_TICKS]
            for i in jumped:
                goals[i] = here[i]
            if jumped:
                names = ", ".join(MOTORS[i] for i in jumped)
                text = f"The position of motor {names} jumped by a turn: held there, calibrate the fingers."
                notes.append(HandNote("error", text))
        if not self._change:
            angles = all_joint_angles(goals, zeros)
            relieved, news = self.guard.check(reading, angles, calibrated)
            notes.extend(HandNote("warning", text) for text in news)
            for i, (old, new) in enumerate(zip(angles, relieved)):
                if new != old:
                    goals[i] += round(ticks(i, new - old))
        target = tuple(goals)
        return (self.aim(target) if target != (self._goals or here) else ()), notes
