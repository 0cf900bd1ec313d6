"""Protects the fingers: loosens an overloaded motor, closes a hot one no further, leaves the others alone.

A motor with too much effort gets a bound just before its measured angle. The bound stays until a command turns back
from it, so that a stream of commands that still ask for more does not squeeze again and again. Joint angles in rad.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reflex.conversions import MOTORS
from reflex.reading import HandReading
from reflex.settings import HandSettings

RELIEVED_FRACTION = 0.8
COOLING_DEGC = 3


class EffortGuard:
    """Bounds of the goals, and their causes."""

    def __init__(self, settings: HandSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Removes all bounds."""
        self._low = np.zeros(4)
        self._high = np.array(self._settings.travel)
        self._overloaded = [False] * 4
        self._hot = [False] * 4

    @property
    def overloaded(self) -> tuple[str, ...]:
        """Overloaded motors."""
        return tuple(name for name, on in zip(MOTORS, self._overloaded) if on)

    @property
    def hot(self) -> tuple[str, ...]:
        """Hot motors."""
        return tuple(name for name, on in zip(MOTORS, self._hot) if on)

    @property
    def bounded(self) -> tuple[str, ...]:
        """Motors whose goals are bounded."""
        inside = (self._low <= 0) & (self._high >= self._settings.travel)
        return tuple(name for name, free in zip(MOTORS, inside) if not free)

    def clip(self, goals: Sequence[float]) -> tuple[float, ...]:
        """Returns the goals [rad] within travel and bounds; a goal that turns back from a bound removes it.

        The bound of a hot motor follows instead, so that it only opens.
        """
        travel = np.array(self._settings.travel)
        wanted = np.clip(goals, 0.0, travel)
        back = (wanted < self._high) | (wanted <= 0)
        self._high = np.where(back, np.where(self._hot, wanted, travel), self._high)
        self._low = np.where((wanted > self._low) | (wanted >= travel), 0.0, self._low)
        return tuple(np.clip(wanted, self._low, self._high).tolist())

    def check(
        self, reading: HandReading, goals: Sequence[float], calibrated: bool
    ) -> tuple[tuple[float, ...], list[str]]:
        """Returns goals [rad] that protect the fingers, equal to `goals` where nothing is wrong, and news as sentences.

        A motor outside of its travel, or of a hand that is not calibrated, is only stopped, because its distance from
        open is unknown.
        """
        settings = self._settings
        new_goals, notes = list(goals), []
        for i, name in enumerate(MOTORS):
            load, angle, most = reading.loads[i], reading.joint_angles[i], float(settings.travel[i])
            known = calibrated and -settings.travel_margin <= angle <= most + settings.travel_margin
            temperature = reading.packet.temperatures[i]
            overloaded = abs(load) > settings.overload[i]
            hot = temperature >= settings.hot - COOLING_DEGC * self._hot[i]
            if overloaded and not self._overloaded[i]:
                notes.append(f"Motor {name} is overloaded (load {load:.0f} of {settings.overload[i]:.0f}): loosened.")
            if hot and not self._hot[i]:
                notes.append(f"Motor {name} has {temperature} degrees Celsius: it does not close further.")
            self._overloaded[i] = overloaded or (
                self._overloaded[i] and abs(load) > RELIEVED_FRACTION * settings.overload[i]
            )
            self._hot[i] = hot
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
