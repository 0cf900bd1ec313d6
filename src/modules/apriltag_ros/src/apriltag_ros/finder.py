"""Tags in a grey picture, by the PyPI package `apriltag`, whose habits end here.

Corners come back in the convention of OpenCV and CameraInfo (the centre of the first pixel is 0, 0), in the order top
left, top right, bottom right, bottom left of the tag as it is printed. The library counts from the corner of the pixel,
half a pixel more. Its own poses are not used; its options refine_* and border do not reach its C part.
"""

from __future__ import annotations

import multiprocessing
from dataclasses import dataclass

import apriltag
import numpy as np

from apriltag_ros.settings import DetectorSettings
from common.poses import read_only

LIBRARY_OFFSET_PX = 0.5


@dataclass(frozen=True, eq=False)
class FoundTag:
    """A tag in a picture.

    Attributes:
        id: number in the family.
        corners: of the black square, shape (4, 2) [px].
        hamming: bits that were put right.
        margin: how clearly black and white were told apart [grey levels].
    """

    id: int
    corners: np.ndarray
    hamming: int
    margin: float


class TagFinder:
    """Finds tags of one family. Made once: the library keeps memory of each detector for good.

    Raises:
        ImportError: another package than PyPI's is installed as `apriltag`.
    """

    def __init__(self, settings: DetectorSettings) -> None:
        if not hasattr(
            apriltag, "DetectorOptions"
        ):  # Debian's python3-apriltag has the same name and another interface
            raise ImportError("the module apriltag is Debian's python3-apriltag, but PyPI's apriltag is needed")
        self._settings = settings
        self._detector = apriltag.Detector(
            apriltag.DetectorOptions(
                families=settings.tag_family,
                nthreads=settings.tag_threads or max(1, multiprocessing.cpu_count() - 1),
                quad_decimate=settings.tag_decimate,
                quad_blur=settings.tag_blur,
            )
        )

    def find(self, grey: np.ndarray) -> tuple[FoundTag, ...]:
        """Returns the tags in a picture, shape (height, width), 8 bit.

        Raises:
            ValueError: the array is no such picture.
        """
        if grey.ndim != 2 or grey.dtype != np.uint8:
            raise ValueError(f"tags are looked for in grey pictures of 8 bit, not in {grey.dtype} {grey.shape}")
        found = [
            FoundTag(tag.tag_id, read_only(tag.corners - LIBRARY_OFFSET_PX), tag.hamming, tag.decision_margin)
            for tag in self._detector.detect(np.ascontiguousarray(grey))
            if tag.hamming <= self._settings.max_hamming_dist
        ]
        if not self._settings.remove_duplicates:
            return tuple(found)
        ids = [tag.id for tag in found]
        return tuple(tag for tag in found if ids.count(tag.id) == 1)
