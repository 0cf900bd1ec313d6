"""Faults of the simulated camera, and what they do to its pictures."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable
from typing import Any

import numpy as np

from rig_simulation.devices.camera.rgbd_camera import RgbdImages
from rig_simulation.faults.injection import Fault, Faults, FaultValue, fraction_of

CAMERA_FAULTS = (
    Fault("vanished", "unplugged: nothing is published any more"),
    Fault("frozen", "the driver hangs: the last pictures come again and again with their old stamps"),
    Fault("stuck", "the sensor hangs: the last pictures come again and again with new stamps"),
    Fault("depth_empty", "no pixel has a depth"),
    Fault("slow", "pictures come seldom", FaultValue("pictures a second [Hz]", 2.0, 0.1, 30.0)),
    Fault(
        "garbled",
        "pictures are torn, have rows too short or of another width, or are not of the size that camera_info says",
        fraction_of("pictures"),
    ),
    Fault("restarted", "the driver ends and its topics are gone; switched off it starts again"),
)


@dataclasses.dataclass(frozen=True)
class Exposure:
    """Pictures with the moment that they show, a stamp of the node's clock."""

    pictures: RgbdImages
    stamp: Any


class ImageStream:
    """What becomes of the pictures on their way out. Time is handed in.

    Args:
        faults: those of CAMERA_FAULTS.
    """

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._random = random.Random(0)
        self._last: Exposure | None = None
        self._last_time = float("-inf")

    def next(self, expose: Callable[[], Exposure], stamp: Any, now: float) -> Exposure | None:
        """Returns what is published next, or None.

        Args:
            expose: takes new pictures; not called where a fault prevents it.
            stamp: the present moment, for old pictures that pretend to be new.
            now: time [s].
        """
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
            exposure = dataclasses.replace(exposure, pictures=_without_depth(exposure.pictures))
        self._last = exposure
        return exposure

    def garbled(self, height: int, width: int, step: int, data: bytes) -> dict[str, Any]:
        """Returns the fields of a picture's message that are to be other ones; none without the fault.

        Args:
            height, width: of the picture [px].
            step: length of a row in bytes.
            data: all rows.
        """
        share = self._faults.value("garbled")
        if share is None or self._random.random() >= share:
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


def _without_depth(pictures: RgbdImages) -> RgbdImages:
    return dataclasses.replace(pictures, depth=_empty(pictures.depth), registered=_empty(pictures.registered))


def _empty(depth: np.ndarray | None) -> np.ndarray | None:
    return None if depth is None else np.zeros_like(depth)
