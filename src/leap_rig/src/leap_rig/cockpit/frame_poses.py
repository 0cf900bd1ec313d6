"""Poses as tf has them: seven numbers, position x, y, z [m] and unit quaternion x, y, z, w."""

from __future__ import annotations

import math
from collections.abc import Iterable
from operator import mul
from typing import Any, Sequence

from common.frames import frame_name

Pose7 = Sequence[float]
IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def compose(a: Pose7, b: Pose7) -> tuple[float, ...]:
    """Returns the pose b in the frame that a is in, where b is in the frame a."""
    x, y, z = turned(a[3:], b[:3])
    i, j, k, w = a[3:]
    p, q, r, s = b[3:]
    return (
        *(a[0] + x, a[1] + y, a[2] + z),
        *(w * p + i * s + j * r - k * q, w * q - i * r + j * s + k * p),
        *(w * r + i * q - j * p + k * s, w * s - i * p - j * q - k * r),
    )


def turned(q: Pose7, v: Sequence[float]) -> tuple[float, float, float]:
    """Returns the vector v turned by the unit quaternion q."""
    i, j, k, w = q
    x, y, z = v
    a, b, c = 2.0 * (j * z - k * y), 2.0 * (k * x - i * z), 2.0 * (i * y - j * x)
    return x + w * a + j * c - k * b, y + w * b + k * a - i * c, z + w * c + i * b - j * a


def differ(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether an eye sees the difference of two positions, half a millimetre, or of two unit quaternions, about a
    thousandth of a radian."""
    visible = 5e-4
    if len(a) == 3:
        return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[2] - b[2])) > visible
    side = 1.0 if sum(map(mul, a, b)) >= 0.0 else -1.0
    return any(abs(p - side * q) > visible for p, q in zip(a, b))


def angle_between(a: Pose7, b: Pose7) -> float:
    """Returns by how much the orientations of two poses differ, 0 to pi [rad]."""
    return 2.0 * math.acos(min(abs(sum(map(mul, a[3:], b[3:]))), 1.0))


class FramePoses:
    """The newest transforms of tf."""

    def __init__(self) -> None:
        self._transforms: dict[str, tuple[str, Pose7, float]] = {}

    def put(self, parent: str, child: str, numbers: Pose7, now: float) -> None:
        """Takes a transform that was received at `now` [s, monotonic; infinite for a static one]."""
        most = 2_000  # frames
        if child in self._transforms or len(self._transforms) < most:
            self._transforms[child] = parent, numbers, now

    def take(self, transforms: Iterable[Any], now: float) -> None:
        """Takes the transforms of a message of tf, likewise."""
        for one in transforms:
            p, q = one.transform.translation, one.transform.rotation
            numbers = p.x, p.y, p.z, q.x, q.y, q.z, q.w
            self.put(frame_name(one.header.frame_id), frame_name(one.child_frame_id), numbers, now)

    def relative(self, parent: str, child: str) -> Pose7 | None:
        """Returns the pose of a frame in its parent, None if that is unknown."""
        found = self._transforms.get(child)
        return found[1] if found is not None and found[0] == parent else None

    def received(self, child: str) -> float:
        """When a frame came last, infinite for a static one or a root; a frame that never came: 0."""
        found = self._transforms.get(child)
        return found[2] if found is not None else 0.0

    def chain(self, frame: str) -> tuple[str, Pose7] | None:
        """Returns the root that a frame hangs on, maybe by others, and its pose there; None in a circle."""
        longest = 64
        whole: Pose7 = IDENTITY
        for _ in range(longest):
            found = self._transforms.get(frame)
            if found is None:
                return frame, whole
            frame, numbers, _ = found
            whole = compose(numbers, whole)
        return None

    def between(self, base: str, frame: str) -> Pose7 | None:
        """Returns the pose of a frame in another one, None if they hang on nothing in common."""
        one, other = self.chain(base), self.chain(frame)
        if one is None or other is None or one[0] != other[0]:
            return None
        back = *(-part for part in one[1][3:6]), one[1][6]
        away = *(-part for part in turned(back, one[1][:3])), *back
        return compose(away, other[1])
