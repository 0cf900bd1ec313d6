"""The program calibrate_camera on the simulated arm: it asks, visits, refuses or stores, and ends with a sentence."""

import io
import re
import signal
from dataclasses import replace

import hand_eye_scene
import numpy as np
import pytest
from board_scene import T_FLANGE_BOARD, BoardScene, parameters

from common import clock
from common.config import parse
from common.poses import inverse, pose, translation
from common.rotations import rotation_about, rotation_angle, unit
from vision.calibration.acceptance import CalibrationConfig, judge
from vision.calibration.record import by_views

pytest.importorskip("rig_msgs.srv")
import rospy
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from rig_simulation.control_port import ControlClient
from vision.ros.calibration import calibrate_program
from vision.ros.calibration.calibration_setup import CalibrationStore, StoreConfig, read

pytestmark = pytest.mark.ros

AHEAD = unit(np.array([0.42, -0.46, 0.10]) - np.array([1.02, -0.02, 0.70]))
RIGHT = unit(np.cross(AHEAD, (0.0, 0.0, 1.0)))
T_BASE_CAMERA = pose(np.column_stack((RIGHT, np.cross(AHEAD, RIGHT), AHEAD)), (1.02, -0.02, 0.70))
"""About 0.12 m from where calibration_views.yaml guesses the camera."""

T_BASE_FLANGE = T_BASE_CAMERA @ pose(rotation_about(0, 2.7), (0.05, 0.02, 0.9)) @ inverse(T_FLANGE_BOARD)


class SimulatedArm:
    """The simulated controller, and where its flange is."""

    def __init__(self, program, wait_until):
        ready = r"127.0.0.1:(\d+), control port 127.0.0.1:(\d+)"
        line = wait_until(lambda: re.search(ready, program.log_path.read_text()), 30.0, "the simulated robot")
        self.port = line[1]
        self._client = ControlClient("127.0.0.1", int(line[2]), 30.0)

    @property
    def options(self):
        """Those with which the program finds it."""
        return ("--ip", "127.0.0.1", "--velocity", "0.5", "--port", self.port)

    def flange(self):
        return np.array(self._client.ask("state")["flange"])

    def moved(self):
        return np.abs(self._client.ask("state")["joints"]).max() > 1e-3


ROBOT = ("rig_simulation", "sunrise_controller.py", "--port", "0", "--control-port", "0")


@pytest.fixture
def arm(virtual_graph):
    return SimulatedArm(virtual_graph.run(*ROBOT), virtual_graph.wait_until)


def board_scene(folder, flange):
    values = parameters(folder, count=9, tries=300)
    values["limits"].update(pictures=4, photometric=False)
    rospy.set_param("camera_calibration", values)
    return BoardScene(T_BASE_CAMERA, T_FLANGE_BOARD, flange, measured=False)


@pytest.fixture
def scene(arm, tmp_path):
    scene = board_scene(tmp_path / "store", arm.flange)
    yield scene
    scene.close()


@pytest.fixture
def still_scene(virtual_graph, tmp_path):
    """The same without an arm."""
    scene = board_scene(tmp_path / "store", lambda: T_BASE_FLANGE)
    yield scene
    scene.close()


@pytest.fixture
def calibrate(virtual_graph):
    """Runs the program, and returns its exit code and its output; `seconds` is how long it ran."""

    def run(*options, answers=()):
        program = virtual_graph.run("vision", "calibrate_camera.py", *options)
        begun = clock.monotonic()
        program.stdin = io.StringIO("".join(f"{answer}\n" for answer in answers))
        code = program.wait(600.0)
        run.seconds = clock.monotonic() - begun
        assert "Traceback" not in program.log, program.log
        return code, program.log

    return run


def stored(tmp_path):
    folder = tmp_path / "store"
    return sorted(folder.iterdir()) if folder.exists() else []


def test_from_a_wrong_guess_to_the_truth_and_again_from_the_file(calibrate, scene, arm, tmp_path):
    code, log = calibrate(*arm.options, "--yes")
    assert code == 0, log
    (file,) = stored(tmp_path)
    assert "The calibration is good" in log and str(file) in log
    distances = [float(text) for text in re.findall(r"marker board at ([\d.]+) m", log)]
    assert len(distances) == 9 and all(0.55 <= distance <= 1.1 for distance in distances)
    record = read(file)
    assert len(record.views) >= 8
    assert (record.camera, record.robot, record.panel) == ("1234", "LBR7R800", "tag_frame")
    assert record.simulated is True
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
    assert stored(tmp_path) == []


def test_views_of_simulated_devices_are_refused_beside_a_real_camera(calibrate, still_scene, tmp_path):
    file = file_of_views(tmp_path, simulated=True)
    rospy.set_param("camera/driver/serial", "1234")
    code, log = calibrate("--again", str(file), "--yes")
    assert code == 1 and f"The calibration {file} was measured with simulated devices" in log
    assert stored(tmp_path) == []


def test_a_refused_calibration_is_shown_before_the_program_ends(virtual_graph, calibrate, still_scene, tmp_path):
    rospy.set_param("camera_calibration/limits/max_point_sd_mm", 0.001)
    markers = virtual_graph.record("camera_calibration/markers", MarkerArray)
    code, log = calibrate("--again", str(file_of_views(tmp_path)), "--yes")
    assert code == 1 and "Nothing was stored" in log
    (marker,) = markers.wait(1, 0.1)[0].markers
    assert marker.ns == "new"


def test_a_viewer_that_does_not_connect_is_waited_for(virtual_graph, calibrate, still_scene, tmp_path):
    virtual_graph.record("camera_calibration/markers", String)
    code, _ = calibrate("--again", str(file_of_views(tmp_path)))
    assert code == 1 and calibrate.seconds == pytest.approx(5.0, abs=0.1)


def file_of_views(tmp_path, board=T_FLANGE_BOARD, **head):
    """A file with good views of this rig, or of one that `head` changes, with the board at T_flange_board."""
    X, _, views = hand_eye_scene.scene(1, 12, hand_eye_scene.SD / 10.0)
    views = [replace(view, T_base_flange=view.T_base_flange @ X @ inverse(board)) for view in views]
    limits = parse(CalibrationConfig, parameters(tmp_path)["limits"])
    verdict = judge(views, board, limits)
    assert verdict.accepted, verdict.sentence
    head = {"robot": "LBR7R800", "flange": "MF_elektrisch", "camera": "1234", "panel": "tag_frame", **head}
    head = {"date": "2026-01-01T00:00:00", "camera_frame": "camera_rgb_optical_frame", "simulated": False, **head}
    config = StoreConfig(str(tmp_path / "other"), "1234", "LBR7R800", "MF_elektrisch")
    return CalibrationStore(config, simulated=True).save(by_views(verdict, views, **head))


def test_a_board_that_is_seen_nowhere(calibrate, scene, arm, tmp_path, monkeypatch):
    """Reported in https://github.com/IFL-CAMP/easy_handeye/issues/51: the marker's frame does not exist: traceback.
    Tried: a board that nobody sees.
    """
    monkeypatch.setattr(calibrate_program, "FIRST_VIEWS", 2)
    scene.visible = False
    code, log = calibrate(*arm.options, "--yes")
    assert code == 1
    assert "saw the marker board at none of 3 arm poses" in log
    assert stored(tmp_path) == []


def test_without_yes_and_terminal_nothing_moves(calibrate, scene, arm):
    code, log = calibrate(*arm.options)
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


def test_by_hand_a_board_that_is_not_seen_is_waited_for(calibrate, still_scene):
    still_scene.measured, still_scene.visible = True, False
    _, log = calibrate("--by-hand", answers=("", "q"))
    assert "not taken" in log and calibrate.seconds == pytest.approx(6.2, abs=0.2)


def test_by_hand_an_arm_that_moves_gives_no_view(calibrate, still_scene):
    begun = clock.monotonic()
    still_scene.measured = True
    still_scene.flange = lambda: translation(1e-2 * (clock.monotonic() - begun), 0.0, 0.0) @ T_BASE_FLANGE
    _, log = calibrate("--by-hand", answers=("", "q"))
    assert "not taken: the arm moved; hold it still" in log


def test_poses_cannot_be_refined_without_the_images(calibrate, still_scene):
    still_scene.measured = True
    rospy.set_param("camera_calibration/limits/photometric", True)
    code, log = calibrate("--by-hand", answers=("", "q"))
    assert code == 1
    assert "taken, 4 images, by the corners: their images did not arrive on /camera/rgb/image_raw" in log


def test_by_hand_without_a_controller(calibrate, still_scene):
    code, log = calibrate("--by-hand", answers=("", "q"))
    assert code == 1
    assert "calibrate_camera: tf has no path from kuka/base_frame" in log and "--ip" in log
    assert calibrate.seconds == pytest.approx(3.0, abs=0.1)


def test_by_hand_the_program_asks_the_arm_itself(calibrate, scene, arm):
    code, log = calibrate("--by-hand", *arm.options, answers=("", "q"))
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
    rospy.set_param("kuka/mounting", mounting)
    code, log = calibrate(*arm.options, "--yes")
    assert code == 1
    assert all(sentence in log for sentence in sentences), log
    assert not arm.moved()


def test_no_robot(calibrate, still_scene):
    code, log = calibrate("--ip", "127.0.0.1", "--port", "9", "--yes")
    assert code == 1
    assert "There is no connection to the robot" in log


def test_a_controller_that_has_the_robot_is_named(virtual_graph, scene, calibrate, arm):
    virtual_graph.start("controller", lambda: (rospy.init_node("kuka_ptp_node"), rospy.spin()))
    code, log = calibrate(*arm.options, "--yes")
    assert code == 1
    assert "The node kuka_ptp_node has the robot's only connection" in log
    assert not arm.moved()


@pytest.mark.parametrize(
    ("options", "change", "sentence"),
    [
        (("--velocity", "0.9"), {}, "'0.9' is not a number in (0, 0.5]"),
        (("--again", "/nowhere.yaml"), {}, "/nowhere.yaml cannot be read"),
        (("--yes",), {"store/camera": "unknown"}, "serial number is unknown"),
        (("--yes", "--robot", "UR5"), {}, "kuka/robot is 'UR5'"),
        (("--yes", "--robot", "LBR14R820"), {}, "camera_apriltag.launch was started for LBR7R800"),
    ],
)
def test_it_refuses_wrong_options_and_parameters(calibrate, still_scene, options, change, sentence):
    for key, value in change.items():
        rospy.set_param(f"camera_calibration/{key}", value)
    code, log = calibrate("--ip", "127.0.0.1", "--port", "1", *options)
    assert code in (1, 2)
    assert sentence in log


@pytest.mark.real
def test_an_interrupt_stores_nothing(ros, wait_until, tmp_path):
    """As the process of a real graph."""
    arm = SimulatedArm(ros.run(*ROBOT), wait_until)
    scene = board_scene(tmp_path / "store", arm.flange)
    try:
        program = ros.run("vision", "calibrate_camera.py", *arm.options, "--yes")
        wait_until(arm.moved, 60.0, "the first motion")
        program.send_signal(signal.SIGINT)
        assert program.wait(30.0) == 130
    finally:
        scene.close()
    log = program.log_path.read_text()
    assert "Interrupted; nothing was stored" in log and "Traceback" not in log
    assert stored(tmp_path) == []
