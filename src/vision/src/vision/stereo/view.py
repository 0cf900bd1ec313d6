"""The headset view: one image for each eye, from the colour camera and its depth if available.

    colour, depth -> rectified -> one image for each eye -> mark of its age if it is old -> lens -> screen

Everything that depends on the camera alone is computed once. The two eyes look along the camera's axis, half their
distance to its left and right. A point at depth z then lies f b / z pixels farther to the right in the left eye's image
than in the right eye's, so that it appears at its true distance (depth-image-based rendering)."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel
from common.config import choice, flag, integer, number, path, text
from leap_motion.service.access import origin_faults
from vision.stereo.lens import Dk2Lens, NoLens

LEFT, RIGHT = 1, -1  # the eyes: the direction in which their images shift as an object comes nearer
NONE = np.float32(-1e6)  # marks a pixel of a map to which no image pixel moved
FONT = cv2.FONT_HERSHEY_SIMPLEX
COLOUR = (255, 200, 60)


@dataclass(frozen=True)
class StereoViewConfig:
    """The schema of stereo_view.yaml."""

    lens: str = choice("dk2", "none", doc="lens to correct: the Rift DK2's, or none for a viewer that does it itself")
    chromatic: bool = flag(doc="correct the chromatic aberration of the lens too")
    magnification: float = number(above=0.0, high=4.0, doc="1 shows true angles, larger values a larger image")
    depth: bool = flag(doc="give each eye its own view by the depth image; false: the same image twice")
    eye_distance: float = number("m", low=0.05, high=0.08, doc="distance between the operator's eyes")
    flat_distance: float = number("m", low=0.3, high=100.0, doc="apparent distance of the image without depth")
    nearest: float = number("m", low=0.1, high=100.0, doc="nearer objects are shown at this distance")
    depth_gap: float = number("s", low=0.0, high=1.0, doc="maximum time between colour and depth image")
    age_after: float = number("s", low=0.1, high=10.0, doc="an older image is marked with its age")
    jpeg_quality: int = integer("%", low=10, high=100, doc="quality of the images for the web page")

    def faults(self) -> list[str]:
        if self.nearest > self.flat_distance:
            return [f"nearest is {self.nearest:g} m, but must be at most flat_distance, {self.flat_distance:g} m."]
        return []


@dataclass(frozen=True)
class WindowConfig:
    """Private parameters of the node stereo_view."""

    output: str = text(doc="the display's output; empty: the Rift, or a window without one", absent="", empty=True)


@dataclass(frozen=True)
class WebConfig:
    """Private parameters of the node stereo_web."""

    host: str = text(doc="address to serve on")
    port: int = integer(low=0, high=65535, doc="port; 0: any free one")
    page: str = path(doc="file of the page")
    certificate: str = path(doc="file of a certificate (PEM), for https; empty with hands: one of its own")
    key: str = path(doc="file of the certificate's key (PEM)")
    hands: bool = flag(doc="take the hands of a headset and serve them as the Leap service does", absent=False)
    leap_port: int = integer(low=0, high=65535, doc="with hands: port of that service", absent=6437)
    box_ahead: float = number("m", low=0.2, high=0.8, doc="with hands: box's middle in front of the head", absent=0.4)
    box_below: float = number("m", low=0.0, high=0.8, doc="with hands: box's middle below the head", absent=0.35)
    name: str = text(doc="further name of this computer that pages may be asked for by", absent="", empty=True)
    video: str = choice("auto", "jpeg", "webrtc", doc="auto: jpeg to this machine, else webrtc", absent="auto")
    only_view: bool = flag(doc="with hands: the operator has no other view; an old image holds the arm", absent=False)
    public: str = text(doc="origin under which a relay or proxy shows the page; empty: none", absent="", empty=True)

    def faults(self) -> list[str]:
        faults = origin_faults(self.public)
        if bool(self.certificate) != bool(self.key):
            faults.append("https needs both certificate and key, but only one is given.")
        return faults


@dataclass(frozen=True, eq=False)
class EyeImages:
    """The images for the two eyes."""

    left: np.ndarray  # RGB, shape (height, width, 3), uint8, of a rectified camera at each eye
    right: np.ndarray
    deep: bool  # whether they differ by depth, rather than by one shift of the whole image

    def aged(self, age: float | None) -> EyeImages:
        """Returns the images marked with their age [s]."""
        return EyeImages(mark_age(self.left, age), mark_age(self.right, age), self.deep)


class StereoView:
    """Makes the eye images from raw images of `rgb` and depth in its pixels. `camera` is the rectified camera of each
    eye image; `screen` draws both on one screen."""

    def __init__(self, rgb: CameraModel, config: StereoViewConfig) -> None:
        self.camera, self._config = rgb.rectified(), config
        size = (rgb.width, rgb.height)
        self._maps = cv2.initUndistortRectifyMap(rgb.K, rgb.D, rgb.R, self.camera.K, size, cv2.CV_16SC2)
        self._half_fb = 0.5 * self.camera.K[0, 0] * config.eye_distance
        self.screen: Dk2Lens | NoLens = NoLens(self.camera)
        if config.lens == "dk2":
            self.screen = Dk2Lens(self.camera, config.magnification, config.chromatic)

    @property
    def tangents(self) -> tuple[float, float, float, float]:
        """The edges of each eye image: tan(angle) to the left, right, up and down."""
        K, width, height = self.camera.K, self.camera.width, self.camera.height
        left, up = (K[0, 2] + 0.5) / K[0, 0], (K[1, 2] + 0.5) / K[1, 1]
        return left, width / K[0, 0] - left, up, height / K[1, 1] - up

    def eyes(self, colour: np.ndarray, depth: np.ndarray | None) -> EyeImages:
        """Returns both eye images from a raw RGB image, shape (height, width, 3), uint8, and depth in its pixels, shape
        (height, width) [m], NaN where unknown. Without depth the image is flat, at the configured distance, or not
        shifted at all if the configuration disables depth. Raises ValueError for an image without its camera's size."""
        size = (self.camera.height, self.camera.width)
        for name, image in (("colour", colour), ("depth", depth)):
            if image is not None and image.shape[:2] != size:
                raise ValueError(f"the {name} image has the shape {image.shape}, but camera_info says {size}")
        flat = cv2.remap(colour, *self._maps, cv2.INTER_LINEAR)
        if depth is None:
            columns = round(self._half_fb / self._config.flat_distance) if self._config.depth else 0
            moves = (np.array([[1.0, 0.0, move], [0.0, 1.0, 0.0]]) for move in (columns, -columns))
            left, right = (cv2.warpAffine(flat, M, size[::-1], flags=cv2.INTER_NEAREST) for M in moves)
            return EyeImages(left, right, False)
        # Nearest neighbour: interpolation would blend an edge with the wall behind it.
        z = cv2.remap(depth, *self._maps, cv2.INTER_NEAREST, borderValue=(float("nan"),))
        shift = self._half_fb * inverse_depth(z, self._config.nearest, self._config.flat_distance)
        left, right = (shifted(flat, eye_map(shift, eye)) for eye in (LEFT, RIGHT))
        return EyeImages(left, right, True)


class ImageAge:
    """Measures the time since the arrival of the image that is shown."""

    def __init__(self) -> None:
        self._stamp: float | None = None
        self._since: float | None = None

    def is_new(self, stamp: float) -> bool:
        """Returns whether an image with this stamp [s] differs from the one shown: a frozen camera repeats its last."""
        return stamp != self._stamp

    def shown(self, stamp: float, since: float) -> None:
        """Records that an image with this stamp [s], which arrived at the time `since` [s], is shown from now on."""
        self._stamp, self._since = stamp, since

    def age(self, now: float) -> float | None:
        """Returns the time since the arrival of the image that is shown [s]; None before the first."""
        return None if self._since is None else now - self._since


def age_text(age: float | None) -> str:
    """Returns the text for an image's age [s]."""
    if age is None:
        return "no image yet"
    return f"{age:.1f} s old" if age < 60.0 else f"{age / 60.0:.0f} min old"


def mark_age(image: np.ndarray, age: float | None) -> np.ndarray:
    """Returns the image, shape (height, width, 3), darkened and with its age [s] in the middle."""
    dark = 0.4  # brightness of a marked image
    marked = cv2.convertScaleAbs(image, alpha=dark)
    height, width = image.shape[:2]
    text = age_text(age)
    scale = width / 400.0
    thickness = max(1, round(2.0 * scale))
    (length, tall), _ = cv2.getTextSize(text, FONT, scale, thickness)
    cv2.putText(marked, text, ((width - length) // 2, (height + tall) // 2), FONT, scale, COLOUR, thickness)
    return marked


def inverse_depth(depth: np.ndarray, nearest: float, instead: float) -> np.ndarray:
    """Returns 1/z for every pixel, float32 [1/m], of a depth image, shape (height, width) [m]. A pixel without depth
    (NaN, infinite, not positive) gets the depth of the farther of its neighbours to the left and right, because most
    gaps are shadows of near objects. A row without any depth gets the farthest of all depths, and an image without any
    gets `instead` [m]. Depths smaller than `nearest` [m] are replaced by it."""
    known = (depth > 0.0) & (depth < np.inf)
    if not known.any():
        return np.full(depth.shape, 1.0 / instead, np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):  # of the holes
        near = np.float32(1.0) / depth
    np.putmask(near, ~known, np.float32(np.inf))
    farthest = near.min()
    pixels, lengths, left, right = _holes(known)
    values = np.append(near, np.float32(np.inf))  # -1: beyond the edge
    filled = np.minimum(values[left], values[right])
    near.reshape(-1)[pixels] = np.where(np.isfinite(filled), filled, farthest).repeat(lengths)
    return np.minimum(near, np.float32(1.0 / nearest), out=near)


def eye_map(shift: np.ndarray, eye: int) -> np.ndarray:
    """Returns the image column that each pixel of an eye's image shows, shape (height, width), float32 [px]. `shift` is
    half the disparity of each pixel, not negative [px]; `eye` is LEFT or RIGHT. Where several pixels coincide, the
    nearest wins. A hole, which opens beside a near object, shows the edge of the background. Columns outside the image
    are outside the camera's view."""
    height, width = shift.shape
    move = shift if eye == LEFT else -shift
    target = np.arange(width, dtype=np.float32) + move
    np.rint(target, out=target)
    outside = (target < 0.0) | (target >= width)
    pixel = target.astype(np.int32)
    pixel += width * np.arange(height, dtype=np.int32)[:, None]
    np.putmask(pixel, outside, height * width)  # a place beside the image
    target -= move
    source = np.full(height * width + 1, NONE, np.float32)
    # A later assignment wins. The left eye's pixels move right: of those that coincide, the nearest began leftmost.
    order = slice(None, None, -1 if eye == LEFT else 1)
    source[pixel.reshape(-1)[order]] = target.reshape(-1)[order]
    return _without_holes(source[:-1].reshape(height, width), eye)


def shifted(image: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Returns the image, shape (height, width, 3), read at the columns of `eye_map`; black outside."""
    return cv2.remap(image, columns, _rows(*columns.shape), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


@functools.lru_cache(maxsize=2)
def _rows(height: int, width: int) -> np.ndarray:
    return np.arange(height, dtype=np.float32)[:, None].repeat(width, axis=1)


def _without_holes(source: np.ndarray, eye: int) -> np.ndarray:
    pixels, lengths, left, right = _holes(source > NONE)
    if not pixels.size:
        return source
    width = source.shape[1]
    values = source.reshape(-1)
    # The neighbour that moved less is farther away; at the edge there is only one neighbour.
    moved_left = np.where(left >= 0, eye * (left % width - values[left]), np.inf)
    moved_right = np.where(right >= 0, eye * (right % width - values[right]), np.inf)
    behind = np.where(moved_left <= moved_right, left, right)
    shown = values[behind].repeat(lengths)
    at_edge = ((left < 0) | (right < 0)).repeat(lengths)
    values[pixels] = shown + np.where(at_edge, pixels - behind.repeat(lengths), 0)
    return source


def _holes(known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns the unknown pixels of an image, flat indices, and of each of their runs along a row the length and the
    known pixels to the left and to the right, -1 beyond the row."""
    width = known.shape[1]
    pixels = np.flatnonzero(~known)
    column = pixels % width
    starts = np.flatnonzero((np.diff(pixels, prepend=-2) > 1) | (column == 0))
    ends = np.flatnonzero((np.diff(pixels, append=known.size + 1) > 1) | (column == width - 1))
    left = np.where(column[starts] > 0, pixels[starts] - 1, -1)
    right = np.where(column[ends] < width - 1, pixels[ends] + 1, -1)
    return pixels, ends - starts + 1, left, right
