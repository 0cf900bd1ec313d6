"""The colour image: lens, exposure, point spread and noise."""

from __future__ import annotations

import cv2
import numpy as np

from rig_simulation.devices.camera.config import ColourConfig
from rig_simulation.devices.camera.lens import CameraLens
from rig_simulation.devices.camera.noise import NoiseField


class ColourSensor:
    """Takes colour images.

    Args:
        lens: of the colour camera.
        config: effects of the sensor.
        rng: source of the noise.
    """

    def __init__(self, lens: CameraLens, config: ColourConfig, rng: np.random.Generator) -> None:
        self._lens = lens
        self._config = config
        self._noise = None
        if config.noise > 0.0:
            field = NoiseField(lens.camera.height, lens.camera.width, 3, 0.0, rng)
            self._noise = field.scaled(config.noise, np.int8)

    def take(self, rendered: np.ndarray) -> np.ndarray:
        """Returns the camera's image, shape (height, width, 3), uint8, red first.

        Args:
            rendered: the lens's window, shape (window.height, window.width, 3), uint8, rows from the bottom.
        """
        image = self._lens.distort(rendered)
        if self._config.exposure != 1.0:
            image = cv2.convertScaleAbs(image, alpha=self._config.exposure)
        if self._config.blur > 0.0:
            image = cv2.GaussianBlur(image, (0, 0), self._config.blur)
        if self._noise is not None:
            image = cv2.add(image, self._noise.cut(), dtype=cv2.CV_8U)
        return image
