"""The workspace plotter as a program."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml

from common import clock
from common.frames import BASE

pytest.importorskip("rig_msgs.srv")
import rospy

from kuka_control.model.workspace_study import ReachStudy

pytest.importorskip("matplotlib")
from matplotlib.colors import to_rgb

from kuka_control.gui.plot import UNREACHED
from kuka_control.ros import plotter_program

pytestmark = pytest.mark.ros
CONFIG = Path(__file__).parents[1] / "config"
QUICK = ("--samples", "60", "--attitudes", "2", "--constrained", "40")


@pytest.fixture
def plotter(monkeypatch, capsys):
    """Runs the program within this process, which spares the time to start one."""
    monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: None)  # this process is a node of other tests, too
    handler = signal.getsignal(signal.SIGTERM)

    def run(*arguments):
        monkeypatch.setattr(rospy, "myargv", lambda: ["workspace_plotter.py", *map(str, arguments)])
        try:
            plotter_program.main()
            code = 0
        except SystemExit as end:
            code = end.code
        said = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, code, said.out, said.err)

    yield run
    signal.signal(signal.SIGTERM, handler)


def params_file(tmp_path, **changes):
    values = yaml.safe_load((CONFIG / "kuka_params_ptp.yaml").read_text())
    path = tmp_path / "params.yaml"
    path.write_text(yaml.safe_dump({**values, **changes}))
    return path


def test_a_custom_home_and_other_tolerances(plotter, tmp_path):
    path = params_file(tmp_path, use_home_pos=True, home_pos=[-45, 20, 0, -100, 0, 40, 0], center_line=[1, -0.9, 0])
    done = plotter("--params", path, "--tolerances", 10, 20, 30, "--save", tmp_path / "w.svg", *QUICK)
    assert done.returncode == 0, done.stderr
    assert "(home_pos)" in done.stdout and "+-10, +-20, +-30 deg" in done.stdout
    assert "<svg" in (tmp_path / "w.svg").read_text()


def test_a_calibrated_arm_is_studied_by_its_own_parameters(plotter, tmp_path):
    example = CONFIG / "dh_parameters_example.yaml"
    done = plotter("--params", params_file(tmp_path, dh_parameters=str(example)), "--save", tmp_path / "w.png", *QUICK)
    assert done.returncode == 0 and "-45.0, 29.5, 0.0, -63.5, 0.0, 87.1, 0.0 deg" in done.stdout, done.stdout
    bad = plotter("--params", params_file(tmp_path, dh_parameters="/no/arm.yaml"), "--save", tmp_path / "w.png", *QUICK)
    assert bad.returncode == 1 and "/no/arm.yaml cannot be read" in bad.stderr


def test_takes_the_parameters_from_the_server(virtual_graph, plotter, tmp_path):
    empty = plotter("--from-server", "--save", tmp_path / "w.png", *QUICK)
    assert empty.returncode == 1 and "no parameters under kuka/" in empty.stderr
    rospy.set_param("kuka", {**yaml.safe_load((CONFIG / "kuka_params_rt.yaml").read_text()), "opening_angle": 80.0})
    rospy.set_param("leap", {"run_tol_yaw": 15.0, "run_tol_pitch": 16, "run_tol_roll": 17.0})
    done = plotter("--from-server", "--save", tmp_path / "w.png", *QUICK)
    assert done.returncode == 0, done.stderr
    assert "80 deg" in done.stdout and "+-15, +-16, +-17 deg" in done.stdout
    rospy.set_param("kuka/inner_sphere_limit", 0.9)
    bad = plotter("--from-server", "--save", tmp_path / "w.png", *QUICK)
    assert bad.returncode == 1 and "kuka/inner_sphere_limit" in bad.stderr


BAD = {"center_line": [0, 0, 1], "z_lower_limit": 0.9, "time_out": -1.0}


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ("--params /no/such.yaml --save w.png", 1, ["/no/such.yaml cannot be read"]),
        ("--save w.xyz", 1, ["w.xyz is not the name of a picture"]),
        ("--save /no/folder/w.png", 1, ["There is no folder /no/folder"]),
        ("--params differs.yaml --save w.png", 1, ["center_line", "z_lower_limit", "time_out"]),
        ("", 1, ["The window is not opened: "]),
        ("--from-server --save w.png", 1, ["There is no ROS master at http://localhost:11311"]),
        ("--samples 0", 2, ["error:"]),
        ("--tolerances 1 2 100", 2, ["error:"]),
        ("--params a --from-server", 2, ["error:"]),
    ],
)
def test_what_does_not_work_is_said(virtual_graph, plotter, tmp_path, monkeypatch, arguments, code, words):
    virtual_graph.master_answers = False
    monkeypatch.setenv("ROS_MASTER_URI", "http://localhost:11311")
    monkeypatch.setenv("QT_API", "pyqt5")  # the program sets it
    monkeypatch.chdir(tmp_path)
    (tmp_path / "differs.yaml").write_text(yaml.safe_dump(BAD))
    done = plotter(*arguments.split(), *QUICK)
    assert done.returncode == code and all(word in done.stderr for word in words), done.stderr
    assert code == 2 or len(done.stderr.splitlines()) == len(words), "one sentence for each fault"
    assert not (tmp_path / "w.png").exists()


def test_the_positions_are_markers_until_the_program_is_interrupted(virtual_graph, plotter, monkeypatch):
    from visualization_msgs.msg import Marker, MarkerArray

    came = []
    rospy.Subscriber("kuka/workspace", MarkerArray, lambda message: came.extend(message.markers))

    def interrupted():
        clock.sleep(1.0)
        raise KeyboardInterrupt

    monkeypatch.setattr(plotter_program, "_wait", interrupted)
    monkeypatch.setattr(plotter_program, "join", lambda *args, **options: None)
    assert plotter("--markers", *QUICK).returncode == 130
    shown, removed = came
    assert (shown.type, shown.action, len(shown.points)) == (Marker.POINTS, Marker.ADD, 60)
    assert len(shown.colors) == 60 and shown.header.frame_id == BASE
    assert (removed.ns, removed.id, removed.action) == (shown.ns, shown.id, Marker.DELETE)


def test_positions_out_of_reach_are_red_whatever_they_reach_turned():
    study = ReachStudy(np.eye(3), np.array([True, False, True]), np.array([1.0, 1.0, 0.0]), {})
    marker = plotter_program.reach_marker(study)
    best, red, worst = ([c.r, c.g, c.b] for c in marker.colors)
    assert red == pytest.approx(to_rgb(UNREACHED)) and best != worst
    assert [[p.x, p.y, p.z] for p in marker.points] == np.eye(3).tolist()
