"""What the program calibrate_camera and the node camera_place share: parameters, stored calibrations, and poses in tf.

The calibrations are a folder of dated yaml files, which never change once written.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rospkg
import rospy
import tf2_ros
import yaml

from apriltag_ros.settings import TagTarget
from common import clock
from common.config import path, text
from common.errors import ConfigError, DeviceError
from common.frames import BASE, CAMERA_LINK, FLANGE_MEASURED
from common.poses import inverse
from common.ros.conversions import pose_from_transform, stamped_transform
from common.ros.files import read_text, read_yaml, write_whole
from common.ros.params import wait_for_config, wait_for_param
from common.simulated import SIMULATED, any_simulated, doubt, refusal
from common.stored_time import moment, utc
from leap_motion.service.access import is_loopback
from vision.calibration.acceptance import CalibrationConfig
from vision.calibration.record import CalibrationRecord, mapping_from_record, record_from_mapping
from vision.marker_board.board import MarkerBoardConfig, board_target

NAMESPACE = "camera_calibration"
SERIAL = "camera/driver/serial"  # written by our driver
UNKNOWN = "unknown"
PREFIX = "camera_place_"
HEADER = "# Place of the camera: lengths in m, errors in mm and deg, quaternions x y z w.\n"
DATE = re.compile(r"^date: *['\"]?([^'\"\s]+)", re.MULTILINE)


@dataclass(frozen=True)
class StoreConfig:
    """The folder of the calibrations, and the hardware that they belong to."""

    folder: str = path(doc="folder of the calibrations; empty: leap_rig/ in ROS's home, ~/.ros")
    camera: str = text(doc="serial number of the camera; empty: the one that its driver reads", empty=True)
    robot: str = text(doc="the arm: LBR7R800 or LBR14R820")
    flange: str = text(doc="its media flange")


class CalibrationStore:
    """Reads and writes the calibrations of one arm and one camera; `simulated`: whether that is the simulated one, None
    if nothing says so.
    """

    def __init__(self, config: StoreConfig, simulated: bool | None) -> None:
        self._config, self._simulated = config, simulated
        self.folder = Path(config.folder) if config.folder else Path(rospkg.get_ros_home()) / "leap_rig"

    def newest(self) -> tuple[CalibrationRecord, Path] | None:
        """Returns the newest calibration of this arm and camera and its file, or None; skips and logs damaged files.
        Raises DeviceError if it may not be used here.
        """
        for file in sorted(self.folder.glob(f"{PREFIX}*.yaml"), key=_age_order, reverse=True):
            try:
                record = read(file)
            except ConfigError as error:
                rospy.logerr("Skipped the calibration %s: %s Delete it, or calibrate again.", file, error)
                continue
            if (record.robot, record.camera) == (self._config.robot, self._config.camera):
                self.check(record, file)
                return record, file
            rospy.loginfo("The calibration %s is for %s and camera %s.", file, record.robot, record.camera)
        return None

    def check(self, record: CalibrationRecord, file: Path) -> None:
        """Raises DeviceError for a calibration that may not be used with this camera; warns of one that does not say
        how it was measured.
        """
        said = f"The calibration {file}", record.simulated, self._simulated
        why = refusal(*said, "Move it away, then run rosrun vision calibrate_camera.py with the real arm and camera.")
        if why:
            raise DeviceError(why)
        if doubt(*said):
            rospy.logwarn("%s", doubt(*said))

    def save(self, record: CalibrationRecord) -> Path:
        """Writes a calibration and returns its file; raises DeviceError, and leaves no file behind, if it cannot."""
        file = self.folder / f"{PREFIX}{record.date.replace(':', '')}.yaml"
        content = yaml.safe_dump(mapping_from_record(record), sort_keys=False)
        try:
            write_whole(file, HEADER + content)
        except OSError as error:
            cure = "The previous calibration stays valid; free the disk or choose another folder."
            raise DeviceError(f"Cannot write {file}: {error.strerror}. {cure}") from None
        return file


def _age_order(file: Path) -> tuple[float, str]:
    """Returns what sorts calibrations by age without reading them whole; one without a date comes as the newest."""
    try:
        found = DATE.search(read_text(file))
        return moment(found[1] if found else ""), file.name
    except (OSError, ValueError):
        return float("inf"), file.name


def read(file: Path) -> CalibrationRecord:
    """Returns the calibration in a file; raises ConfigError if it cannot be read, or is damaged."""
    return record_from_mapping(read_yaml(file))


@dataclass(frozen=True)
class CalibrationSetup:
    """The parameters under camera_calibration/, and the tags of the marker board."""

    board: MarkerBoardConfig
    limits: CalibrationConfig
    store_config: StoreConfig
    store: CalibrationStore
    target: TagTarget
    simulated: bool | None  # the camera; None if its driver does not say

    def measured_by(self, arm: str) -> bool | None:
        """Returns whether what this camera and the arm at an address, "" for an unknown one, measure is simulated: a
        simulated arm listens on this machine alone, where no real one is.
        """
        return any_simulated(self.simulated, is_loopback(arm) if arm else None)

    def check_serial(self) -> None:
        """Raises DeviceError if the camera has no serial number; nothing may be stored for it then."""
        if self.store_config.camera == UNKNOWN:
            raise DeviceError(
                "The camera's serial number is unknown, so any other camera would use its calibration: give it a name, "
                "the same each time, with camera_apriltag.launch serial:=NAME."
            )

    @property
    def head(self) -> dict[str, str]:
        """The first entries of a calibration record: date, and the hardware that it belongs to."""
        store, date = self.store_config, utc(clock.time())
        hardware = {"robot": store.robot, "flange": store.flange, "camera": store.camera}
        return {"date": date, **hardware, "panel": self.board.frame}


def read_setup(detector: str) -> CalibrationSetup:
    """Returns the setup; waits for its parameters and for those of the node `detector`. Raises ConfigError."""
    serial_wait_s = 10.0  # longest wait for the serial number
    poll_s = 0.1
    board = wait_for_config(MarkerBoardConfig, f"{NAMESPACE}/panel")
    limits = wait_for_config(CalibrationConfig, f"{NAMESPACE}/limits")
    store = wait_for_config(StoreConfig, f"{NAMESPACE}/store")
    deadline = clock.monotonic() + serial_wait_s
    while not rospy.has_param(SERIAL) and clock.monotonic() < deadline and not rospy.is_shutdown():
        clock.sleep(poll_s)
    serial = rospy.get_param(SERIAL, None)
    simulated = None if serial is None else serial == SIMULATED
    if not store.camera:
        store = replace(store, camera=str(serial or UNKNOWN))
        rospy.loginfo("The camera's serial number is %s.", store.camera)
    target = board_target(wait_for_param(detector), detector, board.frame)
    return CalibrationSetup(board, limits, store, CalibrationStore(store, simulated), target, simulated)


class TfPoses:
    """Looks up the poses that determine the camera pose in tf, and reports which one is missing or stale."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    def flange(self, stamp: rospy.Time, timeout: float) -> np.ndarray:
        """Returns T_base_flange, shape (4, 4) [m], at a time; raises DeviceError if tf lacks it after `timeout` [s]."""
        return self._lookup(BASE, FLANGE_MEASURED, stamp, timeout, "is the arm's controller running?")

    def camera_link(self, T_base_optical: np.ndarray, optical: str, stamp: rospy.Time):
        """Returns the tf message of camera_link in the base, from the pose of the optical frame, shape (4, 4) [m];
        raises DeviceError if the camera's driver does not publish its frames.
        """
        static_wait_s = 10.0
        hint = "is the camera's driver running?"
        T_link_optical = self._lookup(CAMERA_LINK, optical, rospy.Time(0), static_wait_s, hint)
        return stamped_transform(T_base_optical @ inverse(T_link_optical), BASE, CAMERA_LINK, stamp)

    def _lookup(self, parent: str, child: str, stamp: rospy.Time, timeout: float, hint: str) -> np.ndarray:
        try:
            found = self._buffer.lookup_transform(parent, child, stamp, rospy.Duration(timeout))
            return pose_from_transform(found.transform)
        except (tf2_ros.LookupException, tf2_ros.ConnectivityException):
            raise DeviceError(f"tf has no path from {parent} to {child}: {hint}") from None
        except tf2_ros.ExtrapolationException:
            raise DeviceError(f"The frame {child} is stale at the time of the image: {hint}") from None
        except ValueError as error:
            raise DeviceError(f"tf has an invalid {child}: {error}") from None
