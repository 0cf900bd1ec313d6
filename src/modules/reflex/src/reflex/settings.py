"""Settings of the hand's client; vectors of four are f1, f2, f3, preshape. The ROS driver takes the ranges and
meanings of its parameters from here, and their values from config/reflex_takktile.yaml, which are the same."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Tuple

Four = Tuple[float, float, float, float]


def _setting(default: Any, unit: str, doc: str, **bounds: float) -> Any:
    """A field with its unit, its meaning and its range: `low` and `high` belong to it; without `low` it is above 0."""
    lower = {} if "low" in bounds else {"above": 0}
    return field(default=default, metadata={"unit": unit, "doc": doc, **lower, **bounds})


@dataclass(frozen=True)
class HandSettings:
    """Settings of the state machine; a load is in 0.1 % of the largest torque."""

    travel: Four = _setting((3.6, 3.6, 3.6, 1.75), "rad", "commands are clamped to 0..travel")
    default_speed: Four = _setting((3.0, 3.0, 3.0, 2.0), "rad/s", "sent when the hand appears", high=3.5)
    overload: Four = _setting(
        (350.0, 350.0, 350.0, 400.0), "0.1 %", "filtered load above which a finger is loosened", high=1000
    )
    loosen_angle: float = _setting(0.05, "rad", "how far from the measured angle it is loosened", high=0.5)
    hot: float = _setting(70.0, "degC", "servo temperature from which a finger is not closed further", high=80)
    travel_margin: float = _setting(0.6, "rad", "measured angles this far outside of travel are wrong", high=0.8)
    default_contact_threshold: int = _setting(
        20, "counts", "pressure above which a taxel is touched; at 0 its noise would be a touch", low=1, high=65535
    )
    silence_time: float = _setting(0.5, "s", "without a packet for this long the hand is silent", above=0.05, high=5)
    request_time: float = _setting(5.0, "s", "how long a calibration waits for a silent hand", high=30)
    tactile_packets: int = _setting(8, "packets", "averaged to zero the tactile sensors", low=1, high=200)
    calibration_round: float = _setting(0.05, "s", "shortest time between two closing steps", low=0.02, high=1)
    calibration_step: int = _setting(6, "ticks", "closing step", low=1, high=20)
    calibration_moved: float = _setting(0.05, "rad", "turn of the knuckle that ends a finger's closing", high=0.5)
    calibration_slack: int = _setting(50, "ticks", "how far a finger's zero is let out from there", low=0, high=200)
    calibration_max_closing: int = _setting(250, "ticks", "no finger is closed further than this", low=10, high=800)
    calibration_max_time: float = _setting(8.0, "s", "the calibration gives up after this time", high=60)
    calibration_max_load: float = _setting(350.0, "0.1 %", "the calibration gives up above this load", high=1000)


def setting_fault(name: str, values: Sequence[float]) -> str | None:
    """Returns which of the values a setting must not have, a part of a sentence; None if it may have all."""
    allowed = next(setting.metadata for setting in fields(HandSettings) if setting.name == name)
    low, above, high = allowed.get("low", -math.inf), allowed.get("above", -math.inf), allowed["high"]
    least = f"at least {low:g}" if "low" in allowed else f"above {above:g}"
    for value in values:
        if not low <= value <= high or value <= above:
            return f"{value:g} must be {least} and at most {high:g} {allowed['unit']}"
    return None
