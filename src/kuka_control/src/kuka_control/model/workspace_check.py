"""Everything that is wrong with a set of parameters for the arm, in one go."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from common.config import parse
from common.errors import ConfigError
from kuka_control.model.calibration_file import DhDeviations
from kuka_control.model.config import ControllerConfig, neighbours
from kuka_control.model.home_pose import HomeError
from kuka_control.model.rig import Rig


def checked_rig(
    values: Mapping, prefix: str = "", read_dh: Callable[[ControllerConfig], DhDeviations | None] = lambda config: None
) -> tuple[ControllerConfig, Rig]:
    """Returns the parameters and the arm with workspace and home that they describe.

    Args:
        values: what the yaml or the parameter server holds, of either controller.
        prefix: stands before each key in the messages, such as "kuka/".
        read_dh: reads the file that the parameter dh_parameters names.

    Raises:
        ConfigError: with all faults, one sentence each.
    """
    config = parse(ControllerConfig, values, prefix, others=neighbours(ControllerConfig))
    try:
        return config, Rig.of(config, read_dh(config))
    except HomeError as error:
        raise ConfigError([str(error)]) from error
