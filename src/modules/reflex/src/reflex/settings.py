"""Settings of the hand's client; vectors of four are f1, f2, f3, preshape.

The ROS driver checks ranges and takes the values from config/reflex_takktile.yaml; the defaults here are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

Four = Tuple[float, float, float, float]


@dataclass(frozen=True)
class HandSettings:
    """Settings of the state machine.

    Attributes:
        travel: commands are clamped to 0..travel [rad].
        default_speed: joint speeds sent when the hand appears [rad/s].
        overload: filtered load above which a finger is loosened [0.1 % of the largest torque].
        loosen_angle: how far from its measured angle it is loosened [rad].
        hot: servo temperature from which a finger does not close further [degC].
        travel_margin: a motor measured this far outside of its travel is not calibrated [rad].
        default_contact_threshold: pressure above which a taxel is touched [counts].
        silence_time: without a packet for this long the hand is silent [s].
        request_time: how long a calibration waits for a silent hand [s].
        tactile_packets: packets averaged to zero the taxels.
        calibration_round: shortest time between two closing steps of the finger calibration [s].
        calibration_step: closing step [ticks].
        calibration_moved: turn of a knuckle that ends the closing of its finger [rad].
        calibration_slack: distance of a finger's zero from the point where its knuckle turned [ticks].
        calibration_max_closing: largest closing of a finger [ticks].
        calibration_max_time: longest finger calibration [s].
        calibration_max_load: load above which the calibration gives up [0.1 %].
    """

    travel: Four = (3.6, 3.6, 3.6, 1.75)
    default_speed: Four = (3.0, 3.0, 3.0, 2.0)
    overload: Four = (350.0, 350.0, 350.0, 400.0)
    loosen_angle: float = 0.05
    hot: float = 70.0
    travel_margin: float = 0.6
    default_contact_threshold: int = 20
    silence_time: float = 0.5
    request_time: float = 5.0
    tactile_packets: int = 8
    calibration_round: float = 0.05
    calibration_step: int = 6
    calibration_moved: float = 0.05
    calibration_slack: int = 50
    calibration_max_closing: int = 250
    calibration_max_time: float = 8.0
    calibration_max_load: float = 350.0
