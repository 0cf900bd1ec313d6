"""Parameters that the program calibrate_camera and the node camera_place share."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import rospy

from apriltag_ros.target import TagTarget
from common.errors import DeviceError
from common.ros.params import wait_for_config, wait_for_param
from vision.calibration.acceptance import CalibrationConfig
from vision.marker_board.board import MarkerBoardConfig
from vision.ros.calibration.store import CalibrationStore, StoreConfig
from vision.ros.marker_board.detections import board_target

NAMESPACE = "camera_calibration"
SERIAL, SERIAL_WAIT_S, POLL_S = "camera/driver/serial", 10.0, 0.1
"""Parameter in which our driver writes the camera's serial number, and how long it may take to open the camera."""

UNKNOWN = "unknown"


@dataclass(frozen=True)
class CalibrationSetup:
    """The parameters under camera_calibration/, and the tags of the marker board."""

    board: MarkerBoardConfig
    limits: CalibrationConfig
    store_config: StoreConfig
    store: CalibrationStore
    target: TagTarget

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
        store, date = self.store_config, time.strftime("%Y-%m-%dT%H:%M:%S")
        hardware = {"robot": store.robot, "flange": store.flange, "camera": store.camera}
        return {"date": date, **hardware, "panel": self.board.frame}


def read_setup(detector: str) -> CalibrationSetup:
    """Returns the setup; waits for its parameters and for those of the node `detector`.

    Raises:
        ConfigError: with all faults.
    """
    board = wait_for_config(MarkerBoardConfig, f"{NAMESPACE}/panel")
    limits = wait_for_config(CalibrationConfig, f"{NAMESPACE}/limits")
    store = wait_for_config(StoreConfig, f"{NAMESPACE}/store")
    if not store.camera:
        store = replace(store, camera=_serial_of_driver() or UNKNOWN)
        rospy.loginfo("The camera's serial number is %s.", store.camera)
    target = board_target(wait_for_param(detector), detector, board.frame)
    return CalibrationSetup(board, limits, store, CalibrationStore(store), target)


def _serial_of_driver() -> str:
    """Returns the serial number that the driver read from the camera; empty if it does not appear in time."""
    deadline = time.monotonic() + SERIAL_WAIT_S
    while not rospy.has_param(SERIAL) and time.monotonic() < deadline and not rospy.is_shutdown():
        time.sleep(POLL_S)
    return str(rospy.get_param(SERIAL, ""))
