"""The program replay.py: in RViz nothing can move, and the tracker's texts come back as they were."""

import json
from dataclasses import replace

import numpy as np
import pytest
from recordings import START, stored, write_recording

from common import clock
from common.errors import RigError
from leap_rig.recording import read
from leap_rig.recording.fingerprint import fingerprint
from leap_rig.recording.recording_files import RecordingFault
from leap_rig.recording.topics import DRIVING

pytest.importorskip("rig_msgs.srv")
from types import SimpleNamespace

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header, String
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE, VIRTUAL_LEAP
from common.ros.conversions import stamped_transform
from common.ros.files import file_hash
from kuka_control.ros.parameter_server import read_yaml, shipped
from kuka_msgs.msg import MoveActionGoal
from leap_motion.msg import RawFrame
from leap_rig.recording.recording_files import MessageKind, StoredMessage
from leap_rig.recording.ros import replay_program
from leap_rig.recording.ros.replay_program import (
    _at_pace,
    _describe,
    _harmless,
    _move_goals,
    _Player,
    _refuse_movers,
    _service,
    move,
)
from leap_rig.recording.waypoints import StreamedMotion
from reflex_msgs.msg import RadianServoCommands

pytestmark = pytest.mark.ros


def transforms(seconds, *frames):
    stamp = rospy.Time(0, START + round(1e9 * seconds))
    return TFMessage([stamped_transform(np.eye(4), *pair, stamp) for pair in frames])


@pytest.fixture
def session(tmp_path):
    """A recording of 60 s with tf, a latched marker, a hand command, a goal and a desired tool."""
    desired = (BASE, VIRTUAL_LEAP), *((VIRTUAL_LEAP, frame) for frame in DRIVING)
    other = stored("/operator_view/markers", String(""), 0.0)
    messages = [
        stored("/tf_static", transforms(0.0, (BASE, "a")), 0.0, True),
        stored("/tf_static", transforms(0.0, (BASE, "b")), 0.0, True),
        stored("/kuka/workspace", MarkerArray([Marker(ns="workspace")]), 0.0, True),
        replace(other, kind=replace(other.kind, md5sum="of another version")),
    ]
    for i in range(300):
        messages += [
            stored("/tf", transforms(0.2 * i, *desired), 0.2 * i),
            stored("/reflex_takktile/radian_hand_command", RadianServoCommands(), 0.2 * i),
            stored("/kuka/move/goal", MoveActionGoal(), 0.2 * i),
        ]
    return write_recording(tmp_path / "run", messages, b"robot_description: <robot/>\n", name="run")


def test_a_view_moves_nothing_and_ends_when_a_controller_starts(ros, session):
    """Reported in https://github.com/ros/ros_comm/issues/706, https://github.com/ros-visualization/rqt_bag/issues/11:
    latched topics are missing in the middle of a bag. Tried: a replay from the middle.
    """
    tf, static = ros.record("/tf", TFMessage), ros.record("/tf_static", TFMessage)
    markers = ros.record("/kuka/workspace", MarkerArray)
    begin = rospy.Time.now()
    program = ros.run("leap_rig", "replay.py", str(session), "--view")
    clock.sleep(2.51)
    assert 11 <= len(tf) <= 12  # of 5 Hz; the first one goes before the connections are there
    assert markers and {t.child_frame_id for t in static[-1].transforms} == {"a", "b"}, "what two nodes latched"
    children = {t.child_frame_id for message in tf for t in message.transforms}
    assert children == {VIRTUAL_LEAP, *(f"recorded/{frame}" for frame in DRIVING)}
    parents = {t.header.frame_id for message in tf for t in message.transforms}
    assert not parents & set(DRIVING)
    stamps = [t.header.stamp for message in tf for t in message.transforms]
    assert all(begin <= stamp <= rospy.Time.now() for stamp in stamps)
    assert {each.name for each in ros.publishers if each.node is program} == {"/tf", "/tf_static", "/kuka/workspace"}
    assert rospy.get_param("robot_description") == "<robot/>"
    rospy.Service("kuka/exit_app", Empty, lambda _: None)
    assert program.wait(0.5 + 0.2) == 1  # it looks where it plays a message
    assert "/test runs on this ROS master" in program.log and "left out" in program.log
    again = ros.run("leap_rig", "replay.py", str(session), "--view")
    assert again.wait(0.1) == 1
    assert len({message._connection_header["callerid"] for message in tf}) == 1, "of the first one alone"


@pytest.fixture
def service(monkeypatch):
    """Stands in place of the Leap service: what is offered, and when."""

    class Service:
        port, clients, sent, lost = 6437, 0, 0, 0

        def __init__(self, *given, simulated):
            self.given, self.simulated = given, simulated
            self.offered, self._stopped = [], clock.Event()
            self.stop, self.run = self._stopped.set, self._stopped.wait
            made.append(self)

        def offer(self, text):
            self.offered.append((text, clock.monotonic()))

    made = []
    monkeypatch.setattr(replay_program, "LeapService", Service)
    return made


@pytest.fixture
def frames(tmp_path):
    """The texts of 3 s, and the folder of their recording."""
    texts = [f'{{"id":{i},  "timestamp":{9000 * i},"hands":[],"pointables":[],"x":"é"}}' for i in range(300)]
    known = [KeyValue("service_version", "2.3.1"), KeyValue("serial", "LP1")]
    status = DiagnosticArray(status=[DiagnosticStatus(name="leap_motion", values=known)])
    messages = [stored("/diagnostics", status, 0.0)]
    for i, text in enumerate(texts):
        frame = RawFrame(rospy.Time(0, START + 10**7 * i), text)
        messages.append(stored("/leap_motion/raw_frames", frame, 0.01 * i + 0.001))
    return texts, write_recording(tmp_path / "run", messages, name="run")


@pytest.mark.parametrize("rate", [0.5, 1.0])
def test_the_tracker_sends_what_was_recorded_at_its_pace(ros, service, frames, rate):
    texts, folder = frames
    run = read(folder, 0.2, 2.8)
    assert run.frames == tuple(texts[20:280]) and run.frame_times[0] == pytest.approx(1e-9 * START + 0.2, abs=1e-6)
    program = ros.run(
        "leap_rig", "replay.py", str(folder), "--tracker", "--port", "7000", "--from", "0.2", "--to", "2.8",
        "--rate", str(rate),
    )  # fmt: skip
    clock.sleep(1.0)
    assert service[0].given == ("127.0.0.1", 7000, "2.3", "2.3.1", "LP1") and not service[0].offered
    assert service[0].simulated, "a recording is no real tracker"
    service[0].clients, connected = 1, clock.monotonic()
    assert program.wait(10.0) == 0, program.log
    sent, times = zip(*service[0].offered)
    if rate == 1.0:
        assert sent == tuple(texts[20:280])
    else:
        assert [json.loads(text)["timestamp"] for text in sent] == [18000 * number for number in range(20, 280)]
    assert 0.5 <= times[0] - connected <= 0.5 + 0.05
    np.testing.assert_allclose(np.array(times) - times[0], 0.01 * np.arange(260) / rate, atol=1e-6)
    assert clock.monotonic() == pytest.approx(times[-1] + 0.5)


def test_a_tracker_to_which_nobody_connects_ends_in_a_sentence(ros, service, frames):
    begun = clock.monotonic()
    program = ros.run("leap_rig", "replay.py", str(frames[1]), "--tracker")
    assert program.wait(100.0) == 1
    assert clock.monotonic() - begun == pytest.approx(60.0, abs=0.06)
    assert "Nobody connected to port 6437 within 60 s." in program.log and "Traceback" not in program.log


def test_another_robot_is_refused_with_what_differs(ros, tmp_path):
    values = dict(read_yaml(shipped("kuka_params_rt.yaml")))
    recorded = fingerprint({**values, "robot": "LBR14R820", "tool_length": 0.2}, str)
    folder = write_recording(tmp_path / "run", [], name="run", robot=recorded)
    rospy.set_param("kuka", values)
    program = ros.run("leap_rig", "replay.py", str(folder), "--robot")
    assert program.wait(1.0) == 1 and "no controller of the arm has started" in program.log
    rospy.set_param("kuka/running", {"parameters": values, "files": {}, "started": 1.0})
    program = ros.run("leap_rig", "replay.py", str(folder), "--robot")
    assert program.wait(1.0) == 1
    text = program.log
    assert "Nothing moves" in text and "LBR14R820" in text and "tool_length was 0.2" in text


def test_what_the_controller_started_with_counts_and_not_what_is_set_since(ros, tmp_path):
    values = read_yaml(shipped("kuka_params_rt.yaml"))
    obstacles = tmp_path / "obstacles.yaml"
    obstacles.write_text("[]")
    started = {**values, "tcp_speed": 0.3, "guard_obstacles": str(obstacles)}
    rospy.set_param("kuka", {**values, "guard_obstacles": str(obstacles)})
    rospy.set_param(
        "kuka/running", {"parameters": started, "files": {"guard_obstacles": file_hash(obstacles)}, "started": 1.0}
    )
    recorded = fingerprint(rospy.get_param("kuka"), file_hash)
    folder = write_recording(tmp_path / "run", [], name="run", robot=recorded)
    program = ros.run("leap_rig", "replay.py", str(folder), "--robot")
    assert program.wait(1.0) == 1
    assert f"tcp_speed was {values['tcp_speed']} when it was recorded, and is 0.3 here" in program.log
    obstacles.write_text("[ ]")
    program = ros.run("leap_rig", "replay.py", str(folder), "--robot")
    assert program.wait(1.0) == 1 and "was changed after the controller read it" in program.log


def test_a_changed_recording_is_refused(ros, session):
    file = session / "messages.mcap"
    file.write_bytes(file.read_bytes()[:-1])
    program = ros.run("leap_rig", "replay.py", str(session), "--tracker", "--port", "0")
    assert program.wait(1.0) == 1 and "was changed" in program.log


def test_a_name_in_a_recording_imports_nothing(ros, tmp_path, capsys, monkeypatch):
    (tmp_path / "harmful.py").write_text("raise SystemExit('imported')")
    monkeypatch.syspath_prepend(str(tmp_path))
    good = stored("/kuka/workspace", String("x"), 0.0)
    player = _Player(1.0)
    for i, name in enumerate(("harmful/msg", "String", "a/b/c", "", "../harmful/x", "harmful.msg/x")):
        player.publish(replace(good, topic=f"/t{i}", kind=replace(good.kind, name=name)))
    assert capsys.readouterr().err.count("left out") == 6
    player.publish(replace(good, topic="/torn", data=good.data[:3]))
    player.publish(replace(stored("/tf", TFMessage(), 0.0), topic="/torn tf", data=b"\xff" * 9))
    assert capsys.readouterr().err.count("left out") == 2
    assert not rospy.is_shutdown()


def test_a_stamp_from_another_age_ends_no_view(ros, capsys):
    for rate in (0.1, 10.0):
        player = _Player(rate)
        for seconds in (1_700_000_000, 1, 2**32 - 1):
            header = Header(0, rospy.Time(seconds), "")
            player._restamp(header)
            assert 0 <= header.stamp.to_sec() < 2**32


OF_TWO_ARMS = [f"{arm}{frame}" for arm in ("", "left/", "right/", "lab/left/") for frame in DRIVING]


@pytest.mark.parametrize("before", ["", "/", "//"])
@pytest.mark.parametrize("frame", OF_TWO_ARMS)
def test_no_spelling_of_a_frame_that_steers_is_published(frame, before):
    assert _harmless(before + frame) == f"recorded/{frame}"


@pytest.mark.parametrize("frame", ["kuka/tool_frame/home", "left/kuka/link_1", "left_hand/frame", "my_hand/frame"])
def test_frames_that_steer_nothing_keep_their_names(frame):
    assert _harmless(frame) == frame


@pytest.mark.parametrize("name", [f"{arm}{name}" for arm in ("", "/left") for name in replay_program.MOVERS])
def test_no_view_beside_an_arm_of_any_namespace(name):
    master = SimpleNamespace(getSystemState=lambda: ([], [], [[name, ["/someone"]]]))
    with pytest.raises(RecordingFault, match="/someone runs on this ROS master"):
        _refuse_movers(master)


@pytest.mark.parametrize("time", ["1e999", "-1e999", "NaN", "9" * 400, "true", "null", '"1"', "[]"])
def test_a_frame_whose_time_is_none_is_sent_as_it_is(time):
    text = f'{{"timestamp":{time}, "hands":[]}}'
    assert _at_pace(text, 0.5) == text


def test_receive_times_that_jump_hold_no_replay_up(monkeypatch):
    fake = SimpleNamespace(now=0.0)
    sent = []

    def sleep(seconds):
        assert 0.0 <= seconds <= replay_program.LONGEST_WAIT_S / 0.5
        fake.now += seconds

    monkeypatch.setattr(replay_program, "clock", SimpleNamespace(monotonic=lambda: fake.now, sleep=sleep))
    times = np.array([0.0, 9e9, 0.0, 0.1, 0.2, -10.0, -9.9])
    run = SimpleNamespace(frames=("a",) * len(times), frame_times=times)
    replay_program._send(run, SimpleNamespace(offer=lambda text: sent.append(fake.now)), 0.5)
    longest = replay_program.LONGEST_WAIT_S / 0.5
    np.testing.assert_allclose(np.diff(sent), [longest, 0.0, 0.2, 0.2, 0.0, 0.2], atol=1e-6)


def test_the_first_pass_is_slow_also_to_where_a_stream_begins():
    poses = np.array([np.eye(4)] * 2)
    poses[1, 0, 3] = 0.1
    motion = StreamedMotion(np.zeros(7), np.array([0.0, 1.0]), poses)
    for rate, usual, expected in ((0.2, 0.15, 0.03), (1.0, 0.15, 0.15), (0.1, 0.05, 0.01), (0.2, 0.005, 0.005)):
        ptp, line = _move_goals(motion, rate, 0.25, usual)
        assert ptp.velocity == pytest.approx(expected) and line.velocity == pytest.approx(0.1 * rate)


def test_a_recording_without_all_its_goals_moves_no_robot(tmp_path):
    manifest = {"robot": {"model": {"robot": "x"}}, "dropped": {"/kuka/sent_goals": 7, "/tf": 1}}
    with pytest.raises(RecordingFault, match="7 messages"):
        move(tmp_path, manifest, None)


def test_a_view_of_a_time_without_messages_says_so(ros, session, monkeypatch):
    monkeypatch.setattr(replay_program.rospy, "init_node", lambda *_, **__: None)
    options = replay_program._parser().parse_args([str(session), "--view", "--from", "100"])
    with pytest.raises(RecordingFault, match="nothing that RViz draws from 100"):
        replay_program.view(session, options)


def test_a_view_whose_master_is_gone_ends_in_a_sentence():
    class Gone:
        def getSystemState(self):
            raise ConnectionRefusedError(111, "Connection refused")

    with pytest.raises(RecordingFault, match="ROS master is gone"):
        _refuse_movers(Gone())


@pytest.mark.parametrize("content", [None, b"\xff", b"a: [", b"{a: " * 999, b"!!python/object:os.x {}"])
def test_parameters_that_cannot_be_read_end_a_view_in_a_sentence(ros, tmp_path, content):
    if content is not None:
        (tmp_path / "parameters.yaml").write_bytes(content)
    with pytest.raises(RigError, match="parameters.yaml"):
        _describe(tmp_path)


@pytest.mark.parametrize("definition", ["bool x\n", "string[] status\n", "a/S[] status\n===\nMSG: a/S\nbool name\n"])
def test_diagnostics_of_another_kind_end_no_replay(tmp_path, definition):
    message = StoredMessage("/diagnostics", MessageKind("a/b", definition), START, b"\1\0\0\0\0\0\0\0"[:8])
    with pytest.raises(RigError):
        _service(write_recording(tmp_path / "run", [message]))
