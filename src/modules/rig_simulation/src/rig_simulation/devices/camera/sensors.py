"""The lenses of the camera, and its colour and depth sensors.

The renderer has pinhole cameras only. A lens defines the pinhole window that contains the camera's view, and for each
pixel of the camera its position in that window. Windows come from OpenGL: their rows run from the bottom up.
Depth is computed in inverse depth w = 1/z, in which planes are linear in the pixel, and in disparity d = f b w, in
which the sensor measures: noise, unit errors and quantisation are added there."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel
from rig_simulation.node_parameters import ColourConfig, DepthConfig


@dataclass(frozen=True)
class PixelWindow:
    """A pinhole image plane."""

    width: int  # of the image [px]
    height: int  # of the image [px]
    # Its borders in the plane one metre in front of the camera, y up [m]
    left: float
    right: float
    bottom: float
    top: float


class CameraLens:
    """Maps the window's image to the camera's; `sample_offset`: position of the window's samples in their pixels, right
    and up from the centre [px]."""

    def __init__(self, camera: CameraModel, sample_offset: tuple[float, float] = (0.0, 0.0)) -> None:
        margin_px = 4  # margin of the window around the camera's view, for interpolation and for the jitter of edges
        self.camera = camera
        focal, centre = np.diag(camera.K)[:2], camera.K[:2, 2]
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        # On the camera's own pixel grid: no interpolation without distortion.
        straight = camera.rays(np.stack((u, v), axis=-1))[..., :2] * focal + centre
        low = np.floor(straight.min(axis=(0, 1))) - margin_px
        high = np.ceil(straight.max(axis=(0, 1))) + margin_px
        width, height = (high - low + 1.0).astype(int)
        left, top = (low - 0.5 - centre) / focal
        right, bottom = (high + 0.5 - centre) / focal
        self.window = PixelWindow(int(width), int(height), left, right, -bottom, -top)
        columns = straight[..., 0] - low[0] - sample_offset[0]
        rows = high[1] - straight[..., 1] - sample_offset[1]
        self._smooth = cv2.convertMaps(columns.astype(np.float32), rows.astype(np.float32), cv2.CV_16SC2)
        self._nearest = np.stack((np.rint(columns), np.rint(rows)), axis=-1).astype(np.int16)

    def distort(self, image: np.ndarray) -> np.ndarray:
        """Returns the camera's image, interpolated from the window's, shape (window.height, window.width[, 3])."""
        positions, fractions = self._smooth
        return cv2.remap(image, positions, fractions, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def distort_nearest(self, image: np.ndarray, shift: np.ndarray | np.int16) -> np.ndarray:
        """Returns the camera's image of the window's nearest pixels, each `shift` beside its own position: to the right
        and up, shape (height, width, 2) or one number for all, int16 [px]."""
        nothing = np.empty(0, np.uint16)
        return cv2.remap(image, self._nearest + shift, nothing, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)


SPARE_PX = 1024  # excess of the large field over a cut, in both directions


class NoiseField:
    """Noise of mean 0 and standard deviation 1 at the cost of a copy an image: random cuts of `height` x `width` [px]
    with 1 to 4 `channels` from one large field. Two cuts share values, but rarely at the same pixel, so a pixel's
    values in successive images are independent. `correlation`: standard deviation of the Gaussian that smooths the
    noise [px]; 0 = white."""

    def __init__(self, height: int, width: int, channels: int, correlation: float, rng: np.random.Generator) -> None:
        field: np.ndarray = rng.standard_normal((height + SPARE_PX, width + SPARE_PX, channels), dtype=np.float32)
        if correlation > 0.0:
            field = cv2.GaussianBlur(field, (0, 0), correlation)
        field = field.reshape(height + SPARE_PX, width + SPARE_PX, channels)
        self._field = (field - field.mean()) / field.std()
        self._size = (height, width)
        self._rng = rng

    def scaled(self, sigma: float, kind: type) -> NoiseField:
        """Returns the field with standard deviation `sigma`, rounded for an integer `kind`."""
        other = object.__new__(NoiseField)
        field = self._field * sigma
        other._field = np.rint(field).astype(kind) if np.issubdtype(kind, np.integer) else field.astype(kind)
        other._size, other._rng = self._size, self._rng
        return other

    def cut(self) -> np.ndarray:
        """Returns the next cut, shape (height, width) or (height, width, channels); a read-only view."""
        row, column = self._rng.integers(0, SPARE_PX, 2)
        cut = self._field[row : row + self._size[0], column : column + self._size[1]]
        return cut[..., 0] if cut.shape[2] == 1 else cut


class ColourSensor:
    """Takes colour images."""

    def __init__(self, lens: CameraLens, config: ColourConfig, rng: np.random.Generator) -> None:
        self._lens = lens
        self._config = config
        self._noise = None
        if config.noise > 0.0:
            field = NoiseField(lens.camera.height, lens.camera.width, 3, 0.0, rng)
            self._noise = field.scaled(config.noise, np.int8)

    def take(self, rendered: np.ndarray) -> np.ndarray:
        """Returns the camera's image, shape (height, width, 3), uint8, red first, of the window, rows bottom up."""
        image = self._lens.distort(rendered)
        if self._config.exposure != 1.0:
            image = cv2.convertScaleAbs(image, alpha=self._config.exposure)
        if self._config.blur > 0.0:
            image = cv2.GaussianBlur(image, (0, 0), self._config.blur)
        if self._noise is not None:
            image = cv2.add(image, self._noise.cut(), dtype=cv2.CV_8U)
        return image


MILLIMETRES = 1000.0
SHADOW_TOLERANCE_PX = 0.25
STEEP = np.radians(60.0)
ANGLE_STEPS = 255


def steep_sigma(angle: float | np.ndarray) -> np.ndarray:
    """Returns the standard deviation added by a surface whose normal has this `angle` to the line of sight [rad], times
    sqrt(z) [m sqrt(m)] (Nguyen, Izadi, Lovell 2012)."""
    angle = np.minimum(angle, np.radians(85.0))
    return np.where(angle > STEEP, 0.0001 * angle**2 / (np.pi / 2.0 - angle) ** 2, 0.0)


def hidden(w: np.ndarray, fb: float) -> np.ndarray:
    """Returns which pixels are occluded as seen from a point beside the camera, from the inverse depth w, shape
    (height, width) [1/m]. The rays of an image row lie in one plane with that point: from there, pixel u appears at `u
    - fb w`, and pixels that overtake their neighbour in that order are hidden. `fb`: focal length times the point's
    distance to the right of the camera, negative to the left [px m]."""
    if fb < 0.0:
        return hidden(w[:, ::-1], -fb)[:, ::-1]
    shifted = np.multiply(w.T, np.float32(-fb), order="C")  # whole rows of it are compared
    shifted += np.arange(len(shifted), dtype=np.float32)[:, None]
    low, high, *_ = cv2.minMaxLoc(np.ascontiguousarray(w))
    # The least of all pixels to the right that can reach so far
    least, step = shifted, 1
    while step <= min(fb * (high - low) + 1.0, len(shifted) - 1.0):
        before, least = least, np.empty_like(shifted)
        cv2.min(before[:-step], before[step:], dst=least[:-step])
        least[-step:] = before[-step:]
        step *= 2
    return (shifted - least > SHADOW_TOLERANCE_PX).T


class DepthSensor:
    """Takes depth images. `rng` gives the unit's errors, drawn first, and the noise; `infrared_offset` is that of the
    infrared camera to the right of the lens [m]: 0 for its own image, the negative distance between the cameras for
    depth registered to the colour image."""

    def __init__(
        self, lens: CameraLens, config: DepthConfig, rng: np.random.Generator, infrared_offset: float = 0.0
    ) -> None:
        warp_nodes = (4, 5)  # nodes of a unit's smooth warp, over height and width of the image
        camera = lens.camera
        self._lens, self._config = lens, config
        self._fb = float(camera.K[0, 0]) * config.projector_baseline
        projector = infrared_offset + config.projector_baseline
        self._blockers = [camera.K[0, 0] * x for x in (projector, infrared_offset) if x != 0.0]
        self.scale = 1.0 + config.scale_error_sd * rng.standard_normal()
        self._warp = None
        if config.warp_sd > 0.0:
            nodes = self._fb * config.warp_sd * rng.standard_normal(warp_nodes, dtype=np.float32)
            self._warp = cv2.resize(nodes, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
        self._noise = self._jitter = None
        if config.noise or config.min_signal > 0.0:
            self._noise = NoiseField(camera.height, camera.width, 1, config.correlation, rng)
        if config.edge_jitter > 0.0:
            jitter = NoiseField(camera.height, camera.width, 2, config.correlation, rng)
            self._jitter = jitter.scaled(config.edge_jitter, np.int16)
        self._x = ((np.arange(camera.width) - camera.K[0, 2]) / camera.K[0, 0]).astype(np.float32)
        self._y = ((np.arange(camera.height) - camera.K[1, 2]) / camera.K[1, 1]).astype(np.float32)[:, None]
        self._sight = self._x**2 + self._y**2 + np.float32(1.0)
        angles = np.arccos(np.linspace(0.0, 1.0, ANGLE_STEPS + 1))
        self._steep = (self._fb * steep_sigma(angles)).astype(np.float32)
        dark = config.dark_return
        self._returned = (dark + (1.0 - dark) * np.linspace(0.0, 1.0, 256) ** 2.2).astype(np.float32)
        self._millimetres = None
        if config.quantisation > 0.0:
            # The depth of each disparity step [mm]; 0 for the first and last, which include all beyond
            last = int(self._fb / (config.min_range * config.quantisation)) + 2
            self._millimetres = self._depth(np.arange(last + 1) * config.quantisation)

    def take(self, inverse_depth: np.ndarray, brightness: np.ndarray) -> np.ndarray:
        """Returns the sensor's image, shape (height, width), uint16 [mm], 0 = no depth, from the lens's window of
        inverse depth, rows from the bottom, float32 [1/m], and its colour image, whose `brightness` replaces the
        infrared reflection."""
        config = self._config
        w = self._with_edges(inverse_depth)
        cosine = self._cosine(w)
        lost = cosine < np.float32(np.cos(np.radians(config.max_angle)))
        if config.shadows:
            for fb in self._blockers:
                lost |= hidden(w, fb)
        square = w * w
        if config.min_signal > 0.0:
            lost |= self._signal(square, cosine, brightness) < np.float32(config.min_signal)
        depth = self._disparity(w, square, cosine)
        if self._millimetres is None:
            depth = self._depth(depth)
        else:
            depth *= np.float32(1.0 / config.quantisation)
            depth = self._millimetres.take(np.rint(depth, out=depth).astype(np.int32), mode="clip")
        depth[lost] = 0
        return depth

    def _with_edges(self, inverse_depth: np.ndarray) -> np.ndarray:
        """Returns the camera's inverse depth; at edges, that of one surface or the other, never between."""
        edge = 0.01  # relative change of inverse depth over a pixel's jitter above which a surface counts as an edge
        smooth = self._lens.distort(inverse_depth)
        shift = np.int16(0) if self._jitter is None else self._jitter.cut()
        beside = self._lens.distort_nearest(inverse_depth, shift)
        edges = cv2.absdiff(beside, smooth) > np.float32(edge) * smooth
        return cv2.copyTo(beside, edges.view(np.uint8), smooth)

    def _cosine(self, w: np.ndarray) -> np.ndarray:
        """Returns the cosine of the angle between normal and line of sight: for a plane n.p = 1, w = n.ray."""
        K = self._lens.camera.K
        nx = cv2.Sobel(w, cv2.CV_32F, 1, 0, ksize=1, scale=0.5 * K[0, 0])
        ny = cv2.Sobel(w, cv2.CV_32F, 0, 1, ksize=1, scale=0.5 * K[1, 1])
        nz = self._x * nx
        np.subtract(w, nz, out=nz)
        product = self._y * ny
        nz -= product
        squares = np.multiply(nz, nz, out=nz)
        for n in (nx, ny):
            np.multiply(n, n, out=n)
            squares += n
        squares *= self._sight
        return np.divide(w, np.sqrt(squares, out=squares), out=squares)

    def _signal(self, square: np.ndarray, cosine: np.ndarray, brightness: np.ndarray) -> np.ndarray:
        """Returns the reflected light of the projector, 1 for a white surface, head-on, 1 m away, from the `square` of
        the inverse depth."""
        # relative standard deviation of the returned light: borders of regions without depth are ragged
        signal_spread = 0.2
        grey = self._lens.distort(cv2.cvtColor(brightness, cv2.COLOR_RGB2GRAY))
        assert self._noise is not None  # the configuration created it
        signal = self._noise.cut() * np.float32(signal_spread)
        signal += np.float32(1.0)
        for factor in (cv2.LUT(grey, self._returned), cosine, square):
            signal *= factor
        return signal

    def _disparity(self, w: np.ndarray, square: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        disparity = np.float32(self._fb / self.scale) * w
        if self._warp is not None:
            disparity += self._warp
        if self._config.noise:
            # fb sigma(1 / w) w^2; for surfaces up to 60 deg sigma(z) = 0.0012 + 0.0019 (z - 0.4)^2 (the same paper)
            a, b, c = np.float32(self._fb) * np.array([0.001504, -0.00152, 0.0019], np.float32)
            sigma = a * square
            sigma += b * w
            sigma += c
            level = cv2.convertScaleAbs(cosine, alpha=ANGLE_STEPS)
            steep = cv2.LUT(level, self._steep)
            np.multiply(steep, square, out=steep)
            np.multiply(steep, np.sqrt(w), out=steep)
            sigma += steep
            sigma *= sigma
            sigma -= np.float32(self._config.quantisation**2 / 12.0)
            cv2.threshold(sigma, 0.0, 0.0, cv2.THRESH_TOZERO, dst=sigma)
            np.sqrt(sigma, out=sigma)
            assert self._noise is not None  # the configuration created it
            sigma *= self._noise.cut()
            disparity += sigma
        return disparity

    def _depth(self, disparity: np.ndarray) -> np.ndarray:
        """Returns the depth in whole millimetres, 0 where out of range."""
        z = self._fb / np.maximum(disparity, 1e-6)
        inside = (z >= self._config.min_range) & (z <= self._config.max_range)
        return np.where(inside, np.rint(z * MILLIMETRES), 0.0).astype(np.uint16)
