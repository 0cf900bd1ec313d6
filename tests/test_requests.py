"""Every request that programs can make of the rig, with each of its numbers, lists and texts zero, negative, not a
number, huge or empty: refused in a sentence, and nothing changes, or known to be meaningful.

What there is to ask is found in the source; the cases of a field come from its type.
"""

from __future__ import annotations

import ast
import copy
import importlib
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from common import clock
from common.camera_model import pinhole
from common.poses import pose

pytest.importorskip("rig_msgs.srv")
import rospy
from actionlib import CommState

from apriltag_ros.srv import AnalyzeSingleImageRequest
from common.frames import BASE
from common.ros.conversions import stamped_pose
from common.ros.images import camera_info_message
from kuka_msgs.msg import MoveGoal
from kuka_msgs.srv import setPayloadRequest, setScalingFactorRequest
from reflex_msgs.msg import FingerPressure
from reflex_msgs.srv import SetSpeedRequest, SetTactileThresholdRequest
from rig_msgs.srv import CheckToolPoseRequest, ChooseArmRequest, ChooseOperatorRequest, HoldToolRequest, SetSceneRequest
from rig_msgs.srv import SimulationFaultRequest as FaultRequest
from simulated.rig import VirtualRig

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[1]
FLOATS = (0.0, -1.0, math.nan, math.inf, 1e30)
TEXTS = ("", "x" * 5000)
ANY = object()
NOT_READ = {r"header\.(seq|stamp)$": ANY, r"^(tool|pose)\.header\.(seq|stamp)$": ANY}
SAME = {r"orientation\.y$": (-1.0,)}  # of (0, 1, 0, 0)
MEANT = {
    "SetSpeed": {},
    "SetTactileThreshold": {r"sensor": (65535,)},  # no pressure is a touch
    "setPayload": {r"^data$": (0.0,)},  # nothing is held
    "setScalingFactor": {},
    "CheckToolPose": {},
    "HoldTool": {r"^duration$": (0.0,)},  # ends it
    "ChooseArm": {},
    "ChooseOperator": {r"^operator$": ("",)},  # nobody
    "SetScene": {},
    "SimulationFault": {
        r"^fault$": ("",),  # lists the faults
        r"^value$": (0.0,),  # the usual one
        r"^duration$": (0.0, 1e30),  # until it is switched off; longer than anything runs
    },
    "MoveAction": {},
    "AnalyzeSingleImage": {
        r"^full_path_where_to_save_image$": ("",),  # nothing is saved
        r"frame_id$": TEXTS,  # goes into the answer
        r"(width|height)$": (0,),  # as large as the image is, or the whole image
        r"distortion_model$": ("",),  # none, as of most drivers without distortion
        r"\.D$": ([],),
        r"\.D\.": (0.0, -1.0, 1e30),  # refused once a tag is seen through such a lens
        r"\.P\.11$": (-1.0, 1e30),  # nobody reads it
        r"binning_[xy]$": (0,),  # none
        r"roi\.": (0,),
    },
}
"""Requests with such fields; by path of a field, what of the cases is meaningful, ANY: nobody reads the field."""


def offered() -> set[str]:
    """Returns the types of the services and actions that the source offers."""
    found = set()
    for file in ROOT.glob("src/**/src/**/*.py"):
        for call in ast.walk(ast.parse(file.read_text())):
            name = getattr(call.func, "attr", "") if isinstance(call, ast.Call) else ""
            if name in ("Service", "_serve", "ActionServer", "SimpleActionServer") and len(call.args) > 1:
                found.add(getattr(call.args[1], "id", "service_type"))
    return found - {"service_type"}


def kind_of(name: str):
    """Returns the type of a service or action."""
    packages = [path.parent.parent.name for path in ROOT.glob("src/**/srv/*.srv")] + ["std_srvs"]
    for package in dict.fromkeys(packages):
        found = getattr(importlib.import_module(f"{package}.srv"), name, None)
        if found is not None:
            return found
    return getattr(importlib.import_module("kuka_msgs.msg"), name)


def request_of(name: str):
    """Returns an empty request of a service, or an empty goal of an action."""
    kind = kind_of(name)
    return kind._request_class() if hasattr(kind, "_request_class") else kind().action_goal.goal


def cases(message, path=""):
    """Yields the path of a field, and what it is set to, for each case of a request."""
    for slot, kind in zip(message.__slots__, message._slot_types):
        here, value = f"{path}{slot}", getattr(message, slot)
        each, is_list, size = re.fullmatch(r"([\w/]+)(\[(\d*)\])?", kind).groups()
        if is_list is not None and not size:
            yield here, []
        if is_list is not None and value and hasattr(value[0], "_slot_types"):
            yield from cases(value[-1], f"{here}.{len(value) - 1}.")
        elif is_list is not None:
            for index in {0, len(value) - 1} if len(value) else ():
                yield from ((f"{here}.{index}", bad) for bad in of_type(each))
        elif hasattr(value, "_slot_types"):
            yield from cases(value, f"{here}.")
        else:
            for bad in of_type(each):
                yield here, bad


def of_type(kind: str):
    if kind.startswith("float"):
        return FLOATS
    if kind in ("time", "duration", "bool"):
        return ()
    whole = re.fullmatch(r"(u?)int(\d+)", kind)
    if whole:
        return (0, 2 ** int(whole[2]) - 1) if whole[1] else (0, -1, 2 ** (int(whole[2]) - 1) - 1)
    return TEXTS if kind == "string" else ()


def changed(message, path: str, value):
    """Returns the message with another value of the field."""
    result = copy.deepcopy(message)
    *way, last = path.split(".")
    at = result
    for step in way:
        at = at[int(step)] if step.isdecimal() else getattr(at, step)
    if last.isdecimal():
        values = list(at)
        values[int(last)] = value
        owner = result
        for step in way[:-1]:
            owner = owner[int(step)] if step.isdecimal() else getattr(owner, step)
        setattr(owner, way[-1], values)
    else:
        setattr(at, last, value)
    return result


def test_the_table_has_every_request_with_a_number_a_list_or_a_text():
    files = {path.stem for path in ROOT.glob("src/**/srv/*.srv")}
    actions = {f"{path.stem}Action" for path in ROOT.glob("src/**/*.action")}
    with_fields = {name for name in files | actions | offered() if any(cases(request_of(name)))}
    assert with_fields == set(MEANT)


class Asker:
    """Asks one service, or the action, and tells what came of it."""

    def __init__(self, graph, name: str, kind: str) -> None:
        self._graph, self._kind = graph, kind
        if kind == "MoveAction":
            import actionlib

            self._client = actionlib.ActionClient(name, kind_of(kind))
            assert self._client.wait_for_server(rospy.Duration(5.0))
        else:
            rospy.wait_for_service(name, 5.0)
            self._client = rospy.ServiceProxy(name, kind_of(kind))

    def ask(self, request) -> str:
        """Returns why the request was refused, empty if it was not."""
        try:
            answer = self._client(request) if self._kind != "MoveAction" else self._move(request)
        except rospy.ServiceException as error:
            assert "cannot process request: " in str(error), f"an exception of the handler: {error}"
            return str(error).rpartition("cannot process request: ")[2].rstrip("\"'")
        return "" if getattr(answer, "success", True) else answer.message or "refused without a sentence"

    def _move(self, goal):
        handle = self._client.send_goal(goal)
        self._graph.wait_until(lambda: handle.get_comm_state() == CommState.DONE, 30.0, "the result")
        return handle.get_result()


def meant(meanings, path: str):
    """Returns what of the cases of a field is meaningful."""
    return next((values for pattern, values in meanings.items() if re.search(pattern, path)), ())


def test_each_request_that_cannot_be_meant_is_refused_in_a_sentence_and_changes_nothing(virtual_graph, tmp_path):
    with VirtualRig(virtual_graph) as rig:
        rig.calm()
        faults, asked = [], set()
        for name, kind, valid, meanings in requests(virtual_graph, rig, tmp_path):
            asker = Asker(virtual_graph, name, kind)
            asked.add(kind)
            followed = asker.ask(valid)
            if followed:
                faults.append(f"{name}: {kind} {followed}")
            before, allowed = settled(rig), {**NOT_READ, **meanings, **MEANT[kind], **SAME}
            for path, value in cases(valid):
                values = meant(allowed, path)
                if values is ANY or value in values:
                    continue
                request = changed(valid, path, value)
                sentence = "It is the same." if request == valid else asker.ask(request)
                if not re.search(r"^.{10,}[.?]$", sentence):
                    faults.append(f"{name}: {path} = {value!r:.30}: {sentence or 'taken'}")
            clock.sleep(1.0)
            if state(rig) != before:
                faults.append(f"{name}: {before} became {state(rig)}")
        assert not faults, "\n".join(faults)
        assert asked == set(MEANT)


def state(rig):
    """Returns what requests could change."""
    arm, hand, status = rig.arm.ask("state"), rig.robot_hand.ask("state"), rig.status
    joints = np.round(arm["joints"], 4).tolist()
    switches = (status.control_on, status.scaling_factor, status.mode)
    faults = [fault for device in rig.devices().values() for fault in device.ask("faults")["faults"] if fault["on"]]
    return switches, joints, hand["speed_settings"], hand["goals"], hand["torque"], faults


def settled(rig):
    """Returns that once it does not change any more."""
    before = None
    while before != state(rig):
        before = state(rig)
        clock.sleep(1.0)
    return before


def requests(graph, rig, folder):
    """Yields each service or action, its type, a request that is followed, and what else is meaningful here."""
    yield "reflex_takktile/set_speed", "SetSpeed", SetSpeedRequest([1.0, 1.0, 1.0, 1.0]), {}
    thresholds = [FingerPressure([20] * 9) for _ in range(3)]
    yield "reflex_takktile/set_tactile_threshold", "SetTactileThreshold", SetTactileThresholdRequest(thresholds), {}
    yield "kuka/set_payload", "setPayload", setPayloadRequest(0.5), {}
    yield "kuka/scaling_factor", "setScalingFactor", setScalingFactorRequest(1.0), {}

    home = np.array(rospy.get_param("kuka/ws_center"))
    tool = pose(np.diag([-1.0, 1.0, -1.0]), np.add(home, [0.0, 0.05, 0.0]))
    place = stamped_pose(tool, BASE, rospy.Time.now())
    yield "kuka/check_tool_pose", "CheckToolPose", CheckToolPoseRequest(place), {}
    joints = np.array(rospy.get_param("kuka/joints_home"))
    rig.control(True)
    clock.sleep(1.0)
    yield "leap_kuka/hold_tool", "HoldTool", HoldToolRequest(place, 60.0), {}
    rig.calm()
    rig.control(True)
    named = MoveGoal(kind=MoveGoal.NAMED, name="home")
    yield "kuka/move", "MoveAction", named, {r"^(joints|pose)": ANY, r"^kind$": (0,), r"^velocity$": (0.0,)}
    bent = MoveGoal(kind=MoveGoal.JOINTS, joints=(joints + 0.01).tolist())
    turned = {r"^joints": (0.0, -1.0)}  # of the last joint
    yield "kuka/move", "MoveAction", bent, {r"^(name|pose)": ANY, r"^kind$": (0,), r"^velocity$": (0.0,), **turned}
    there = MoveGoal(kind=MoveGoal.POSE, pose=place)
    yield "kuka/move", "MoveAction", there, {r"^(name|joints)": ANY, r"^kind$": (0,), r"^velocity$": (0.0,)}
    yield "kuka/move", "MoveAction", named, {"": ANY}  # back
    rig.control(False)
    yield "leap_hand/choose_operator", "ChooseOperator", ChooseOperatorRequest(""), {}

    ports = [text for name in ("", "control-", "hand-", "hand-control-") for text in (f"--{name}port", "0")]
    graph.run("rig_simulation", "world.py", "--stepped", "--scene", "cup", *ports, "--world-port", "19876")
    graph.run("rig_simulation", "simulation_node.py", f"_arm_port:={rig._arguments['robot_control_port']}",
              f"_hand_port:={rig._arguments['hand_control_port']}", "_leap_port:=0", "_camera_port:=0",
              "_world_port:=19876")  # fmt: skip
    yield "simulation/set_scene", "SetScene", SetSceneRequest("objects"), {}
    yield "simulation/fault", "SimulationFault", FaultRequest("arm", "slow", False, 0.1, 1.0), {}

    for arm in ("left", "right"):
        rospy.set_param(
            f"{arm}/leap",
            {**rospy.get_param("leap"), "arm_choice": "service", "engagement": "relative", "hold_time": 30.0},
        )
    graph.run("leap_kuka", "arm_choice_node.py", "_arms:=[left, right]")
    yield "leap_kuka/choose_arm", "ChooseArm", ChooseArmRequest("left"), {}

    image, camera = folder / "in.png", pinhole("camera", 64, 48, [[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]])
    cv2.imwrite(str(image), np.zeros((48, 64), np.uint8))
    graph.run("apriltag_ros", "apriltag_ros_single_image_server_node.py", "_rectified:=false",
              "_standalone_tags:=[{id: 0, size: 0.1}]")  # fmt: skip
    info = camera_info_message(camera, "camera_optical", rospy.Time.now())
    analysis = AnalyzeSingleImageRequest(str(image), str(folder / "out.png"), info)
    yield "single_image_tag_detection", "AnalyzeSingleImage", analysis, {}
