"""What the calibration's program and the node that publishes the camera's place both read at their start."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import rospy

from apriltag_ros.target import Target
from common.errors import DeviceError
from common.ros.params import wait_for_config
from vision.calibration.acceptance import CalibrationConfig
from vision.marker_board.board import PanelConfig
from vision.ros.calibration.store import CalibrationStore, StoreConfig
from vision.ros.marker_board.detections import panel_target

NAMESPACE = "camera_calibration"
SERIAL, SERIAL_WAIT_S, POLL_S = "camera/driver/serial", 10.0, 0.1
"""Where our driver writes the camera's serial number, and how long it may take until it has opened the camera."""

UNKNOWN = "unknown"


@dataclass(frozen=True)
class CalibrationSetup:
    """The parameters under camera_calibration/, and the panel."""

    panel: PanelConfig
    limits: CalibrationConfig
    store_config: StoreConfig
    store: CalibrationStore
    target: Target

    def check_serial(self) -> None:
        """Raises DeviceError if nothing tells the camera from others, so that nothing may be stored for it."""
        if self.store_config.camera == UNKNOWN:
            raise DeviceError(
                "The camera's serial number is unknown, and its calibration would be taken for any other camera's: "
                "give it a name, the same each time, as camera_apriltag.launch serial:=NAME."
            )


def read_setup(detector: str) -> CalibrationSetup:
    """Returns the set-up; waits for its parameters.

    Args:
        detector: name of the detector node.

    Raises:
        ConfigError: with all faults.
    """
    panel = wait_for_config(PanelConfig, f"{NAMESPACE}/panel")
    limits = wait_for_config(CalibrationConfig, f"{NAMESPACE}/limits")
    store = wait_for_config(StoreConfig, f"{NAMESPACE}/store")
    if not store.camera:
        store = replace(store, camera=_serial_of_driver() or UNKNOWN)
        rospy.loginfo("The camera's serial number is %s.", store.camera)
    return CalibrationSetup(panel, limits, store, CalibrationStore(store), panel_target(detector, panel.frame))


def _serial_of_driver() -> str:
    """Returns what the driver read from the camera; empty if it says nothing in time."""
    deadline = time.monotonic() + SERIAL_WAIT_S
    while not rospy.has_param(SERIAL) and time.monotonic() < deadline and not rospy.is_shutdown():
        time.sleep(POLL_S)
    return str(rospy.get_param(SERIAL, ""))
