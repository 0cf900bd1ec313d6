"""The yaml that is shipped, and faults of the parameters."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from common.config import parse
from common.errors import ConfigError
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.start_gate import interaction_box

SHIPPED = yaml.safe_load((Path(__file__).parents[1] / "config" / "leap_params.yaml").read_text())


def test_the_shipped_parameters_are_those_of_the_reference(leap):
    config = parse(LeapConfig, SHIPPED, "leap/")
    np.testing.assert_array_equal(config.box_dimensions, [0.2, 0.2, 0.2])
    assert (
        config.filter == "kalman"
        and parse(LeapConfig, {k: v for k, v in SHIPPED.items() if k != "filter"}).filter == "mean"
    )
    assert {k: v for k, v in vars(config).items() if k != "box_dimensions"} == {
        k: v for k, v in vars(leap(filter="kalman")).items() if k != "box_dimensions"
    }


@pytest.mark.parametrize(
    "change, word",
    [
        ({"center_line": [1, 0, 0.1]}, "z must be zero"),
        ({"center_line": [0, 0, 0]}, "zero vector"),
        ({"ws_center": [0.5, 0.0, 0.1]}, "above z_lower_limit"),
        ({"tool_length": -0.1}, "tool_length"),
    ],
)
def test_bad_parameters_of_the_arm_are_named(change, word):
    good = {"center_line": [1, -1, 0], "z_lower_limit": 0.2, "tool_length": 0.106, "ws_center": [0.42, -0.42, 0.4]}
    parse(ArmPlacement, good, "kuka/")
    with pytest.raises(ConfigError, match=word):
        parse(ArmPlacement, {**good, **change}, "kuka/")


def test_the_box_stands_over_the_leap_at_the_height_of_the_workspace_centre(leap, arm):
    box = interaction_box(leap(), arm())
    np.testing.assert_allclose(box.center, [0.0, 0.35, 0.0])
    np.testing.assert_array_equal(box.size, [0.2, 0.2, 0.2])


def test_a_box_that_reaches_into_the_leap_is_refused(leap, arm):
    with pytest.raises(ConfigError, match="z_clearance"):
        interaction_box(leap(z_clearance=0.0), arm(ws_center=np.array([0.5, 0.0, 0.25])))
