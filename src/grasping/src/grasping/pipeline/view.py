"""The image that the network gets, and where it was taken from: the camera's own, or one from above the table.

The networks learned on images from above, and take the far edge of a table seen from the side for most graspable. So
the depth image is drawn anew from straight above: each reading goes where it lies, what is not above the table becomes
table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from common.camera_model import CameraModel, pinhole
from common.config import integer, number
from common.plane_fit import GATE_SD
from common.poses import pose, read_only
from common.rotations import cross, unit
from grasping.network.depth_image import (
    NETWORK_SIDE,
    Crop,
    NetworkImage,
    PlaneFound,
    best_plane,
    centre_crop,
    prepare,
)

GAP = np.ones((5, 5), np.uint8)


@dataclass(frozen=True)
class CropConfig:
    """Which part of the camera's image is looked at."""

    side: int = integer("px", low=12, high=4096, doc="rows and columns of the square window")
    rows_up: int = integer("px", low=-2048, high=2048, doc="how far it stands above the image's middle")


@dataclass(frozen=True)
class TableConfig:
    """The view from above the table."""

    extent: float = number("m", above=0.05, high=2.0, doc="of the table that the view shows, in both directions")
    distance: float = number("m", above=0.1, high=3.0, doc="of the view's camera from the table")
    noise: float = number("1/m", above=0.0, high=0.1, doc="standard deviation of a pixel's inverse depth")
    min_share: float = number(above=0.0, high=1.0, doc="of the window's readings that must lie on the table")
    max_slope: float = number("deg", above=0.0, below=85.0, doc="steepest line of sight, against the table's normal")
    min_height: float = number("m", above=0.0, high=0.2, doc="what is lower belongs to the table")
    max_height: float = number("m", above=0.0, high=1.0, doc="what is higher is no object: the arm")
    keep_angle: float = number("deg", above=0.0, high=45.0, doc="the view stays while the table turns by less")
    keep_distance: float = number("m", above=0.0, high=0.5, doc="and while it moves by less")


class GraspView(NamedTuple):
    """What the network sees, and the camera that sees it."""

    image: NetworkImage  # the network's
    graspable: np.ndarray  # where a grasp may be: has a reading, and from above is on an object; (300, 300), bool
    depth: np.ndarray  # the whole image that it was cut from, shape (h, w) [m], NaN where nothing is known
    rays: np.ndarray  # direction of each of its pixels, shape (h, w, 3)
    camera: CameraModel  # that took it, a real or an imagined one
    T_camera_view: np.ndarray
    """Pose of that camera in the real one, shape (4, 4) [m]. The refinement has its axes: an imagined
    camera's z axis is straight down on the table, its x axis the real camera's as far as the table lets it."""


class NoView(Exception):
    """There is nothing to show to the network; the message is the reason, a clause without its full stop."""


class CameraView:
    """Shows the camera's own image: the window in its middle."""

    def __init__(self, crop: CropConfig) -> None:
        self._crop = crop
        self._rays = Rays()

    def step(self, depth: np.ndarray, camera: CameraModel) -> GraspView:
        """Returns the view of a depth image, shape (h, w) [m]; raises NoView if the window does not fit or is empty."""
        crop = _window(depth, self._crop)
        try:
            image = prepare(depth, crop)
        except ValueError as error:
            raise NoView(str(error)) from None
        return GraspView(image, image.valid, depth, self._rays.of(camera), camera, read_only(np.eye(4)))

    def reset(self) -> None:
        """Forgets nothing: each image stands for itself."""


class _Place(NamedTuple):
    """Where the view from above the table is."""

    made_for: tuple[bytes, bytes, tuple[int, ...], Crop]  # camera, size and window of the images that it is for
    table: PlaneFound  # as it was found
    T: np.ndarray  # pose of the view's camera in the real one, shape (4, 4) [m]
    turned: np.ndarray  # directions of the real camera's pixels in the view's axes, shape (3, h, w), float32
    shift: np.ndarray  # of the real camera in the view's axes, shape (3,), float32 [m]
    above: np.ndarray  # depth at which each of its pixels would still show table, shape (h, w), float32 [m]


class TableView:
    """Shows the table from above. The view stays where it is while the table seems to shake only."""

    def __init__(self, crop: CropConfig, config: TableConfig) -> None:
        self._crop, self._config = crop, config
        self._rays = Rays()
        focal, centre = NETWORK_SIDE / config.extent * config.distance, 0.5 * (NETWORK_SIDE - 1)
        K = [[focal, 0.0, centre], [0.0, focal, centre], [0.0, 0.0, 1.0]]
        self._camera = pinhole("above the table", NETWORK_SIDE, NETWORK_SIDE, K)
        self._own_rays = read_only(_all_rays(self._camera))
        self.reset()

    def reset(self) -> None:
        self._place: _Place | None = None

    def step(self, depth: np.ndarray, camera: CameraModel) -> GraspView:
        """Returns the view of a depth image, shape (h, w) [m]. Raises NoView if the window does not fit or holds no
        reading, no table is seen, or nothing stands on it.
        """
        crop = _window(depth, self._crop)
        rays = self._rays.of(camera)
        seen_from = self._find(depth, rays, crop, camera)
        height = self._heights(depth, seen_from)
        above = height > 0.0
        if not above.any():
            raise NoView("nothing stands on the table")
        seen = np.float32(self._config.distance) - height
        mean = float(seen.mean())
        inside = Crop(0, 0, NETWORK_SIDE)
        # What is not above the table is known to be table.
        known = np.ones(seen.shape, bool)
        image = NetworkImage(inside, np.clip(seen - mean, -1.0, 1.0), seen, known, mean)
        return GraspView(image, above, seen, self._own_rays, self._camera, seen_from.T)

    def _find(self, depth: np.ndarray, rays: np.ndarray, crop: Crop, camera: CameraModel) -> _Place:
        """Returns where the table is, and moves the view if it is another one; raises NoView without a table."""
        stride = 6  # pixels of the camera's image, in rows and columns, to one in which the table is looked for
        rounded = 1e-5  # error of a height in single precision, at most [m]
        window = (slice(crop.row, crop.row + crop.side, stride), slice(crop.column, crop.column + crop.side, stride))
        known = np.isfinite(depth[window]) & (depth[window] > 0.0)
        if not known.any():
            raise NoView("the depth image holds no reading inside the crop")
        c = self._config
        seen_rays, seen_depth = rays[window][known], depth[window][known]
        middle = rays[crop.row + crop.side // 2, crop.column + crop.side // 2].astype(float)
        made_for = (camera.K.tobytes(), camera.D.tobytes(), depth.shape, crop)
        place = self._place if self._place is not None and self._place.made_for == made_for else None
        table = best_plane(seen_rays, seen_depth, c.noise)
        if table is None or table.share < c.min_share:
            share = 0.0 if table is None else table.share
            raise NoView(f"no table is seen: {share:.0%} of the pixels lie in one plane")
        slope = _slope(table, middle)
        if slope > c.max_slope:
            raise NoView(f"the largest plane is seen too flatly to be the table: {slope:.0f} degrees off its normal")
        if place is not None and self._same(place.table, table):
            return place
        on_it = np.abs(seen_rays.astype(float) @ table.a - 1.0 / seen_depth) < GATE_SD * c.noise
        shown = (seen_rays[on_it].astype(float) * seen_depth[on_it, None]).mean(axis=0)
        T = read_only(_looking_down(table, shown, c.distance))
        R, p = T[:3, :3], T[:3, 3]
        turned = np.ascontiguousarray(np.moveaxis(rays @ R, -1, 0), np.float32)
        shift = (-R.T @ p).astype(np.float32)
        with np.errstate(divide="ignore"):
            nearest = np.where(turned[2] > 0.0, (c.distance - c.min_height + rounded - shift[2]) / turned[2], np.inf)
        self._place = _Place(made_for, table, T, turned, shift, nearest.astype(np.float32))
        return self._place

    def _same(self, known: PlaneFound, table: PlaneFound) -> bool:
        turned = np.degrees(np.arccos(np.clip(table.direction @ known.direction, -1.0, 1.0)))
        moved = abs(table.distance - known.distance)
        return bool(turned < self._config.keep_angle and moved < self._config.keep_distance)

    def _heights(self, depth: np.ndarray, place: _Place) -> np.ndarray:
        """Returns the height above the table in the view, gaps closed, shape (300, 300), float32 [m]; 0: table."""
        c, side, turned, shift = self._config, NETWORK_SIDE, place.turned, place.shift
        with np.errstate(invalid="ignore"):
            chosen = np.flatnonzero(depth < place.above)
        flat = depth.ravel()[chosen]
        x, y, z = (flat * turned[i].ravel()[chosen] + shift[i] for i in range(3))
        height = np.float32(c.distance) - z
        scale, centre = self._camera.K[0, 0], self._camera.K[0, 2]
        with np.errstate(invalid="ignore", divide="ignore"):
            u, v = (np.rint(p / z * scale + centre) for p in (x, y))
        shown = (height > c.min_height) & (height < c.max_height) & (flat > 0.0)
        shown &= (u >= 0.0) & (u < side) & (v >= 0.0) & (v < side)
        pixels = v[shown].astype(np.int32) * side + u[shown].astype(np.int32)
        highest = np.zeros(side * side, np.float32)
        np.maximum.at(highest, pixels, height[shown])
        highest = highest.reshape(side, side)
        closed = cv2.morphologyEx(highest, cv2.MORPH_CLOSE, GAP)
        np.copyto(closed, highest, where=highest > 0.0)
        return closed


class Rays:
    """The directions of a camera's pixels, computed once for each camera."""

    def __init__(self) -> None:
        self._made_for: tuple[bytes, bytes, int, int] | None = None
        self._rays = np.zeros((0, 0, 3), np.float32)

    def of(self, camera: CameraModel) -> np.ndarray:
        """Returns the directions, shape (height, width, 3), float32, read-only."""
        made_for = (camera.K.tobytes(), camera.D.tobytes(), camera.width, camera.height)
        if made_for != self._made_for:
            self._rays = _all_rays(camera).astype(np.float32)
            self._rays.setflags(write=False)
            self._made_for = made_for
        return self._rays


def _all_rays(camera: CameraModel) -> np.ndarray:
    return camera.rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1))


def _window(depth: np.ndarray, crop: CropConfig) -> Crop:
    try:
        return centre_crop(depth.shape, crop.side, crop.rows_up)
    except ValueError as error:
        raise NoView(str(error)) from None


def _slope(table: PlaneFound, middle: np.ndarray) -> float:
    """Returns the angle between a direction `middle`, shape (3,), and the table's normal [deg]."""
    return float(np.degrees(np.arccos(np.clip(unit(middle) @ table.direction, -1.0, 1.0))))


def _looking_down(table: PlaneFound, middle: np.ndarray, distance: float) -> np.ndarray:
    """Returns the pose of a camera above `middle`, shape (3,) [m], its x axis nearest to the real camera's."""
    z = table.direction
    x = unit(np.array([1.0, 0.0, 0.0]) - z[0] * z)
    return pose(np.column_stack([x, cross(z, x), z]), middle + (table.distance - middle @ z - distance) * z)
