"""What is fuzzed without a running rig: each target takes one input and raises what is a finding.

A target may raise its `declared` errors, which say what is wrong with the input. Everything else is a finding: another
exception, a check of its own that fails, such as a number that is not finite and passes, or a process that dies.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gzip
import importlib
import io
import json
import math
import os
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from unittest import mock

import hypothesis
import numpy as np
import yaml
from hypothesis import strategies as st
from hypothesis.database import DirectoryBasedExampleDatabase

from common.config import parse
from common.errors import RigError
from fuzz.mutations import EDITS, edited_bytes, edited_tree, near, near_bytes, near_json, near_trees

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "src"
DATA = ROOT.parent / "shared" / "data"


@dataclasses.dataclass(frozen=True)
class Target:
    """One target: its name, what makes the strategy of its inputs, the function that takes one, the errors that it may
    raise, whether it needs the generated messages, and how much an example costs against the others.
    """

    name: str
    inputs: Callable[[], st.SearchStrategy[Any]]
    take: Callable[[Any], None]
    declared: tuple[type[Exception], ...]
    ros: bool = False
    cost: float = 1.0


TARGETS: dict[str, Target] = {}


def target(
    inputs: Callable[[], st.SearchStrategy[Any]], *declared: type[Exception], ros: bool = False, cost: float = 1.0
) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Registers the function below as a target under its name."""

    def register(take: Callable[[Any], None]) -> Callable[[Any], None]:
        TARGETS[take.__name__] = Target(take.__name__, inputs, take, declared, ros, cost)
        return take

    return register


def law(target: Target, examples: int, search: bool = True) -> Callable[[], None]:
    """Returns the function that tries examples of a target and raises what the smallest input of a finding raises.

    `search`: it begins with what was found before, makes a finding smaller and keeps it.
    """

    def test(given: Any) -> None:
        with contextlib.suppress(*target.declared):
            target.take(given)

    test.__name__ = test.__qualname__ = target.name
    phases = [phase for phase in hypothesis.Phase if phase is not hypothesis.Phase.explain]
    settings = hypothesis.settings(
        max_examples=examples, deadline=None, suppress_health_check=list(hypothesis.HealthCheck),
        database=DirectoryBasedExampleDatabase(ROOT / ".hypothesis" / "fuzz") if search else None,
        phases=phases if search else [hypothesis.Phase.generate],
    )  # fmt: skip
    return settings(hypothesis.given(target.inputs())(test))


def finite(value: Any, where: str = "") -> None:
    """Raises AssertionError if a number in a record, a list, a mapping or an array is not finite."""
    if isinstance(value, np.ndarray):
        assert value.dtype.kind not in "fc" or np.isfinite(value).all(), f"{where} is not finite: {value}"
    elif isinstance(value, float):
        assert math.isfinite(value), f"{where} is {value}"
    elif isinstance(value, dict):
        for key, item in value.items():
            finite(item, f"{where}/{key}")
    elif isinstance(value, (list, tuple)):
        for item in value:
            finite(item, where)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            finite(getattr(value, field.name), f"{where}.{field.name}")


def recorded(folder: str, pattern: str, take: Callable[[Path], Sequence[Any]]) -> list[Any]:
    """Returns seeds from the recordings beside the project, none where they are not."""
    return [seed for path in sorted((DATA / folder).glob(pattern)) for seed in take(path)]


# The arm


KST_ANSWERS = (b"done\n", b"nak\n", b"1\n", b"0\n", b"0.1_-0.2_0.3_-0.4_0.5_-0.6_0.7_\n",
               b"1.0E-5_2.0_3.0_\n", b"500.0_0.0_800.0_0.1_0.2_3.1_\n", b"-0.0_NaN_1.0_2.0_3.0_4.0_5.0_\n")  # fmt: skip
KST_LINES = (
    "TFtrans_0.0_0.0_150.0_0.0_0.0_0.0_", "jRelVel_0.2_", "jp_-0.785_0.523_0.0_-1.396_0.0_1.221_0.0_", "doPTPinJS",
    "startDirectServoJoints", "stopDirectServoJoints", "getJointsPositions", "Torques_ext_J", "Eef_pos", "Eef_force",
    "cArtixanPosition_500_0_500_0_0_0_", "doPTPinCS", "doPTPinCSRelBase", "doPTPinCSCircle1", "stDcEEf_",
    "DcSeCar_1_2_3_4_5_6_", "stVelDcJoint_", "velJDC_0.1_0_0_0_0_0_0_",
    "startSmartImpedneceJoints_1_0_0_0_100_10_",
    "jpJP_0_0_0_0_0_0_0_", "jpEEfP_0_0_0_0_0_0_0_", "doPTP!inJS_1_2_3_", "doPTP!inCS_1_2_", "getPin3", "pin1on",
    "blueOn", "handGuiding",
)  # fmt: skip
MOTION = ("doPTP", "start", "stDc", "stVel", "handGuiding", "preciseHandGuiding")


class Wire:
    """Stands for a KstTransport: what the server says is known from the start, and then the connection is lost."""

    def __init__(self, answers: bytes) -> None:
        from kst.codec import KstLineSplitter, parse_reply

        self._replies = [parse_reply(line) for line in KstLineSplitter().feed(answers)]
        self.ended_by_peer, self.program = True, "MatlabToolboxServer"
        self.sent: list[str] = []
        self.monotonic = time.monotonic

    def send(self, line: str, timeout: float) -> None:
        """Takes a line."""
        self.sent.append(line)

    def receive(self, deadline: float) -> Any:
        """Returns the next reply."""
        from kst.errors import ConnectionLost

        if not self._replies:
            raise ConnectionLost("the connection was closed")
        return self._replies.pop(0)

    def waiting(self) -> list[Any]:
        """Returns one reply in three: some come before they are asked for."""
        return [self._replies.pop(0)] if len(self._replies) % 3 == 2 else []

    def give_up(self, reason: str) -> None:
        """Ends."""
        from kst.errors import ConnectionLost

        raise ConnectionLost(reason)

    def pause(self, duration: float) -> None:
        """Does not wait."""

    end_writing = reopen = close = abort = lambda self: None


def _conversations() -> st.SearchStrategy[Any]:
    number = st.sampled_from(("0.1", "-1.5", "0.0", "1E-5", "NaN", "Infinity", "-Infinity", "1e999", "nan", "5"))
    numbers = st.sampled_from((3, 6, 7)).flatmap(lambda n: st.lists(number, min_size=n, max_size=n))
    line = numbers.map(lambda texts: "_".join([*texts, "\n"]).encode())
    answer = st.one_of(st.sampled_from(KST_ANSWERS), line, near(KST_ANSWERS, edited_bytes))
    conversation = st.lists(answer, max_size=30).map(b"".join)
    return st.tuples(conversation, st.lists(st.integers(0, 11), min_size=1, max_size=12))


@target(_conversations)
def kst_client(given: Any) -> None:
    """A client whose server says anything: results are finite, and no goal out of range is sent."""
    from kst import codec
    from kst.client import KstClient, KstTiming
    from kst.codec import Feedback, ToolTransform
    from kst.errors import KstError
    from kst.limits import JointLimits
    from kst.session import KstSession

    answers, calls = given
    wire = Wire(answers)
    timing = KstTiming(**{f.name: 0.0 for f in dataclasses.fields(KstTiming) if f.type == "float"}, tries=3)
    session: Any = KstSession(wire, dataclasses.replace(timing, reply=0.01, servo_reply=0.01, silence=0.02))  # type: ignore[arg-type]
    client = KstClient(session, ToolTransform(np.eye(4)), JointLimits([-2.0] * 7, [2.0] * 7))
    q = [0.1] * 7
    acts: tuple[Callable[[], Any], ...] = (
        client.joints, client.external_torques, client.measured_torques, client.pose, client.force, client.moment,
        lambda: client.start_ptp_joints(q, 0.2), client.ptp_arrived, client.start_joint_servo, client.stop_joint_servo,
        lambda: [client.servo(q, feedback) for feedback in Feedback], lambda: client.stream(q) and client.answers(),
    )  # fmt: skip
    for call in calls:
        try:
            result = acts[call]()
        except KstError:
            continue
        if isinstance(result, list):
            result = [value for item in result for value in (item if isinstance(item, tuple) else (item,))]
            result = [value for value in result if isinstance(value, np.ndarray)]
        finite(result, acts[call].__name__)
    assert all(codec.END.line == line or (line.isascii() and "\n" not in line) for line in wire.sent)


def _lines() -> st.SearchStrategy[Any]:
    seeds = [line.encode() for line in KST_LINES]
    line = st.one_of(st.sampled_from(seeds), near(seeds, edited_bytes))
    return st.lists(st.tuples(line, st.sampled_from((0.0, 0.004, 0.05))), min_size=1, max_size=12)


@target(_lines, cost=20.0)
def sunrise_commands(lines: Any) -> None:
    """Lines to the simulated controller: it answers text, and the arm moves only after a start, to finite joints."""
    from rig_simulation.devices.sunrise.application import Application, ControllerIO
    from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
    from rig_simulation.devices.sunrise.java_text import JavaLineSplitter

    arm = SimulatedArm(_robot(), ArmSettings())
    before, application, splitter, now, started = (
        arm.q.copy(),
        Application(arm, ControllerIO()),
        JavaLineSplitter(),
        0.0,
        False,
    )
    for data, pause in lines:
        now += pause
        for line in splitter.feed(data + b"\n"):
            started |= line.startswith(MOTION)
            answer = application.receive(line, now)
            assert answer.isascii()
        assert application.advance(now).isascii()
        finite(arm.q, "the arm's joints")
        assert started or np.array_equal(arm.q, before), "the arm moved without a start"


ROBOT_STARTS = ("doPTP", "startDirectServoJoints", "lrFloat", "lrGuide", "lrResume")
ROBOT_NUMBERS = (0.0, 0.1, -0.5, 1.0, 7.0, 1e-3, 3.2, 100.0, 300.0, 1e308, 1e999, -0.0, math.nan)


def _robot_words() -> st.SearchStrategy[Any]:
    from rig_simulation.devices.sunrise.leap_rig_words import WORDS

    opening = ("lrHello_1_", "lrTool_1_0_0_60_0_0_106_0_0_0_", "startDirectServoJoints", "jRelVel_0.5_")
    numbers = st.lists(st.one_of(st.sampled_from(ROBOT_NUMBERS), st.floats(-4.0, 4.0)), max_size=14)
    made = st.builds(
        lambda word, numbers, right: f"{word.text.rstrip('_')}_{''.join(f'{x}_' for x in numbers[: word.most or 99])}"
        if right else f"{word.text}{numbers}",
        st.sampled_from(WORDS), numbers, st.booleans(),
    )  # fmt: skip
    seeds = [line.encode() for line in (*opening, *KST_LINES)]
    line = st.one_of(st.sampled_from(seeds), made.map(str.encode), near(seeds, edited_bytes))
    happens = st.sampled_from(("", "", "", "second", "push", "enabling", "stop"))
    return st.lists(st.tuples(line, st.sampled_from((0.0, 0.004, 0.15, 0.5)), happens), min_size=1, max_size=14)


@target(_robot_words, cost=30.0)
def robot_application(lines: Any) -> None:
    """Lines to the simulated robot application, whose client then goes: whole lines answer, and an arm that was not
    started stays; afterwards it rests."""
    from rig_simulation.devices.sunrise.application import ControllerIO
    from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
    from rig_simulation.devices.sunrise.java_text import RobotLineSplitter
    from rig_simulation.devices.sunrise.leap_rig import LeapRigApplication

    arm = SimulatedArm(_robot(), ArmSettings())
    application, splitter, now, started = LeapRigApplication(arm, ControllerIO()), RobotLineSplitter(), 0.0, False
    for data, pause, happens in lines:
        for line in splitter.feed(data + b"\n"):
            started |= line.startswith(ROBOT_STARTS)
            said = application.second(line, now) if happens == "second" else application.receive(line, now)
            assert said.isascii() and said.endswith("\n") if said else not said, said
        if happens == "push":
            arm.set_tool_force(np.array([0.0, 40.0 if not arm.tool_force.any() else 0.0, 0.0]))
        elif happens == "enabling":
            arm.enabling = not arm.enabling
        elif happens == "stop":
            application.stop()
        now += pause
        assert application.advance(now).isascii()
        finite(arm.q, "the arm's joints")
        assert started or not arm.q.any(), "the arm moved without a start"
    application.abandon()
    for _ in range(30):
        now += 0.1
        application.advance(now)
    assert not application.busy and not arm.v.any() and not arm.in_servo, (
        "a client that is gone leaves an arm that moves"
    )


_ROBOT: list[Any] = []


def _robot() -> Any:
    if not _ROBOT:
        from rig_simulation.devices.sunrise.robot import Robot
        from rig_simulation.files import read_urdf

        _ROBOT.append(Robot(read_urdf("LBR7R800", "MF_elektrisch")))
    return _ROBOT[0]


# The Leap


def leap_frames() -> list[dict]:
    """Returns frames of the simulated service, both ways of writing, and recorded ones."""
    from leap_motion.service import wire
    from rig_simulation.operator.motion import Script
    from rig_simulation.operator.sources import ScriptedOperator

    frames = []
    for service in ("2.3", "gemini"):
        source = ScriptedOperator(Script(), service=service).frames(np.random.default_rng(0), 1)
        frames += [json.loads(next(source)[1].text(i, 10**6 + i)) for i in range(3)]
    frames.append(json.loads(wire.frame([], 110.0).text(1, 10**6)))

    def few(path: Path) -> list[dict]:
        with gzip.open(path, "rt") as file:
            lines = file.read().splitlines()
        return [json.loads(line) for line in lines[len(lines) // 3 :: len(lines)]]

    return frames + recorded("leap", "*.jsonl.gz", few)


def _leap_texts() -> st.SearchStrategy[Any]:
    events = [
        {"event": {"type": "deviceEvent", "state": {"attached": True, "id": "LP1", "streaming": True, "type": "P"}}},
        {"event": {"type": "deviceConnect", "state": True}}, {"serviceVersion": "2.3.1", "version": 6},
    ]  # fmt: skip
    return near_json(*leap_frames(), *events)


@target(_leap_texts, cost=4.0)
def leap_text(text: Any) -> None:
    """A message of the Leap service to the driver: what passes is finite."""
    from leap_motion.codec import LeapProtocolError, read_header, read_message

    for read in (read_header, read_message):
        try:
            finite(read(text), read.__name__)
        except LeapProtocolError as error:
            assert "\n" not in str(error) and len(str(error)) < 300, "the reason is no sentence"


@target(_leap_texts, ros=True, cost=8.0)
def leap_message(text: Any) -> None:
    """A frame on its way through the driver to the nodes: as bytes and as they read them, by either way."""
    import rospy

    from leap_motion.codec import LeapProtocolError, read_message
    from leap_motion.frames import LeapFrame
    from leap_motion.msg import Human
    from leap_motion.ros.human import FrameMessage
    from leap_motion.ros.tracking import ReceivedHuman, ReceivedSkeletons

    try:
        frame = read_message(text)
    except LeapProtocolError:
        return
    if isinstance(frame, LeapFrame):
        data = FrameMessage(frame, rospy.Time(5)).data
        message = Human().deserialize(data)
        for kind in (ReceivedHuman, ReceivedSkeletons):
            received = kind().deserialize(data)
            assert len(received.hands) == message.right_hand.is_present + message.left_hand.is_present
            finite([vars(hand) if not dataclasses.is_dataclass(hand) else hand for hand in received.hands], "a hand")


def _human_bytes() -> st.SearchStrategy[Any]:
    import rospy

    from leap_motion.codec import read_message
    from leap_motion.ros.human import FrameMessage

    return near_bytes(*(FrameMessage(read_message(json.dumps(f)), rospy.Time(5)).data for f in leap_frames()[2:4]))


@target(_human_bytes, ros=True, cost=4.0)
def human_bytes(data: Any) -> None:
    """Bytes of leap_motion/leap_device of another program, which rospy reports if they are no message."""
    import genpy

    from leap_motion.ros.tracking import ReceivedHuman

    with contextlib.suppress(genpy.DeserializationError):
        assert len(ReceivedHuman().deserialize(data).hands) <= 2


@target(
    lambda: st.tuples(
        near_json({"background": True}, {"focused": True, "optimizeHMD": False}), near_bytes(b"/v6.json", b"/")
    )
)
def leap_service(given: Any) -> None:
    """What a client says to the Leap service of this project."""
    from leap_motion.service import wire
    from leap_motion.service.access import AccessCode, is_own_host

    text, path = given
    for service in ("2.3", "gemini"):
        policies = wire.policies(text, service)
        assert all(isinstance(value, bool) for value in policies.values())
        assert wire.version_of(path.decode("latin-1"), service) in (None, *range(1, 8))
    assert not AccessCode("381927").accepts(text, "10.0.0.5", 0.0)
    is_own_host(text, "10.0.0.5")


def _headset() -> st.SearchStrategy[Any]:
    points = [[round(0.01 * (i % 5) + 0.02 * j, 3) for j in range(3)] for i in range(25)]
    hand = [number for point in points for number in point]
    head = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]
    message = {"t": 1000.0, "place": 0, "head": head, "left": None, "right": hand}
    both = {**message, "left": hand, "t": 1016.0}
    return st.lists(near_trees(message, both), min_size=1, max_size=5)


@target(_headset, cost=8.0)
def headset_messages(messages: Any) -> None:
    """Messages of a headset's page, to the frames that the driver then reads."""
    from leap_motion.codec import read_message
    from leap_motion.headset.hand_stream import HandStream
    from leap_motion.headset.transport import _read
    from leap_motion.service import wire

    stream = HandStream(0.4, 0.3)
    for i, message in enumerate(messages):
        message = _read(json.dumps(message))
        try:
            frame = stream.step(message, 10.0 + 0.016 * i, 0.2, False)
        except ValueError as error:
            assert str(error).startswith(("A message of the page", "The head of a message")), f"its own words: {error}"
            continue
        if frame is not None:
            finite(read_message(wire.frame(list(frame.hands), frame.rate).text(i, 10**6 + i)), "the frame")
        assert not stream.note or stream.note.endswith("."), f"no sentence for a person: {stream.note}"


# The robot hand


def _packets() -> st.SearchStrategy[Any]:
    from rig_simulation.devices.reflex.hand import SimulatedHand

    hand = SimulatedHand()
    return st.lists(near_bytes(hand.packet(), bytes([1, 2, 2, 2, 2]), bytes([2, *[10, 0] * 4])), min_size=1, max_size=4)


@target(_packets)
def reflex_datagrams(packets: Any) -> None:
    """Datagrams to the driver of the hand, and to the simulated hand."""
    from reflex.calibration import DEFAULTS, FingerZeros, TactileOffsets
    from reflex.codec import PacketError, decode_state, is_command
    from reflex.reading import UNLOADED, joint_positions, measure
    from rig_simulation.devices.reflex.hand import SimulatedHand
    from rig_simulation.devices.reflex.wire import read_command

    hand, loads = SimulatedHand(), UNLOADED
    for packet in packets:
        command = read_command(packet)
        if command is not None:
            hand.handle(command)
        hand.step(0.01)
        assert len(hand.packet()) == 202
        is_command(packet)
        try:
            state = decode_state(packet)
        except PacketError:
            continue
        reading = measure(state, DEFAULTS[FingerZeros], DEFAULTS[TactileOffsets], ((30,) * 9,) * 3, loads)
        loads = reading.loads
        finite(reading, "the reading")
        finite(joint_positions(reading), "the joints")


# Parameters and files of yaml


def schemas() -> dict[str, type]:
    """Returns every schema of parameters in the packages by name, as far as they can be imported here."""
    found = {}
    for path in sorted(SRC.glob("**/src/*/**/*.py")):
        if "from common.config import" not in path.read_text() or "tests" in path.parts:
            continue
        module_name = ".".join(path.with_suffix("").parts[len(path.parts) - path.parts[::-1].index("src") :])
        if "ros" in path.parts and "ROS_PACKAGE_PATH" not in os.environ:
            continue
        module = importlib.import_module(module_name)
        for name, item in vars(module).items():
            if isinstance(item, type) and item.__module__ == module_name and dataclasses.is_dataclass(item):
                fields = dataclasses.fields(item)
                if fields and all("kind" in field.metadata for field in fields):
                    found[f"{module_name}.{name}"] = item
    return found


def shipped_values() -> list[dict]:
    """Returns the mappings in the yaml files of the packages' config folders."""
    found = []
    for path in sorted(SRC.glob("**/config/**/*.yaml")):
        values = yaml.safe_load(path.read_text())
        found += [values] if isinstance(values, dict) else []
    return found


def _parameters() -> st.SearchStrategy[Any]:
    seeds, shipped = [], shipped_values()
    for key, schema in schemas().items():
        fields = {field.name: field.metadata["absent"] for field in dataclasses.fields(schema)}
        plain = {name: value for name, value in fields.items() if isinstance(value, (int, float, str, bool))}
        known = [values for values in shipped if len(fields.keys() & values.keys()) > len(fields) // 2]
        for values in known[:2] or [{}]:
            given = {name: value for name, value in values.items() if name in fields}
            seeds.append((key, {**dict.fromkeys(fields, 0.5), **plain, **given}))
    return near(seeds, lambda seed, edits: (seed[0], edited_tree(seed[1], edits)))


_SCHEMAS: dict[str, type] = {}


@target(_parameters, RigError, cost=2.0)
def parameters(given: Any) -> None:
    """Values of every schema of parameters."""
    name, values = given
    if not _SCHEMAS:
        _SCHEMAS.update(schemas())
    finite(parse(_SCHEMAS[name], values, "x/"), name)


def _yaml_files() -> st.SearchStrategy[Any]:
    """Texts of the files that people edit, each for its own reader."""
    simulated = SRC / "modules/rig_simulation/config"
    deviations: dict[str, Any] = {"robot": "LBR7R800", "serial": "1", "date": "2026"}
    deviations.update({f"delta_{name}": [0.0] * 7 for name in ("a", "alpha", "d", "theta")})
    seeds: list[tuple[str, str]] = [
        ("configurations", (SRC / "kuka_control/config/joint_configurations.yaml").read_text()),
        ("obstacles", (simulated / "wall_obstacles.yaml").read_text()),
        ("deviations", yaml.safe_dump(deviations)),
    ]
    seeds += [("scene", path.read_text()) for path in sorted(simulated.glob("scenes/*.yaml"))]
    seeds += [("board", path.read_text()) for path in sorted(simulated.glob("panels/*.yaml"))]
    seeds += [("camera", path.read_text()) for path in sorted((SRC / "vision/config").glob("xtion_*.yaml"))]
    seeds += [("lens", (SRC / "vision/config/xtion_rgb.yaml").read_text())]
    seeds += [("tags", path.read_text()) for path in sorted(SRC.glob("**/config/*tag*.yaml"))]
    seeds += [("hand", text) for text in _hand_calibrations()]
    pose = {"position": [0.0] * 3, "quaternion": [0.0, 0.0, 0.0, 1.0]}
    seeds.append(("calibration", yaml.safe_dump({"views": [], "T_base_camera": pose, "date": "2026-01-01T00:00:00"})))

    def edited(seed: tuple[str, str], edits: list[int]) -> tuple[str, str]:
        kind, text = seed
        if edits[0] % 2:
            return kind, edited_bytes(text.encode(), edits).decode("utf-8", "replace")
        return kind, yaml.dump(edited_tree(yaml.safe_load(text), edits), allow_unicode=True)

    return near(seeds, edited)


def _hand_calibrations() -> list[str]:
    from reflex.calibration import DEFAULTS, FingerZeros, TactileOffsets, calibration_text

    return [calibration_text(DEFAULTS[kind]) for kind in (FingerZeros, TactileOffsets)]


def _read_file(kind: str, text: str) -> Any:
    """Returns what the reader of this kind of file makes of its text."""
    from common.camera_model import from_calibration
    from common.ros.files import read_yaml
    from iiwa_kinematics.robot_model import robot_model

    arm = robot_model("LBR7R800", "MF_elektrisch")
    if kind == "hand":
        from reflex.calibration import FingerZeros, TactileOffsets, parse_calibration

        return [parse_calibration(record, text, "the file") for record in (FingerZeros, TactileOffsets)]
    with _file(text.encode("utf-8", "surrogatepass"), "x.yaml") as path:
        values: Any = read_yaml(path)
    if kind == "configurations":
        from kuka_control.model.joint_configurations import named_configurations

        return named_configurations(values, arm)
    if kind == "obstacles":
        from kuka_control.model.obstacles import obstacles_from

        return obstacles_from(values, arm.wrist_flange)
    if kind == "deviations":
        from kuka_control.model.config import DhDeviations

        return parse(DhDeviations, values)
    if kind in ("scene", "board"):
        from rig_simulation.world.scene import board_from, scene_from

        return (scene_from if kind == "scene" else board_from)(values)
    if kind == "calibration":
        from vision.calibration.record import record_from_mapping

        return record_from_mapping(values)
    if kind == "tags":
        from apriltag_ros.settings import detector_settings, targets

        return (detector_settings if isinstance(values, dict) and "tag_family" in values else targets)(values)
    if kind == "lens":
        from leap_motion.webcam.lens import lens_of_calibration

        return lens_of_calibration(values)
    return from_calibration(values)


@target(_yaml_files, RigError, cost=6.0)
def yaml_files(given: Any) -> None:
    """A file that a person edits: what passes is finite."""
    from leap_motion.webcam.lens import WebcamError
    from reflex.errors import CalibrationFileError

    with contextlib.suppress(CalibrationFileError, WebcamError):
        finite(_read_file(*given), given[0])


@target(lambda: near_trees({"date": "2026-01-31T12:00:00", "serial": "LP1", "position": [0.0, 0.0, 0.1],
                            "quaternion": [0.0, 0.0, 0.0, 1.0], "residual_mm": 1.0}).map(yaml.safe_dump),
        RigError, ros=True, cost=6.0)  # fmt: skip
def user_files(text: Any) -> None:
    """The files in a person's home: where the tracker stands."""
    from leap_motion.ros import registrations

    with _file(text.encode("utf-8", "surrogatepass"), "x.yaml") as path, mock.patch.object(
        registrations, "registration_file", lambda name: path
    ):
        finite(registrations.load("x", datetime(2026, 2, 1).timestamp()).T_desk_leap)


class _file:
    """A file with this content for the time of a `with`."""

    def __init__(self, content: bytes, name: str) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="fuzz")
        self._path = Path(self._folder.name) / name
        self._path.write_bytes(content)

    def __enter__(self) -> Path:
        return self._path

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()


# Weights, episodes, recordings


def _weights() -> st.SearchStrategy[Any]:
    import torch

    from grasping.network.networks import NETWORKS

    buffer = io.BytesIO()
    torch.save(NETWORKS["ggcnn"]().state_dict(), buffer)
    seeds = [buffer.getvalue(), *recorded("ggcnn", "*.hdf5", lambda path: [path.read_bytes()])]
    return near(seeds, edited_bytes)


@target(_weights, cost=100.0)
def weight_files(data: Any) -> None:
    """Weight files of the networks, torch and Keras: they are read or refused."""
    import torch

    from grasping.network import weights
    from grasping.poses import taste_file

    for load in (weights.load, taste_file.load):
        try:
            network = load(data)[0]
        except weights.WeightsError:
            continue
        if isinstance(network, torch.nn.Module):
            assert all(torch.isfinite(value).all() for value in network.state_dict().values())


def _archives() -> st.SearchStrategy[Any]:
    seed = _episode()
    with zipfile.ZipFile(io.BytesIO(seed)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}

    def inside(which: int, edits: list[int]) -> bytes:
        """Returns the archive with one file edited and checksums that are right."""
        name = sorted(files)[which % len(files)]
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            for other, data in files.items():
                head = edited_bytes(data[:300], edits) + data[300:] if other == name else data
                archive.writestr(other, head)
        return stream.getvalue()

    return st.one_of(near_bytes(seed), st.builds(inside, st.integers(0, 99), EDITS))


def _episode() -> bytes:
    from grasping.lab.dataset import store

    sys.path.append(str(SRC / "grasping/tests"))
    from episodes import episode  # the tests' own

    return store.encode(episode())


@target(_archives, RigError, cost=20.0)
def episodes(data: Any) -> None:
    """Files of episodes."""
    from grasping.lab.dataset import store

    found = store.decode(data)
    finite(found.T_base_grasp, "the grasp")


def _recordings() -> st.SearchStrategy[Any]:
    frames = leap_frames()
    lines = [json.dumps(frame) for frame in frames]
    text = "\n".join(lines[:4]).encode()
    edited = st.lists(near_json(*frames), max_size=3).map(lambda more: "\n".join(more).encode("utf-8", "surrogatepass"))
    return st.one_of(near_bytes(text), edited, near_bytes(gzip.compress(text)))


@target(_recordings, RigError, cost=10.0)
def recordings(data: Any) -> None:
    """Recordings of hands, packed or not, to the frames that are played."""
    from rig_simulation.operator.sources import Playback, Recording

    with _file(data, "frames.jsonl.gz" if data[:2] == b"\x1f\x8b" else "frames.jsonl") as path:
        playback = Playback(Recording(path, loop=True))
        for _ in range(3):
            json.loads(playback.next().text, parse_constant=_refuse)


def _refuse(token: str) -> None:
    raise AssertionError(f"{token} was written")


def _runs() -> st.SearchStrategy[Any]:
    """Recordings of a run, as MCAP files: bytes edited anywhere, within a chunk, or within a message or its type."""
    import zlib

    import zstandard
    from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
    from mcap.data_stream import RecordBuilder
    from mcap.records import Channel, Chunk, Header, Message, Schema
    from std_msgs.msg import Header as RosHeader
    from tf2_msgs.msg import TFMessage

    from common.frames import BASE, TOOL_DESIRED
    from kuka_msgs.msg import jointPositions
    from leap_motion.msg import RawFrame
    from leap_rig.recording import topics
    from reflex_msgs.msg import Hand, RadianServoCommands
    from rig_msgs.msg import SentGoals

    pose = Transform(Vector3(0.1, 0.2, 0.3), Quaternion(0.0, 0.0, 0.0, 1.0))
    examples = (
        (topics.RAW_FRAMES, RawFrame()), (topics.SENT_GOALS, SentGoals()), (topics.JOINTS, jointPositions()),
        (topics.HAND_STATE, Hand()), (topics.HAND_COMMAND, RadianServoCommands()),
        (topics.TF, TFMessage([TransformStamped(RosHeader(frame_id=BASE), TOOL_DESIRED, pose)])),
    )  # fmt: skip
    seeds = []
    for topic, message in examples:
        buffer = io.BytesIO()
        message.serialize(buffer)
        seeds.append((topic, message._type, message._full_text, buffer.getvalue()))

    def chunk(records: Sequence[tuple[str, str, str, bytes]]) -> bytes:
        builder = RecordBuilder()
        for i, (topic, kind, text, data) in enumerate(records, 1):
            Schema(data=text.encode("utf-8", "replace"), encoding="ros1msg", id=i, name=kind).write(builder)
            Channel(id=i, topic=topic, message_encoding="ros1", metadata={}, schema_id=i).write(builder)
            Message(channel_id=i, log_time=10**9 * i, data=data, publish_time=0, sequence=0).write(builder)
        return builder.end()

    def file(content: bytes) -> bytes:
        builder = RecordBuilder()
        Header(profile="ros1", library="").write(builder)
        Chunk("zstd", zstandard.compress(content), 0, 0, zlib.crc32(content), len(content)).write(builder)
        return b"\x89MCAP0\r\n" + builder.end()

    def in_a_message(which: int, edits: list[int]) -> bytes:
        records = list(seeds)
        topic, kind, text, data = records[which]
        if edits[0] % 2:
            data = edited_bytes(data, edits)
        else:
            text = edited_bytes(text.encode(), edits).decode("utf-8", "replace")
        records[which] = topic, kind, text, data
        return file(chunk(records))

    whole = chunk(seeds)
    return st.one_of(
        near_bytes(file(whole)),
        EDITS.map(lambda edits: file(edited_bytes(whole, edits))),
        st.builds(in_a_message, st.integers(0, len(seeds) - 1), EDITS),
    )


@target(_runs, RigError, ros=True, cost=6.0)
def runs(data: Any) -> None:
    """Files of a recorded run: they are read up to where they are whole, or refused in a sentence."""
    import hashlib

    from leap_rig.recording import read
    from leap_rig.recording.recording_files import FORMAT, MANIFEST, MESSAGES, VERSION

    with _file(data, MESSAGES) as path:
        files = {MESSAGES: hashlib.sha256(data).hexdigest()}
        manifest = {"format": FORMAT, "version": VERSION, "complete": True, "files": files}
        (path.parent / MANIFEST).write_text(json.dumps(manifest))
        run = read(path.parent)
    assert len(run.goals) == len(run.goal_times) == len(run.goal_velocities)
    assert run.desired.shape[1:] == (4, 4) and len(run.desired) == len(run.desired_times)
    finite(run.desired, "a desired tool")
    finite((run.frame_times, run.desired_times, run.goal_times, run.joint_times, run.hand_times), "a time")
    for text in run.frames:
        text.encode("utf-8", "surrogateescape")


def _requests() -> st.SearchStrategy[Any]:
    seeds: list[dict] = [
        {"do": "fault", "name": "slow", "on": True, "value": 0.3, "duration": 2}, {"do": "faults"},
        {"do": "state"}, {"do": "set", "value": [0.0] * 7},
    ]  # fmt: skip
    return near_json(*seeds).map(lambda text: text.encode("utf-8", "surrogatepass"))


@target(_requests)
def control_port(line: Any) -> None:
    """Lines to a control port with the faults of every device: each has an answer in JSON."""
    answer = json.loads(_port()._answer(line), parse_constant=_refuse)
    assert isinstance(answer.pop("ok"), bool)
    assert "failed:" not in answer.get("error", ""), answer


_PORT: list[Any] = []


def _port() -> Any:
    """Returns a control port that is not on the network."""
    if not _PORT:
        from rig_simulation.control_port import ControlPort
        from rig_simulation.devices.sunrise.server import _numbers
        from rig_simulation.faults.arm import ARM_FAULTS
        from rig_simulation.faults.injection import Faults

        state = {"q": [0.0] * 7}
        handlers = {"state": lambda: state, "set": lambda value: {"value": _numbers(value, 7).tolist()}}
        port = ControlPort({**Faults(ARM_FAULTS).requests, **handlers})
        port.close()
        _PORT.append(port)
    return _PORT[0]


# Messages as bytes


def _tf_bytes() -> st.SearchStrategy[Any]:
    import rospy
    from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
    from std_msgs.msg import Header
    from tf2_msgs.msg import TFMessage

    transform = Transform(Vector3(0.1, 0.2, 0.3), Quaternion(0.0, 0.0, 0.0, 1.0))
    buffer = io.BytesIO()
    stamped = [TransformStamped(Header(0, rospy.Time(5), "/a"), name, transform) for name in ("b", "/ü")]
    TFMessage(stamped).serialize(buffer)
    return near_bytes(buffer.getvalue())


@target(_tf_bytes, ros=True)
def tf_bytes(data: Any) -> None:
    """Bytes on /tf to the controller, which reads them itself."""
    import struct

    from common.ros.raw_tf import RawTfMessage

    with contextlib.suppress(struct.error, UnicodeDecodeError):
        assert len(list(RawTfMessage().deserialize(data).raw_transforms())) <= len(data)
