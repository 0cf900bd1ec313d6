"""camera.launch and the launch files that include it: whose lenses, and whose driver and frames."""

import os
import subprocess

import pytest
import yaml

pytestmark = pytest.mark.ros
ABOVE = [
    ("vision", "camera_apriltag.launch"),
    ("vision", "camera_oculus.launch"),
    ("vision", "plane_pose.launch"),
    ("vision", "register_rgbd.launch"),
    ("grasping", "grasping.launch"),
]


def roslaunch(option, package, file, *args, **environment):
    out = subprocess.run(
        ["roslaunch", option, package, file, *args],
        capture_output=True, text=True, timeout=90.0, env={**os.environ, **environment},
    )  # fmt: skip
    assert out.returncode == 0, out.stderr
    return out.stdout


@pytest.mark.parametrize(("package", "file"), ABOVE)
def test_the_lenses_are_those_of_the_files_that_are_given(package, file, tmp_path):
    for name in ("rgb", "depth"):
        (tmp_path / f"{name}.yaml").write_text(f"camera_name: my_{name}\n")
    args = [f"{name}_calibration:={tmp_path / name}.yaml" for name in ("rgb", "depth")]
    values = yaml.safe_load(roslaunch("--dump-params", package, file, "sim:=false", *args))
    assert values["/camera/driver/rgb_calibration/camera_name"] == "my_rgb"
    assert values["/camera/driver/depth_calibration/camera_name"] == "my_depth"


@pytest.fixture
def openni2_launch(tmp_path):
    """A package of that name with one node, and the path on which it is found."""
    package = tmp_path / "openni2_launch"
    (package / "launch").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>openni2_launch</name></package>")
    args = "".join(f'<arg name="{n}"/>' for n in ("camera", "rgb_camera_info_url", "depth_camera_info_url"))
    node = '<node pkg="vision" type="xtion_node.py" name="$(arg camera)_of_openni2"/>'
    (package / "launch" / "openni2.launch").write_text(f"<launch>{args}{node}</launch>")
    return f"{tmp_path}:{os.environ['ROS_PACKAGE_PATH']}"


@pytest.mark.parametrize(("package", "file"), [("vision", "camera.launch"), *ABOVE])
def test_with_openni2_launch_our_own_names_of_the_frames_are_there_too(openni2_launch, package, file):
    args = (package, file, "sim:=false", "openni2_launch:=true")
    nodes = set(roslaunch("--nodes", *args, ROS_PACKAGE_PATH=openni2_launch).split())
    assert {"/camera_of_openni2", "/camera/frames", "/camera/watchdog"} <= nodes
    assert "/camera/driver" not in nodes
    values = yaml.safe_load(roslaunch("--dump-params", *args, ROS_PACKAGE_PATH=openni2_launch))
    assert values["/camera/frames/driver_frames"] is False


@pytest.mark.parametrize("openni2", ["true", "false"])
def test_the_simulated_camera_has_all_its_frames(openni2):
    args = ("vision", "camera.launch", f"openni2_launch:={openni2}")
    assert {"/camera/driver", "/camera/frames"} <= set(roslaunch("--nodes", *args).split())
    assert yaml.safe_load(roslaunch("--dump-params", *args))["/camera/frames/driver_frames"] is True
