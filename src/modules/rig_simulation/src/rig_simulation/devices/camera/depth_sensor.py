"""The depth image of a structured-light sensor, from the true depth.

It is computed in inverse depth w = 1/z, in which planes are linear in the pixel, and in disparity d = f b w, in which
the sensor measures: noise, unit errors and quantisation are added there.
"""

from __future__ import annotations

import cv2
import numpy as np

from rig_simulation.devices.camera.config import DepthConfig
from rig_simulation.devices.camera.lens import CameraLens
from rig_simulation.devices.camera.noise import NoiseField

MILLIMETRES = 1000.0
EDGE = 0.01
"""Relative change of inverse depth over a pixel's jitter above which a surface counts as an edge."""
SHADOW_TOLERANCE_PX = 0.25
SIGNAL_SPREAD = 0.2
"""Relative standard deviation of the returned light, which makes borders of regions without depth ragged."""
STEEP = np.radians(60.0)
ANGLE_STEPS = 255
WARP_NODES = (4, 5)
"""Nodes of a unit's smooth warp, over height and width of the image."""


def axial_sigma(z: float | np.ndarray) -> float | np.ndarray:
    """Returns the standard deviation of depth at z [m], for surfaces up to 60 deg (Nguyen, Izadi, Lovell 2012)."""
    return 0.0012 + 0.0019 * (z - 0.4) ** 2


def steep_sigma(angle: float | np.ndarray) -> np.ndarray:
    """Returns the standard deviation added by a steep surface, times sqrt(z) [m sqrt(m)] (the same paper).

    Args:
        angle: between the surface's normal and the line of sight [rad].
    """
    angle = np.minimum(angle, np.radians(85.0))
    return np.where(angle > STEEP, 0.0001 * angle**2 / (np.pi / 2.0 - angle) ** 2, 0.0)


def hidden(w: np.ndarray, fb: float) -> np.ndarray:
    """Returns which pixels are occluded as seen from a point beside the camera.

    The rays of an image row lie in one plane with that point. From there, pixel u appears at u - fb w; pixels that
    overtake their neighbour in that order are hidden.

    Args:
        w: inverse depth, shape (height, width) [1/m].
        fb: focal length times the point's distance to the right of the camera, negative to the left [px m].
    """
    u = np.arange(w.shape[1], dtype=np.float32)
    shifted = u - np.float32(fb) * w
    if fb > 0.0:
        nearest = np.minimum.accumulate(shifted[:, ::-1], axis=1)[:, ::-1]
        return shifted > nearest + SHADOW_TOLERANCE_PX
    nearest = np.maximum.accumulate(shifted, axis=1)
    return shifted < nearest - SHADOW_TOLERANCE_PX


class DepthSensor:
    """Takes depth images.

    Args:
        lens: of the camera of the image.
        config: effects of the sensor.
        rng: source of the unit's errors, drawn first, and of the noise.
        infrared_offset: of the infrared camera to the right of the lens [m]: 0 for its own image, the negative
            distance between the cameras for depth registered to the colour image.
    """

    def __init__(
        self, lens: CameraLens, config: DepthConfig, rng: np.random.Generator, infrared_offset: float = 0.0
    ) -> None:
        camera = lens.camera
        self._lens, self._config = lens, config
        self._fb = float(camera.K[0, 0]) * config.projector_baseline
        projector = infrared_offset + config.projector_baseline
        self._blockers = [camera.K[0, 0] * x for x in (projector, infrared_offset) if x != 0.0]
        self.scale = 1.0 + config.scale_error_sd * rng.standard_normal()
        self._warp = None
        if config.warp_sd > 0.0:
            nodes = self._fb * config.warp_sd * rng.standard_normal(WARP_NODES, dtype=np.float32)
            self._warp = cv2.resize(nodes, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
        self._noise = self._jitter = None
        if config.noise or config.min_signal > 0.0:
            self._noise = NoiseField(camera.height, camera.width, 1, config.correlation, rng)
        if config.edge_jitter > 0.0:
            jitter = NoiseField(camera.height, camera.width, 2, config.correlation, rng)
            self._jitter = jitter.scaled(config.edge_jitter, np.int16)
        self._u = (np.arange(camera.width) - camera.K[0, 2]).astype(np.float32)
        self._v = (np.arange(camera.height) - camera.K[1, 2]).astype(np.float32)[:, None]
        self._sight = (self._u / camera.K[0, 0]) ** 2 + (self._v / camera.K[1, 1]) ** 2 + 1.0
        angles = np.arccos(np.linspace(0.0, 1.0, ANGLE_STEPS + 1))
        self._steep = (self._fb * steep_sigma(angles)).astype(np.float32)
        self._millimetres = self._table()

    def take(self, inverse_depth: np.ndarray, brightness: np.ndarray) -> np.ndarray:
        """Returns the sensor's image, shape (height, width), uint16 [mm], 0 = no depth.

        Args:
            inverse_depth: the lens's window, rows from the bottom, float32 [1/m].
            brightness: the window's colour image, in place of the infrared reflection.
        """
        config = self._config
        w = self._with_edges(inverse_depth)
        cosine = self._cosine(w)
        lost = cosine < np.cos(np.radians(config.max_angle))
        if config.shadows:
            for fb in self._blockers:
                lost |= hidden(w, fb)
        if config.min_signal > 0.0:
            lost |= self._signal(w, cosine, brightness) < config.min_signal
        depth = self._to_millimetres(self._disparity(w, cosine))
        depth[lost] = 0
        return depth

    def _with_edges(self, inverse_depth: np.ndarray) -> np.ndarray:
        """Returns the camera's inverse depth; at edges, that of one surface or the other, never between."""
        smooth = self._lens.distort(inverse_depth)
        shift = np.int16(0) if self._jitter is None else self._jitter.cut()
        beside = self._lens.distort_nearest(inverse_depth, shift)
        return np.where(np.abs(beside - smooth) > EDGE * smooth, beside, smooth)

    def _cosine(self, w: np.ndarray) -> np.ndarray:
        """Returns the cosine of the angle between normal and line of sight: for a plane n.p = 1, w = n.ray."""
        wu = cv2.Sobel(w, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
        wv = cv2.Sobel(w, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
        K = self._lens.camera.K
        n_squared = (w - self._u * wu - self._v * wv) ** 2 + (np.float32(K[0, 0]) * wu) ** 2
        n_squared += (np.float32(K[1, 1]) * wv) ** 2
        return w / np.sqrt(n_squared * self._sight)

    def _signal(self, w: np.ndarray, cosine: np.ndarray, brightness: np.ndarray) -> np.ndarray:
        """Returns the reflected light of the projector; 1 for a white surface, head-on, 1 m away."""
        grey = self._lens.distort(cv2.cvtColor(brightness, cv2.COLOR_RGB2GRAY))
        dark = self._config.dark_return
        returned = (dark + (1.0 - dark) * np.linspace(0.0, 1.0, 256) ** 2.2).astype(np.float32)
        assert self._noise is not None  # the configuration created it
        ragged = 1.0 + SIGNAL_SPREAD * self._noise.cut()
        return cv2.LUT(grey, returned) * cosine * w * w * ragged

    def _disparity(self, w: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        disparity = np.float32(self._fb / self.scale) * w
        if self._warp is not None:
            disparity += self._warp
        if self._config.noise:
            per_metre = 0.0012 * w * w + 0.0019 * (1.0 - 0.4 * w) ** 2  # axial_sigma(1 / w) * w^2
            level = cv2.convertScaleAbs(cosine, alpha=ANGLE_STEPS)
            sigma = self._fb * per_metre + cv2.LUT(level, self._steep) * w * w * np.sqrt(w)
            rounding = self._config.quantisation**2 / 12.0
            assert self._noise is not None  # the configuration created it
            disparity += np.sqrt(np.maximum(sigma * sigma - rounding, 0.0)) * self._noise.cut()
        return disparity

    def _to_millimetres(self, disparity: np.ndarray) -> np.ndarray:
        if self._millimetres is not None:
            steps = np.rint(disparity * np.float32(1.0 / self._config.quantisation)).astype(np.int32)
            return self._millimetres.take(steps, mode="clip")
        return self._in_range(self._fb / np.maximum(disparity, 1e-6)).astype(np.uint16)

    def _table(self) -> np.ndarray | None:
        """Returns the depth of each disparity step [mm]; 0 for the first and last, which include all beyond."""
        if self._config.quantisation == 0.0:
            return None
        last = int(self._fb / (self._config.min_range * self._config.quantisation)) + 2
        disparity = np.arange(last + 1) * self._config.quantisation
        return self._in_range(self._fb / np.maximum(disparity, 1e-6)).astype(np.uint16)

    def _in_range(self, z: np.ndarray) -> np.ndarray:
        """Returns the depth in whole millimetres, 0 where out of range."""
        inside = (z >= self._config.min_range) & (z <= self._config.max_range)
        return np.where(inside, np.rint(z * MILLIMETRES), 0.0)
