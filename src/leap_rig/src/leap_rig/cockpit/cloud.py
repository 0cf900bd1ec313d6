"""A point cloud (sensor_msgs/PointCloud2 of ROS), thinned to what a page can draw."""

from __future__ import annotations

from typing import Any

import numpy as np

MOST_POINTS = 12_000
FLOAT32, UINT32 = 7, 6
NUMBERS = ("x", "y", "z")
NEARER = 0.985  # points are drawn so much nearer to the camera than the table on which they lie, which would hide them


class CloudFault(ValueError):
    """A point cloud cannot be drawn; the message says why."""


def thinned(cloud: Any, most: int = MOST_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions, shape (n, 3) [m], and colours, shape (n, 3), bytes, of at most `most` points; the same
    pixels in each cloud of a size, so that a still scene keeps still. Raises CloudFault."""
    fields = {field.name: field for field in cloud.fields}
    colour = next((fields[name] for name in ("rgb", "rgba") if name in fields), None)
    used = [fields[name] for name in NUMBERS if name in fields]
    if len(used) < len(NUMBERS) or any(field.datatype != FLOAT32 for field in used):
        raise CloudFault("its points have no x, y, z of the type float32")
    if colour is not None and colour.datatype not in (FLOAT32, UINT32):
        raise CloudFault("its colours are neither float32 nor uint32")
    step, row = cloud.point_step, cloud.row_step
    ends = [field.offset + 4 for field in (*used, *([colour] if colour else []))]
    if max(ends) > step or step * cloud.width > row or row * cloud.height != len(cloud.data):
        raise CloudFault(f"{len(cloud.data)} bytes are not {cloud.height} rows of {cloud.width} points")
    if not cloud.data:
        return np.zeros((0, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.uint8)
    every = 1
    while -(-cloud.height // every) * -(-cloud.width // every) > most:
        every += 1
    rows = np.frombuffer(cloud.data, dtype=np.uint8).reshape(cloud.height, row)[::every, : step * cloud.width]
    pixels = np.ascontiguousarray(rows.reshape(len(rows), cloud.width, step)[:, ::every]).reshape(-1, step)
    number = np.dtype(np.float32).newbyteorder(">" if cloud.is_bigendian else "<")
    columns = [np.ascontiguousarray(pixels[:, f.offset : f.offset + 4]).view(number)[:, 0] for f in used]
    points: np.ndarray = NEARER * np.stack(columns, axis=1).astype(np.float32)
    seen = np.isfinite(points).all(axis=1) & (np.abs(points) < 50.0).all(axis=1)
    if colour is None:
        colours = np.full((len(points), 3), 200, dtype=np.uint8)
    else:
        bgr = pixels[:, colour.offset : colour.offset + 4]
        colours = bgr[:, 1:4] if cloud.is_bigendian else bgr[:, 2::-1]
    return points[seen], np.ascontiguousarray(colours[seen])
