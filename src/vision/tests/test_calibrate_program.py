"""The program calibrate_camera on the simulated arm: it asks, visits, refuses or stores, and ends with a sentence."""

import builtins
import contextlib
import re
import signal
import sys
from dataclasses import replace

import hand_eye_scene
import numpy as np
import pytest
from board_scene import T_FLANGE_BOARD, BoardScene, parameters

from common.config import parse
from common.poses import inverse, pose
from common.rotations import rotation_about, rotation_angle, unit
from vision.calibration.acceptance import CalibrationConfig, judge
from vision.calibration.record import by_views

pytestmark = pytest.mark.ros

AHEAD = unit(np.array([0.42, -0.46, 0.10]) - np.array([1.02, -0.02, 0.70]))
RIGHT = unit(np.cross(AHEAD, (0.0, 0.0, 1.0)))
T_BASE_CAMERA = pose(np.column_stack((RIGHT, np.cross(AHEAD, RIGHT), AHEAD)), (1.02, -0.02, 0.70))
"""About 0.12 m from where calibration_views.yaml guesses the camera."""

T_BASE_FLANGE = T_BASE_CAMERA @ pose(rotation_about(0, 2.7), (0.05, 0.02, 0.9)) @ inverse(T_FLANGE_BOARD)

PROGRAM = ("rosrun", "vision", "calibrate_camera.py", "--ip", "127.0.0.1", "--velocity", "0.5")


class SimulatedArm:
    """The simulated controller, and where its flange is."""

    def __init__(self, processes, wait_until):
        from rig_simulation.control_port import ControlClient

        program = processes.start(
            "rosrun", "rig_simulation", "sunrise_controller.py", "--port", "0", "--control-port", "0"
        )
        line = wait_until(
            lambda: re.search(r"127.0.0.1:(\d+), control port 127.0.0.1:(\d+)", program.log_path.read_text()),
            30.0,
            "it",
        )
        self.port, control = int(line[1]), int(line[2])
        self.client = ControlClient("127.0.0.1", control, 30.0)

    def flange(self):
        return np.array(self.client.ask("state")["flange"])

    def moved(self):
        return np.abs(self.client.ask("state")["joints"]).max() > 1e-3


@pytest.fixture(scope="module")
def arms(tmp_path_factory, pytestconfig):
    """Returns a function that gives an arm that has not moved: the last one, or a new one."""
    shared = pytestconfig.pluginmanager.get_plugin(str(pytestconfig.rootpath / "conftest.py"))
    processes = shared.Processes(tmp_path_factory.mktemp("arm"))
    arms = []

    def unmoved():
        if not arms or arms[-1].moved():
            processes.end_all()
            arms.append(SimulatedArm(processes, shared.wait_until))
        return arms[-1]

    yield unmoved
    processes.end_all()


@pytest.fixture
def arm(arms):
    return arms()


@contextlib.contextmanager
def board_scene(folder, flange):
    import rospy

    values = parameters(folder, count=9, tries=300)
    values["limits"].update(pictures=4, photometric=False)
    rospy.set_param("camera_calibration", values)
    scene = BoardScene(T_BASE_CAMERA, T_FLANGE_BOARD, flange, measured=False)
    yield scene
    scene.close()
    rospy.delete_param("camera_calibration")


@pytest.fixture
def scene(ros, arm, tmp_path):
    with board_scene(tmp_path / "store", arm.flange) as scene:
        yield scene


@pytest.fixture
def still_scene(ros, tmp_path):
    """The same without an arm."""
    with board_scene(tmp_path / "store", lambda: T_BASE_FLANGE) as scene:
        yield scene


@pytest.fixture
def calibrate(ros, capsys, monkeypatch):
    """Runs the program within this process, and returns its exit code and its output.

    A start of Python with all that the program imports would take longer than most cases.
    """
    import rospy

    def run(*options, answers=()):
        from vision.ros.calibration import calibrate_program

        left = iter(answers)

        def answer(question):
            print(question)
            try:
                return next(left)
            except StopIteration:
                raise EOFError from None

        handler = signal.getsignal(signal.SIGTERM)
        with monkeypatch.context() as patch:
            patch.setattr(rospy, "init_node", lambda *args, **kwargs: None)  # this process is a node already
            patch.setattr(rospy, "signal_shutdown", lambda reason: None)
            patch.setattr(sys, "argv", [PROGRAM[2], *options])
            patch.setattr(builtins, "input", answer)
            try:
                with pytest.raises(SystemExit) as end:
                    calibrate_program.main()
            finally:
                signal.signal(signal.SIGTERM, handler)
        return end.value.code, "".join(capsys.readouterr())

    return run


def robot(arm):
    """The options for the simulated arm."""
    return ("--ip", "127.0.0.1", "--velocity", "0.5", "--port", str(arm.port))


def stored(tmp_path):
    folder = tmp_path / "store"
    return sorted(folder.iterdir()) if folder.exists() else []


def test_from_a_wrong_guess_to_the_truth_and_again_from_the_file(calibrate, scene, arm, tmp_path, processes):
    from vision.ros.calibration.calibration_setup import read

    program = processes.start(*PROGRAM, "--port", str(arm.port), "--yes")
    assert program.wait(240.0) == 0, program.log_path.read_text()
    (file,) = stored(tmp_path)
    log = program.log_path.read_text()
    assert "The calibration is good" in log and str(file) in log
    record = read(file)
    assert len(record.views) >= 8
    assert (record.camera, record.robot, record.panel) == ("1234", "LBR7R800", "tag_frame")
    off = inverse(T_BASE_CAMERA) @ record.T_base_camera
    assert np.linalg.norm(off[:3, 3]) < 0.003
    assert np.degrees(rotation_angle(off[:3, :3])) < 0.3
    np.testing.assert_allclose(record.T_flange_board, T_FLANGE_BOARD, atol=0.004)

    code, log = calibrate("--again", str(file))
    assert code == 1, "nobody was there to say yes"
    assert "The camera pose differs by 0.0 mm and 0.00 deg" in log
    assert stored(tmp_path) == [file]


def test_views_of_another_rig_are_refused(calibrate, still_scene, tmp_path):
    others = {
        "robot": "LBR14R820",
        "flange": "MF_touch_pneumatisch",
        "camera": "another_camera",
        "panel": "other_panel",
    }
    file = file_of_views(tmp_path, **others)
    code, log = calibrate("--again", str(file), "--yes")
    assert code == 1
    assert "another rig" in log and all(f"{key} {value}, not" in log for key, value in others.items())
    assert "Traceback" not in log
    assert stored(tmp_path) == []


def test_a_refused_calibration_is_shown_before_the_program_ends(ros, processes, still_scene, tmp_path):
    import rospy
    from visualization_msgs.msg import MarkerArray

    rospy.set_param("camera_calibration/limits/max_point_sd_mm", 0.001)
    markers = ros.record("camera_calibration/markers", MarkerArray)
    file = file_of_views(tmp_path)
    program = processes.start("rosrun", "vision", "calibrate_camera.py", "--again", str(file), "--yes")
    assert program.wait(60.0) == 1
    assert "Nothing was stored" in program.log_path.read_text()
    (marker,) = markers.wait(1)[0].markers
    assert marker.ns == "new"


def file_of_views(tmp_path, board=T_FLANGE_BOARD, **head):
    """A file with good views of this rig, or of one that `head` changes, with the board at T_flange_board."""
    from vision.ros.calibration.calibration_setup import CalibrationStore, StoreConfig

    X, _, views = hand_eye_scene.scene(1, 12, hand_eye_scene.SD / 10.0)
    views = [replace(view, T_base_flange=view.T_base_flange @ X @ inverse(board)) for view in views]
    limits = parse(CalibrationConfig, parameters(tmp_path)["limits"])
    verdict = judge(views, board, limits)
    assert verdict.accepted, verdict.sentence
    head = {"robot": "LBR7R800", "flange": "MF_elektrisch", "camera": "1234", "panel": "tag_frame", **head}
    record = by_views(verdict, views, date="2026-01-01T00:00:00", camera_frame="camera_rgb_optical_frame", **head)
    return CalibrationStore(StoreConfig(str(tmp_path / "other"), "1234", "LBR7R800", "MF_elektrisch")).save(record)


def test_a_board_that_is_not_as_drawn_is_refused(calibrate, still_scene, tmp_path):
    file = file_of_views(tmp_path, T_FLANGE_BOARD @ pose(rotation_about(0, 0.1), (0.0, 0.03, 0.0)))
    code, log = calibrate("--again", str(file), "--yes")
    assert code == 1
    assert "from its drawing, the limits are" in log
    assert "Nothing was stored" in log
    assert stored(tmp_path) == []


def test_a_board_that_is_seen_nowhere(calibrate, scene, arm, tmp_path, monkeypatch):
    from vision.ros.calibration import calibrate_program

    monkeypatch.setattr(calibrate_program, "VIEW_TIMEOUT_S", 1.0)
    monkeypatch.setattr(calibrate_program, "FIRST_VIEWS", 2)
    scene.visible = False
    code, log = calibrate(*robot(arm), "--yes")
    assert code == 1
    assert "saw the marker board at none of 3 arm poses" in log
    assert stored(tmp_path) == []


def test_without_yes_and_terminal_nothing_moves(calibrate, scene, arm):
    code, log = calibrate(*robot(arm))
    assert code == 1
    assert "Without a terminal" in log
    assert not arm.moved()


def test_by_hand_with_nobody_moving_the_arm(calibrate, still_scene):
    still_scene.measured = True
    code, log = calibrate("--by-hand", answers=("", "", "q"))
    assert code == 1
    assert "taken, 4 images, by the corners" in log
    assert "not taken: the flange is only 0.0 mm and 0.0 deg" in log
    assert "1 views are too few" in log


def test_poses_cannot_be_refined_without_the_images(calibrate, still_scene):
    import rospy

    still_scene.measured = True
    rospy.set_param("camera_calibration/limits/photometric", True)
    code, log = calibrate("--by-hand", answers=("", "q"))
    assert code == 1
    assert "taken, 4 images, by the corners: their images did not arrive on /camera/rgb/image_raw" in log


def test_by_hand_without_a_controller(calibrate, still_scene):
    code, log = calibrate("--by-hand", answers=("", "q"))
    assert code == 1
    assert "calibrate_camera: tf has no path from kuka/base_frame" in log and "--ip" in log


def test_by_hand_the_program_asks_the_arm_itself(calibrate, scene, arm):
    code, log = calibrate("--by-hand", *robot(arm), answers=("", "q"))
    assert code == 1
    assert "taken, 4 images, by the corners" in log
    assert "The connection is closed" in log
    assert not arm.moved()


@pytest.mark.parametrize(
    ("mounting", "sentences"),
    [
        (
            [180, 0, 0],
            ["base turned by roll 180, pitch 0, yaw 0 deg", "At the start"],
        ),
        ("ceiling", ["kuka/mounting is 'ceiling', but must be 3 finite numbers"]),
    ],
)
def test_an_arm_on_a_ceiling_is_known_as_one(scene, arm, calibrate, mounting, sentences):
    import rospy

    rospy.set_param("kuka/mounting", mounting)
    try:
        code, log = calibrate(*robot(arm), "--yes")
    finally:
        rospy.delete_param("kuka")
    assert code == 1
    assert all(sentence in log for sentence in sentences), log
    assert not arm.moved()


def test_no_robot(calibrate, still_scene, free_port):
    code, log = calibrate("--ip", "127.0.0.1", "--port", str(free_port()), "--yes")
    assert code == 1
    assert "There is no connection to the robot" in log


def test_a_controller_that_has_the_robot_is_named(processes, scene, calibrate, arm, wait_until, tmp_path):
    node = tmp_path / "node.py"
    node.write_text("import rospy; rospy.init_node('kuka_ptp_node'); print('here', flush=True); rospy.spin()")
    holder = processes.start("python3", str(node))
    wait_until(lambda: "here" in holder.log_path.read_text(), 20.0, "the node")
    code, log = calibrate(*robot(arm), "--yes")
    assert code == 1
    assert "The node kuka_ptp_node has the robot's only connection" in log
    assert not arm.moved()


@pytest.mark.parametrize(
    ("options", "change", "sentence"),
    [
        (("--velocity", "0.9"), {}, "'0.9' is not a number in (0, 0.5]"),
        (("--again", "/nowhere.yaml"), {}, "/nowhere.yaml cannot be read"),
        (("--yes",), {"store/camera": "unknown"}, "serial number is unknown"),
        (("--yes",), {"views/tilt": [45, 20]}, "tilt"),
        (("--yes", "--robot", "UR5"), {}, "kuka/robot is 'UR5'"),
        (("--yes", "--robot", "LBR14R820"), {}, "camera_apriltag.launch was started for LBR7R800"),
    ],
)
def test_it_refuses_wrong_options_and_parameters(calibrate, still_scene, options, change, sentence):
    import rospy

    for key, value in change.items():
        rospy.set_param(f"camera_calibration/{key}", value)
    code, log = calibrate("--ip", "127.0.0.1", "--port", "1", *options)
    assert code in (1, 2)
    assert sentence in log


def test_an_interrupt_stores_nothing(scene, arm, processes, wait_until, tmp_path):
    program = processes.start(*PROGRAM, "--port", str(arm.port), "--yes")
    wait_until(lambda: "Move to" in program.log_path.read_text(), 60.0, "the tour")
    assert processes.end(program, 30.0) == 130
    log = program.log_path.read_text()
    assert "Interrupted; nothing was stored" in log and "Traceback" not in log
    assert stored(tmp_path) == []
