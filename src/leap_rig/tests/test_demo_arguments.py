"""What the command line of the demo refuses, before anything starts."""

from __future__ import annotations

import pytest

pytest.importorskip("rig_msgs.srv")
from common.config import parse
from common.errors import ConfigError, RigError
from leap_rig.ros import demo
from leap_rig.ros.demo import OF_TWO_ARMS, SCENARIOS, Deaths, launch_arguments, parse_arguments
from rig_simulation.node_parameters import OperatorConfig

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--recording", "no_such.jsonl"], "the recording no_such.jsonl is not a file"),
        (["--record", "film.avi"], "the film film.avi must end with .mp4"),
        (["--record", "/no_folder/film.mp4"], "/no_folder/film.mp4 cannot be written"),
        (["--report", "/no_folder/x.json"], "/no_folder/x.json cannot be written"),
        (["--record", "folder.png"], "folder.png cannot be written: it is a folder"),
        (["--offset", "0", "150", "0"], "the offset shifts a recording, and none is given"),
        (["--offset", "0", "nan", "0", "--recording", __file__], "the offset 0.0 nan 0.0 must be three finite numbers"),
        (["--duration", "-1"], "the duration -1.0 must be a positive number of seconds"),
        (["--duration", "nan"], "the duration nan must be a positive number of seconds"),
        (
            ["--scenario", "pick_cups"],
            "there is no scenario 'pick_cups'; known are pick_cup and assisted_grasp",
        ),
        (["--", "scenario:=juggle"], "there is no scenario 'juggle'"),
        (["--scenario", "pick_cup", "--recording", __file__], "pick_cup and a recording exclude each other"),
        (["--scenario", "pick_cup", "--", "recording:=a.jsonl"], "pick_cup and a recording exclude each other"),
        (["--scenario", "pick_cup", "--tutorial"], "pick_cup and the tutorial exclude each other"),
        (["--", "tracker:=kinect"], "there is no tracker 'kinect'; known are leap"),
        (["--scenario", "pick_cup", "--", "tracker:=headset"], "the tracker headset sees your own hand"),
        (["--", "operator:=no_such_person"], "/no_such_person.yaml for operator:=no_such_person; known: "),
        (["--", "operator:=../x"], "The name of the operator is '../x', but must"),
        (["--", "scene:=no_such/scene.yaml"], "no_such/scene.yaml is not a file"),
        (
            ["--tracker", "webcam", "--scenario", "wall"],
            "the tracker webcam sees your own hand; a scenario or recording",
        ),
        (["--tracker", "webcam", "--", "video:=no_such.mp4"], "no_such.mp4 is not a file"),
        (["--tracker", "none", "--scenario", "wall"], "without a tracker no hand is seen, but a scenario, recording"),
        (
            ["--tracker", "none", "--tutorial"],
            "without a tracker no hand is seen, but a scenario, recording or",
        ),
        (["--", "robot_port"], "'robot_port' is not of the form name:=value"),
        (["--", "robots:=3"], "robots is '3', but must be 1 or 2"),
        (["--scenario", "two_cups"], "the scenario two_cups needs two arms: robots:=2"),
        (["--scenario", "wall", "--", "robots:=2"], "for two arms there is two_cups and hand_over"),
        (["--", "robots:=2", "lift_workspace:=true"], "robots:=2 does not go with lift_workspace:=true"),
        (["--tracker", "webcam", "--", "robots:=2"], "robots:=2 does not go with tracker:=webcam"),
        (["--", "sim:=false"], "the demo is the simulated rig; the real one is started by `roslaunch leap_rig demo"),
    ],
)
def test_bad_arguments_get_one_sentence(arguments, sentence, capsys, tmp_path, monkeypatch):
    (tmp_path / "folder.png").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        parse_arguments(arguments)
    assert end.value.code == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    ("display", "said"),
    [
        ("", "There is no screen, as neither DISPLAY nor WAYLAND_DISPLAY is set"),
        (":98765", "The screen :98765 (DISPLAY) does not answer"),
    ],
)
def test_without_a_screen_the_demo_says_so_and_starts_no_window(monkeypatch, capsys, display, said):
    for name in ("WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", display)
    assert not demo.has_screen(demo.parse_arguments([]))
    assert f"{said}: RViz and the control panel are not started." in capsys.readouterr().out
    assert not demo.has_screen(demo.parse_arguments(["--headless"])) and not capsys.readouterr().out


def test_without_a_place_for_the_logs_no_node_starts(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "new" / "log"))
    demo.refuse_without_logs()
    monkeypatch.setattr(demo.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 3_000_000})())
    with pytest.raises(RigError, match=r"new/log has 3 MB left"):
        demo.refuse_without_logs()
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "file" / "log"))
    with pytest.raises(RigError, match="file/log: Not a directory"):
        demo.refuse_without_logs()


def test_a_scene_of_ones_own_is_found_from_where_the_demo_is_started(tmp_path, monkeypatch):
    (tmp_path / "my scenes").mkdir()
    (tmp_path / "my scenes" / "mine.yaml").write_text("scatter: 0.0\n")
    monkeypatch.chdir(tmp_path)
    arguments = launch_arguments(parse_arguments(["--", "scene:=my scenes/mine.yaml", "leap_args:=--seed 1"]), False)
    assert arguments[-2:] == [f"scene:={tmp_path}/my scenes/mine.yaml", "leap_args:=--seed 1"]
    assert launch_arguments(parse_arguments(["--", "scene:=objects"]), False)[-1] == "scene:=objects"


def test_the_scenarios_are_those_of_the_simulated_operator():
    for name in SCENARIOS:
        arms = ["left", "right"] if name in OF_TWO_ARMS else []
        assert parse(OperatorConfig, {"scenario": name, "arms": arms}).scenario == name
        with pytest.raises(ConfigError):
            parse(OperatorConfig, {"scenario": name, "arms": [] if arms else ["left", "right"]})
    with pytest.raises(ConfigError) as refusal:
        parse(OperatorConfig, {"scenario": "juggle"})
    assert all(name in str(refusal.value) for name in SCENARIOS)


@pytest.mark.parametrize("namespace", ["", "/", "lab1", "/lab1/b/"])
def test_the_rig_continues_without_a_film_a_camera_or_a_window_and_without_no_other_node(monkeypatch, namespace):
    monkeypatch.setenv("ROS_NAMESPACE", namespace)
    deaths, before = Deaths(), f"{namespace.strip('/')}/".lstrip("/")
    for name in ("viewer-3", "recorder-4", "camera/driver-6", "leap_driver-5"):
        deaths.process_died(before + name, 1)
    deaths.process_died(f"{before}kuka_panel-12", 0)
    deaths.process_died(f"{before}rviz-9", -9)
    film, camera, *windows = deaths.remarks
    assert windows == [
        "The rig continued without a window: kuka_panel ended with exit code 0.",
        "The rig continued without a window: rviz ended with exit code -9.",
    ]
    assert "film" in film and "recorder ended with exit code 1" in film
    assert "without its camera" in camera and "camera/driver ended with exit code 1" in camera
    assert deaths.sentences == ["leap_driver ended with exit code 1"]
