"""Typed configuration: what is accepted, what is refused, and how the refusal reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import REQUIRED, choice, flag, integer, keys, number, parse, parse_part, path, required, text, vector
from common.errors import ConfigError


@dataclass(frozen=True)
class Example:
    robot: str = choice("LBR7R800", "LBR14R820", doc="the arm")
    angle: float = number("deg", above=0.0, below=180.0)
    size: int = integer(low=1, high=100)
    centre: np.ndarray = vector(3, "m")
    home: bool = flag()
    host: str = text()
    file: str = path(absent="")

    def faults(self):
        return [] if self.centre[2] == 0.0 else ["centre must lie in the plane z = 0."]


GOOD = {"robot": "LBR7R800", "angle": 50, "size": 10, "centre": [1, -1, 0], "home": False, "host": "localhost"}


def faults(**changes):
    with pytest.raises(ConfigError) as error:
        parse(Example, {**GOOD, **changes}, "kuka/")
    return error.value.faults


def test_good_values_are_read_with_their_types():
    config = parse(Example, GOOD)
    assert isinstance(config.angle, float) and config.size == 10 and config.home is False
    np.testing.assert_array_equal(config.centre, [1.0, -1.0, 0.0])
    with pytest.raises(ValueError):
        config.centre[0] = 2.0


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("robot", "LBR8"), ("angle", 0.0), ("angle", 180), ("angle", "50"), ("angle", float("nan")), ("angle", True),
        ("size", 0), ("size", 1.5), ("size", False), ("centre", [1, 2]), ("centre", "abc"),
        ("centre", [1, 2, float("inf")]), ("centre", 3.0), ("home", 1), ("host", " "), ("host", 5),
        ("file", "arm.yaml"), ("file", 5), ("file", None),
    ],
)  # fmt: skip
def test_a_bad_value_is_refused_with_its_key_and_value(key, value):
    (fault,) = faults(**{key: value})
    assert fault.startswith(f"kuka/{key} is {value!r}, but must be ")


def test_a_path_is_absolute_or_empty_or_left_out():
    assert parse(Example, GOOD).file == parse(Example, {**GOOD, "file": ""}).file == ""
    assert parse(Example, {**GOOD, "file": "/arm.yaml"}).file == "/arm.yaml"
    assert faults(file="arm.yaml") == ("kuka/file is 'arm.yaml', but must be an absolute path, or empty.",)


def test_the_range_and_unit_are_named():
    assert faults(angle=200.0) == ("kuka/angle is 200.0, but must be a finite number in (0, 180) deg.",)
    assert faults(size=0) == ("kuka/size is 0, but must be a whole number in [1, 100].",)


def test_all_faults_are_reported_at_once():
    assert len(faults(angle=-1, size=0, stray=1)) == 3


def test_a_part_of_a_file_adds_its_faults_to_those_of_the_others():
    found = ["The table has no legs."]
    assert parse_part(Example, {**GOOD, "size": 0}, "objects/1/", found) is None
    assert found[0] == "The table has no legs." and found[1].startswith("objects/1/size is 0, ")
    part = parse_part(Example, {**GOOD, "kind": "box"}, "objects/2/", found, others=("kind",))
    assert part is not None and part.size == 10 and len(found) == 2


def test_missing_and_unknown_keys_are_faults_unless_they_belong_to_others():
    with pytest.raises(ConfigError, match="kuka/robot is missing"):
        parse(Example, {k: v for k, v in GOOD.items() if k != "robot"}, "kuka/")
    assert "stray is not a known key" in faults(stray=1)[0]
    assert parse(Example, {**GOOD, "stray": 1}, others=("stray",)).size == 10


def test_what_no_single_key_can_check():
    assert faults(centre=[1, 1, 1]) == ("kuka/centre must lie in the plane z = 0.",)


def test_not_a_mapping():
    with pytest.raises(ConfigError, match="must be a mapping"):
        parse(Example, 7, "kuka/")


def test_keys_tell_type_range_unit_meaning_and_default():
    assert keys(Example) == [
        ("robot", "one of", "LBR7R800, LBR14R820", "", "the arm", REQUIRED),
        ("angle", "number", "(0, 180)", "deg", "", REQUIRED),
        ("size", "whole number", "[1, 100]", "", "", REQUIRED),
        ("centre", "3 numbers", "", "m", "", REQUIRED),
        ("home", "true or false", "", "", "", REQUIRED),
        ("host", "text", "", "", "", REQUIRED),
        ("file", "absolute path, or empty", "", "", "", ""),
    ]


@given(st.floats())
def test_a_number_is_accepted_exactly_in_its_range(value):
    if 0.0 < value < 180.0:
        assert parse(Example, {**GOOD, "angle": value}).angle == value
    else:
        faults(angle=value)


@dataclass(frozen=True)
class Later:
    old: float = number()
    angles: np.ndarray = vector(3, "deg", high=180.0, absent=(0.0, 0.0, 0.0))
    used: bool = flag(absent=False)
    limit: float = number(absent=None)


def test_a_key_that_came_later_may_be_absent_and_is_checked_like_the_others_if_not():
    config = parse(Later, {"old": 1})
    np.testing.assert_array_equal(config.angles, [0.0, 0.0, 0.0])
    assert config.used is False and config.limit is None
    assert parse(Later, {"old": 1, "used": True, "limit": 2}).limit == 2.0
    with pytest.raises(ConfigError, match="angles is .*, but must be 3 finite numbers"):
        parse(Later, {"old": 1, "angles": [0, 0, 181]})
    assert required(Later) == ("old",)
