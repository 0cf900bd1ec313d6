"""camera.launch and the launch files that include it: whose lenses, and whose driver and frames."""

import os

import pytest

pytest.importorskip("roslaunch")
from tools import launched

pytestmark = pytest.mark.ros
ABOVE = [
    ("vision", "camera_apriltag.launch"),
    ("vision", "camera_oculus.launch"),
    ("vision", "plane_pose.launch"),
    ("vision", "register_rgbd.launch"),
    ("grasping", "grasping.launch"),
]


@pytest.mark.parametrize(("package", "file"), ABOVE)
def test_the_lenses_are_those_of_the_files_that_are_given(package, file, tmp_path):
    for name in ("rgb", "depth"):
        (tmp_path / f"{name}.yaml").write_text(f"camera_name: my_{name}\n")
    args = [f"{name}_calibration:={tmp_path / name}.yaml" for name in ("rgb", "depth")]
    values = launched.parameters(package, file, *args)
    assert values["/camera/driver/rgb_calibration/camera_name"] == "my_rgb"
    assert values["/camera/driver/depth_calibration/camera_name"] == "my_depth"


@pytest.fixture
def openni2_launch(tmp_path, monkeypatch):
    """A package of that name with one node."""
    package = tmp_path / "openni2_launch"
    (package / "launch").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>openni2_launch</name></package>")
    args = "".join(f'<arg name="{n}"/>' for n in ("camera", "rgb_camera_info_url", "depth_camera_info_url"))
    node = '<node pkg="vision" type="xtion_node.py" name="$(arg camera)_of_openni2"/>'
    (package / "launch" / "openni2.launch").write_text(f"<launch>{args}{node}</launch>")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}:{os.environ['ROS_PACKAGE_PATH']}")
    monkeypatch.setattr("roslaunch.substitution_args._rospack", None)  # which keeps the packages that it has found


@pytest.mark.parametrize(("package", "file"), [("vision", "camera.launch"), *ABOVE])
def test_with_openni2_launch_our_own_names_of_the_frames_are_there_too(openni2_launch, package, file):
    args = (package, file, "openni2_launch:=true")
    nodes = launched.nodes(*args)
    assert {"/camera_of_openni2", "/camera/frames", "/camera/watchdog"} <= nodes
    assert "/camera/driver" not in nodes
    values = launched.parameters(*args)
    assert values["/camera/frames/driver_frames"] is False and values["/camera/driver/serial"] == ""


@pytest.mark.parametrize("openni2", ["true", "false"])
def test_the_simulated_camera_has_all_its_frames(openni2):
    args = ("vision", "camera.launch", "sim:=true", f"openni2_launch:={openni2}")
    assert {"/camera/driver", "/camera/frames"} <= launched.nodes(*args)
    assert launched.parameters(*args)["/camera/frames/driver_frames"] is True
