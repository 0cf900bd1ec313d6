"""Kinematics, dynamics and drives of the arm, from the URDF of the rig; the rig itself has its own closed form.

Positions in metres in the frame `kuka/base_frame`; the hand's joints stand at zero.
The server's loop gives DirectServo a destination every cycle: measured joint + f(goal - measured joint). The model of
DirectServo: each joint moves towards its destination with the mid-point speed of a smooth move of the minimum
trajectory time (distance / (2/3 T)), never faster than it can brake before the destination, and within its speed and
acceleration limits. So it approaches a step in the goal from one side, without overshoot."""

from __future__ import annotations

import math
from typing import Callable, Sequence

import numpy as np
import pinocchio as pin

from common.frames import FLANGE
from common.poses import read_only, translation
from common.rotations import rotation_from_zyx

JOINTS = tuple(f"kuka/joint_{k}" for k in range(1, 8))


class Robot:
    """One arm with its media flange and the hand on it, from the text of the URDF; raises ValueError if that lacks one
    of the seven joints or the flange. `mounting`: roll, pitch and yaw of the base in an upright world [deg]; gravity
    follows it."""

    def __init__(self, urdf: str, mounting: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        full = pin.buildModelFromXML(urdf)
        missing = [name for name in JOINTS if not full.existJointName(name)]
        if missing or not full.existFrame(FLANGE):
            raise ValueError(f"The robot description lacks {', '.join(missing) or FLANGE}.")
        locked = [full.getJointId(name) for name in full.names[1:] if name not in JOINTS]
        self._model = pin.buildReducedModel(full, locked, pin.neutral(full))
        self._data = self._model.createData()
        roll, pitch, yaw = np.radians(mounting)
        R_world_base = rotation_from_zyx(yaw, pitch, roll)
        self._model.gravity = pin.Motion(R_world_base.T @ self._model.gravity.linear, np.zeros(3))
        frame = self._model.frames[self._model.getFrameId(FLANGE)]
        self._last_joint = frame.parent
        self._flange_in_joint = frame.placement
        self.lower = read_only(self._model.lowerPositionLimit)  # joint range, shape (7,) [rad]
        self.upper = read_only(self._model.upperPositionLimit)
        self.max_speed = read_only(self._model.velocityLimit)  # shape (7,) [rad/s]

    def within_range(self, q: np.ndarray) -> bool:
        """Returns whether all joint angles, shape (7,) [rad], are numbers within the joint range."""
        return bool(np.all((q >= self.lower) & (q <= self.upper)))

    def flange(self, q: np.ndarray) -> np.ndarray:
        """Returns the pose of the flange in the base, shape (4, 4), at the joint angles q, shape (7,) [rad]."""
        pin.forwardKinematics(self._model, self._data, q)
        return (self._data.oMi[self._last_joint] * self._flange_in_joint).homogeneous

    def tool_speed(self, q: np.ndarray, v: np.ndarray, T_flange_tool: np.ndarray) -> float:
        """Returns the speed of the tool point [m/s] at the joint angles q [rad] and speeds v [rad/s], shape (7,)."""
        if not v.any():
            return 0.0
        pin.forwardKinematics(self._model, self._data, q, v)
        vx, vy, vz, wx, wy, wz = self._data.v[self._last_joint].vector.tolist()
        x, y, z = self._flange_in_joint.act(T_flange_tool[:3, 3]).tolist()
        return math.sqrt((vx + wy * z - wz * y) ** 2 + (vy + wz * x - wx * z) ** 2 + (vz + wx * y - wy * x) ** 2)

    def jacobian(self, q: np.ndarray, T_flange_tool: np.ndarray) -> np.ndarray:
        """Returns the geometric Jacobian at the tool point, in the tool's axes, shape (6, 7); rows 0-2 linear."""
        J = pin.computeJointJacobian(self._model, self._data, q, self._last_joint)
        return (self._flange_in_joint * pin.SE3(T_flange_tool)).actionInverse @ J

    def wrench(self, q: np.ndarray, T_flange_tool: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Returns force [N] and moment [Nm] at the tool point, in the tool's axes, shape (6,), from joint torques by
        damped least squares: there are seven torques for six unknowns, and a singularity hides some of them."""
        damping = 1e-6
        J = self.jacobian(q, T_flange_tool)
        return np.linalg.solve(J @ J.T + damping * np.eye(6), J @ torque)

    def torques(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Returns the joint torques, shape (7,) [Nm], of gravity and motion at angles, speeds and accelerations."""
        return np.array(pin.rnea(self._model, self._data, q, v, a))

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """Returns the inertia at the joints q [rad], shape (7, 7) [kg m^2]."""
        M = pin.crba(self._model, self._data, q)
        return np.triu(M) + np.triu(M, 1).T

    def weight(self, q: np.ndarray, mass: float, com: np.ndarray) -> np.ndarray:
        """Returns the torques that the weight of a mass [kg] at `com` in the flange frame, shape (3,) [m], makes at the
        joints q, shape (7,) each [rad], [Nm]."""
        J = self.jacobian(q, translation(*com.tolist()))
        return J[:3].T @ (self.flange(q)[:3, :3].T @ (mass * self._model.gravity.linear))


MIN_TRAJECTORY_TIME_S = 0.04
CYCLE_S = 1e-3
Law = Callable[[np.ndarray], np.ndarray]


def lts_law(error: np.ndarray) -> np.ndarray:
    """Returns f(e) = sign(e) a (1 - exp(-(e/b)^2)) [rad], the law of the published server (builds 1.5 to LTS)."""
    lts_reach_rad = 0.07
    lts_width_rad = 0.0525
    scaled = [e / lts_width_rad for e in error.tolist()]
    return np.array([math.copysign(lts_reach_rad * math.expm1(-s * s), s) for s in scaled])


def plain_law(error: np.ndarray) -> np.ndarray:
    """Returns f(e) = e, the law of the 1.7 build for the pneumatic flange."""
    return error


LAWS = {"lts": lts_law, "none": plain_law}


class Drives:
    """Computes the speed of the joints after one step within the limits `speed` and `acceleration` of each joint, shape
    (7,) [rad/s], [rad/s^2]; `trajectory_time`: DirectServo's minimum trajectory time [s]."""

    def __init__(self, speed: np.ndarray, acceleration: np.ndarray, trajectory_time: float) -> None:
        # braking uses this fraction of the acceleration limit; the server's law needs the rest
        braking_fraction = 0.8
        self._acceleration = acceleration
        self._lag = 2.0 / 3.0 * trajectory_time
        double_braking = 2.0 * braking_fraction * acceleration
        linear_range = 0.5 * double_braking * self._lag**2
        self._limits = [limit.tolist() for limit in (speed, acceleration, double_braking, linear_range)]

    def towards(self, distance: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Returns the speed, shape (7,) [rad/s], after a step of dt [s] towards a destination at `distance` from the
        measured joints, shape (7,) [rad]; `v`: present speed, shape (7,) [rad/s]."""
        after = []
        for way, now, speed, acceleration, double_braking, linear_range in zip(
            distance.tolist(), v.tolist(), *self._limits
        ):
            path, most = abs(way), acceleration * dt
            if path <= linear_range:
                wanted = path / self._lag
            else:
                wanted = math.sqrt(double_braking * (path - 0.5 * linear_range))
            if wanted > speed:
                wanted = speed
            change = math.copysign(wanted, way) - now
            if change > most:
                change = most
            elif change < -most:
                change = -most
            after.append(now + change)
        return np.array(after)

    def brake(self, v: np.ndarray, dt: float) -> np.ndarray:
        """Returns the speed, shape (7,) [rad/s], after a step of dt [s] of braking."""
        change = self._acceleration * dt
        return v - np.minimum(np.maximum(v, -change), change)
