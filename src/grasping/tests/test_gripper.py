"""The description of a gripper."""

from __future__ import annotations

import dataclasses

import pytest

from common.errors import RigError
from grasping.poses.gripper import GRIPPER, read_gripper


def test_missing_keys_are_those_of_the_usual_gripper(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("{opening: 0.08, least: 0.02}")
    assert read_gripper(file) == dataclasses.replace(GRIPPER, opening=0.08, least=0.02)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{opening: .nan}", "mine.yaml: opening is nan, but must be a finite number in"),
        ("{opening: 5}", r"opening is 5, but must be a finite number in \(0.01, 0.5\] m"),
        ("{width: 0.1}", "width is not a known key; known are opening, thickness"),
        ("{opening: 0.05, least: 0.06}", "least is 0.06 m, but must be at most opening, 0.05 m"),
        ("[", "mine.yaml is no yaml file"),
        ("", "must be a mapping"),
    ],
)
def test_a_bad_description_is_refused(tmp_path, text, sentence):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(RigError, match=sentence):
        read_gripper(file)
