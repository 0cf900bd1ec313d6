"""Raw counts of the ReFlex TakkTile hand to angles, speeds and loads of its joints. A motor's joint angle is the
turn of its tendon spool [rad], 0 = open. Motors in the order f1, f2, f3, preshape; closing lowers the position of f2
and preshape. Constants as in the maker's driver, where pi is entered as 3.141596."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

MOTORS = ("f1", "f2", "f3", "preshape")
FINGERS = MOTORS[:3]

PI = 3.141596
TICK_RAD = 8 * PI / 4095
ENCODER_RAD = 2 * PI / 16383
SIGNS = (1, -1, 1, -1)
RATIOS = (1.42, 1.42, 1.42, 1.5)
TURN_TICKS = 1024


def joint_angle(motor: int, raw: float, zero: float) -> float:
    """Returns the joint angle [rad] of a motor whose servo is at `raw` [ticks] and open at `zero` [joint rad]."""
    return float(SIGNS[motor] * (zero_reference(motor, raw) - zero))


def zero_reference(motor: int, raw: float) -> float:
    """Returns the zero [joint rad] that makes the position `raw` [ticks] the open one."""
    return raw * TICK_RAD / RATIOS[motor]


def raw_target(motor: int, angle: float, zero: float) -> int:
    """Returns the servo position [ticks], truncated, of a joint angle [rad]; raises ValueError if the angle is not
    finite, or the position is outside of what the hand may be sent."""
    max_target_ticks = 16383
    raw = (SIGNS[motor] * angle + zero) * RATIOS[motor] / TICK_RAD
    if not math.isfinite(raw) or not 0 <= raw <= max_target_ticks:
        where = f"{angle} rad of motor {MOTORS[motor]} is position {raw:g}"
        raise ValueError(f"{where}; positions lie in 0..{max_target_ticks}")
    return int(raw)


def ticks(motor: int, turn: float) -> float:
    """Returns how many servo ticks turn the joint by `turn` [rad]."""
    return SIGNS[motor] * turn * RATIOS[motor] / TICK_RAD


def servo_fault(positions: Sequence[int]) -> str:
    """Returns a sentence on servos that do not answer (0) or report positions [ticks] no target can have, or ""."""
    min_valid_ticks = 1100
    max_valid_ticks = 64000
    wrong = [f"{n} ({raw})" for n, raw in zip(MOTORS, positions) if not min_valid_ticks < raw < max_valid_ticks]
    return f"The position of servo {', '.join(wrong)} cannot be right; check its cable." if wrong else ""


def speed_units(motor: int, speed: float) -> int:
    """Returns the moving-speed register for a joint speed [rad/s]; never 0, which means full speed. Raises
    ValueError if the speed is not finite."""
    speed_unit_rad_s = 0.01194
    max_speed_units = 1023
    direction_bit = 1024
    if not math.isfinite(speed):
        raise ValueError(f"the speed of motor {MOTORS[motor]} is {speed}")
    units = int(min(abs(speed) * RATIOS[motor] / speed_unit_rad_s, max_speed_units))
    if SIGNS[motor] * speed < 0:
        units += direction_bit
    return units or 1


def proximal_angle(raw: int, zero: float) -> float:
    """Returns the proximal angle [rad] of a knuckle encoder at `raw` counts that is open at `zero` [rad]. Closing
    lowers the count. The encoder wraps; the angle is the one in [-pi/2, 3 pi/2), the range of a finger."""
    return float((zero - raw * ENCODER_RAD + PI / 2) % (2 * PI) - PI / 2)


def closing_load(motor: int, raw: int) -> int:
    """Returns the load [0.1 % of the largest torque] of a present-load register; positive = closing effort."""
    max_forward_load = 1023
    return SIGNS[motor] * (raw - max_forward_load if raw > max_forward_load else -raw)


def all_joint_angles(raw: Sequence[int], zeros: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    return tuple(joint_angle(i, raw[i], zeros[i]) for i in range(4))
