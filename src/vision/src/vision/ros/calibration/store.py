"""The folder with the calibrations of the camera pose: a dated yaml file each, never changed once written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import rospkg
import rospy
import yaml

from common.config import path, text
from common.errors import ConfigError, DeviceError
from common.ros.files import write_whole
from vision.calibration.record import CalibrationRecord, mapping_from_record, record_from_mapping

PREFIX = "camera_place_"


@dataclass(frozen=True)
class StoreConfig:
    """The folder of the calibrations, and the hardware that they belong to."""

    folder: str = path(doc="folder of the calibrations; empty: leap_rig/ in ROS's home, ~/.ros")
    camera: str = text(doc="serial number of the camera; empty: the one that its driver reads", empty=True)
    robot: str = text(doc="the arm: LBR7R800 or LBR14R820")
    flange: str = text(doc="its media flange")


class CalibrationStore:
    """Reads and writes the calibrations of one arm and one camera."""

    def __init__(self, config: StoreConfig) -> None:
        self._config = config
        self.folder = Path(config.folder) if config.folder else Path(rospkg.get_ros_home()) / "leap_rig"

    def newest(self) -> tuple[CalibrationRecord, Path] | None:
        """Returns the newest calibration of this arm and camera, and its file; None without one.

        A damaged file is logged and skipped.
        """
        for file in sorted(self.folder.glob(f"{PREFIX}*.yaml"), reverse=True):
            try:
                record = read(file)
            except (ConfigError, DeviceError) as error:
                rospy.logerr("Skipped the calibration %s: %s Delete it, or calibrate again.", file, error)
                continue
            if (record.robot, record.camera) == (self._config.robot, self._config.camera):
                return record, file
            rospy.loginfo("The calibration %s is for %s and camera %s.", file, record.robot, record.camera)
        return None

    def save(self, record: CalibrationRecord) -> Path:
        """Writes a calibration and returns its file.

        Raises:
            DeviceError: the disk is full or the folder cannot be written; no file is left behind.
        """
        file = self.folder / f"{PREFIX}{record.date.replace(':', '')}.yaml"
        content = "# Place of the camera: lengths in m, errors in mm and deg, quaternions x y z w.\n" + yaml.safe_dump(
            mapping_from_record(record), sort_keys=False
        )
        try:
            write_whole(file, content)
        except OSError as error:
            raise DeviceError(
                f"Cannot write {file}: {error.strerror}. The previous calibration stays valid; free the disk or choose "
                "another folder."
            ) from None
        return file


def read(file: Path) -> CalibrationRecord:
    """Returns the calibration in a file.

    Raises:
        DeviceError: the file cannot be read.
        ConfigError: the file is damaged, or is not a calibration.
    """
    try:
        values = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise DeviceError(f"Cannot read {file}: {error}.") from None
    except yaml.YAMLError as error:
        raise ConfigError([f"{file} is not valid yaml: {' '.join(str(error).split())}."]) from None
    return record_from_mapping(values)
