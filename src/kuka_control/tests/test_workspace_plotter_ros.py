"""The workspace plotter as a program."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rig_msgs.srv")
import rospy

from kuka_control.ros import plotter_program

pytestmark = pytest.mark.ros
pytest.importorskip("matplotlib")

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


def test_a_file_of_what_differs(plotter, tmp_path):
    path = tmp_path / "overrides.yaml"
    path.write_text("z_lower_limit: 0.9\n")
    done = plotter("--params", path, "--save", tmp_path / "w.png", *QUICK)
    assert done.returncode == 1
    assert "z_lower_limit (0.9 m)" in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr


def test_all_faults_of_a_bad_workspace_are_said(plotter, tmp_path):
    path = params_file(tmp_path, center_line=[0, 0, 1], z_lower_limit=0.9, time_out=-1.0)
    done = plotter("--params", path, "--save", tmp_path / "w.png", *QUICK)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 3
    assert all(key in done.stderr for key in ("center_line", "z_lower_limit", "time_out"))
    assert not (tmp_path / "w.png").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--params", "/no/such.yaml", "--save", "w.png"], "/no/such.yaml cannot be read"),
        (["--save", "w.xyz"], "w.xyz is not the name of a picture"),
        (["--save", "/no/folder/w.png"], "There is no folder /no/folder"),
    ],
)
def test_what_does_not_work_is_said_in_one_sentence(plotter, arguments, sentence):
    done = plotter(*arguments, *QUICK)
    assert done.returncode == 1
    assert sentence in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr


def test_without_a_display_a_window_is_refused_in_one_sentence(plotter, monkeypatch):
    monkeypatch.setenv("QT_API", "pyqt5")  # the program sets it
    done = plotter(*QUICK)
    assert done.returncode == 1
    assert "The window is not opened: " in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr


@pytest.mark.parametrize(
    "arguments", [["--samples", "0"], ["--tolerances", "1", "2", "100"], ["--params", "a", "--from-server"]]
)
def test_bad_options_are_refused(plotter, arguments):
    done = plotter(*arguments)
    assert done.returncode == 2 and "error:" in done.stderr


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


def test_says_that_there_is_no_master(virtual_graph, plotter, tmp_path, monkeypatch):
    virtual_graph.master_answers = False
    monkeypatch.setenv("ROS_MASTER_URI", "http://localhost:11311")
    done = plotter("--from-server", "--save", tmp_path / "w.png")
    assert done.returncode == 1
    assert "There is no ROS master at http://localhost:11311" in done.stderr and len(done.stderr.splitlines()) == 1
