"""What is looked for: a single tag, or a bundle of tags that are rigidly fixed to each other.

The frame of a tag has its origin in the centre, x to the right and y up for who looks at it upright, z towards him.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from common.poses import read_only

CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
"""Corners of the black square in units of its edge: top left, top right, bottom right, bottom left."""


@dataclass(frozen=True, eq=False)
class TagPlace:
    """A tag in its target.

    Attributes:
        id: number in the family.
        size: edge of the black square [m].
        T_target_tag: pose of the tag, shape (4, 4) [m].
    """

    id: int
    size: float
    T_target_tag: np.ndarray = field(default_factory=lambda: read_only(np.eye(4)))

    @property
    def corners(self) -> np.ndarray:
        """The corners in the frame of the target, in the order of `CORNERS`, shape (4, 3) [m]."""
        return self.size * CORNERS @ self.T_target_tag[:3, :3].T + self.T_target_tag[:3, 3]


@dataclass(frozen=True)
class Target:
    """What gets one pose.

    Attributes:
        name: frame in tf.
        tags: one for a single tag, more for a bundle.
    """

    name: str
    tags: tuple[TagPlace, ...]

    def matched(self, seen: dict[int, np.ndarray]) -> tuple[tuple[TagPlace, ...], np.ndarray, np.ndarray]:
        """Returns the tags of the target that were seen, their corners in the target, shape (n, 3) [m], and in the
        picture, shape (n, 2) [px].

        Args:
            seen: corners in the picture, shape (4, 2) [px], by id.
        """
        tags = tuple(tag for tag in self.tags if tag.id in seen)
        if not tags:
            return (), np.empty((0, 3)), np.empty((0, 2))
        return tags, np.concatenate([tag.corners for tag in tags]), np.concatenate([seen[tag.id] for tag in tags])
