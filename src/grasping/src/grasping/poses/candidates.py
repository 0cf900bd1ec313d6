"""The places of an image that can be grasped, and what can be seen of each, by which an operator may choose.

The level frame: origin in the camera's optical centre, z down across the table, x the image's x axis laid into it, y
towards who stands below the image. Features are in an object's own axes where it has some: its long axis, its middle,
its bulk (the thickest place of its outline) and its lighter end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from common.camera_model import CameraModel
from common.poses import read_only
from common.rotations import cross, unit
from grasping.network.depth_image import EVERY, NOISE, Crop, NetworkImage, best_plane
from grasping.network.maps import Maps, Peak, gaussian, half_turn, peaks

OTHER_LINES = (0.25 * np.pi, 0.5 * np.pi, -0.25 * np.pi)  # turned from that line [rad]
LENGTH_M = 0.05  # makes lengths about 1

TASTES = (
    "quality",  # smoothed, of GGCNN
    "height",  # above the table
    "below top",  # of the object
    "opening",
    "along",  # distance from the middle along the long axis, by half the object's length
    "towards lighter end",  # the same with a sign, as far as the ends differ
    "aside",  # distance from the long axis, by half the object's width
    "from middle",
    "from bulk",
    "thickness",  # of the outline here, by that of the bulk
    "across",  # cosine of twice the angle between line and long axis, as far as there is one
    "right",  # of the middle
    "towards operator",
    "line cos",  # of twice the angle in the image
    "line sin",
    "rim",  # fraction of the surroundings that is table
    "certainty",  # of GGCNN's line
    "against line",  # how far a line is from GGCNN's, as far as that one is certain
)


class LevelFrame(NamedTuple):
    """The table as a camera sees it."""

    R: np.ndarray  # of the level frame in the camera's, shape (3, 3)
    distance: float  # from the camera [m]


class Candidates(NamedTuple):
    """n places that can be grasped, the best quality first."""

    peaks: tuple[Peak, ...]  # in the network's image
    frame: LevelFrame
    points: np.ndarray  # on the surface in the level frame, shape (n, 3) [m]
    angles: np.ndarray  # of the lines through the fingers, anticlockwise in the image, shape (n,) [rad]
    openings: np.ndarray  # shape (n,) [m]
    slopes: np.ndarray  # of the surface, down by x and y, an edge being none, shape (n, 2)
    tastes: np.ndarray  # shape (n, len(TASTES)), about 1

    @property
    def quality(self) -> np.ndarray:
        """Smoothed, of GGCNN, shape (n,)."""
        return self.tastes[:, TASTES.index("quality")]

    @property
    def heights(self) -> np.ndarray:
        """Above the table, shape (n,) [m]."""
        return self.frame.distance - self.points[:, 2]


def candidates(
    maps: Maps, certainty: np.ndarray, image: NetworkImage, camera: CameraModel, frame: LevelFrame
) -> Candidates:
    """Returns the candidates of smoothed maps; `certainty`: length of GGCNN's (cos, sin), shape of the maps."""
    ambiguous = 0.7  # where GGCNN is less certain of its line, others are candidates as well
    found = covering(maps)
    turns = np.zeros(len(found))
    for peak, sure in [(p, certainty[p.row, p.column]) for p in found]:
        if sure < ambiguous:
            found += [_turned(peak, turn) for turn in OTHER_LINES]
            turns = np.append(turns, OTHER_LINES)
    order = np.argsort([-p.quality for p in found], kind="stable")
    return described([found[i] for i in order], turns[order], certainty, image, camera, frame)


def _turned(peak: Peak, turn: float) -> Peak:
    other_quality = 0.8  # of the candidates on other lines, as a fraction of that on GGCNN's line
    return peak._replace(angle=half_turn(peak.angle + turn), quality=other_quality * peak.quality)


def covering(maps: Maps) -> list[Peak]:
    """Returns the best peak and pixels of no better quality, best first, 4 rows or columns apart."""
    spacing = 4  # between two candidates, rows or columns [px of the network's image]
    most = 96  # candidates in an image
    least_quality = 0.1  # of a candidate, smoothed
    least_of_best = 0.3  # the same as a fraction of the best one's
    border = 20  # rows and columns at the image's border without candidates, as those without peaks
    best = peaks(maps, 1, border, least_quality)
    if not best:
        return []
    quality = maps.quality[border:-border, border:-border]
    least = max(least_quality, least_of_best * best[0].quality)
    rows, columns = np.nonzero((quality > least) & (quality < best[0].quality))
    order = np.argsort(-quality[rows, columns], kind="stable")
    places = zip((rows[order] + border).tolist(), (columns[order] + border).tolist())
    free, found = np.ones(maps.quality.shape, bool), best
    for row, column in ((best[0].row, best[0].column), *places):
        if not free[row, column]:
            continue
        free[max(0, row - spacing + 1) : row + spacing, max(0, column - spacing + 1) : column + spacing] = False
        if (row, column) != best[0][:2]:
            found.append(maps.at(row, column))
            if len(found) == most:
                break
    return found


def level_frame(image: NetworkImage, rays: np.ndarray) -> LevelFrame:
    """Returns the table's frame; without a plane, the table lies across the optical axis at the image's mean depth.
    `rays`: of the image's pixels in the camera's frame, x, y, 1, shape (h, w, 3).
    """
    part = (slice(EVERY // 2, None, EVERY),) * 2
    seen = image.valid[part]
    plane = best_plane(rays[part][seen], image.depth[part][seen], NOISE)
    if plane is None or plane.direction[2] < 0.5:
        return LevelFrame(np.eye(3), image.mean)
    z = plane.direction
    x = unit(np.array([1.0, 0.0, 0.0]) - z[0] * z)
    return LevelFrame(np.column_stack([x, cross(z, x), z]), plane.distance)


def heights(image: NetworkImage, camera: CameraModel, frame: LevelFrame) -> np.ndarray:
    """Returns how high above the table the pixels' points are, shape (h, w) [m]."""
    rays = image_rays(image, camera)
    found: np.ndarray = frame.distance - image.depth * (rays.reshape(-1, 3) @ frame.R[:, 2]).reshape(rays.shape[:2])
    return found


def image_rays(image: NetworkImage, camera: CameraModel) -> np.ndarray:
    """Returns the rays x, y, 1 of the network's image's pixels before an undistorted camera, shape (h, w, 3), not to be
    written."""
    return _rays(len(image.depth), image.crop, *camera.K[:2].ravel().tolist())


@lru_cache(maxsize=4)
def _rays(side: int, crop: Crop, fx: float, _: float, cx: float, __: float, fy: float, cy: float) -> np.ndarray:
    # Pixels are squares: their centres, not their corners, lie on each other's grid.
    centres = (np.arange(side) + 0.5) * crop.side / side - 0.5
    x, y = np.meshgrid((crop.column + centres - cx) / fx, (crop.row + centres - cy) / fy)
    return read_only(np.stack([x, y, np.ones_like(x)], axis=-1))


class _Objects(NamedTuple):
    """The outlines of n objects on the table."""

    middle: np.ndarray  # shape (n, 2) [m]
    axis: np.ndarray  # unit vectors along them, towards their lighter ends, shape (n, 2)
    length: np.ndarray  # half of it, shape (n,) [m]
    width: np.ndarray  # likewise
    long: np.ndarray  # 0 is round, 1 a line
    uneven: np.ndarray  # how much their ends differ, 0 to 1
    bulk: np.ndarray  # shape (n, 2) [m]
    thick: np.ndarray  # thickness of the bulk [px]
    top: np.ndarray  # height above the table [m]


def described(
    grasps: Sequence[Peak],
    turns: np.ndarray,
    certainty: np.ndarray,
    image: NetworkImage,
    camera: CameraModel,
    frame: LevelFrame,
) -> Candidates:
    """Returns grasps with what can be seen of them; `turns`: of their lines from GGCNN's, shape (n,) [rad]."""
    object_m = 0.008  # what stands out of the table by more is an object
    eye_m = 0.02  # standard deviation of the blur through which a surface's slope is seen
    rim_m = 0.012  # radius in which the surroundings of a place are looked at
    lowest_m = -0.01  # heights beyond are holes badly filled, or the arm
    highest_m = 0.25
    rays = image_rays(image, camera)
    seen_height = heights(image, camera, frame).astype(np.float32)
    height = np.clip(cv2.medianBlur(seen_height, 5), lowest_m, highest_m)
    pixel_m = image.crop.side / len(image.depth) * image.mean / camera.K[0, 0]
    mask = cv2.morphologyEx((height > object_m).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    thickness = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    nearest, objects = _objects(mask, thickness, height, image.depth, rays, frame)
    at = np.array([(p.row, p.column) for p in grasps], int).reshape(-1, 2)
    rows, columns = at[:, 0], at[:, 1]
    reach, eye_px = max(1, round(rim_m / pixel_m)), eye_m / pixel_m
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    window, inside = _window(at, reach + 2, mask.shape)
    around = cv2.filter2D(mask[window].astype(np.float32), -1, disc / np.float32(disc.sum()))[inside]
    z = cv2.medianBlur(image.depth[window].astype(np.float32), 5)[inside]
    window, inside = _window(at, int(4.0 * eye_px + 0.5) + 1, mask.shape)
    smooth = gaussian(np.clip(height[window], 0.0, None), eye_px)
    down, right = (np.gradient(smooth, pixel_m, axis=axis)[inside] for axis in (0, 1))
    steep = 1.0 + np.hypot(down, right)
    places = (z[:, None] * rays[rows, columns]) @ frame.R
    angles = np.array([p.angle for p in grasps], float)
    openings = np.array([p.width for p in grasps], float) * z * image.crop.side / len(image.depth) / camera.K[0, 0]
    quality, sure = np.array([p.quality for p in grasps], float), certainty[rows, columns]
    of = _Objects(*(values[nearest[rows, columns]] for values in objects))
    off = places[:, :2] - of.middle
    along, aside = (off * of.axis).sum(axis=1), off[:, 1] * of.axis[:, 0] - off[:, 0] * of.axis[:, 1]
    # y points down the image, angles are anticlockwise.
    axis = np.arctan2(-of.axis[:, 1], of.axis[:, 0])
    h = frame.distance - places[:, 2]
    seen = {
        "quality": quality,
        "height": h / LENGTH_M,
        "below top": (of.top - h) / LENGTH_M,
        "opening": openings / LENGTH_M,
        "along": np.abs(along / of.length),
        "towards lighter end": along / of.length * of.uneven,
        "aside": np.abs(aside / of.width),
        "from middle": np.hypot(*off.T) / LENGTH_M,
        "from bulk": np.hypot(*(places[:, :2] - of.bulk).T) / LENGTH_M,
        "thickness": thickness[rows, columns] / of.thick,
        "across": of.long * np.cos(2.0 * (angles - axis)),
        "right": off[:, 0] / LENGTH_M,
        "towards operator": off[:, 1] / LENGTH_M,
        "line cos": np.cos(2.0 * angles),
        "line sin": np.sin(2.0 * angles),
        "rim": 1.0 - around,
        "certainty": sure,
        "against line": np.sin(turns) ** 2 * sure,
    }
    slopes = np.stack([right / steep, down / steep], axis=1)
    liked = np.clip(np.column_stack([seen[name] for name in TASTES]), -4.0, 4.0)
    return Candidates(tuple(grasps), frame, places, angles, openings, slopes, liked)


def _window(at: np.ndarray, margin: int, shape: tuple[int, ...]) -> tuple[tuple[slice, ...], tuple[np.ndarray, ...]]:
    """Returns the part of an image with pixels (row, column), shape (n, 2), and so much about them, and the pixels'
    rows and columns in it; for no pixels the whole image."""
    if not len(at):
        return (slice(None),) * 2, tuple(at.T)
    first = np.maximum(at.min(axis=0) - margin, 0)
    end = np.minimum(at.max(axis=0) + margin + 1, shape)
    return tuple(slice(a, b) for a, b in zip(first.tolist(), end.tolist())), tuple((at - first).T)


def _objects(
    mask: np.ndarray, thickness: np.ndarray, height: np.ndarray, depth: np.ndarray, rays: np.ndarray, frame: LevelFrame
) -> tuple[np.ndarray, _Objects]:
    """Returns for each pixel the number of the object there, or of the nearest one, and the objects."""
    smallest_object_px = 40
    count, parts, sizes, _ = cv2.connectedComponentsWithStats(mask)
    kept = [part for part in range(1, count) if sizes[part, cv2.CC_STAT_AREA] >= smallest_object_px]
    if not kept:
        kept, parts = [1], np.ones_like(parts)
    which = np.zeros(parts.shape, np.int32)
    found = []
    for i, part in enumerate(kept):
        of = parts == part
        which[of] = i + 1
        xy = (depth[of, None] * rays[of]) @ frame.R[:, :2]
        middle = xy.mean(axis=0)
        spread, axes = np.linalg.eigh(np.cov((xy - middle).T))
        axis = axes[:, 1]
        t, s = (xy - middle) @ axis, (xy - middle) @ np.array([-axis[1], axis[0]])
        sd = np.sqrt(np.maximum(spread, 1e-8))
        skew = float(np.mean(t**3)) / sd[1] ** 3
        # The tail of the distribution is the lighter end.
        axis = axis if skew >= 0.0 else -axis
        inner = thickness[of]
        bulk = int(np.argmax(inner))
        found.append(
            (
                middle,
                axis,
                max(0.005, float(np.percentile(np.abs(t), 98))),
                max(0.005, float(np.percentile(np.abs(s), 98))),
                1.0 - sd[0] / sd[1],
                min(1.0, 2.0 * abs(skew)),
                xy[bulk],
                max(1.0, float(inner[bulk])),
                float(np.percentile(height[of], 95)),
            )
        )
    away = np.where(which > 0, 0, 1).astype(np.uint8)
    _, cells = cv2.distanceTransformWithLabels(away, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(int(cells.max()) + 1, np.int32)
    of_label[cells[away == 0]] = which[away == 0]
    return np.maximum(of_label[cells] - 1, 0), _Objects(*(np.array(values) for values in zip(*found)))
