"""Each node as a process of its own: it has the topics and services of the handbook's page, and ends on Ctrl-C.

What it does is tested in virtual time, in its package. The nodes of a package run side by side.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
NODE = re.compile(r'\brun\(("|NAME|name\b|node)|\binit_node\(|(?<!\.)\bjoin\(("|NAME|NODE)')
"""What stands in a program that is a node, or in the module that it runs."""


class Bench(NamedTuple):
    """With what a test works."""

    ros: Any
    wait_until: Callable
    patch: pytest.MonkeyPatch
    folder: Path


def world(bench):
    """The simulated arm and hand."""
    import rospy

    ports = ("--port", "0", "--control-port", "0", "--hand-port", "0", "--hand-control-port", "0", "--world-port", "0")
    process = bench.ros.run("rig_simulation", "world.py", *ports)
    bench.wait_until(lambda: "world: scene" in process.log_path.read_text(), 60.0, "the world")
    said = process.log_path.read_text()
    arm, arm_control = map(int, re.search(r"listening on [\d.]+:(\d+), control port [\d.]+:(\d+)", said).groups())
    rospy.set_param("kuka/ip", "127.0.0.1")
    rospy.set_param("kuka/port", arm)
    others = {"leap_port": 0, "hand_port": 0, "camera_port": 0}
    port = int(said.strip().rsplit(":", 1)[1])
    rospy.set_param("simulation", {"arm_port": arm_control, "world_port": port, **others})
    for name in ("camera/driver/port", "camera_truth/port"):
        rospy.set_param(name, port)
    rospy.set_param("camera/driver/control_port", 0)


def hand(_bench):
    """What leap_hand_node asks of the hand's driver."""
    import rospy
    from std_srvs.srv import Empty, EmptyResponse

    for name in ("calibrate_fingers", "calibrate_tactile"):
        rospy.Service(f"reflex_takktile/{name}", Empty, lambda _: EmptyResponse())


def tool(_bench):
    """What others read of the controller's parameters."""
    import rospy

    from tools import launched

    for name, value in launched.parameters("kuka_control", "kuka_params_rt.launch").items():
        rospy.set_param(name, value)
    rospy.set_param("kuka/ws_center", [0.5, 0.0, 0.4])  # the controller computes it


def viewer(bench):
    """A window that shows the operator's view, which is made for those who look."""
    from rig_msgs.msg import OperatorView

    bench.ros.record("operator_view/rows", OperatorView)


def camera(bench):
    """A stand-in of the camera's library, with a camera."""
    state = bench.folder / "camera"
    state.write_text("present")
    bench.patch.setenv("FAKE_CAMERA", str(state))
    paths = [str(ROOT / "src" / "vision" / "tests" / "fake_openni"), os.environ.get("PYTHONPATH", "")]
    bench.patch.setenv("PYTHONPATH", os.pathsep.join(paths))


@dataclass(frozen=True)
class Program:
    """A program.

    Attributes:
        node: its name in the launch file, or without one on the graph.
        launch: package, file and arguments of a launch file, for its parameters and options.
        package, options: without a launch file.
        needs: what it starts with.
        sign: a topic or service, for a node that is not on the page.
        later: names of the page that it has only as another node asks for them, or by other options.
        code: at Ctrl-C.
    """

    script: str
    node: str
    launch: tuple[str, ...] = ()
    package: str = ""
    options: tuple[str, ...] = ()
    needs: tuple[Callable, ...] = ()
    sign: str = ""
    later: frozenset[str] = frozenset()
    code: int = 0


PROGRAMS = {
    "grasping": [
        Program("collect.py", "grasp_collection", ("grasping", "collect.launch"), needs=(tool,)),
        Program("ggcnn.py", "ggcnn", ("leap_rig", "grasping.launch", "sim:=true"), needs=(tool,)),
        Program("grasp_execution.py", "grasp_execution", ("grasping", "execution.launch"), needs=(tool,)),
        Program("grasp_picture.py", "grasp_picture", package="grasping", options=("grasp.png",),
                sign="/ggcnn/out/grasps", code=1),
        Program("image_viewer.py", "image_viewer", package="grasping", options=("image:=/viewer/red",),
                sign="/viewer/red"),
    ],
    "kuka_control": [
        Program("gui.py", "kuka_panel", package="kuka_control"),
        Program("real_time_controller.py", "kuka_real_time_node", ("kuka_control", "real_time_controller.launch"),
                needs=(world,)),
    ],
    "kuka_control's other controller": [
        Program("ptp_controller.py", "kuka_ptp_node", ("kuka_control", "ptp_controller.launch"), needs=(world,)),
    ],
    "leap_hand and leap_kuka": [
        Program("leap_hand_node.py", "leap_hand_node", ("leap_hand", "leap_hand.launch"), needs=(hand,)),
        Program("arm_choice_node.py", "arm_choice",
                ("leap_rig", "two_arms.launch", "sim:=true", "arm_choice:=service", "one_process:=false"),
                sign="/leap_kuka/choose_arm"),
        Program("leap_kuka_node.py", "leap_kuka_node", ("leap_kuka", "leap_kuka.launch"), needs=(tool,)),
        Program("operator_input_node.py", "operator_input_node", package="leap_kuka",
                sign="/leap_kuka/operator_input"),
    ],
    "leap_rig and reflex": [
        Program("cockpit_node.py", "cockpit", ("leap_rig", "demo.launch", "view:=browser", "cockpit_port:=0"),
                sign="/cockpit/episode_mark"),
        Program("leap_teleop.py", "leap_teleop", ("leap_rig", "two_arms.launch", "sim:=true"),
                sign="/leap_motion/leap_device"),
        Program("operator_view_node.py", "operator_view", ("leap_rig", "demo.launch"), needs=(viewer,)),
        Program("reflex_takktile_driver.py", "reflex_takktile_driver", ("leap_rig", "demo.launch")),
        Program("tutorial.py", "tutorial", ("leap_rig", "demo.launch", "tutorial:=true"), sign="/kuka/status"),
    ],
    "the Leap and the camera": [
        Program("leap_driver.py", "leap_driver", ("leap_motion", "leap_driver.launch"),
                later=frozenset({"/simulated_devices"})),
        Program("visualizer.py", "leap_motion_visualizer", ("leap_motion", "visualization.launch"),
                sign="/leap_motion/visualization_marker_array"),
        Program("xtion_node.py", "camera/driver", ("vision", "camera.launch"),
                sign="/camera/depth/image_raw", needs=(camera,)),
    ],
    "rig_simulation": [
        Program("operator_node.py", "operator", ("leap_rig", "demo.launch"), needs=(tool,)),
        Program("camera_node.py", "camera/driver", ("leap_rig", "camera.launch", "sim:=true"), needs=(world,)),
        Program("camera_truth_node.py", "camera_truth", ("leap_rig", "camera.launch", "sim:=true"), needs=(world,)),
        Program("simulation_node.py", "simulation", ("leap_rig", "demo.launch"), needs=(world,)),
    ],
    "vision and apriltag_ros": [
        Program("apriltag_ros_continuous_node.py", "apriltag_ros_continuous_node",
                ("vision", "camera_apriltag.launch", "sim:=true")),
        Program("apriltag_ros_single_image_server_node.py", "apriltag_ros_single_image_server",
                package="apriltag_ros", options=("_standalone_tags:=[{id: 0, size: 0.1}]",),
                sign="/single_image_tag_detection"),
        Program("camera_frames_node.py", "camera/frames", ("vision", "camera.launch", "sim:=true")),
        Program("camera_place_node.py", "camera_place", ("vision", "camera_apriltag.launch", "sim:=true")),
        Program("camera_watchdog_node.py", "camera/watchdog", ("vision", "camera.launch", "sim:=true"),
                later=frozenset({"/camera/depth/image_raw", "/camera/rgb/image_raw"})),
        Program("plane_pose_node.py", "plane_pose", ("vision", "plane_pose.launch", "sim:=true")),
        Program("register_rgbd_start.py", "camera/register_rgbd", ("leap_rig", "camera.launch", "sim:=true")),
        Program("stereo_view_node.py", "stereo_view", ("vision", "camera_oculus.launch", "sim:=true")),
    ],
}  # fmt: skip
ELSEWHERE = {
    "collect_shown_grasp.py", "move.py", "simple_controller.py", "teach.py", "hand_wizard.py", "demo.py",
    "lerobot_server.py", "record.py", "record_episodes.py", "replay.py", "ros2_bridge.py", "calibrate_camera.py",
    "run_policy.py", "workspace_plotter.py", "register_rgbd_node.py", "stereo_web_node.py",
}  # fmt: skip
"""Programs that talk with a person, or need a device or a recording: the tests of their packages start them."""


def command(program: Program) -> tuple[str, list[str]]:
    """Sets the parameters of the launch file; returns package and options."""
    import rospy

    from tools import launched

    if not program.launch:
        return program.package, [f"__name:={program.node}", *program.options]
    package, file, *arguments = program.launch
    config = launched.config(package, file, tuple(arguments))
    (node,) = (each for each in config.nodes if f"{each.namespace}{each.name}" == f"/{program.node}")
    for name, parameter in config.params.items():
        rospy.set_param(name, parameter.value)
    remaps = [f"{old}:={new}" for old, new in node.remap_args]
    return node.package, [f"__name:={node.name}", f"__ns:={node.namespace}", *shlex.split(node.args), *remaps]


def names_of(node: str, state: list) -> dict[str, set[str]]:
    """The topics and services of a node, without those that rospy and tf2 give to each."""
    found = {
        kind: {name for name, nodes in offered if node in nodes}
        for kind, offered in zip(("publishes", "hears", "offers"), state)
    }
    of_each = {"/rosout", *(f"{node}/{name}" for name in ("get_loggers", "set_logger_level", "tf2_frames"))}
    return {kind: names - of_each for kind, names in found.items()}


def has_its_names(program: Program, found: dict[str, set[str]], page: dict[str, set[str]]) -> bool:
    """Whether a node has the names of its page; without a page, its sign."""
    if program.sign:
        return program.sign in set().union(*found.values())
    assert any(page.values()), f"{program.script} is not on the page"
    return all(names - program.later <= found[kind] <= names for kind, names in page.items())


@pytest.mark.ros
@pytest.mark.real
@pytest.mark.parametrize("programs", PROGRAMS.values(), ids=PROGRAMS)
def test_they_have_the_names_of_their_pages_and_end_on_ctrl_c(
    ros, programs, wait_until, names_on_the_page, monkeypatch, tmp_path
):
    import rosgraph

    commands = [command(program) for program in programs]
    for need in dict.fromkeys(need for program in programs for need in program.needs):
        need(Bench(ros, wait_until, monkeypatch, tmp_path))
    started = [
        (program, ros.run(package, program.script, *options))
        for program, (package, options) in zip(programs, commands)
    ]  # fmt: skip
    faults: dict[str, Any] = {}  # what a failure shows

    def all_have_their_names():
        state = rosgraph.Master("/test").getSystemState()
        faults.clear()
        for program, process in started:
            assert process.poll() is None, f"{program.script} has ended: {process.log_path.read_text()}"
            found = names_of(f"/{program.node}", state)
            if not has_its_names(program, found, names_on_the_page(program.node)):
                faults[program.script] = found
        return not faults

    wait_until(all_have_their_names, 30.0, faults)
    for _, process in started:
        process.send_signal(signal.SIGINT)
    for program, process in started:
        process.wait(20.0)
        said = process.log_path.read_text()
        if process.returncode != program.code or "Traceback" in said:
            faults[program.script] = process.returncode, said
    assert not faults


def test_every_node_is_here_or_named():
    modules = {str(path).rpartition("/src/")[2]: path.read_text() for path in ROOT.glob("src/**/src/**/*.py")}

    def is_node(script: Path) -> bool:
        text = script.read_text()
        names = re.findall(r"^from (\w[\w.]+) import", text, re.MULTILINE)
        files = {f"{name.replace('.', '/')}.py" for name in names if not name.endswith(".node")}
        return any(NODE.search(each) for each in (text, *(modules.get(file, "") for file in files)))

    scripts = {path.name for path in ROOT.glob("src/**/scripts/*.py") if is_node(path)}
    listed = {program.script for programs in PROGRAMS.values() for program in programs}
    assert scripts == listed | ELSEWHERE and not listed & ELSEWHERE
