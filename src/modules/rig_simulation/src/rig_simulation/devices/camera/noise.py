"""Noise for every image at the cost of a copy: random cuts from one large field.

Two cuts share values, but rarely at the same pixel, so a pixel's values in successive images are independent.
"""

from __future__ import annotations

import cv2
import numpy as np

SPARE_PX = 1024
"""Excess of the large field over a cut, in both directions."""


class NoiseField:
    """Noise of mean 0 and standard deviation 1.

    Args:
        height, width: of a cut [px].
        channels: 1 to 4.
        correlation: standard deviation of the Gaussian that the white noise is smoothed with [px]; 0 = none.
        rng: source of the field and of the cuts.
    """

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
