"""Detection targets: a single tag, or a bundle of tags that are rigidly fixed to each other.

The frame of a tag has its origin in the centre. Seen by a viewer who looks at the upright tag, x points right, y up and
z towards the viewer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from common.poses import read_only

CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
"""Corners of the black square in units of its edge: top left, top right, bottom right, bottom left."""


@dataclass(frozen=True, eq=False)
class TargetTag:
    """A tag of a target."""

    id: int  # number in the family
    size: float  # edge of the black square [m]
    T_target_tag: np.ndarray = field(default_factory=lambda: read_only(np.eye(4)))  # pose of the tag, shape (4, 4) [m]

    @property
    def corners(self) -> np.ndarray:
        """The corners in the frame of the target, in the order of `CORNERS`, shape (4, 3) [m]."""
        return self.size * CORNERS @ self.T_target_tag[:3, :3].T + self.T_target_tag[:3, 3]


@dataclass(frozen=True)
class TagTarget:
    """One tag or a bundle of tags that gets one pose; `name` is its tf frame."""

    name: str
    tags: tuple[TargetTag, ...]

    @property
    def corners(self) -> np.ndarray:
        """The corners of all tags in the frame of the target, shape (4 n, 3) [m]."""
        return np.concatenate([tag.corners for tag in self.tags])

    def matched(self, corners: dict[int, np.ndarray]) -> tuple[tuple[TargetTag, ...], np.ndarray, np.ndarray]:
        """Returns the detected tags of the target, and their corners in the target, shape (4 n, 3) [m], and in the
        image, shape (4 n, 2) [px], from the detected corners by tag id, each shape (4, 2) [px]."""
        tags = tuple(tag for tag in self.tags if tag.id in corners)
        if not tags:
            return (), np.empty((0, 3)), np.empty((0, 2))
        return tags, np.concatenate([tag.corners for tag in tags]), np.concatenate([corners[tag.id] for tag in tags])
