"""The node camera_place: live and stored pose, what is stored on demand, stale frames, and how it exits."""

import signal

import numpy as np
import pytest
import yaml
from board_scene import OPTICAL, T_FLANGE_BOARD, T_LINK_OPTICAL, BoardScene, parameters

from common import clock
from common.poses import inverse, pose
from common.rotations import rotation_about

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from common.ros.conversions import pose_from_transform
from common.ros.images import image_message
from vision.ros.calibration.calibration_setup import read_setup
from vision.ros.marker_board.detections import BoardListener, ViewCapture

pytestmark = pytest.mark.ros

T_BASE_FLANGE = pose(rotation_about(1, 2.5), (0.5, -0.3, 0.4))
T_BASE_CAMERA = T_BASE_FLANGE @ T_FLANGE_BOARD @ inverse(pose(rotation_about(0, 2.7), (0.05, 0.02, 0.9)))


@pytest.fixture
def scene(ros, tmp_path):
    rospy.set_param("camera_calibration", parameters(tmp_path / "store"))
    scene = BoardScene(T_BASE_CAMERA, T_FLANGE_BOARD, lambda: T_BASE_FLANGE)
    yield scene
    scene.close()


@pytest.fixture
def buffer(ros):
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    yield buffer
    listener.unregister()


def camera_pose(buffer, parent="kuka/base_frame", child=OPTICAL):
    """Returns T_base_camera in tf, or the pose of another frame."""
    return pose_from_transform(buffer.lookup_transform(parent, child, rospy.Time(0), rospy.Duration(2.0)).transform)


def call(name):
    rospy.wait_for_service(name, 2.0)
    return rospy.ServiceProxy(name, Trigger)()


def stored(ros):
    """Waits until the live pose can be stored; returns the answer."""
    return ros.wait_until(lambda: (lambda a: a if a.success else None)(call("camera_place/store")), 2.0, "the storing")


def test_live_then_stored_then_loaded_without_the_tag(ros, scene, buffer, tmp_path):
    node = ros.run("vision", "camera_place_node.py")
    np.testing.assert_allclose(camera_pose(buffer), T_BASE_CAMERA, atol=0.01)
    assert "the camera pose is live" in node.log_path.read_text()
    link = T_BASE_CAMERA @ inverse(T_LINK_OPTICAL)
    np.testing.assert_allclose(camera_pose(buffer, child="camera_link"), link, atol=0.01)
    seen = camera_pose(buffer, "tag_frame", "kuka/flange_frame/seen")
    np.testing.assert_allclose(seen, inverse(T_FLANGE_BOARD), atol=1e-9)
    assert "is stored in" in stored(ros).message
    node.send_signal(signal.SIGINT)
    assert node.wait(1.0) == 0
    (file,) = (tmp_path / "store").iterdir()
    values = yaml.safe_load(file.read_text())
    assert values["kind"] == "live" and 0.5 < values["point_sd_mm"] < 1.5
    assert not {"rms_mm", "rms_deg"} & set(values) and "error" not in values["views"][0], "one view has no residual"

    scene.visible = False
    clock.sleep(0.1)
    buffer.clear()
    again = ros.run("vision", "camera_place_node.py", "_mode:=stored")
    np.testing.assert_allclose(camera_pose(buffer), T_BASE_CAMERA, atol=0.005)
    assert file.name in again.log_path.read_text()
    assert "one view without confirmation" in again.log_path.read_text()
    assert "is a stored one already" in call("camera_place/store").message
    assert call("camera_place/reload").message.startswith("The camera pose is stored on ")


def test_who_saw_the_live_pose_also_gets_the_stored_one_and_never_waits(ros, scene, buffer):
    """tf2 does not turn a frame that moved into a static one, so the stored pose is repeated, ahead of time."""
    ros.run("vision", "camera_place_node.py")
    camera_pose(buffer)
    stored(ros)
    clock.sleep(0.11)
    for _ in range(300):
        assert buffer.can_transform("kuka/base_frame", OPTICAL, rospy.Time.now())
        clock.sleep(0.01)


def test_a_stale_flange_gives_no_pose_and_detections_count_for_three_seconds(ros, scene):
    """Reported in https://github.com/IFL-CAMP/easy_handeye/issues/144: tf extrapolates when a sample is taken. Tried:
    a stale flange.
    """
    scene.measured = False
    node = ros.run("vision", "camera_place_node.py", "_mode:=live")
    clock.sleep(0.2)
    assert "tf has no path" not in node.log_path.read_text(), "it waits 0.2 s for the flange"
    clock.sleep(0.1)
    assert "tf has no path from kuka/base_frame" in node.log_path.read_text()
    scene.measured = True
    stored(ros)
    scene.measured = False
    clock.sleep(2.4)
    assert call("camera_place/store").success
    clock.sleep(0.65)
    assert "no detection of the marker board" in call("camera_place/store").message
    clock.sleep(3.0)
    assert "is stale at the time" in node.log_path.read_text()


def test_what_moves_or_is_uncertain_is_not_stored(ros, scene, tmp_path):
    """A board that trembles, a small tag that faces the camera, and one with two poses that fit."""
    scene.noise = np.full(6, 0.01)
    ros.run("vision", "camera_place_node.py", "_mode:=live")
    for sd, noise, reason in (
        (scene.sd, scene.noise, "board moved"),
        ([0.05, 0.05, 0.05, 0.001, 0.001, 0.001], np.zeros(6), "86.60 mm, the limit is 1.5 mm"),
        ([2e-4, 2e-4, 5e-4, 0.2, 0.2, 0.2], np.zeros(6), "19.85 deg, the limit is 0.25 deg"),
    ):
        scene.sd, scene.noise = np.array(sd), noise
        clock.sleep(1.0)
        assert reason in call("camera_place/store").message
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize(("seconds", "stores"), [(9.5, True), (10.5, False)])
def test_the_serial_number_is_the_drivers_and_is_waited_for(ros, scene, tmp_path, seconds, stores):
    rospy.set_param("camera_calibration/store/camera", "")
    rospy.set_param("kuka/ip", "172.31.1.147")
    rospy.delete_param("camera/driver/serial")
    ros.run("vision", "camera_place_node.py", "_mode:=live")
    clock.sleep(seconds)
    rospy.set_param("camera/driver/serial", "1207290099")
    if stores:
        stored(ros)
        (file,) = (tmp_path / "store").iterdir()
        values = yaml.safe_load(file.read_text())
        assert (values["camera"], values["simulated"]) == ("1207290099", False)
    else:
        clock.sleep(1.0)
        assert "The camera's serial number is unknown" in call("camera_place/store").message


def test_diagnostics_say_when_the_board_is_gone(ros, scene):
    ros.run("vision", "camera_place_node.py", "_mode:=live")
    heard = ros.record("/diagnostics", DiagnosticArray)

    def state():
        found = [status for message in heard for status in message.status if status.name == "camera_place"]
        return (found[-1].level, found[-1].message) if found else (None, "")

    live = (DiagnosticStatus.OK, "live")
    ros.wait_until(lambda: state() == live, 2.0, "a pose")
    scene.visible = False
    clock.sleep(0.9)
    assert state() == live
    clock.sleep(0.7)
    assert state() == (DiagnosticStatus.WARN, "the marker board was not detected for 1 s")
    scene.visible, scene.frame = True, f"/{OPTICAL}"
    clock.sleep(0.6)
    assert state() == live
    scene.detects = False
    own = DiagnosticStatus(DiagnosticStatus.WARN, "apriltag_ros", "Nothing has come on /camera/rgb/image_raw.", "", [])
    said = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)
    clock.sleep(1.5)
    said.publish(DiagnosticArray(status=[own]))
    clock.sleep(0.6)
    level, sentence = state()
    assert level == DiagnosticStatus.WARN and sentence.startswith("nothing has come on /tag_detections for ")
    assert sentence.endswith("; the detector says: Nothing has come on /camera/rgb/image_raw")


def test_a_view_says_that_the_detector_is_silent_and_why_images_were_of_no_use(ros, scene):
    setup = read_setup("apriltag_ros_continuous_node")
    capture = ViewCapture(setup, BoardListener(setup.target), "apriltag_ros_continuous_node")
    images = rospy.Publisher("camera/rgb/image_raw", Image, queue_size=1)
    grey = np.zeros((480, 640), np.uint8)
    rospy.Timer(rospy.Duration(0.05), lambda _: images.publish(image_message(grey, "mono8", OPTICAL, rospy.Time.now())))
    detections, how = capture.capture()
    assert detections and "the colour image has the encoding mono8" in how
    scene.detects = False
    clock.sleep(1.1)
    with pytest.raises(ValueError, match="nothing has come on /tag_detections for"):
        capture.capture()


def test_a_torn_calibration_is_named_and_left_aside(ros, scene, buffer, tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "camera_place_2026-01-01T000000.yaml").write_text("date: '2026-01-01T00:00:00'\nT_base_cam")
    node = ros.run("vision", "camera_place_node.py")
    camera_pose(buffer)
    log = node.log_path.read_text()
    assert "Skipped the calibration" in log and "the camera pose is live" in log


def test_reload_in_the_mode_live(ros, scene):
    ros.run("vision", "camera_place_node.py", "_mode:=live")
    answer = call("camera_place/reload")
    assert answer.success and "the mode is live" in answer.message


def test_reload_after_the_only_calibration_was_moved_away(ros, scene, tmp_path):
    ros.run("vision", "camera_place_node.py")
    stored(ros)
    (file,) = (tmp_path / "store").iterdir()
    file.unlink()
    assert "has no calibration" in call("camera_place/reload").message
    stored(ros)


@pytest.mark.parametrize(
    ("parameters", "change", "fault"),
    [
        (("_mode:=both", "_mod:=live"), {}, "~mode is 'both'"),
        (("_mode:=stored",), {}, "No calibration for LBR7R800 and camera 1234"),
        (("_mode:=live",), {"camera_calibration/panel/frame": "box"}, "the marker board box"),
    ],
)
def test_it_names_wrong_parameters(ros, scene, parameters, change, fault):
    for key, value in change.items():
        rospy.set_param(key, value)
    node = ros.run("vision", "camera_place_node.py", *parameters)
    assert node.wait(5.0) == 1
    log = node.log_path.read_text()
    assert fault in log
    assert "Traceback" not in log


def test_it_waits_for_its_parameters_and_an_interrupt_stops_it(ros):
    node = ros.run("vision", "camera_place_node.py")
    clock.sleep(1.0)
    assert "Waiting for the parameter" in node.log_path.read_text()
    node.send_signal(signal.SIGINT)
    assert node.wait(1.0) == 0
    assert "Traceback" not in node.log_path.read_text()
