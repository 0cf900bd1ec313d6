"""The node camera_place: live and stored place, what is stored on demand, stale frames, and how it ends."""

import numpy as np
import pytest
import yaml
from board_scene import OPTICAL, T_FLANGE_BOARD, T_LINK_OPTICAL, BoardScene, parameters

from common.poses import inverse, pose
from common.rotations import rotation_about

pytestmark = pytest.mark.ros

T_BASE_FLANGE = pose(rotation_about(1, 2.5), (0.5, -0.3, 0.4))
T_BASE_CAMERA = T_BASE_FLANGE @ T_FLANGE_BOARD @ inverse(pose(rotation_about(0, 2.7), (0.05, 0.02, 0.9)))


@pytest.fixture
def scene(ros, tmp_path):
    import rospy

    rospy.set_param("camera_calibration", parameters(tmp_path / "store"))
    scene = BoardScene(T_BASE_CAMERA, T_FLANGE_BOARD, lambda: T_BASE_FLANGE)
    yield scene
    scene.close()
    rospy.delete_param("camera_calibration")


@pytest.fixture
def buffer(ros):
    import tf2_ros

    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    yield buffer
    listener.unregister()


def camera_pose(buffer, timeout=30.0):
    """Returns T_base_camera in tf."""
    import rospy

    from common.ros.conversions import pose_from_transform

    found = buffer.lookup_transform("kuka/base_frame", OPTICAL, rospy.Time(0), rospy.Duration(timeout))
    return pose_from_transform(found.transform)


def call(name):
    import rospy
    from std_srvs.srv import Trigger

    rospy.wait_for_service(name, 30.0)
    return rospy.ServiceProxy(name, Trigger)()


def test_live_then_stored_then_loaded_without_the_tag(ros, scene, buffer, processes, wait_until, tmp_path):
    node = ros.run("vision", "camera_place_node.py")
    np.testing.assert_allclose(camera_pose(buffer), T_BASE_CAMERA, atol=0.01)
    assert "the camera pose is live" in node.log_path.read_text()
    link = T_BASE_CAMERA @ inverse(T_LINK_OPTICAL)
    import rospy

    from common.ros.conversions import pose_from_transform

    found = buffer.lookup_transform("kuka/base_frame", "camera_link", rospy.Time(0), rospy.Duration(30.0))
    np.testing.assert_allclose(pose_from_transform(found.transform), link, atol=0.01)
    found = buffer.lookup_transform("tag_frame", "kuka/flange_frame/seen", rospy.Time(0), rospy.Duration(30.0))
    np.testing.assert_allclose(pose_from_transform(found.transform), inverse(T_FLANGE_BOARD), atol=1e-9)
    answer = wait_until(lambda: (lambda a: a if a.success else None)(call("camera_place/store")), 15.0, "the storing")
    assert "is stored in" in answer.message
    assert processes.end(node) == 0
    (file,) = (tmp_path / "store").iterdir()
    values = yaml.safe_load(file.read_text())
    assert values["kind"] == "live" and 0.5 < values["point_sd_mm"] < 1.5
    assert not {"rms_mm", "rms_deg"} & set(values) and "error" not in values["views"][0], "one view has no residual"

    scene.visible = False
    buffer.clear()
    again = ros.run("vision", "camera_place_node.py", "_mode:=stored")
    np.testing.assert_allclose(camera_pose(buffer), T_BASE_CAMERA, atol=0.005)
    wait_until(lambda: file.name in again.log_path.read_text(), 15.0, "the sentence about the file")
    assert "one view without confirmation" in again.log_path.read_text()
    assert "is a stored one already" in call("camera_place/store").message
    assert call("camera_place/reload").message.startswith("The camera pose is stored on ")


def test_who_saw_the_live_place_also_gets_the_stored_one(ros, scene, buffer, wait_until):
    """tf2 does not turn a frame that moved into a fixed one."""
    import rospy

    ros.run("vision", "camera_place_node.py")
    camera_pose(buffer)
    wait_until(lambda: call("camera_place/store").success, 15.0, "the storing")
    later = rospy.Time.now() + rospy.Duration(2.0)
    found = buffer.lookup_transform("kuka/base_frame", OPTICAL, later, rospy.Duration(60.0))
    assert abs((found.header.stamp - later).to_sec()) < 1e-6


def test_a_stale_flange_gives_no_place(ros, scene, wait_until):
    scene.measured = False
    node = ros.run("vision", "camera_place_node.py", "_mode:=live")
    wait_until(lambda: "tf has no path from kuka/base_frame" in node.log_path.read_text(), 20.0, "the warning")
    scene.measured = True
    wait_until(lambda: call("camera_place/store").success, 20.0, "a place")
    scene.measured = False
    wait_until(lambda: "is stale at the time" in node.log_path.read_text(), 30.0, "the warning")
    wait_until(lambda: "no detection of the marker board" in call("camera_place/store").message, 20.0, "the refusal")


def test_what_moves_or_is_uncertain_is_not_stored(ros, scene, wait_until, tmp_path):
    """A board that trembles, a small tag that faces the camera, and one with two poses that fit."""
    ros.run("vision", "camera_place_node.py", "_mode:=live")
    for sd, noise, reason in (
        (scene.sd, np.full(6, 0.01), "board moved"),
        ([0.05, 0.05, 0.05, 0.001, 0.001, 0.001], np.zeros(6), "86.60 mm, the limit is 1.5 mm"),
        ([2e-4, 2e-4, 5e-4, 0.2, 0.2, 0.2], np.zeros(6), "19.85 deg, the limit is 0.25 deg"),
    ):
        scene.sd, scene.noise = np.array(sd), noise
        wait_until(lambda reason=reason: reason in call("camera_place/store").message, 20.0, reason)
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize(("serial", "stores"), [("1207290099", True), ("", False)])
def test_the_serial_number_is_the_drivers_and_needed_to_store(ros, scene, wait_until, tmp_path, serial, stores):
    import rospy

    rospy.set_param("camera_calibration/store/camera", "")
    rospy.set_param("camera/driver/serial", serial)
    try:
        ros.run("vision", "camera_place_node.py", "_mode:=live")
        if stores:
            wait_until(lambda: call("camera_place/store").success, 20.0, "the storing")
            (file,) = (tmp_path / "store").iterdir()
            assert yaml.safe_load(file.read_text())["camera"] == serial
        else:
            assert "The camera's serial number is unknown" in call("camera_place/store").message
    finally:
        rospy.delete_param("camera")


def test_diagnostics_say_when_the_board_is_gone(ros, scene, wait_until):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    ros.run("vision", "camera_place_node.py", "_mode:=live")
    heard = ros.record("/diagnostics", DiagnosticArray)

    def state():
        found = [status for message in heard for status in message.status if status.name == "camera_place"]
        return (found[-1].level, found[-1].message) if found else (None, "")

    wait_until(lambda: state() == (DiagnosticStatus.OK, "live"), 20.0, "a place")
    scene.visible = False
    wait_until(
        lambda: state()[0] == DiagnosticStatus.WARN and "was not detected for" in state()[1], 20.0, "the warning"
    )
    scene.visible = True
    wait_until(lambda: state() == (DiagnosticStatus.OK, "live"), 20.0, "a place again")


def test_a_torn_calibration_is_named_and_left_aside(ros, scene, wait_until, tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "camera_place_2026-01-01T000000.yaml").write_text("date: '2026-01-01T00:00:00'\nT_base_cam")
    node = ros.run("vision", "camera_place_node.py")
    wait_until(lambda: "Skipped the calibration" in node.log_path.read_text(), 20.0, "the sentence")
    wait_until(lambda: "the camera pose is live" in node.log_path.read_text(), 20.0, "live")


def test_reload_in_the_mode_live(ros, scene):
    ros.run("vision", "camera_place_node.py", "_mode:=live")
    answer = call("camera_place/reload")
    assert answer.success and "the mode is live" in answer.message


def test_reload_after_the_only_calibration_was_moved_away(ros, scene, buffer, wait_until, tmp_path):
    ros.run("vision", "camera_place_node.py")
    camera_pose(buffer)
    wait_until(lambda: call("camera_place/store").success, 15.0, "the storing")
    (file,) = (tmp_path / "store").iterdir()
    file.unlink()
    assert "has no calibration" in call("camera_place/reload").message
    wait_until(lambda: call("camera_place/store").success, 15.0, "the storing of what is live again")


@pytest.mark.parametrize(
    ("parameters", "change", "fault"),
    [
        (("_mode:=both", "_mod:=live"), {}, "~mode is 'both'"),
        (("_mode:=stored",), {}, "No calibration for LBR7R800 and camera 1234"),
        (("_mode:=live",), {"camera_calibration/panel/frame": "box"}, "the marker board box"),
        (("_mode:=live",), {"camera_calibration/limits/pictures": 0}, "camera_calibration/limits/pictures is 0"),
    ],
)
def test_it_names_wrong_parameters(ros, scene, parameters, change, fault):
    import rospy

    for key, value in change.items():
        rospy.set_param(key, value)
    node = ros.run("vision", "camera_place_node.py", *parameters)
    assert node.wait(30.0) == 1
    log = node.log_path.read_text()
    assert fault in log
    assert "Traceback" not in log


def test_it_waits_for_its_parameters_and_ends_with_an_interrupt(ros, processes, wait_until):
    node = ros.run("vision", "camera_place_node.py")
    wait_until(lambda: "Waiting for the parameter" in node.log_path.read_text(), 20.0, "the waiting")
    processes.end(node)
    assert "Traceback" not in node.log_path.read_text()
