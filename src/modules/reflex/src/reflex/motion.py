"""Where the motors are to go: goals, their limits, and the packets that say so.

Goals are kept in servo positions [ticks], so that what stays is sent again unchanged. While the speed is being changed
the hand would read a target as a speed; the newest one waits. Pure: time [s] is handed in, packets come out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reflex.codec import StatePacket, encode_target
from reflex.conversions import MOTORS, TURN_TICKS, all_joint_angles, implausible_servos, raw_target, ticks
from reflex.effort import EffortGuard
from reflex.reading import Reading
from reflex.settings import Settings
from reflex.speed_change import SpeedChange

# A servo at full speed needs a second for so many ticks.
_JUMP_TICKS = TURN_TICKS - 124


@dataclass(frozen=True)
class Note:
    """Something that a person should read; level is "info", "warning" or "error"."""

    level: str
    text: str


class Motion:
    """The goals of the four motors."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.guard = EffortGuard(settings)
        self._goals: tuple[int, ...] | None = None
        self._change: SpeedChange | None = None
        self._waiting: tuple[int, ...] | None = None

    @property
    def changing_speed(self) -> bool:
        """Whether a change of speed is under way."""
        return self._change is not None

    def reset(self) -> None:
        """Forgets goals, limits and a change of speed: torque is off."""
        self._goals = self._change = self._waiting = None
        self.guard.reset()

    def change_speed(self, speeds: Sequence[float], now: float) -> tuple[bytes, ...]:
        """Begins to set the joint speeds [rad/s] and returns the first packet.

        Raises:
            ValueError: a speed is not finite.
        """
        self._change = SpeedChange(speeds, now)
        return self._change.step(now)

    def step(self, now: float) -> tuple[bytes, ...]:
        """Returns what is due by now: packets of a change of speed, then the target that waited for its end."""
        if self._change is None:
            return ()
        packets = self._change.step(now)
        if not self._change.done:
            return packets
        self._change = None
        waiting, self._waiting = self._waiting, None
        return packets if waiting is None else (*packets, *self.aim(waiting))

    def aim(self, positions: tuple[int, ...]) -> tuple[bytes, ...]:
        """Makes these positions [ticks] the goals, as they are."""
        self._goals = positions
        if self._change:
            self._waiting = positions
            return ()
        return (encode_target(positions),)

    def command(
        self, angles: Sequence[float], positions: Sequence[int], zeros: np.ndarray
    ) -> tuple[tuple[bytes, ...], str]:
        """Makes joint angles the goals, within travel and the guard's bounds.

        Args:
            angles: finite joint angles [rad].
            positions: where the servos stand [ticks].
            zeros: motor zeros [joint rad].

        Returns:
            The packets, and why there are none as a sentence.
        """
        margin, travel = self._settings.travel_margin, self._settings.travel
        silent = implausible_servos(positions)
        if silent:
            return (), f"The position of servo {', '.join(silent)} cannot be right: is its cable loose?"
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
        self, reading: Reading, previous: StatePacket | None, zeros: np.ndarray, calibrated: bool
    ) -> tuple[tuple[bytes, ...], list[Note]]:
        """Looks at a new reading for what must not go on.

        A motor whose servo suddenly counts from another turn would wind on to its old goal: it is held. An overloaded
        one is loosened. The others keep the goals that they were last sent to.

        Args:
            reading: the new reading.
            previous: the packet before it, or None.
            zeros: motor zeros [joint rad].
            calibrated: whether they are this hand's own.

        Returns:
            The packets, and what is new.
        """
        here = reading.packet.positions
        if implausible_servos(here):
            return (), []
        goals, notes = list(self._goals or here), []
        if previous and not implausible_servos(previous.positions):
            jumped = [i for i in range(4) if abs(here[i] - previous.positions[i]) > _JUMP_TICKS]
            for i in jumped:
                goals[i] = here[i]
            if jumped:
                names = ", ".join(MOTORS[i] for i in jumped)
                text = f"The position of motor {names} jumped by a turn: held there, calibrate the fingers."
                notes.append(Note("error", text))
        if not self._change:
            angles = all_joint_angles(goals, zeros)
            relieved, news = self.guard.check(reading, angles, calibrated)
            notes.extend(Note("warning", text) for text in news)
            for i, (old, new) in enumerate(zip(angles, relieved)):
                if new != old:
                    goals[i] += round(ticks(i, new - old))
        target = tuple(goals)
        return (self.aim(target) if target != (self._goals or here) else ()), notes
