"""Faults of the simulated camera, and their effect on its images."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable
from typing import Any

import numpy as np

from rig_simulation.devices.camera.rgbd_camera import RgbdImages
from rig_simulation.faults.injection import Fault, Faults, FaultValue, fraction_of

CAMERA_FAULTS = (
    Fault("vanished", "unplugged: nothing is published"),
    Fault("frozen", "the driver hangs: the last images repeat with their old stamps"),
    Fault("stuck", "the sensor hangs: the last images repeat with new stamps"),
    Fault("depth_empty", "no pixel has a depth"),
    Fault("slow", "the frame rate is low", FaultValue("frame rate [Hz]", 2.0, 0.1, 30.0)),
    Fault(
        "garbled",
        "images are truncated, or their row length, width or height contradicts the data or camera_info",
        fraction_of("images"),
    ),
    Fault("restarted", "the driver stops and its topics disappear; it starts again when the fault ends"),
)


@dataclasses.dataclass(frozen=True)
class Exposure:
    """Images with their time stamp, of the node's clock."""

    images: RgbdImages
    stamp: Any


class ImageStream:
    """Drops, repeats and changes images on their way out. Time is handed in."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._random = random.Random(0)
        self._last: Exposure | None = None
        self._last_time = float("-inf")

    def next(self, expose: Callable[[], Exposure], stamp: Any, now: float) -> Exposure | None:
        """Returns the exposure to publish at the time `now` [s], or None. `expose` takes new images, unless a fault
        prevents it; `stamp`: the present time, for old images that pretend to be new."""
        active = self._faults.active()
        if "vanished" in active or ("slow" in active and now < self._last_time + 1.0 / active["slow"]):
            return None
        self._last_time = now
        if self._last is not None and "frozen" in active:
            return self._last
        if self._last is not None and "stuck" in active:
            return dataclasses.replace(self._last, stamp=stamp)
        exposure = expose()
        if "depth_empty" in active:
            images = exposure.images
            empty: dict[str, Any] = {name: _empty(getattr(images, name)) for name in ("depth", "registered")}
            exposure = dataclasses.replace(exposure, images=dataclasses.replace(images, **empty))
        self._last = exposure
        return exposure

    def garbled(self, height: int, width: int, step: int, data: bytes) -> dict[str, Any]:
        """Returns the fields of an image message to overwrite, whose rows have `step` bytes; empty without fault."""
        fraction = self._faults.value("garbled")
        if fraction is None or self._random.random() >= fraction:
            return {}
        half = height // 2
        ways: tuple[dict[str, Any], ...] = (
            {"data": data[: self._random.randrange(len(data))]},
            {"step": step // 2},
            {"width": 2 * width},
            {"height": height + 1},
            {"height": half, "data": data[: half * step]},
        )
        return self._random.choice(ways)


def _empty(depth: np.ndarray | None) -> np.ndarray | None:
    return None if depth is None else np.zeros_like(depth)
