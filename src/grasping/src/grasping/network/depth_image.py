"""From a depth image to the network's input: crop, fill holes, scale to 300 x 300, take off the mean; and its planes.

The steps are those of the published node (ggcnn_kinova_grasping), except that holes are filled before the image is
scaled: a missing pixel would otherwise spoil all that are interpolated from it.
A plane is a vector a, shape (3,) [1/m], with a . X = 1 for its points X: the unit vector along it points away from the
camera, its length is one over the distance. Along a pixel's ray (x, y, 1) the inverse depth is a . ray, linear in a,
and the noise of a structured-light camera is nearly constant there.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import cv2
import numpy as np

CAMERA, TABLE = "camera", "table"  # views as named in ggcnn.yaml, in datasets and in weight files
VIEWS = (CAMERA, TABLE)
NETWORK_SIDE = 300
CROP_SIDE = 400
TRIPLES = 64  # hypotheses: with a third of the pixels in the plane, one triple has no outlier in nine of ten images
AT_ONCE = 2**16  # distances from hypotheses that are judged at once: more would not stay in the processor's cache
GATE_SD = 3.0
ROUNDS = 3
FLAT = 1e-9  # a smaller determinant is of three pixels in a row
NOISE = 0.003  # standard deviation of a pixel's inverse depth [1/m]
EVERY = 5  # step between the rows and columns that are used


class Crop(NamedTuple):
    """A square window of the camera's image."""

    row: int  # first row
    column: int  # first column
    side: int  # rows and columns


class NetworkImage(NamedTuple):
    """What the network sees."""

    crop: Crop  # where it was cut from the camera's image
    input: np.ndarray  # network input, shape (300, 300), float32, in [-1, 1] [m]
    depth: np.ndarray  # the same without holes and with its mean, shape (300, 300) [m]
    valid: np.ndarray  # where the camera had a reading, shape (300, 300), bool
    mean: float  # what was taken off [m]


def centre_crop(shape: tuple[int, ...], side: int = CROP_SIDE, rows_up: int = 0) -> Crop:
    """Returns the middle window of an image of `shape`, moved up by `rows_up`; raises ValueError if it does not fit."""
    row, column = (shape[0] - side) // 2 - rows_up, (shape[1] - side) // 2
    if side < 1 or row < 0 or column < 0 or row + side > shape[0]:
        raise ValueError(f"a crop of {side} x {side}, moved up by {rows_up}, does not fit {shape[1]} x {shape[0]}")
    return Crop(row, column, side)


def prepare(depth: np.ndarray, crop: Crop, side: int = NETWORK_SIDE) -> NetworkImage:
    """Returns the network's image of a window of the camera's, shape (h, w) [m]; not finite or not positive = no
    reading. Raises ValueError if the window holds no reading.
    """
    window = depth[crop.row : crop.row + crop.side, crop.column : crop.column + crop.side].astype(np.float32)
    valid = np.isfinite(window) & (window > 0.0)
    if not valid.any():
        raise ValueError("the depth image holds no reading inside the crop")
    scaled = cv2.resize(fill_holes(window, valid), (side, side), interpolation=cv2.INTER_LINEAR)
    seen = cv2.resize(valid.astype(np.uint8), (side, side), interpolation=cv2.INTER_NEAREST) > 0
    mean = float(scaled.mean())
    return NetworkImage(crop, np.clip(scaled - mean, -1.0, 1.0), scaled, seen, mean)


def fill_holes(depth: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Returns the image inpainted (Navier-Stokes) where not `valid`, shape (h, w), float32 [m]; one pixel must be."""
    if valid.all():
        return depth
    # The method leaves the outermost pixels alone: a mirrored border of one pixel makes them inner ones.
    known = np.where(valid, depth, np.float32(0.0))
    bordered = cv2.copyMakeBorder(known, 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    holes = cv2.copyMakeBorder((~valid).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    scale = float(np.abs(bordered).max())
    filled = cv2.inpaint(bordered / np.float32(scale), holes, 1, cv2.INPAINT_NS)
    return filled[1:-1, 1:-1] * np.float32(scale)


class PlaneFound(NamedTuple):
    """A plane in an image."""

    a: np.ndarray  # shape (3,) [1/m]
    share: float  # of the pixels that lie in it

    @property
    def direction(self) -> np.ndarray:
        """Unit vector across the plane, away from the camera, shape (3,)."""
        return self.a / np.linalg.norm(self.a)

    @property
    def distance(self) -> float:
        """Of the plane from the camera [m]."""
        return float(1.0 / np.linalg.norm(self.a))


def best_plane(rays: np.ndarray, depth: np.ndarray, noise: float) -> PlaneFound | None:
    """Returns the plane that most pixels lie in, None if there are too few; the same pixels give the same plane.
    `rays`: of the pixels, x, y, 1, shape (n, 3); `depth`: shape (n,) [m], finite and positive; `noise`: standard
    deviation of the inverse depth [1/m].
    """
    if len(depth) < 3:
        return None
    pixels, gate = _pixels(rays, depth), GATE_SD * noise
    planes = _planes(pixels[:, _picks(len(depth))])
    if not len(planes):
        return None
    step = max(1, AT_ONCE // len(depth))
    parts = (planes[i : i + step] for i in range(0, len(planes), step))
    cost = [_clipped(part @ pixels, gate) for part in parts]
    return _refined(planes[np.argmin(np.concatenate(cost))], pixels, gate)


def same_plane(known: PlaneFound, rays: np.ndarray, depth: np.ndarray, noise: float) -> PlaneFound | None:
    """Returns a known plane as other pixels show it, without a search; None if too few lie in it. Arguments: as of
    `best_plane`.
    """
    return _refined(np.append(known.a, -1.0), _pixels(rays, depth), GATE_SD * noise)


def _pixels(rays: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Returns x, y, 1 and the inverse depth of pixels, shape (4, n). The product of a plane's a and -1 with them is how
    far off the plane they are.
    """
    pixels = np.empty((4, len(depth)))
    pixels[:3] = rays.T
    np.divide(1.0, depth, out=pixels[3], dtype=float)
    return pixels


def _planes(triples: np.ndarray) -> np.ndarray:
    """Returns the planes through those triples of pixels, shape (4, m, 3), that are not in a row: a and -1, (k, 4)."""
    x, y, _, inverse = triples[..., 0]
    (x1, x2), (y1, y2), _, (z1, z2) = np.moveaxis(triples[..., 1:] - triples[..., :1], 2, 1)
    area = x1 * y2 - x2 * y1
    wide = np.abs(area) > FLAT
    area[~wide] = 1.0
    planes = np.full((len(area), 4), -1.0)
    planes[:, 0] = a = (z1 * y2 - z2 * y1) / area
    planes[:, 1] = b = (x1 * z2 - x2 * z1) / area
    planes[:, 2] = inverse - a * x - b * y
    return planes if wide.all() else planes[wide]


def _clipped(off: np.ndarray, gate: float) -> np.ndarray:
    """Returns the sums over the pixels of how far planes are off, at most the gate each; `off` is overwritten."""
    np.abs(off, out=off)
    np.minimum(off, gate, out=off)
    return off.sum(axis=1)


def _refined(plane: np.ndarray, pixels: np.ndarray, gate: float) -> PlaneFound | None:
    """Returns the plane, shape (4,), fitted to the pixels, shape (4, n), within the gate; None if they are no plane."""
    for _ in range(ROUNDS):
        inside = pixels.compress(np.abs(plane @ pixels) < gate, axis=1)
        (xx, xy, x, xz), (_, yy, y, yz), (_, _, n, z), _ = (inside @ inside.T).tolist()
        # The inverse of a symmetric matrix by its cofactors.
        a, b, c, d, e, f = (
            yy * n - y * y,
            x * y - xy * n,
            xy * y - x * yy,
            xx * n - x * x,
            xy * x - xx * y,
            xx * yy - xy * xy,
        )
        determinant = xx * a + xy * b + x * c
        if determinant < FLAT:
            return None
        solution = a * xz + b * yz + c * z, b * xz + d * yz + e * z, c * xz + e * yz + f * z
        plane = np.array([*(value / determinant for value in solution), -1.0])
    if not plane[:3].any():
        return None
    return PlaneFound(plane[:3], np.count_nonzero(np.abs(plane @ pixels) < gate) / pixels.shape[1])


@functools.lru_cache(maxsize=1024)
def _picks(count: int) -> np.ndarray:
    """Returns the triples of `count` pixels that hypotheses are made of, shape (TRIPLES, 3)."""
    picks = np.random.default_rng(0).integers(0, count, (TRIPLES, 3))
    picks.setflags(write=False)
    return picks
