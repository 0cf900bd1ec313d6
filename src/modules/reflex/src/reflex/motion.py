"""Goals of the motors, their limits, protection of the fingers, changes of speed, and the packets for them. Goals
are servo positions [ticks], so that a goal that stays is sent again unchanged. During a change of speed the hand
would read a target as a speed; the newest target waits. Pure: time [s] comes in, packets come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from reflex.codec import POSITION, VELOCITY, StatePacket, encode_mode, encode_target
from reflex.conversions import MOTORS, TURN_TICKS, all_joint_angles, raw_target, servo_fault, speed_units, ticks
from reflex.reading import HandReading
from reflex.settings import HandSettings

# A servo at full speed needs a second for this many ticks.
_JUMP_TICKS = TURN_TICKS - 124

PAUSES_S = (0.020, 0.035, 0.035)  # after each packet of a change of speed [s]


@dataclass(frozen=True)
class HandNote:
    """A sentence for the log; level is "info", "warning" or "error"."""

    level: str
    text: str


class MotorSpeedChange:
    """One change of the four joint speeds [rad/s], begun at `now` [s]: three packets with pauses between them, as
    the hand reads targets as speeds in velocity mode, in which torque is off. Raises ValueError if a speed is not
    finite."""

    def __init__(self, speeds: Sequence[float], now: float) -> None:
        units = [speed_units(i, speed) for i, speed in enumerate(speeds)]
        self._packets = zip((encode_mode(VELOCITY), encode_target(units), encode_mode(POSITION)), PAUSES_S)
        self._due = now
        self.done = False

    def step(self, now: float) -> tuple[bytes, ...]:
        """Returns the packet that is due, if one is; `done` is true one pause after the last."""
        if now < self._due:
            return ()
        packet, pause = next(self._packets, (None, 0.0))
        self._due = now + pause
        self.done = packet is None
        return () if packet is None else (packet,)


class EffortGuard:
    """Protects the fingers: loosens an overloaded motor, closes a hot one no further. Such a motor gets a bound just
    before its measured angle, which stays until a command turns back from it, so that it is not squeezed again and
    again [rad]."""

    def __init__(self, settings: HandSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        self._low = [0.0] * 4
        self._high = [float(most) for most in self._settings.travel]
        self._overloaded, self._hot = [False] * 4, [False] * 4

    @property
    def overloaded(self) -> tuple[str, ...]:
        return tuple(compress(MOTORS, self._overloaded))

    @property
    def hot(self) -> tuple[str, ...]:
        return tuple(compress(MOTORS, self._hot))

    @property
    def bounded(self) -> tuple[str, ...]:
        limits = zip(MOTORS, self._low, self._high, self._settings.travel)
        return tuple(name for name, low, high, most in limits if low > 0 or high < most)

    def clip(self, goals: Sequence[float]) -> tuple[float, ...]:
        """Returns the goals [rad] within travel and bounds. A goal that turns back from a bound removes it; the
        bound of a hot motor follows instead, so that it only opens."""
        clipped = []
        for i, (goal, most) in enumerate(zip(goals, self._settings.travel)):
            wanted = min(max(float(goal), 0.0), float(most))
            if wanted < self._high[i] or wanted <= 0:
                self._high[i] = wanted if self._hot[i] else float(most)
            if wanted > self._low[i] or wanted >= most:
                self._low[i] = 0.0
            clipped.append(min(max(wanted, self._low[i]), self._high[i]))
        return tuple(clipped)

    def check(
        self, reading: HandReading, goals: Sequence[float], calibrated: bool
    ) -> tuple[tuple[float, ...], list[str]]:
        """Returns goals [rad] that protect the fingers, equal to `goals` where nothing is wrong, and news as
        sentences. A motor outside of its travel, or of a hand that is not calibrated, is only stopped, because its
        distance from open is unknown."""
        relieved_fraction = 0.8
        cooling_degc = 3
        settings = self._settings
        new_goals, notes = list(goals), []
        for i, name in enumerate(MOTORS):
            load, angle, most = reading.loads[i], reading.joint_angles[i], float(settings.travel[i])
            known = calibrated and -settings.travel_margin <= angle <= most + settings.travel_margin
            temperature = reading.packet.temperatures[i]
            overloaded = abs(load) > settings.overload[i]
            hot = temperature >= settings.hot - cooling_degc * self._hot[i]
            if overloaded and not self._overloaded[i]:
                notes.append(f"Motor {name} is overloaded (load {load:.0f} of {settings.overload[i]:.0f}): loosened.")
            if hot and not self._hot[i]:
                notes.append(f"Motor {name} has {temperature} degrees Celsius: it does not close further.")
            still = self._overloaded[i] and abs(load) > relieved_fraction * settings.overload[i]
            self._overloaded[i], self._hot[i] = overloaded or still, hot
            if overloaded and load > 0:
                end = 0.0 if known else angle
                new_goals[i] = min(goals[i], max(angle - settings.loosen_angle, min(angle, end)))
                self._low[i], self._high[i] = 0.0, min(self._high[i], max(0.0, new_goals[i]))
            elif overloaded:
                end = most if known else angle
                new_goals[i] = max(goals[i], min(angle + settings.loosen_angle, max(angle, end)))
                self._low[i], self._high[i] = max(self._low[i], min(most, new_goals[i])), most
            if hot:
                self._high[i] = max(self._low[i], min(self._high[i], new_goals[i]))
        return tuple(new_goals), notes


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
        return self._change is not None

    def reset(self) -> None:
        """Drops goals, limits and a change of speed: torque is off."""
        self._goals = self._change = self._waiting = None
        self.guard.reset()

    def change_speed(self, speeds: Sequence[float], now: float) -> tuple[bytes, ...]:
        """Begins to set the joint speeds [rad/s]; returns the first packet. Raises ValueError if a speed is not
        finite."""
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
        """Makes these positions [ticks] the goals, as they are; raises ValueError, and the goals stay, unless they
        are four positions that a packet can hold."""
        packet = encode_target(positions)
        self._goals = positions
        if self._change:
            self._waiting = positions
            return ()
        return (packet,)

    def command(
        self, angles: Sequence[float], positions: Sequence[int], zeros: np.ndarray
    ) -> tuple[tuple[bytes, ...], str]:
        """Makes finite joint angles [rad] the goals, within travel and the guard's bounds, from the servos'
        positions [ticks] and zeros [joint rad]; returns the packets and the reason of a refusal."""
        margin, travel = self._settings.travel_margin, self._settings.travel
        fault = servo_fault(positions)
        if fault:
            return (), fault
        for name, angle, most in zip(MOTORS, all_joint_angles(positions, zeros), travel):
            if not -margin <= angle <= most + margin:
                where = f"Motor {name} stands at {angle:.2f} rad by its calibration"
                return (), f"{where}, outside of its travel 0..{most:g} rad: calibrate the fingers."
        try:
            goals = tuple(raw_target(i, angle, zeros[i]) for i, angle in enumerate(self.guard.clip(angles)))
        except ValueError as error:
            return (), f"The command was refused: {error}."
        return self.aim(goals), ""

    def protect(
        self, reading: HandReading, previous: StatePacket | None, zeros: np.ndarray, calibrated: bool
    ) -> tuple[tuple[bytes, ...], list[HandNote]]:
        """Holds a motor whose servo suddenly counts from another turn, since it would wind on to its old goal, and
        loosens an overloaded one; the others keep their goals. `previous` is the packet before the reading, and
        `calibrated` says whether the zeros [joint rad] are this hand's own. Returns the packets and the news."""
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
