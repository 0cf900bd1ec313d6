"""Depth images with grasp rectangles: folders of Cornell, of Jacquard, and of the user's own; and their training maps.

A grasp rectangle is the place of a parallel gripper in an image (Jiang, Moseson and Saxena, ICRA 2011): its middle, the
line through both fingers, their distance, and the length of a finger across that line. The format of the user's own
label files is in docs/handbook/own-objects.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from common.errors import RigError
from common.plausible import plausible_depth
from common.ros.files import read_text, write_whole
from grasping.lab.synthetic.samples import Sample
from grasping.network.depth_image import NETWORK_SIDE, Crop, prepare
from grasping.network.maps import WIDTH_SCALE_PX, Peak, half_turn

SCHEMA = 1
SUFFIX = ".grasps.json"
IMAGE_SUFFIXES = (".png", ".npy", ".tif", ".tiff")


class LabelError(RigError):
    """A file with labelled grasps cannot be used."""


@dataclass(frozen=True)
class GraspRectangle:
    """A grasp in an image. Raises ValueError if a value is not finite, or a side not positive."""

    row: float  # of its middle [px]
    column: float  # of its middle [px]
    angle: float  # of the line through both fingers, anticlockwise from the horizontal, modulo pi [rad]
    opening: float  # between the fingers [px]
    breadth: float  # of a finger, across the line [px]

    def __post_init__(self) -> None:
        largest_px = 1e5  # of any number in a label
        for name, value in asdict(self).items():
            if not isinstance(value, (int, float)) or isinstance(value, bool) or not abs(value) < largest_px:
                raise ValueError(f"{name} is {value!r} and must be a number below {largest_px:g}")
        if self.opening <= 0.0 or self.breadth <= 0.0:
            raise ValueError(f"opening and breadth are {self.opening:g} and {self.breadth:g} px and must be positive")

    @classmethod
    def between(cls, a: tuple[float, float], b: tuple[float, float], breadth: float) -> GraspRectangle:
        """Returns the rectangle of two fingers at (column, row) [px]."""
        across, up = b[0] - a[0], a[1] - b[1]
        middle = 0.5 * (a[1] + b[1]), 0.5 * (a[0] + b[0])
        return cls(*middle, half_turn(math.atan2(up, across)), math.hypot(across, up), breadth)

    def corners(self, fraction: float = 1.0) -> np.ndarray:
        """Returns the corners as (column, row), shape (4, 2) [px]; of the opening only a fraction about the middle."""
        along = 0.5 * fraction * self.opening * np.array([math.cos(self.angle), -math.sin(self.angle)])
        across = 0.5 * self.breadth * np.array([math.sin(self.angle), math.cos(self.angle)])
        middle = np.array([self.column, self.row])
        return np.stack(
            [middle - along - across, middle + along - across, middle + along + across, middle - along + across]
        )


@dataclass(frozen=True)
class LabelledImage:
    """An image with its grasps; it is read when it is needed.

    Attributes:
        name: of the image, the same on every machine.
        thing: what lies there: images of one thing belong to the same split.
        depth: returns the image, shape (h, w) [m], 0 or NaN where there is no reading.
        grasps: the rectangles.
    """

    name: str
    thing: str
    depth: Callable[[], np.ndarray]
    grasps: tuple[GraspRectangle, ...]

    def checked_depth(self) -> np.ndarray:
        """Returns the image; raises RigError if it cannot be used, or the grasps are not of an image of its size."""
        depth = self.depth()
        height, width = depth.shape
        for grasp in self.grasps:
            inside = -0.5 <= grasp.row <= height - 0.5 and -0.5 <= grasp.column <= width - 0.5
            if not inside or max(grasp.opening, grasp.breadth) > math.hypot(width, height):
                raise RigError(
                    f"{self.name}: a grasp at row {grasp.row:g}, column {grasp.column:g}, {grasp.opening:g} px open, "
                    f"is not of an image of {width} x {height}: its labels are of another size."
                )
        return depth


class LabelledFolder(NamedTuple):
    """The labelled images of a folder."""

    images: list[LabelledImage]  # with a grasp
    left_out: list[str]  # one sentence for each label file that cannot be used, or holds no grasp


def read_depth(path: Path) -> np.ndarray:
    """Returns a depth image, shape (h, w) [m], of a file: 16-bit in millimetres, floating-point in metres. Raises
    RigError if the file is not a depth image, or not in these units.
    """
    try:
        if path.suffix.lower() == ".npy":
            depth = np.load(path, allow_pickle=False)
        else:
            depth = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror or error}.") from error
    except cv2.error:  # of an empty file
        depth = None
    except (ValueError, EOFError) as error:
        raise RigError(f"{path} cannot be read: {error}.") from error
    if not isinstance(depth, np.ndarray):  # of several arrays in one file, too
        raise RigError(f"{path} is not an image.")
    if depth.dtype.newbyteorder("=") == np.uint16:
        depth = depth * np.float32(0.001)
    if depth.ndim != 2 or not np.issubdtype(depth.dtype, np.floating):
        raise RigError(f"{path} holds {depth.dtype} of shape {depth.shape}, not 16-bit millimetres or metres, (h, w).")
    return _plausible(depth, path)


def _plausible(depth: np.ndarray, path: Path) -> np.ndarray:
    try:
        return plausible_depth(depth)
    except ValueError as error:
        raise RigError(f"{path}: {error}.") from error


def depth_images(folder: Path) -> list[Path]:
    """Returns the depth images of a folder, by name; raises RigError if there are none."""
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    if not found:
        raise RigError(f"{folder} holds no depth image ({', '.join(IMAGE_SUFFIXES)}).")
    return found


def read(folder: Path) -> LabelledFolder:
    """Returns the labelled images of a folder of any of the three kinds; raises RigError if there are none."""
    if not folder.is_dir():
        raise RigError(f"{folder} is not a folder.")
    files = {path.with_name(path.name.lower()): path for path in sorted(folder.rglob("*"))}
    left_out: list[str] = []
    for pattern, of_file in ((f"*{SUFFIX}", _own), ("pcd*cpos.txt", _cornell), ("*_grasps.txt", _jacquard)):
        images = []
        for lower, path in files.items():
            if not fnmatchcase(lower.name, pattern) or (of_file is _own and path.parent != folder):
                continue
            try:
                image = of_file(path, files)
            except LabelError as error:
                left_out.append(str(error))
            else:
                images += [image] * bool(image.grasps)
                left_out += [f"{path} holds no grasp."] * (not image.grasps)
        if images:
            return LabelledFolder(images, left_out)
    if left_out:
        raise LabelError(f"None of the {len(left_out)} label files in {folder} can be used; the first: {left_out[0]}")
    raise RigError(
        f"{folder} holds no labelled grasps: neither *{SUFFIX} (label_grasps.py makes them), nor Cornell's "
        "pcd*cpos.txt, nor Jacquard's *_grasps.txt."
    )


def _labelled(row: float, column: float, angle: float, opening: float, breadth: float) -> GraspRectangle:
    """Returns the rectangle that a label states; raises ValueError if it is not in pixels and radians."""
    least_px = 1.0  # of the sides of a labelled rectangle: those in metres, or in fractions of the image, are shorter
    grasp = GraspRectangle(row, column, angle, opening, breadth)
    if min(opening, breadth) < least_px:
        raise ValueError(
            f"opening and breadth are {opening:g} and {breadth:g} px and must be at least {least_px:g} px: they are in "
            "pixels, not in metres"
        )
    if abs(angle) > 2.0 * math.pi:
        raise ValueError(f"angle is {angle:g} rad and must be within 2 pi: it is in radians, not in degrees")
    return grasp


def _beside(path: Path, files: Mapping[Path, Path], *names: str) -> Path:
    """Returns the first file of these names beside a label file, in capitals or not; raises LabelError if none is."""
    found = next((files[path.with_name(n.lower())] for n in names if path.with_name(n.lower()) in files), None)
    if found is None:
        raise LabelError(f"{path} belongs to no image: {' or '.join(names)} is missing.")
    return found


def read_grasps(path: Path) -> list[GraspRectangle]:
    """Returns the grasps of one of the user's own label files; raises LabelError for anything else."""
    try:
        content = json.loads(read_text(path))
        if not isinstance(content, dict) or content.get("schema") != SCHEMA:
            raise ValueError(f'it has no "schema": {SCHEMA}')
        return [_labelled(**grasp) for grasp in content["grasps"]]
    except (ValueError, TypeError, KeyError, OSError, RecursionError) as error:
        raise LabelError(f"{path} is not a file of labelled grasps: {error}.") from error


def write_grasps(path: Path, grasps: Iterable[GraspRectangle]) -> None:
    """Writes a label file whole or not at all."""
    rows = ",\n".join(f"  {json.dumps(asdict(grasp))}" for grasp in grasps)
    write_whole(path, f'{{"schema": {SCHEMA}, "grasps": [\n{rows}\n]}}\n')


def label_file(image: Path) -> Path:
    return image.with_name(image.stem + SUFFIX)


def _own(path: Path, files: Mapping[Path, Path]) -> LabelledImage:
    stem = path.name[: -len(SUFFIX)]
    image = _beside(path, files, *(f"{stem}{suffix}" for suffix in IMAGE_SUFFIXES))
    return LabelledImage(stem, stem, partial(read_depth, image), tuple(read_grasps(path)))


def _cornell(path: Path, files: Mapping[Path, Path]) -> LabelledImage:
    """pcdNNNNcpos.txt holds four corners a rectangle, "column row" each, some NaN; its depth is the point cloud
    pcdNNNN.txt, or pcdNNNNd.tiff [m] where somebody has converted it. The first two corners span the opening.
    """
    name = path.name[: -len("cpos.txt")]
    image = _beside(path, files, f"{name}d.tiff", f"{name}.txt")
    try:
        lines = [line.split() for line in read_text(path).split("\n") if line.strip()]
        corners = np.array([[float(word) for word in line] for line in lines])
        grasps = [_of_corners(four) for four in corners.reshape(-1, 4, 2) if np.isfinite(four).all()]
    except (ValueError, OSError) as error:
        raise LabelError(f"{path} does not hold four corners a rectangle: {error}.") from error
    of_image = read_depth if image.suffix.lower() == ".tiff" else _of_cloud
    return LabelledImage(name, name, partial(of_image, image), tuple(grasps))


def _of_corners(corners: np.ndarray) -> GraspRectangle:
    (ax, ay), (bx, by) = corners[:2]
    row, column = corners[:, 1].mean(), corners[:, 0].mean()
    opening, breadth = (float(np.linalg.norm(corners[i + 1] - corners[i])) for i in (0, 1))
    return _labelled(float(row), float(column), half_turn(math.atan2(ay - by, bx - ax)), opening, breadth)


def _of_cloud(path: Path) -> np.ndarray:
    """Returns the distances of an ASCII point cloud whose last column is the pixel's number, shape (480, 640) [m]."""
    cornell_shape = (480, 640)
    cornell_mm = 1e-3  # the point clouds are in millimetres
    depth = np.full(cornell_shape, np.nan, np.float32)
    try:
        _, _, body = read_text(path).partition("DATA ascii\n")
        points = np.array([line.split() for line in body.splitlines() if line.strip()], dtype=float).reshape(-1, 5)
        depth.ravel()[points[:, 4].astype(int)] = cornell_mm * np.linalg.norm(points[:, :3], axis=1)
    except (ValueError, IndexError, OSError) as error:
        raise RigError(
            f"{path} is not a point cloud of {cornell_shape[1]} x {cornell_shape[0]} pixels: {error}."
        ) from error
    return _plausible(depth, path)


def _jacquard(path: Path, files: Mapping[Path, Path]) -> LabelledImage:
    """*_grasps.txt holds "column;row;angle;opening;breadth" a line, angles in degrees clockwise, best first; a
    grasp is there once for each breadth. The depth is *_perfect_depth.tiff, else *_stereo_depth.tiff [m].
    """
    name = path.name[: -len("_grasps.txt")]
    tiff = _beside(path, files, *(f"{name}_{kind}_depth.tiff" for kind in ("perfect", "stereo")))
    grasps = []
    try:
        for line in read_text(path).split():
            column, row, degrees, opening, breadth = (float(word) for word in line.split(";"))
            grasps.append(_labelled(row, column, half_turn(-math.radians(degrees)), opening, breadth))
    except (ValueError, OSError) as error:
        raise LabelError(f"{path} does not hold five numbers a grasp: {error}.") from error
    return LabelledImage(name, name.partition("_")[2] or name, partial(read_depth, tiff), tuple(grasps))


def crop_around(grasps: Iterable[GraspRectangle], shape: tuple[int, ...], side: int) -> Crop:
    """Returns the window of `side` pixels, at most what the image has, about the grasps' mean and inside the image."""
    side = min(side, *shape)
    middle = np.mean([(grasp.row, grasp.column) for grasp in grasps], axis=0)
    row, column = (int(np.clip(round(c - 0.5 * side), 0, n - side)) for c, n in zip(middle, shape))
    return Crop(row, column, side)


def in_network_image(grasp: GraspRectangle, crop: Crop) -> GraspRectangle:
    """Returns a grasp in the pixels of the network's image of a window."""
    scale = NETWORK_SIDE / crop.side
    row, column = (scale * (c + 0.5 - first) - 0.5 for c, first in ((grasp.row, crop.row), (grasp.column, crop.column)))
    return GraspRectangle(row, column, grasp.angle, scale * grasp.opening, scale * grasp.breadth)


def labels(image: LabelledImage, crop: Crop) -> list[Peak]:
    """Returns the grasps as the rectangle metric compares them, in the pixels of the network's image."""
    found = [in_network_image(grasp, crop) for grasp in image.grasps]
    return [Peak(round(g.row), round(g.column), 1.0, g.angle, g.opening) for g in found]


def sample(image: LabelledImage, side: int) -> Sample:
    """Returns the network's image of a window of `side` pixels and its labels: as published, the middle third of each
    rectangle is a grasp, the first one where several overlap; nothing else is. Raises RigError if there is no reading
    in the window, or none of the grasps.
    """
    depth = image.checked_depth()
    crop = crop_around(image.grasps, depth.shape, side)
    try:
        seen = prepare(depth, crop)
    except ValueError as error:
        raise RigError(f"{image.name}: {error}.") from error
    quality, angle, width = (np.zeros((NETWORK_SIDE, NETWORK_SIDE), np.uint8) for _ in range(3))
    for grasp in reversed([in_network_image(grasp, crop) for grasp in image.grasps]):
        inside = np.zeros_like(quality)
        cv2.fillConvexPoly(inside, np.round(grasp.corners(1.0 / 3.0)).astype(np.int32), (1,))
        here = inside > 0
        quality[here] = 255
        angle[here] = round(256.0 * grasp.angle / np.pi) % 256
        width[here] = round(255.0 * min(grasp.opening / WIDTH_SCALE_PX, 1.0))
    if not quality.any():
        raise RigError(
            f"{image.name}: none of its {len(image.grasps)} grasps lies in the window of {crop.side} pixels."
        )
    known = np.ones_like(quality, bool)
    return Sample((seen.depth - seen.mean).astype(np.float16), quality, angle, width, known)
