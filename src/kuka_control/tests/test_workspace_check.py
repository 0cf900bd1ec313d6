"""All faults of a set of parameters at once."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from common.errors import ConfigError
from kuka_control.model.rig import checked_rig
from kuka_control.model.workspace_study import sentences, title

CONFIG = Path(__file__).parents[1] / "config"


def values(name="kuka_params_rt.yaml", **changes):
    return {**yaml.safe_load((CONFIG / name).read_text()), **changes}


def faults(**changes):
    with pytest.raises(ConfigError) as caught:
        checked_rig(values(**changes), "kuka/")
    return caught.value.faults


def test_no_key_is_blamed_twice():
    assert len(faults(center_line=[0, 0, 0])) == 1
    assert len(faults(z_lower_limit=0.05)) == 1


@pytest.mark.parametrize(
    ("key", "value"),
    [("center_line", "left"), ("opening_angle", None), ("robot", ["LBR7R800"]), ("outer_sphere_limit", float("nan"))],
)
def test_what_is_no_number_leaves_the_geometry_unjudged(key, value):
    (fault,) = faults(**{key: value})
    assert fault.startswith(f"kuka/{key} is ")


def test_a_home_out_of_reach_is_a_fault():
    (fault,) = faults(tool_length=0.5)
    assert "out of reach" in fault and "too long" in fault


def test_the_report_says_both_figures_and_has_no_minus_zero():
    class Study:
        percent_down, percent_within, percent_always = 94.5, 86.14, 49.6
        positions = np.zeros((1000, 3))
        failures = {}  # noqa: RUF012

    config, rig = checked_rig(values(center_line=[-1, 0, 0]))
    text = "\n".join(sentences(config, rig, Study, (25.0, 25.0, 25.0)))
    assert "straight down: 94.5 % of 1000 positions" in text
    assert "within yaw, pitch, roll of +-25 deg: 86.1 % of the poses" in text
    assert "-0.0" not in text
    assert "+-25, +-20, +-25 deg" in "\n".join(sentences(config, rig, Study, (25.0, 20.0, 25.0)))
    assert title(config) == "Workspace of the LBR7R800: center_line [-1, 0, 0], 50 deg"
