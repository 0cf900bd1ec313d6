"""Named joint configurations, and what a person may ask for."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common.errors import ConfigError
from iiwa_kinematics.robot_model import JOINT_RANGES_DEG, robot_model
from kuka_control.model.joint_configurations import chosen_configuration, named_configurations, range_faults

MODEL = robot_model("LBR7R800", "MF_elektrisch")
SHIPPED = yaml.safe_load((Path(__file__).parents[1] / "config" / "joint_configurations.yaml").read_text())
NAMED = named_configurations(SHIPPED, MODEL)


def faults(call, *arguments):
    with pytest.raises(ConfigError) as caught:
        call(*arguments)
    return caught.value.faults


def test_the_shipped_configurations():
    degrees = {name: np.degrees(q).round(9).tolist() for name, q in NAMED.items()}
    assert degrees == {
        "zero": [0, 0, 0, 0, 0, 0, 0],
        "hand_mounting": [0, 0, 0, -110, 0, -50, 0],
        "camera_calibration": [0, 20, 10, -110, 0, 90, -45],
    }


@given(st.lists(st.floats(-400.0, 400.0), min_size=7, max_size=7))
def test_every_joint_out_of_range_is_named_and_no_other(angles):
    found = range_faults(MODEL, np.radians(angles))
    outside = [
        i + 1 for i, (a, limit) in enumerate(zip(angles, JOINT_RANGES_DEG)) if abs(np.radians(a)) > MODEL.upper[i]
    ]
    assert [int(fault.split()[1]) for fault in found] == outside
    assert all(f"{-JOINT_RANGES_DEG[j - 1]:g} to {JOINT_RANGES_DEG[j - 1]:g} deg" in f for j, f in zip(outside, found))


def test_a_name_or_seven_angles_can_be_chosen():
    assert chosen_configuration(["zero"], NAMED, MODEL)[0] == "zero"
    text, q = chosen_configuration(["0", "-20.5", "10", "-110", "0", "9e1", "175"], NAMED, MODEL)
    np.testing.assert_allclose(np.degrees(q), [0, -20.5, 10, -110, 0, 90, 175])
    assert text == "the given angles"
    assert not q.flags.writeable


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["home"], "There is no joint configuration 'home'; known are zero, hand_mounting, camera_calibration."),
        (["1"], "'1' is neither"),
        (["0", "0", "0", "0", "0", "0"], "neither"),
        (["0", "0", "0", "0", "0", "0", "0", "0"], "neither"),
        (["0", "0", "0", "0", "0", "0", "x"], "neither"),
        (["0", "0", "0", "0", "0", "0", "nan"], "neither"),
        (["0", "0", "0", "inf", "0", "0", "0"], "neither"),
        (["0", "0", "0", "0", "0", "0", "176"], "Joint 7 at 176 deg is out of its range of -175 to 175 deg."),
    ],
)
def test_anything_else_is_refused(words, sentence):
    (fault,) = faults(chosen_configuration, words, NAMED, MODEL)
    assert sentence in fault


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (None, "must be a mapping"),
        ({}, "must be a mapping"),
        ([1, 2], "must be a mapping"),
        ({"a b": [0] * 7}, "'a b' is no name"),
        ({3: [0] * 7}, "3 is no name"),
        ({"low": [0] * 6}, "low is [0, 0, 0, 0, 0, 0], but must be 7 finite numbers deg"),
        ({"low": [0, 0, 0, 0, 0, 0, float("nan")]}, "low is"),
        ({"low": [0, 130, 0, 0, 0, 0, 0]}, "low: Joint 2 at 130 deg is out of its range"),
    ],
)
def test_a_bad_file_is_refused(values, sentence):
    (fault,) = faults(named_configurations, values, MODEL)
    assert sentence in fault


def test_all_faults_of_a_file_are_said():
    assert len(faults(named_configurations, {"a": [0] * 6, "b": "x", "c": [0] * 7}, MODEL)) == 2
    assert len(faults(named_configurations, {"a": [200] * 7, "b": [0] * 7}, MODEL)) == 7
