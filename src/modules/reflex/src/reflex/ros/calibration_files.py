"""The files in which a hand's calibration is kept, in a folder that the user may write."""

from __future__ import annotations

import os
from pathlib import Path

import rospkg
import rospy

from common.errors import DeviceError
from common.ros.files import write_whole
from reflex.calibration import (
    FingerZeros,
    TactileOffsets,
    offsets_from_text,
    offsets_text,
    zeros_from_text,
    zeros_text,
)

FINGERS = "finger_calibrate.yaml"
TACTILE = "tactile_calibrate.yaml"


class CalibrationFiles:
    """Reads and writes the two files.

    Args:
        folder: where they are kept; `~` at its beginning is the home folder. Made when something is saved.
    """

    def __init__(self, folder: str) -> None:
        self._folder = Path(os.path.expanduser(folder))
        self._shipped = Path(rospkg.RosPack().get_path("reflex")) / "config"

    def load(self) -> tuple[FingerZeros, TactileOffsets, bool]:
        """Returns both calibrations, the shipped ones where none was saved, and whether the fingers' was saved.

        Raises:
            ConfigError: a file holds something else.
            DeviceError: a file cannot be read.
        """
        fingers, tactile = self._find(FINGERS), self._find(TACTILE)
        zeros = zeros_from_text(_read(fingers), str(fingers))
        offsets = offsets_from_text(_read(tactile), str(tactile))
        rospy.loginfo("Calibration from %s and %s.", fingers, tactile)
        return zeros, offsets, fingers.parent == self._folder

    def save_zeros(self, zeros: FingerZeros) -> Path:
        """Writes the zeros of the fingers and returns the file.

        Raises:
            DeviceError: the disk is full or the folder cannot be written; the old file is whole.
        """
        return self._write(FINGERS, zeros_text(zeros))

    def save_offsets(self, offsets: TactileOffsets) -> Path:
        """Writes the zeros of the tactile sensors and returns the file.

        Raises:
            DeviceError: the disk is full or the folder cannot be written; the old file is whole.
        """
        return self._write(TACTILE, offsets_text(offsets))

    def _find(self, name: str) -> Path:
        saved = self._folder / name
        return saved if saved.exists() else self._shipped / name

    def _write(self, name: str, text: str) -> Path:
        path = self._folder / name
        try:
            write_whole(path, text)
        except OSError as error:
            raise DeviceError(
                f"Cannot write {path}: {error.strerror}; the calibration holds until the driver ends."
            ) from None
        return path


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DeviceError(f"Cannot read {path}: {error}.") from None
