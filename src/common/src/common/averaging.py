"""Means over the newest samples of a stream."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike


class Window:
    """The newest `size` samples, float arrays of one shape; their mean exists once the window is full."""

    def __init__(self, size: int) -> None:
        if size < 1:
            raise ValueError(f"a window needs a size of at least 1, not {size}")
        self._samples: deque[np.ndarray] = deque(maxlen=size)

    def add(self, sample: ArrayLike) -> None:
        """Adds a sample; a full window drops its oldest one.

        Raises:
            ValueError: the sample is not finite.
        """
        sample = np.asarray(sample, dtype=float)
        if not np.all(np.isfinite(sample)):
            raise ValueError(f"the sample {sample.tolist()} is not finite")
        self._samples.append(sample)

    def reset(self) -> None:
        """Forgets all samples."""
        self._samples.clear()

    @property
    def full(self) -> bool:
        """Whether there are `size` samples."""
        return len(self._samples) == self._samples.maxlen

    def mean(self) -> np.ndarray | None:
        """Returns the mean of the samples, or None before the window is full."""
        return np.mean(self._samples, axis=0) if self.full else None
