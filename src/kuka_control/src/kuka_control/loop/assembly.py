"""How the control loops are put together from the configuration and the rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kuka_control.limits.line_plan import LineLimits
from kuka_control.limits.motion_limits import MotionLimits, Unlimited
from kuka_control.limits.moving_arm import MovingPoints, ShapeLimits
from kuka_control.limits.speed_change import GuardedRoom
from kuka_control.loop.control_loop import PtpLoop, PtpSettings, RealTimeLoop, RealTimeSettings
from kuka_control.loop.goal_stream import GoalStreamSettings
from kuka_control.loop.moves import MovePlanner
from kuka_control.model.config import ControllerConfig, PtpConfig, RealTimeConfig
from kuka_control.model.ptp_contact import torque_ranges
from kuka_control.model.rig import Rig
from kuka_control.numbers import SPEED_MARGIN

if TYPE_CHECKING:
    from kuka_control.limits.collision import CollisionGuard


RANGE_MARGIN_RAD = float(np.radians(0.1))
"""Servo goals keep this distance to the ends of the joint ranges, where the robot's controller would end servo mode."""


def real_time_loop(config: RealTimeConfig, rig: Rig) -> RealTimeLoop:
    limits = stream_limits(config, rig)
    goals = GoalStreamSettings(
        joint_speeds=limits.joint_speeds,
        tool_speed=config.tcp_speed,
        shaped=config.shaping != "none",
        lower=limits.lower,
        upper=limits.upper,
    )
    slow, fast = config.velocity_ptp_slow, config.velocity_ptp_fast
    guard = collision_guard(config, rig)
    speeds, ranges = rig.model.max_speed, ptp_torque_ranges(config, rig)
    settings = RealTimeSettings(
        *(rig.ptp_velocity, rig.home.q, speeds, config.time_out, slow, fast, guard, ranges),
        *(config.servo_law, goals, rig.carried, None if config.gives_way is None else (config.gives_way, rig.load)),
    )
    return RealTimeLoop(settings, rig.chain, motion_limits(config, rig, guard) if goals.shaped else Unlimited())


def collision_guard(config: ControllerConfig, rig: Rig) -> CollisionGuard | None:
    """Returns the collision guard, None if it is off; ValueError: its file of obstacles was not handed in."""
    if not config.collision_guard:
        return None
    from kuka_control.limits.collision import CollisionGuard  # its library takes a quarter of a second to load

    if config.guard_obstacles and rig.obstacles is None:
        raise ValueError(f"what {config.guard_obstacles} says has to be read and handed in")
    around = rig.obstacles or ()
    return CollisionGuard(rig.kinematics, config.marker_ring, around, config.guard_margin, config.allow_contact)


def ptp_torque_ranges(config: ControllerConfig, rig: Rig) -> Callable[..., np.ndarray] | None:
    """Returns what makes the ranges of the torques in PTP motions, None if nothing is to end them."""
    margin = config.ptp_contact_torque
    return partial(torque_ranges, rig.load, margin=margin) if margin > 0.0 else None


def line_limits(config: RealTimeConfig, rig: Rig) -> LineLimits | None:
    """Returns the limits of straight lines; None where the stream of goals is not shaped."""
    if config.shaping == "none":
        return None
    limits = stream_limits(config, rig)
    return LineLimits(
        kinematics=rig.kinematics,
        workspace=rig.workspace,
        lower=limits.lower,
        upper=limits.upper,
        joint_speeds=limits.joint_speeds,
        shape=limits.shape,
        speed=limits.speed,
        points=_points(rig),
    )


def move_planner(config: ControllerConfig, rig: Rig, named: Mapping[str, np.ndarray]) -> MovePlanner:
    """Returns what checks motions for programs; `named` are joints [rad], shape (7,), by name."""
    if isinstance(config, RealTimeConfig):
        slow, fast = config.velocity_ptp_slow, config.velocity_ptp_fast
        return MovePlanner(rig, named, slow, max(slow, fast), line_limits(config, rig))
    velocity = config.velocity_ptp if isinstance(config, PtpConfig) else 0.0
    return MovePlanner(rig, named, velocity, velocity, None)


class StreamLimits(NamedTuple):
    lower: np.ndarray  # joint ranges, shape (7,) [rad]
    upper: np.ndarray
    joint_speeds: np.ndarray  # shape (7,) [rad/s]
    shape: ShapeLimits
    speed: float  # of every point of the moving arm [m/s]


def stream_limits(config: RealTimeConfig, rig: Rig) -> StreamLimits:
    """Returns the limits of servo goals; faster joints change their speed more quickly in proportion."""
    fastest = rig.model.max_speed
    pace = fastest / np.min(fastest)
    return StreamLimits(
        lower=rig.model.lower + RANGE_MARGIN_RAD,
        upper=rig.model.upper - RANGE_MARGIN_RAD,
        joint_speeds=config.joint_speed * fastest,
        shape=ShapeLimits(config.joint_acceleration * pace, config.joint_jerk * pace),
        speed=SPEED_MARGIN * config.tcp_speed,
    )


def _points(rig: Rig) -> MovingPoints:
    """Returns the points of the arm whose speed is limited, with a hand whose opening is not known."""
    return MovingPoints(rig.kinematics, rig.carried(None))


def motion_limits(config: RealTimeConfig, rig: Rig, guard: CollisionGuard | None = None) -> MotionLimits:
    limits = stream_limits(config, rig)
    room = GuardedRoom(
        lower=limits.lower,
        upper=limits.upper,
        speed=limits.speed,
        points=_points(rig),
        tool_jacobian=rig.kinematics.jacobian,
        workspace=None if rig.workspace.lifted else rig.workspace,
        collisions=guard,
    )
    return MotionLimits(limits.joint_speeds, limits.shape, room)


def ptp_loop(config: PtpConfig, rig: Rig) -> PtpLoop:
    velocity, threshold = config.velocity_ptp, float(np.radians(config.joints_thresh))
    guard = collision_guard(config, rig)
    speeds, ranges = rig.model.max_speed, ptp_torque_ranges(config, rig)
    settings = PtpSettings(
        rig.ptp_velocity, rig.home.q, speeds, config.time_out, velocity, velocity, guard, ranges, threshold
    )
    return PtpLoop(settings, rig.chain)
