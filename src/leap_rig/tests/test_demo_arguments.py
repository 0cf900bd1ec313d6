"""What the command line of the demo refuses, before anything starts."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--recording", "no_such.jsonl"], "the recording no_such.jsonl is not a file"),
        (["--record", "film.avi"], "the film film.avi must end with .mp4"),
        (["--record", "/no_folder/film.mp4"], "/no_folder/film.mp4 cannot be written: there is no folder /no_folder"),
        (["--report", "/no_folder/x.json"], "/no_folder/x.json cannot be written: there is no folder /no_folder"),
        (["--duration", "-1"], "the duration -1.0 must be a positive number of seconds"),
        (["--duration", "nan"], "the duration nan must be a positive number of seconds"),
        (["--", "robot_port"], "'robot_port' is not of the form name:=value"),
        (["--", "sim:=false"], "the demo is the simulated rig; the real one is started by `roslaunch leap_rig demo"),
    ],
)
def test_bad_arguments_get_one_sentence(arguments, sentence, capsys):
    from leap_rig.ros.demo import parse_arguments

    with pytest.raises(SystemExit) as end:
        parse_arguments(arguments)
    assert end.value.code == 2
    assert sentence in capsys.readouterr().err
