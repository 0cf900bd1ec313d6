"""Schema of the driver's private parameters: config/reflex_takktile.yaml and the addresses of the launch file."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from common.config import integer, number, text, vector
from reflex.conversions import MOTORS
from reflex.settings import HandSettings

MAX_TRAVEL_RAD = HandSettings.travel


@dataclass(frozen=True)
class ReflexDriverConfig:
    """Parameters of the driver; vectors of four are f1, f2, f3, preshape."""

    network_interface: str = text("interface on which the hand is, such as eth0; lo for the simulated hand")
    port: int = integer(low=1, high=65535, doc="UDP port of hand and host")
    calibration_folder: str = text("where calibrations are kept; may begin with ~")

    travel: np.ndarray = vector(4, "rad", above=0, doc="commands are clamped to 0..travel")
    default_speed: np.ndarray = vector(4, "rad/s", above=0, high=3.5, doc="sent when the hand appears")
    overload: np.ndarray = vector(4, "0.1 %", above=0, high=1000, doc="filtered load above which a finger is loosened")
    loosen_angle: float = number("rad", above=0, high=0.5, doc="how far from the measured angle it is loosened")
    hot: float = number("degC", above=0, high=80, doc="servo temperature from which a finger is not closed further")
    travel_margin: float = number("rad", above=0, high=0.8, doc="measured angles this far outside of travel are wrong")
    default_contact_threshold: int = integer("counts", low=0, high=65535, doc="pressure above which a taxel is touched")
    silence_time: float = number("s", above=0.05, high=5, doc="without a packet for this long the hand is silent")
    request_time: float = number("s", above=0, high=30, doc="how long a calibration waits for a silent hand")

    tactile_packets: int = integer("packets", low=1, high=200, doc="averaged to zero the tactile sensors")
    calibration_round: float = number("s", low=0.02, high=1, doc="shortest time between two closing steps")
    calibration_step: int = integer("ticks", low=1, high=20, doc="closing step")
    calibration_moved: float = number("rad", above=0, high=0.5, doc="turn of the knuckle that ends a finger's closing")
    calibration_slack: int = integer("ticks", low=0, high=200, doc="how far a finger's zero is let out from there")
    calibration_max_closing: int = integer("ticks", low=10, high=800, doc="no finger is closed further than this")
    calibration_max_time: float = number("s", above=0, high=60, doc="the calibration gives up after this time")
    calibration_max_load: float = number("0.1 %", above=0, high=1000, doc="the calibration gives up above this load")

    def faults(self) -> list[str]:
        """Returns what is wrong beyond the range of single fields: travel above what the hand's fingers can do."""
        return [
            f"travel of {name} is {value:g} rad; the hand has {most:g} rad at most."
            for name, value, most in zip(MOTORS, self.travel, MAX_TRAVEL_RAD)
            if value > most
        ]

    def settings(self) -> HandSettings:
        """Returns the settings of the state machine."""
        values = {field.name: getattr(self, field.name) for field in fields(HandSettings)}
        return HandSettings(**{k: tuple(v.tolist()) if isinstance(v, np.ndarray) else v for k, v in values.items()})
