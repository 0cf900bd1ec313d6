"""Forward kinematics of the seven joints, and their geometric Jacobian. At zero the arm stands upright. Joints 1, 3,
5, 7 turn about the arm's length (z), joints 2 and 6 about y, joint 4 about -y:  R_base_flange = Rz(q1) Ry(q2) Rz(q3)
Ry(-q4) Rz(q5) Ry(q6) Rz(q7). This is the chain of the KUKA Sunrise Toolbox. The arithmetic is written out in plain
floats: for single poses this is several times faster than 4 x 4 products."""

from __future__ import annotations

from math import cos, hypot, sin, sqrt
from typing import Iterable, Sequence, Tuple

import numpy as np

from iiwa_kinematics.robot_model import RobotModel

Vector = Tuple[float, float, float]
Ball = Tuple[float, float, float, float]  # centre in the flange, x, y, z [m], and radius [m]
Frames = Tuple[Tuple[Vector, ...], Vector, Vector, Vector, Vector, Tuple[Vector, Vector, Vector]]


def zyz_axes(a: float, b: float, c: float) -> tuple[Vector, Vector, Vector]:
    """Returns the x, y and z axis, the columns, of Rz(a) Ry(b) Rz(c)."""
    ca, sa, cb, sb, cc, sc = cos(a), sin(a), cos(b), sin(b), cos(c), sin(c)
    return (
        (ca * cb * cc - sa * sc, sa * cb * cc + ca * sc, -sb * cc),
        (-ca * cb * sc - sa * cc, -sa * cb * sc + ca * cc, sb * sc),
        (ca * sb, sa * sb, cb),
    )


def combination(a: float, x: Vector, b: float, y: Vector, c: float = 0.0, z: Vector = (0.0, 0.0, 0.0)) -> Vector:
    return (
        a * x[0] + b * y[0] + c * z[0],
        a * x[1] + b * y[1] + c * z[1],
        a * x[2] + b * y[2] + c * z[2],
    )


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def pose_of_axes(x: Vector, y: Vector, z: Vector, p: Vector) -> np.ndarray:
    """Returns the pose with these unit axes at p, shape (4, 4) [m]."""
    return np.array([
        [x[0], y[0], z[0], p[0]],
        [x[1], y[1], z[1], p[1]],
        [x[2], y[2], z[2], p[2]],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip


def forward(model: RobotModel, q: np.ndarray) -> np.ndarray:
    """Returns the pose of the flange in the base, shape (4, 4) [m], at joints q, shape (7,) [rad]."""
    _, _, _, _, p, (x, y, z) = joint_frames(model, q)
    return pose_of_axes(x, y, z, p)


def arm_points(model: RobotModel, q: np.ndarray) -> np.ndarray:
    """Returns base, shoulder, elbow, wrist and flange, shape (5, 3) [m], at joints q, shape (7,) [rad]."""
    _, shoulder, elbow, wrist, flange, _ = joint_frames(model, q)
    return np.array([(0.0, 0.0, 0.0), shoulder, elbow, wrist, flange])


def jacobian(model: RobotModel, q: np.ndarray, T_flange_tool: np.ndarray | None = None) -> np.ndarray:
    """Returns the geometric Jacobian of the tool point in the base frame, shape (6, 7). Rows 0 to 2: velocity of the
    tool point [m/s], rows 3 to 5: angular velocity [rad/s], per joint speed [rad/s], at the joints q, shape (7,)
    [rad]. `T_flange_tool`, shape (4, 4) [m], is the flange itself if omitted."""
    axes, shoulder, elbow, wrist, p, (x, y, z) = joint_frames(model, q)
    if T_flange_tool is not None:
        tx, ty, tz = T_flange_tool[:3, 3].tolist()
        tool = combination(tx, x, ty, y, tz, z)
        p = (p[0] + tool[0], p[1] + tool[1], p[2] + tool[2])
    J = np.empty((6, 7))
    for i, point in enumerate((shoulder, shoulder, shoulder, elbow, wrist, wrist, wrist)):
        J[:3, i] = cross(axes[i], (p[0] - point[0], p[1] - point[1], p[2] - point[2]))
        J[3:, i] = axes[i]
    return J


def tool_point(model: RobotModel, tool: Vector, q: Sequence[float], around: float) -> tuple[Vector, list[float]]:
    """Returns the tool point in the base [m], and how far the moving arm reaches from the axes of joints 1 to 7 [m].
    The arm is the elbow, the wrist, and all within `around` [m] of the tool point, `tool` in the flange [m], at joints
    q, 7 [rad]."""
    q1, q2, q3, q4, q5, q6, q7 = q
    upper, fore = model.shoulder_elbow, model.elbow_wrist
    x, y, z = tool[0], tool[1], tool[2] + model.wrist_flange
    r7 = hypot(x, y)
    c, s = cos(q7), sin(q7)
    x, y = c * x - s * y, s * x + c * y
    r6 = hypot(x, z)
    c, s = cos(q6), sin(q6)
    x, z = c * x + s * z, c * z - s * x
    r5 = hypot(x, y)
    c, s = cos(q5), sin(q5)
    x, y, z = c * x - s * y, s * x + c * y, z + fore
    r4 = hypot(x, z)
    c, s = cos(q4), sin(q4)
    x, z = c * x - s * z, c * z + s * x
    wx, wz = -s * fore, c * fore + upper  # the wrist; its y is zero
    w3 = abs(wx)
    r3 = hypot(x, y)
    c, s = cos(q3), sin(q3)
    x, y, z = c * x - s * y, s * x + c * y, z + upper
    wx, wy, elbow = c * wx, s * wx, upper
    r2, w2 = hypot(x, z), hypot(wx, wz)
    c, s = cos(q2), sin(q2)
    x, z = c * x + s * z, c * z - s * x
    wx, elbow = c * wx + s * wz, abs(s * upper)
    r1, w1 = hypot(x, y), hypot(wx, wy)
    c, s = cos(q1), sin(q1)
    reaches = [
        max(r1 + around, w1, elbow),
        max(r2 + around, w2, upper),
        max(r3 + around, w3),
        max(r4 + around, fore),
        r5 + around,
        r6 + around,
        r7 + around,
    ]
    return (c * x - s * y, s * x + c * y, z + model.base_shoulder), reaches


def fastest_point(model: RobotModel, balls: Iterable[Ball], q: Sequence[float], v: Sequence[float]) -> float:
    """Returns the speed of the fastest point of elbow, wrist, flange, and balls that move with the flange [m/s].
    `q`: joints, 7 [rad], `v`: their speeds, 7 [rad/s]. The velocity x, y, z and the turn w are those of elbow, then
    wrist, then flange, in axes that turn with the joints."""
    _, q2, q3, q4, q5, q6, q7 = q
    v1, v2, v3, v4, v5, v6, v7 = v
    c, s = cos(q2), sin(q2)
    wx, wy, wz = -s * v1, v2, c * v1 + v3
    c, s = cos(q3), sin(q3)
    wx, wy = c * wx + s * wy, c * wy - s * wx
    x, y = model.shoulder_elbow * wy, -model.shoulder_elbow * wx
    fastest = hypot(x, y)
    wy -= v4
    c, s = cos(q4), sin(q4)
    wx, wz = c * wx + s * wz, c * wz - s * wx
    x, y, z = c * x + model.elbow_wrist * wy, y - model.elbow_wrist * wx, -s * x
    fastest = max(fastest, sqrt(x * x + y * y + z * z))
    c, s, wz = cos(q5), sin(q5), wz + v5
    wx, wy, x, y = c * wx + s * wy, c * wy - s * wx, c * x + s * y, c * y - s * x
    c, s, wy = cos(q6), sin(q6), wy + v6
    wx, wz, x, z = c * wx - s * wz, c * wz + s * wx, c * x - s * z, c * z + s * x
    x, y = x + model.wrist_flange * wy, y - model.wrist_flange * wx
    c, s, wz = cos(q7), sin(q7), wz + v7
    wx, wy, x, y = c * wx + s * wy, c * wy - s * wx, c * x + s * y, c * y - s * x
    return max(fastest, fastest_beyond(balls, (x, y, z), (wx, wy, wz)))


def fastest_beyond(balls: Iterable[Ball], v: Vector, w: Vector) -> float:
    """Returns the greatest speed of the flange and of a point in balls [m/s]; v, w: of the flange [m/s], [rad/s]."""
    (vx, vy, vz), (wx, wy, wz) = v, w
    turn, fastest = sqrt(wx * wx + wy * wy + wz * wz), sqrt(vx * vx + vy * vy + vz * vz)
    for x, y, z, radius in balls:
        a, b, c = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
        speed = sqrt(a * a + b * b + c * c) + radius * turn
        if speed > fastest:
            fastest = speed
    return fastest


def joint_frames(model: RobotModel, q: Sequence[float] | np.ndarray) -> Frames:
    """Returns the joint axes, the points shoulder, elbow, wrist and flange [m], and the axes of the flange."""
    q1, q2, q3, q4, q5, q6, q7 = map(float, q)
    x3, y3, z3 = zyz_axes(q1, q2, q3)
    c4, s4 = cos(q4), sin(q4)
    x4, z4 = combination(c4, x3, s4, z3), combination(-s4, x3, c4, z3)
    shoulder = (0.0, 0.0, model.base_shoulder)
    elbow = combination(1.0, shoulder, model.shoulder_elbow, z3)
    wrist = combination(1.0, elbow, model.elbow_wrist, z4)
    x, y, z = (combination(v[0], x4, v[1], y3, v[2], z4) for v in zyz_axes(q5, q6, q7))
    flange = combination(1.0, wrist, model.wrist_flange, z)
    y1 = (-sin(q1), cos(q1), 0.0)
    y5 = combination(-sin(q5), x4, cos(q5), y3)
    axes = ((0.0, 0.0, 1.0), y1, z3, (-y3[0], -y3[1], -y3[2]), z4, y5, z)
    return axes, shoulder, elbow, wrist, flange, (x, y, z)
