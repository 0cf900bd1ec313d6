"""Admittance: the tool gives way to a force, as a mass on a spring and a damper that is tied to the desired tool frame.

    M x'' + D x' + K x = F,    x: displacement from the desired frame [m], F: force on the tool [N], both in the base.

For a robot that takes only joints. The measured force is late, and so is the arm: against a body of the stiffness
k the loop M s^2 + D s + K + k exp(-s T) = 0 is stable up to a delay T alone (`delay_margin`). Impedance control in the
robot has no such delay. Source: Hogan, Impedance control, 1985; Nyquist's criterion for the delay."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from common.poses import read_only
from kuka_control.numbers import FORCE_DELAY_S, FORCE_MOST_N, FORCE_OLD_S


@dataclass(frozen=True)
class AdmittanceSettings:
    """Mass [kg], damping [Ns/m] and stiffness [N/m] of what gives way, all above 0; forces below `dead_band` [N] do
    nothing; it gives way by `farthest` [m] and `fastest` [m/s] at most."""

    mass: float = 8.0
    damping: float = 1200.0
    stiffness: float = 500.0
    dead_band: float = 5.0
    farthest: float = 0.05
    fastest: float = 0.1


class Admittance:
    """The displacement of the tool, shape (3,) [m], as `displacement`; at first none."""

    def __init__(self, settings: AdmittanceSettings) -> None:
        self._settings = settings
        self.displacement, self._v = read_only(np.zeros(3)), np.zeros(3)

    def step(self, force: np.ndarray | None, age: float, dt: float) -> np.ndarray:
        """Returns the displacement after a time `dt` [s] under a force, shape (3,) [N], that was measured `age` [s]
        ago. One that is not known holds it where it is."""
        if dt <= 0.0:
            return self.displacement
        known = known_force(force, age)
        if known is None:
            self._v = np.zeros(3)
            return self.displacement
        s = self._settings
        size = float(np.linalg.norm(known))
        pull = known * (max(size - s.dead_band, 0.0) / size if size else 0.0)
        damped = s.mass + dt * s.damping + dt * dt * s.stiffness
        v = _bounded((s.mass * self._v + dt * (pull - s.stiffness * self.displacement)) / damped, s.fastest)
        x = _bounded(self.displacement + dt * v, s.farthest)
        self._v = (x - self.displacement) / dt
        self.displacement = read_only(x)
        return self.displacement


def known_force(force: np.ndarray | None, age: float) -> np.ndarray | None:
    """Returns a force, shape (3,) [N], that was measured `age` [s] ago; None if it is too old or cannot be true."""
    return force if force is not None and age <= FORCE_OLD_S and np.linalg.norm(force) <= FORCE_MOST_N else None


def _bounded(vector: np.ndarray, longest: float) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)


def delay_margin(settings: AdmittanceSettings, contact_stiffness: float) -> float:
    """Returns up to which delay from the displacement to the measured force [s] the tool is stable at a body of this
    stiffness [N/m]; infinity: with any."""
    m, d, k, c = settings.mass, settings.damping, settings.stiffness, contact_stiffness
    half = k / m - 0.5 * (d / m) ** 2  # (k - m w^2)^2 + (d w)^2 = c^2, solved for w^2
    root = half * half - (k * k - c * c) / (m * m)
    if root < 0.0 or half + math.sqrt(root) <= 0.0:
        return math.inf
    w = math.sqrt(half + math.sqrt(root))
    return (math.pi - math.atan2(d * w, k - m * w * w)) / w


def stiffest_contact(settings: AdmittanceSettings, delay: float) -> float:
    """Returns up to which stiffness of a body [N/m] the tool is stable with a delay [s]."""
    low, high = settings.stiffness * 1e-3, 1e9
    for _ in range(200):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if delay_margin(settings, middle) > delay else (low, middle)
    return low


def stability_fault(settings: AdmittanceSettings, contact: float, most_damping: float) -> str | None:
    """Returns why the tool would swing at a body of the stiffness `contact` [N/m], a sentence that says what would do;
    None if it does not."""
    bears = stiffest_contact(settings, FORCE_DELAY_S)
    if contact <= bears:
        return None
    low, high = settings.damping, most_damping
    for _ in range(40):
        middle = 0.5 * (low + high)
        enough = contact <= stiffest_contact(replace(settings, damping=middle), FORCE_DELAY_S)
        low, high = (low, middle) if enough else (middle, high)
    damped = contact <= stiffest_contact(replace(settings, damping=high), FORCE_DELAY_S)
    instead = f"admittance_damping in [{math.ceil(high)}, {most_damping:g}], or " if damped else ""
    return (
        f"admittance_damping is {settings.damping:g} Ns/m, but the tool swings with it at a body of {contact:g} N/m; "
        f"use {instead}admittance_contact up to {math.floor(bears)}."
    )
