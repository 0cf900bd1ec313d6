"""Where the table would be seen if nothing stood on it: what an operator's idea of high and low refers to.

A camera that leans sees the near side of a bare table centimetres nearer than the far side; the heights of things are
seen against that, not against the image's mean.
"""

from __future__ import annotations

import numpy as np

from grasping.network.depth_image import NetworkImage
from grasping.network.planes import best_plane

NOISE = 0.003
"""Standard deviation of a pixel's inverse depth [1/m]."""
EVERY = 5
"""Step between the rows and columns that are used."""
FARTHEST_M = 10.0
"""Of a table that is seen nearly edge on."""


def table_depth(image: NetworkImage) -> np.ndarray:
    """Returns the depth of the plane that most of the image lies in, shape (h, w), float32 [m]; the image's mean
    where no plane is found."""
    h, w = image.depth.shape
    row, column = np.indices((h, w))
    # A plane's inverse depth is linear in rows and columns, whatever the camera's focal length.
    rays = np.stack([column / w - 0.5, row / h - 0.5, np.ones((h, w))], axis=-1)
    part = (slice(EVERY // 2, None, EVERY),) * 2
    seen = image.valid[part]
    found = best_plane(rays[part][seen], image.depth[part][seen], NOISE)
    if found is None:
        return np.full((h, w), image.mean, np.float32)
    return (1.0 / np.maximum(rays @ found.a, 1.0 / FARTHEST_M)).astype(np.float32)
