"""The admittance of one stay in servo mode: which force it answers to, and why to none."""

from __future__ import annotations

import math

import numpy as np

from kuka_control.loop.commands import Observation
from kuka_control.model.admittance import Admittance, AdmittanceSettings, known_force
from kuka_control.model.target import NO_OFFSET
from kuka_control.model.tool_load import ToolLoad
from kuka_control.numbers import FORCE_AGAIN_S, FORCE_OLD_S

SHOWN_M = 0.002  # a smaller displacement is not said
UNKNOWN = "The force on the tool is not known; it gives way no further."
GIVES_WAY = "The tool gives way to a force."


class GivingWay:
    """Displaces the tool that follows, less its weight and that of what the hand holds. Where the force at the begin
    shows another weight, the tool stays stiff, as what is measured is no contact then.

    Attributes:
        why_not: why the tool does not give way, or no further, a sentence, or None."""

    def __init__(self, settings: AdmittanceSettings, load: ToolLoad) -> None:
        self._settings, self._load = settings, load
        self.begin(0.0)

    def begin(self, now: float) -> None:
        """Begins a stay, at rest in the desired frame at the time `now` [s]."""
        self._admittance = Admittance(self._settings)
        self._begun = self._time = now
        self._unknown_at = -math.inf  # when the force was not known last [s]
        self._weighed = False  # whether the force at the begin is that of the weight
        self._reading: np.ndarray | None = None  # the newest force as it was measured
        self._force: np.ndarray | None = None  # without weight, in the base
        self.why_not: str | None = None
        self._stiff = False

    @property
    def says(self) -> str | None:
        """What to say of the tool now, a sentence, or None."""
        far = float(np.linalg.norm(self._admittance.displacement)) > SHOWN_M
        return self.why_not or (GIVES_WAY if far else None)

    def step(self, seen: Observation, now: float) -> np.ndarray:
        """Returns the displacement at a new frame, shape (3,) [m]."""
        longest = 0.05  # step of time, also after a stall: the tool does not catch up [s]
        dt, self._time = min(now - self._time, longest), now
        if self._stiff:
            return NO_OFFSET
        if seen.force is not self._reading:
            self._reading = seen.force
            self._force = None if seen.force is None else self._touching(seen, seen.force)
        if not self._weighed and seen.force_age > now - self._begun:
            self._force = None  # it was measured on the way here
        force = known_force(self._force, seen.force_age)
        if force is not None and not self._weighed:
            self._weighed = True
            size = float(np.linalg.norm(force))
            if size > self._settings.dead_band:
                self._stiff = True
                self.why_not = (
                    f"The tool does not give way: where it begins to follow, {size:.0f} N are on it; touch nothing "
                    "there, and set tool_mass, tool_center_of_mass and kuka/set_payload."
                )
                return NO_OFFSET
        if force is None and (self._weighed or now - self._begun > FORCE_OLD_S):
            self._unknown_at = now
        holds = now - self._unknown_at < FORCE_AGAIN_S
        self.why_not = UNKNOWN if holds else None
        return self._admittance.step(None if holds else force, seen.force_age, dt)

    def _touching(self, seen: Observation, force: np.ndarray) -> np.ndarray:
        """Returns the force of what touches the tool, in the base, shape (3,) [N]."""
        known, carried = seen.reckoned
        payload = seen.inputs.switches.payload - carried
        weight, _ = self._load.unknown(known).wrench(seen.joints, payload)
        return self._load.kinematics.forward(seen.joints)[:3, :3] @ (force - weight)
