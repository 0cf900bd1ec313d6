"""Where a parallel gripper can take hold of what lies on the table: antipodal grasps in slices of a height map.

For each direction the map is turned until the jaws close along the rows. The map cut at the height of the finger tips
shows the contacts, the room for the fingers, and the normals, which must lie in the friction cone, also upwards: a ball
held above its equator slips out. Angles follow the image: from its horizontal, anticlockwise, modulo pi.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from grasping.poses.gripper import Gripper

LEVEL_M = 0.005  # distance between the heights at which the map is cut
LOWEST_OBJECT_M = 0.008  # what stands out of the table by less is table
FREE = 1e3  # depth of what is outside the map [m]


class Grasps(NamedTuple):
    """All grasps of a height map."""

    angles: np.ndarray  # directions, shape (k,) [rad]
    scores: np.ndarray  # 0 where there is no grasp, up to 1, shape (k, n, n)
    openings: np.ndarray  # between the pads before closing, shape (k, n, n) [m]


class Labels(NamedTuple):
    """The best grasp at each cell or pixel, each shape (h, w)."""

    quality: np.ndarray  # 0 to 1
    angle: np.ndarray  # modulo pi [rad]
    opening: np.ndarray  # [m] on a height map, [px] in an image
    known: np.ndarray  # where the label holds


def grasps(surface: np.ndarray, table: np.ndarray, cell: float, gripper: Gripper, directions: int = 12) -> Grasps:
    """Returns the score and opening of a grasp at each cell, `cell` [m] wide, for each direction. `surface` and `table`
    are depths, of what a parallel view sees and of the bare table, shape (n, n) [m].
    """
    margin = int(gripper.opening / cell)
    return in_directions(surface, table, margin, directions, lambda s, t: _along_rows(s, t, cell, gripper))


def in_directions(
    surface: np.ndarray,
    table: np.ndarray,
    margin: int,
    directions: int,
    along_rows: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> Grasps:
    """Returns the grasps of a hand in each direction; `margin`: what it needs around the objects [cells]; `along_rows`:
    returns score and opening of its grasps along the rows of the turned maps.
    """
    n = len(surface)
    angles = np.pi * np.arange(directions) / directions
    scores, openings = np.zeros((directions, n, n), np.float32), np.zeros((directions, n, n), np.float32)
    window = around(surface < table - LOWEST_OBJECT_M, (margin, margin))
    if window is None:
        return Grasps(angles, scores, openings)
    surface, table = surface[window].astype(np.float32), table[window].astype(np.float32)
    size = surface.shape
    for k, angle in enumerate(angles):
        turn, turn_back, turned_size = _turns(size, np.degrees(angle))
        flat = cv2.warpAffine(surface, turn, turned_size, flags=cv2.INTER_NEAREST, borderValue=(FREE,))
        ground = cv2.warpAffine(table, turn, turned_size, flags=cv2.INTER_LINEAR, borderValue=(FREE,))
        score, opening = along_rows(flat, ground)
        # A grasp is worth what its neighbours are worth too: the hand misses by millimetres.
        score = cv2.blur(score, (3, 3))
        back = size[::-1]
        scores[k][window] = cv2.warpAffine(score, turn_back, back, flags=cv2.INTER_LINEAR)
        openings[k][window] = cv2.warpAffine(opening, turn_back, back, flags=cv2.INTER_NEAREST)
    scores[openings == 0.0] = 0.0
    smooth = 0.5 * scores + 0.25 * (np.roll(scores, 1, axis=0) + np.roll(scores, -1, axis=0))
    return Grasps(angles, np.where(scores > 0.0, smooth, 0.0).astype(np.float32), openings)


def best(found: Grasps) -> Labels:
    """Returns the best direction at each cell, its angle refined by its two neighbours."""
    # Between directions about equally good, as on a disc, the one nearest to the horizontal is the target: one answer
    # that can be learnt, where the mean of several would be none.
    horizontal_bonus = 0.08
    bonus = horizontal_bonus * np.cos(2.0 * found.angles)[:, None, None]
    choice = np.argmax(np.where(found.scores > 0.0, found.scores + bonus, -1.0), axis=0)
    count = len(found.angles)

    def at(values: np.ndarray, k: np.ndarray) -> np.ndarray:
        return np.take_along_axis(values, (k % count)[None], axis=0)[0]

    quality = at(found.scores, choice)
    vector = sum(at(found.scores, choice + d) * np.exp(2j * found.angles[(choice + d) % count]) for d in (-1, 0, 1))
    angle = np.where(quality > 0.0, 0.5 * np.angle(vector), 0.0)
    return Labels(quality, angle, np.where(quality > 0.0, at(found.openings, choice), 0.0), np.ones_like(choice, bool))


def angle_at(found: Grasps, k: int, cell: tuple[int, int]) -> float:
    """Returns the angle of direction k at a cell, refined by its two neighbours [rad]."""
    count = len(found.angles)
    around = [(k + d) % count for d in (-1, 0, 1)]
    return float(0.5 * np.angle(sum(found.scores[(i, *cell)] * np.exp(2j * found.angles[i]) for i in around)))


def in_image(
    labels: Labels,
    surface: np.ndarray,
    cell: float,
    depth: np.ndarray,
    focal: float,
    T_map_camera: np.ndarray | None = None,
) -> Labels:
    """Returns the labels of an image's pixels. Side walls, which the parallel view does not see, have no label; outside
    the map lies the bare table. `surface`: the map, shape (n, n) [m], cells of `cell` [m]; `depth`: of the pixels,
    exact, shape (h, w) [m]; `focal`: length [px]; `T_map_camera`: of the camera in the map, whose origin is its middle
    and z its depth, shape (4, 4) [m], None if they are the same.
    """
    n = len(surface)
    row, column = np.indices(depth.shape)
    h, w = depth.shape
    x = (column - 0.5 * (w - 1)) / focal * depth
    y = (row - 0.5 * (h - 1)) / focal * depth
    below = depth
    if T_map_camera is not None:
        points = np.stack([x, y, depth], axis=-1) @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
        x, y, below = np.moveaxis(points, -1, 0)
    i, j = (np.round(c / cell + 0.5 * (n - 1)).astype(int) for c in (y, x))
    inside = (i >= 0) & (i < n) & (j >= 0) & (j < n)
    i, j = np.clip(i, 0, n - 1), np.clip(j, 0, n - 1)
    seen = np.abs(surface[i, j] - below) < 2.0 * cell
    quality = np.where(inside & seen, labels.quality[i, j], 0.0)
    return Labels(quality, labels.angle[i, j], labels.opening[i, j] / depth * focal, ~inside | seen)


def _along_rows(surface: np.ndarray, table: np.ndarray, cell: float, gripper: Gripper) -> tuple[np.ndarray, np.ndarray]:
    """Returns score and opening [m] of the grasps whose jaws close along the rows."""
    # how far the surface may stand out under a finger's pad beyond the point it should touch
    pad_unevenness_m = 0.0075
    half_pad = round(0.5 * gripper.breadth / cell)
    need = int(np.ceil((gripper.thickness + gripper.clearance) / cell))
    uneven = pad_unevenness_m / cell
    palm_size = (2 * int(0.5 * gripper.opening / cell) + 1, 2 * half_pad + 1)
    score, opening = np.zeros_like(surface), np.zeros_like(surface)
    tip = np.minimum(surface + gripper.reach, table - gripper.ground)
    level = np.floor(tip / LEVEL_M).astype(int)
    objects = surface < table - LOWEST_OBJECT_M
    margin = (half_pad + 3, palm_size[0] + need + 2)
    for wanted in np.unique(level[objects]):
        cut = wanted * LEVEL_M
        here = objects & (level == wanted) & (surface < cut)
        window = around(here, margin)
        if window is None:
            continue
        here, near = here[window], surface[window]
        high = near < cut - gripper.palm
        if high.any():
            here &= cv2.dilate(high.astype(np.uint8), np.ones(palm_size[::-1], np.uint8)) == 0
        y, x = np.nonzero(here)
        occupied = near < cut
        pad = cv2.dilate(occupied.astype(np.uint8), np.ones((2 * half_pad + 1, 1), np.uint8)) > 0
        left, right = _ends(occupied, y, x)
        pad_left, pad_right = _ends(pad, y, x)
        width = (pad_right - pad_left - 1) * cell + 2.0 * gripper.clearance
        fits = (width <= gripper.opening) & (pad_left >= need) & (pad_right < near.shape[1] - need)
        fits &= (left - pad_left <= uneven) & (pad_right - right <= uneven)
        y, x, left, right, pad_left, pad_right, width = (
            v[fits] for v in (y, x, left, right, pad_left, pad_right, width)
        )
        blurred = cv2.GaussianBlur(occupied.astype(np.float32), (0, 0), 1.5)
        across, along = cv2.Sobel(blurred, cv2.CV_32F, 0, 1), cv2.Sobel(blurred, cv2.CV_32F, 1, 0)
        slope = np.abs(across) / np.maximum(np.abs(along), 1e-6)
        worst = np.maximum(slope[y, left + 1], slope[y, right - 1])
        top = cut - near[y, x]
        for inner in (np.minimum(left + 2, right - 1), np.maximum(right - 2, left + 1)):
            # How far the face leans: its rise over the cell and a half from the contact; one that reaches the top
            # so soon is upright.
            rise = cut - near[y, inner]
            worst = np.maximum(worst, np.where(rise > 0.8 * top, 0.0, 1.5 * cell / np.maximum(rise, 1e-6)))
        filled = np.cumsum(np.pad(pad, ((0, 0), (1, 0))), axis=1, dtype=np.int16)
        room = filled[y, pad_left + 1] == filled[y, pad_left + 1 - need]
        room &= filled[y, pad_right + need] == filled[y, pad_right]
        steady = np.clip(1.0 - worst / gripper.friction, 0.0, 1.0)
        half = 0.5 * (pad_right - pad_left)
        centring = np.clip(1.0 - np.abs(x - 0.5 * (pad_left + pad_right)) / half, 0.0, 1.0)
        good = room & (worst < gripper.friction)
        score[window][y[good], x[good]] = (centring * (0.3 + 0.7 * steady))[good]
        opening[window][y[good], x[good]] = np.minimum(width[good] + gripper.margin, gripper.opening)
    return score, opening


def _ends(occupied: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the free columns on the left and right of the run of occupied cells that holds (y, x)."""
    last = occupied.shape[1]
    column = np.arange(last, dtype=np.int16)
    left = np.maximum.accumulate(np.where(occupied, np.int16(-1), column), axis=1)[y, x]
    right = np.minimum.accumulate(np.where(occupied, np.int16(last), column)[:, ::-1], axis=1)[y, last - 1 - x]
    return left.astype(int), right.astype(int)


def around(mask: np.ndarray, margin: tuple[int, int]) -> tuple[slice, slice] | None:
    """Returns the smallest window that holds the mask and `margin` cells around it, None when there is nothing."""
    rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
    if not len(rows):
        return None
    high, wide = (slice(max(0, v[0] - m), v[-1] + m + 1) for v, m in zip((rows, columns), margin))
    return high, wide


def _turns(size: tuple[int, ...], degrees: float) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Returns the affine maps that turn an image so that `degrees` becomes horizontal, and back, and the new size."""
    h, w = size
    c, s = abs(np.cos(np.radians(degrees))), abs(np.sin(np.radians(degrees)))
    turned = (int(np.ceil(w * c + h * s)) + 1, int(np.ceil(w * s + h * c)) + 1)
    forward = np.asarray(cv2.getRotationMatrix2D((0.5 * (w - 1), 0.5 * (h - 1)), -degrees, 1.0), dtype=float)
    forward[:, 2] += 0.5 * (turned[0] - w), 0.5 * (turned[1] - h)
    return forward, cv2.invertAffineTransform(forward), turned
