"""The file of a calibrated arm's parameters that the parameter dh_parameters names."""

from __future__ import annotations

from pathlib import Path

from common.config import parse
from common.errors import ConfigError
from kuka_control.model.calibration_file import DhDeviations
from kuka_control.model.config import ControllerConfig
from kuka_control.ros.parameter_server import read_yaml


def dh_deviations(config: ControllerConfig) -> DhDeviations | None:
    """Returns what the file says; None if the parameter is empty.

    Raises:
        RigError: the file cannot be read, or a value is not plausible.
    """
    if not config.dh_parameters:
        return None
    path = Path(config.dh_parameters)
    found = parse(DhDeviations, read_yaml(path), f"{path}: ")
    if found.robot != config.robot:
        raise ConfigError([f"{path}: robot is {found.robot}, but the arm is a {config.robot}."])
    return found
