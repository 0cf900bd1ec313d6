"""What the calibration's program and the node that publishes the camera's place both read at their start."""

from __future__ import annotations

from dataclasses import dataclass

from apriltag_ros.target import Target
from common.ros.params import wait_for_config
from vision.calibration import CalibrationConfig
from vision.panel import PanelConfig
from vision.ros.calibration_store import CalibrationStore, StoreConfig
from vision.ros.panel_sights import panel_target

NAMESPACE = "camera_calibration"


@dataclass(frozen=True)
class CalibrationSetup:
    """The parameters under camera_calibration/, and the panel."""

    panel: PanelConfig
    limits: CalibrationConfig
    store_config: StoreConfig
    store: CalibrationStore
    target: Target


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
    return CalibrationSetup(panel, limits, store, CalibrationStore(store), panel_target(detector, panel.frame))
