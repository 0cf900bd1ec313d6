"""What the launch files of the rig start and hand over, without starting it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rig_msgs.srv")
from common.arms import arms_from
from common.config import parse
from kuka_control.model.arms import placement_faults
from kuka_control.model.config import RealTimeConfig, neighbours
from kuka_control.model.rig import workspace_of
from leap_kuka.config import LeapConfig
from leap_rig.ros.demo import OF_ONE_ARM
from tools import launched
from tools.reference.commands import AS_TYPED
from tools.reference.launch_files import arguments

pytestmark = pytest.mark.ros


def parameters(*arguments: str) -> dict:
    """Returns the parameters that the demo would set."""
    return launched.parameters("leap_rig", "demo.launch", *arguments)


def nodes(*arguments: str) -> set[str]:
    """Returns the names of the nodes that the demo would start."""
    return launched.nodes("leap_rig", "demo.launch", *arguments)


ROOT = Path(__file__).resolve().parents[3]
LAUNCH_FILES = sorted(ROOT.glob("src/**/launch/*.launch"))
PANEL = "/kuka_panel"
DEMO = ROOT / "src/leap_rig/launch/demo.launch"
SIMULATORS = {DEMO, DEMO.with_name("simulated_devices.launch"), DEMO.with_name("two_simulated_arms.launch")}
"""The launch files that start simulated devices unasked."""
BESIDE = [
    ("kuka_control", "real_time_controller.launch", "/kuka/ip", "127.0.0.1", "172.31.1.147"),
    ("kuka_control", "ptp_controller.launch", "/kuka/ip", "127.0.0.1", "172.31.1.147"),
    ("reflex", "reflex_takktile.launch", "/reflex_takktile_driver/network_interface", "lo", "eth0"),
]
"""Those that use a device which another one simulates: the parameter that says where, simulated and real."""
CHOOSING = [
    path
    for path in LAUNCH_FILES
    if '<arg name="sim" default' in path.read_text() and path.name not in {file for _, file, *_ in BESIDE}
]


def simulators(path: Path, *arguments: str) -> list:
    """Returns the nodes that simulate, or that say that what follows is simulated, in the order of their start."""
    started = launched.config(path.parents[1].name, path.name, arguments).nodes
    return [node for node in started if node.package == "rig_simulation" or "simulated.sh" in str(node.launch_prefix)]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: f"{path.parents[1].name}-{path.stem}")
def test_no_launch_file_but_the_demo_and_the_simulated_devices_simulates_unasked(path):
    must_be_given = [name for name, arg in arguments(path).items() if arg.get("default") is None]
    assert bool(simulators(path, *(f"{name}:=left" for name in must_be_given))) is (path in SIMULATORS)


@pytest.mark.parametrize("path", CHOOSING, ids=lambda path: f"{path.parents[1].name}-{path.stem}")
def test_what_is_asked_to_simulate_says_so_before_anything_else_does(path):
    assert "/simulated.sh " in launched.prefixes(path.parents[1].name, path.name, "sim:=true")[0]
    assert any(node.package == "rig_simulation" for node in simulators(path, "sim:=true"))
    assert not simulators(path, "sim:=false") and launched.nodes(path.parents[1].name, path.name, "sim:=false")


@pytest.mark.parametrize("package, file, parameter, simulated, real", BESIDE)
def test_a_driver_alone_finds_the_simulated_device_with_sim_true(package, file, parameter, simulated, real):
    assert launched.parameters(package, file, "sim:=true")[parameter] == simulated
    assert launched.parameters(package, file)[parameter] == real


def test_the_lines_that_the_report_of_2019_has_are_those_of_the_page():
    lines = [line.typed.split() for line in AS_TYPED]
    typed = {(words[1], words[2]) for words in lines if words[0] == "roslaunch"}
    files = {("vision", name) for name in ("camera_oculus.launch", "camera_apriltag.launch", "register_rgbd.launch")}
    assert files | {("grasping", "grasping.launch"), ("leap_rig", "leap_rig.launch")} <= typed
    paths = {(path.parents[1].name, path.name): path for path in LAUNCH_FILES}
    for line, words in zip(AS_TYPED, lines):
        if words[0] == "roslaunch":
            path = paths[words[1], words[2] if "." in words[2] else f"{words[2]}.launch"]
            assert bool(simulators(path, *words[3:])) is (path == DEMO), line


@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize(
    ("package", "file", "node"),
    [
        ("leap_rig", "demo.launch", "kuka_real_time_node"),
        ("kuka_control", "real_time_controller.launch", "kuka_real_time_node"),
        ("kuka_control", "ptp_controller.launch", "kuka_ptp_node"),
    ],
)
def test_the_workspace_is_lifted_only_where_it_is_asked_for_and_never_on_a_real_robot(package, file, node, asked):
    words = launched.command_line(package, file, node, *(["lift_workspace:=true"] if asked else []))
    assert ("--lift-workspace" in words) is asked and "--i-know" not in words


@pytest.mark.real
def test_the_first_line_says_what_to_pass_and_the_program_gets_its_arguments():
    script = ROOT / "src/common/shell/simulated.sh"
    for what, *words in (("rig", "robot_ip", "sim:=false"), ("camera", "Xtion", "sim:=true")):
        command = [script, what, "printf", "%s|", "a b", "c"]
        lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
        assert len(lines) == 2 and all(part in lines[0] for part in ("simulated", *words))
        assert lines[1] == "a b|c|"


@pytest.mark.parametrize(
    ("package", "file"),
    [
        *(("kuka_control", f"{mode}_controller.launch") for mode in ("real_time", "ptp")),
        *(("leap_rig", f"{name}.launch") for name in ("demo", "leap_rig", "leap_rig_ptp_debug")),
    ],
)
def test_the_control_panel_comes_with_each_controller_once(package, file):
    assert PANEL in launched.nodes(package, file)
    assert PANEL not in launched.nodes(package, file, "gui:=false")


CAMERA = {f"/camera/{name}" for name in ("driver", "frames", "watchdog", "register_rgbd")} | {"/camera_truth"}
NETWORK = {"/ggcnn", "/grasp_execution"}
VIEW = {"/operator_view"}


@pytest.mark.parametrize(
    ("arguments", "there", "missing"),
    [
        (["rviz:=true"], CAMERA | VIEW, NETWORK),
        (["rviz:=false"], set(), CAMERA | NETWORK | VIEW),
        (["rviz:=true", "camera:=false"], set(), CAMERA | NETWORK),
        (["rviz:=true", "world:=false"], set(), CAMERA | NETWORK),
        (["rviz:=false", "camera:=true"], CAMERA, NETWORK),
        (["rviz:=false", "scenario:=assisted_grasp"], CAMERA | NETWORK, set()),
        (["rviz:=false", "scenario:=policy"], CAMERA | {"/policy"}, NETWORK),
        (["rviz:=false", "scenario:=policy", "policy:=none"], CAMERA | {"/operator"}, {"/policy"}),
        (["rviz:=true", "sim:=false"], set(), CAMERA | NETWORK),
        (["rviz:=false", "tracker:=headset"], CAMERA | VIEW | {"/stereo_web", "/operator"}, NETWORK | {"/leapd"}),
        (["rviz:=false", "tracker:=headset", "sim:=false"], VIEW | {"/stereo_web"}, CAMERA | {"/leapd"}),
        (["rviz:=false", "recording:=a.jsonl"], {"/leapd"}, {"/stereo_web"}),
        (["rviz:=false", "sim:=false", "grasping:=true"], (CAMERA - {"/camera_truth"}) | NETWORK, {"/camera_truth"}),
    ],
)
def test_who_looks_at_the_rig_gets_the_camera_and_its_cloud(arguments, there, missing):
    started = nodes("gui:=false", *arguments)
    assert there <= started
    assert not missing & started


PORTS = [f"{device}_control_port:={5000 + i}" for i, device in enumerate(("robot", "leap", "hand", "camera"))]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["rviz:=true", "world_port:=5000", "camera_rate:=2.5"],
         {"camera/driver/rate": 2.5, "camera/driver/port": 5000, "camera_truth/port": 5000}),
        (["rviz:=true"], {"camera/driver/rate": 3.0}),
        (["grasping:=true", *PORTS],
         {"camera/driver/rate": 6.0, "camera/driver/fault": "", "camera/driver/control_port": 5003,
          "simulation/arm_port": 5000, "simulation/leap_port": 5001, "simulation/hand_port": 5002,
          "simulation/camera_port": 5003}),
        (["grasping:=true", "camera_fault:=slow garbled:5:0.2"], {"camera/driver/fault": "slow garbled:5:0.2"}),
        (["tracker:=headset", "rviz:=false", "leap_port:=7000", "web_host:=0.0.0.0"],
         {"stereo_web/web/hands": True, "stereo_web/web/host": "0.0.0.0", "stereo_web/web/leap_port": 7000,
          "leap_driver/port": 7000, "operator/leapd_port": 0, "simulation/leap_port": 0}),
        (["tracker:=headset", "rviz:=false"], {"stereo_web/web/host": "127.0.0.1"}),
    ],
)  # fmt: skip
def test_arguments_of_the_demo_reach_the_nodes_that_need_them(arguments, expected):
    values = parameters(*arguments)
    assert {name: values[f"/{name}"] for name in expected} == expected
    if "/camera/driver/rate" in values:
        assert 1.0 / values["/camera/driver/rate"] < values["/camera/watchdog/silence"]


def test_the_nodes_of_a_frame_run_in_one_process_with_their_parameters():
    apart = {"/leap_driver", "/leap_kuka_node", "/leap_hand_node"}
    assert apart <= nodes() and "/leap_teleop" not in nodes()
    one = ("one_process:=true", "leap_port:=5001")
    started, values = nodes(*one), parameters(*one)
    assert "/leap_teleop" in started and not apart & started
    assert values["/leap_teleop/driver/port"] == 5001 and values["/leap_teleop/hand/hand_only"] is False
    there = {name for name in parameters() if name.startswith(("/leap/", "/leap_hand/"))}
    assert there <= set(values)


def test_a_webcam_takes_the_place_of_the_simulated_leap_with_limits_of_its_own():
    values = parameters("tracker:=webcam")
    assert values["/leap/min_confidence"] > parameters()["/leap/min_confidence"]
    assert parameters("tracker:=webcam", "sim:=false")["/leap/min_confidence"] < values["/leap/min_confidence"]
    assert values["/operator/leapd_port"] == 0 and "/leapd" in nodes("tracker:=webcam")
    of_a_camera = ("leapd", "tracker:=webcam", "camera_device:=/dev/video2", "gui:=false")
    line = " ".join(launched.command_line("leap_rig", "demo.launch", *of_a_camera))
    assert "--headless" in line and "--camera=/dev/video2" in line
    of_a_film = ("leapd", "tracker:=webcam", "video:=/a b.mp4", "leap_args:=--setup above", "leap_port:=7")
    line = " ".join(launched.command_line("leap_rig", "demo.launch", *of_a_film))
    assert all(part in line for part in ("--video=/a b.mp4", "--setup above", "--port 7"))


@pytest.mark.parametrize("process", ["one_process:=true", "one_process:=false"])
def test_without_a_tracker_nothing_publishes_the_desired_tool_and_all_else_is_there(process):
    none = ("tracker:=none", process)
    teleoperation = {"/leapd", "/leap_driver", "/leap_kuka_node", "/leap_hand_node", "/leap_teleop"}
    assert nodes(*none) == nodes(process) - teleoperation
    assert {"/kuka_real_time_node", "/reflex_takktile_driver", "/simulated_world"} <= nodes(*none)
    assert parameters(*none)["/operator/leapd_port"] == parameters(*none)["/simulation/leap_port"] == 0
    assert nodes(*none, "sim:=false") == nodes(process, "sim:=false") - teleoperation


ARMS = ("left", "right")
OF_AN_ARM = {"kuka_real_time_node", "reflex_takktile_driver", "robot_state_publisher"}


def of_both(names: set[str]) -> set[str]:
    return {f"/{arm}/{name}" for arm in ARMS for name in names}


def test_two_arms_have_their_nodes_in_namespaces_and_share_world_leap_and_panel():
    shared = {"/simulated_world", "/leapd", "/simulation", "/operator"}
    hidden = ("robots:=2", "rviz:=false", "gui:=false")
    both = of_both(OF_AN_ARM | {"simulation"})
    assert nodes(*hidden) == shared | both | {"/leap_teleop"}
    shown = nodes("robots:=2") - nodes(*hidden)
    assert shown == {PANEL, "/rviz"} | of_both({"operator_view"})
    apart = of_both({"leap_kuka_node", "leap_hand_node"}) | {"/leap_driver"}
    assert nodes(*hidden, "one_process:=false") == shared | both | apart
    assert nodes(*hidden, "sim:=false") == of_both(OF_AN_ARM) | {"/leap_teleop"}
    assert nodes("robots:=3") == set()


@pytest.mark.parametrize(
    "given", ["recording:=/a b.gz", "offset:=0 1 0", "world:=false", "scenario:=wall", "camera:=true"]
)
def test_what_is_for_one_arm_ends_the_launch_of_two_with_a_sentence(given):
    assert nodes("robots:=2", given, "rviz:=false", "gui:=false") == {"/arguments"}


def test_the_launch_file_refuses_for_two_arms_the_same_arguments_as_make_demo():
    """A launch file cannot read the list in Python, so it has one of its own."""
    (text,) = re.findall(r'<arg name="for_one" value="\$\(eval (.*?)\)"/>', DEMO.read_text(), re.DOTALL)
    condition = compile(text.replace("\n", " "), "for_one", "eval")
    allowed = {name: yaml.safe_load(value) if value else "" for name, value in OF_ONE_ARM.items()}
    allowed["scenario"] = "two_cups"
    assert set(condition.co_names) == {*allowed, "str", "join"}
    assert eval(condition, allowed.copy()).split() == []
    for name, value in allowed.items():
        other = not value if isinstance(value, bool) else "another"
        assert eval(condition, {**allowed, name: other}).split() == [f"{name}:={other}"]


@pytest.mark.parametrize(
    "given", ["arm_choice:=region", "arms:=/a.yaml", "right_robot_ip:=1.2.3.4", "right_hand_interface:=eth7"]
)
def test_what_is_for_two_arms_ends_the_launch_of_one_with_a_sentence(given):
    assert nodes(given, "rviz:=false", "gui:=false") == {"/arguments"}


def test_the_sentence_about_misplaced_arguments_names_them(virtual_graph):
    words = ("2", "recording:=/a.gz", "offset:=0", "1", "0", "__name:=x")
    program = virtual_graph.run("leap_rig", "misplaced_arguments.py", *words)
    assert program.wait(0.1) == 1
    sentence = "Nothing was started: recording:=/a.gz offset:=0 1 0 would have no effect with robots:=2"
    assert program.log.startswith(sentence)


def test_one_hand_that_chooses_gets_relative_engagement_for_both_arms_and_any_hand():
    values = parameters("robots:=2", "arm_choice:=service")
    for arm in ARMS:
        expected = {"leap/arm_choice": "service", "leap/engagement": "relative", "leap/hold_time": 120.0}
        expected["leap_hand/fingers_follow"] = "steering"
        assert {key: values[f"/{arm}/{key}"] for key in expected} == expected
    apart = ("robots:=2", "arm_choice:=region", "one_process:=false", "rviz:=false", "gui:=false")
    assert "/arm_choice" in nodes(*apart)
    values = parameters(*apart)
    assert values["/arm_choice/arms"] == list(ARMS)
    assert [values[f"/{arm}/leap_hand_node/hand"] for arm in ARMS] == ["any", "any"]
    apart = parameters("robots:=2")
    assert [apart[f"/{arm}/leap/arm_choice"] for arm in ARMS] == ["none"] * 2
    assert [apart[f"/{arm}/leap_hand/fingers_follow"] for arm in ARMS] == ["any"] * 2


def test_each_of_two_arms_gets_its_own_robot_hand_and_operators_hand():
    ports = {"robot_port": 5000, "robot_control_port": 5010, "hand_port": 5020, "hand_control_port": 5030}
    values = parameters("robots:=2", *(f"{name}:={value}" for name, value in ports.items()))
    for number, arm in enumerate(ARMS):
        expected = {
            "kuka/port": 5000 + number, "kuka/ip": "127.0.0.1", "reflex_takktile_driver/port": 5020 + number,
            "simulation/arm_port": 5010 + number, "simulation/hand_port": 5030 + number, "tf_prefix": arm,
            "leap/hand": arm, "leap/box_offset": pytest.approx(0.16 * (2 * number - 1)),
        }  # fmt: skip
        assert {key: values[f"/{arm}/{key}"] for key in expected} == expected
        assert values[f"/{arm}/reflex_takktile_driver/calibration_folder"].endswith(f"/reflex/lo/{arm}")
    assert values["/leap_teleop/arms"] == values["/operator/arms"] == list(ARMS)
    apart = parameters("robots:=2", "one_process:=false")
    assert [apart[f"/{arm}/leap_hand_node/hand"] for arm in ARMS] == list(ARMS)
    assert apart["/left/leap_hand_node/hand_only"] is False
    real = parameters("robots:=2", "sim:=false")
    assert real["/left/kuka/ip"] != real["/right/kuka/ip"] and real["/left/kuka/port"] == real["/right/kuka/port"]
    interfaces = [real[f"/{arm}/reflex_takktile_driver/network_interface"] for arm in ARMS]
    assert interfaces == ["eth0", "eth1"]
    assert real["/left/kuka/rate_servo"] > values["/left/kuka/rate_servo"], "lower rates are for simulated arms alone"


def test_what_an_earlier_file_said_of_two_arms_does_not_stay():
    assert "/arms/" in launched.config("leap_rig", "two_arms.launch", ()).clear_params


def test_the_controllers_of_two_arms_accept_what_the_launch_files_set():
    values = parameters("robots:=2")

    def under(name: str) -> dict:
        tree: dict = {}
        for key, value in values.items():
            if key.startswith(name):
                *path, last = key[len(name) :].split("/")
                at = tree
                for part in path:
                    at = at.setdefault(part, {})
                at[last] = value
        return tree

    configs = {arm: parse(RealTimeConfig, under(f"/{arm}/kuka/"), others=neighbours(RealTimeConfig)) for arm in ARMS}
    workspaces = {arm: workspace_of(config) for arm, config in configs.items()}
    arms = arms_from(under("/arms/"))
    for arm, config in configs.items():
        assert placement_faults(arms, arm, config.mounting, workspaces) == []
        assert parse(LeapConfig, under(f"/{arm}/leap/")).hand == arm


def test_an_own_file_stands_above_the_rates_of_two_simulated_arms(tmp_path):
    (tmp_path / "own.yaml").write_text("rate_servo: 77.0\n")
    values = parameters("robots:=2", f"overrides:={tmp_path}/own.yaml")
    assert values["/left/kuka/rate_servo"] == values["/right/kuka/rate_servo"] == 77.0
    assert values["/left/kuka/rate_joints"] == 25.0 and values["/left/kuka/center_line"] == [1, 0, 0]


@pytest.mark.parametrize("name", ["rig", "two_arms"])
def test_the_presets_of_rviz_show_each_text_once_and_no_whole_cloud(name):
    """The rows say what box and guard say; frames are named in the tree of displays."""

    def all_of(displays: list[dict]) -> list[dict]:
        return [one for display in displays for one in (display, *all_of(display.get("Displays", [])))]

    preset = yaml.safe_load((ROOT / f"src/leap_rig/rviz/{name}.rviz").read_text())
    shown = [one for one in all_of(preset["Visualization Manager"]["Displays"]) if one["Enabled"]]
    assert not any(one.get("Show Names") for one in shown)
    hidden = {"interaction_box": {"reason"}, "guard_markers": {"distance", "robot"}}
    for topic, spaces in hidden.items():
        found = [one["Namespaces"] for one in shown if one.get("Marker Topic", "").endswith(topic)]
        assert found and all(one == dict.fromkeys(spaces, False) for one in found)
    assert {one["Topic"] for one in shown if "Topic" in one} <= {"operator_view/cloud"}


def test_the_presets_of_rviz_show_topics_and_frames_of_each_arm():
    def named(display: dict, keys: tuple[str, ...]) -> set[str]:
        here = {display[key] for key in keys if key in display} | set(display.get("Frames", ()))
        return here.union(*(named(inner, keys) for inner in display.get("Displays", ())))

    keys = ("Marker Topic", "Robot Description", "Reference Frame")
    one, two = (
        {name for display in preset["Visualization Manager"]["Displays"] for name in named(display, keys)}
        for preset in (yaml.safe_load((ROOT / f"src/leap_rig/rviz/{name}.rviz").read_text()) for name in PRESETS)
    )
    shared = {"world", "simulation/objects", "simulation/contacts"}
    assert shared < two and {name.split("/")[0] for name in two - shared} == set(ARMS)
    for arm in ARMS:
        assert {name[len(arm) + 1 :] for name in two if name.startswith(f"{arm}/")} <= one


PRESETS = ("rig", "two_arms")
