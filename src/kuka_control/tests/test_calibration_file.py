"""The file of a calibrated arm: what it may hold, and what the kinematics make of it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from common.config import parse
from common.errors import ConfigError
from kuka_control.model.config import DhDeviations

EXAMPLE = Path(__file__).parents[1] / "config" / "dh_parameters_example.yaml"


def example(**changes):
    return parse(DhDeviations, {**yaml.safe_load(EXAMPLE.read_text()), **changes}, "arm.yaml: ")


def test_the_example_is_good_and_says_its_units():
    found = example()
    assert found.robot == "LBR7R800"
    np.testing.assert_allclose(found.parameters.d, 1e-3 * found.delta_d)
    np.testing.assert_allclose(found.parameters.theta, np.pi / 180.0 * found.delta_theta)
    assert found.parameters.any
    for line in EXAMPLE.read_text().splitlines():
        assert line.startswith("#") or not line or any(unit in line for unit in ("# mm", "# deg", "no unit")), line


@pytest.mark.parametrize(
    "key, value, allowed",
    [
        ("delta_a", [0, 0, 0, 0, 0, 0, 5.1], r"7 finite numbers, each in \[-5, 5\] mm"),
        ("delta_d", [0.34, 0, 0.4, 0, 400.0, 0, 0.161], r"each in \[-5, 5\] mm"),
        ("delta_alpha", [-1.01, 0, 0, 0, 0, 0, 0], r"each in \[-1, 1\] deg"),
        ("delta_theta", [0, 0, float("nan"), 0, 0, 0, 0], r"each in \[-1, 1\] deg"),
        ("robot", "LBR8", "one of LBR7R800, LBR14R820"),
    ],
)
def test_a_value_that_is_not_plausible_is_refused_with_its_key_and_range(key, value, allowed):
    with pytest.raises(ConfigError, match=rf"^arm.yaml: {key} is .*, but must be .*{allowed}"):
        example(**{key: value})


@pytest.mark.ros
@pytest.mark.parametrize("on_this_machine", [True, False])
@pytest.mark.parametrize("said", [{}, {"simulated": False}, {"simulated": True}])
def test_a_simulated_arms_geometry_is_refused_by_a_real_arm_and_an_unknown_one_doubted(
    tmp_path, said, on_this_machine, monkeypatch
):
    from kuka_control.ros.parameter_server import dh_deviations

    warned: list[str] = []
    monkeypatch.setattr("rospy.logwarn", lambda text, *words: warned.append(text % words))
    example = {key: value for key, value in yaml.safe_load(EXAMPLE.read_text()).items() if key != "simulated"}
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump({**example, **said}))
    config = SimpleNamespace(dh_parameters=str(file), robot="LBR7R800", on_this_machine=on_this_machine)
    if said.get("simulated") and not on_this_machine:
        with pytest.raises(ConfigError, match=f"^{file} was measured with simulated devices"):
            dh_deviations(config)
    else:
        assert dh_deviations(config).robot == "LBR7R800"
    doubted = [f"{file} does not say whether"] if not said and not on_this_machine else []
    assert [text[: len(doubted[0])] if doubted else text for text in warned] == doubted
