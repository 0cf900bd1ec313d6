"""Numbers on a command line are within their range, or refused with it."""

from __future__ import annotations

import argparse
import math

import pytest

from common.command_line import angle, exit_code, finite, not_negative, parse_options, port, positive, real, whole
from common.errors import RigError


@pytest.mark.parametrize(
    ("kind", "taken", "refused"),
    [
        (finite, {"-1e3": -1e3}, ["inf", "nan", "one"]),
        (not_negative, {"0": 0.0}, ["-0.1", "inf", "nan"]),
        (positive, {"0.1": 0.1}, ["0", "inf", "nan"]),
        (angle, {"-180": -180.0}, ["180.1", "nan"]),
        (real(0.0, 1.0), {"0": 0.0, "1": 1.0}, ["-0.1", "1.1", "nan"]),
        (real(0.0, math.inf, open_low=True), {"inf": math.inf}, ["0", "nan", "-1"]),
        (whole(1, 3), {"3": 3}, ["0", "4", "1.0", "-1"]),
        (port, {"0": 0, "65535": 65535}, ["65536", "-1", "x"]),
    ],
)
def test_a_number_is_taken_or_refused_with_its_range(kind, taken, refused):
    assert {text: kind(text) for text in taken} == taken
    for text in refused:
        with pytest.raises(argparse.ArgumentTypeError, match=f"'{text}' is not a"):
            kind(text)


def test_what_roslaunch_adds_is_ignored_and_nothing_else(capsys):
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int)
    assert parse_options(parser, ["--seed", "3", "__name:=x"]).seed == 3
    with pytest.raises(SystemExit):
        parse_options(parser, ["stray"])
    assert "unrecognized arguments: stray" in capsys.readouterr().err
    parser.add_argument("files", nargs="+")
    for last in ("film.mp4", "-film.mp4", "/a/b c:=d.mp4"):
        given = ["--seed", "3", "--", last, "__name:=x", "__log:=/a b", "image:=/x", "~key:=3"]
        assert parse_options(parser, given).files == [last]


@pytest.mark.parametrize("error", [RigError("no arm"), OSError("no arm")])
def test_an_error_is_a_sentence_and_exit_code_1(capsys, error):
    def job():
        raise error

    assert exit_code("program", job) == 1 and capsys.readouterr().err == "program: no arm\n"
    assert exit_code("program", lambda: None) == 0 and exit_code("program", lambda: 3) == 3
