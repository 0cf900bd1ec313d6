"""The program record_episodes.py: services and the cockpit's marks make recordings with labels, and what is latched is
in each of them."""

import gc
import itertools
import json
import signal
import threading
import tracemalloc
from collections import Counter
from pathlib import Path

import pytest

from common import clock
from leap_rig.recording.recording_files import MessageKind, messages, verify
from leap_rig.recording.session import (
    DISCARDED,
    FAILURE,
    SUCCESS,
    UNFINISHED,
    chosen,
    episode_folder,
    episode_folders,
    read_label,
)

pytest.importorskip("rig_msgs.srv")
from types import SimpleNamespace

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Pose, Quaternion
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger, TriggerResponse

from common.ros.service_calls import call
from leap_motion.msg import Hand, Human
from leap_rig.operator.cues import Beep
from leap_rig.operator.ros.speaker import Speaker
from leap_rig.recording.ros import record_program
from leap_rig.recording.ros.record_program import Inbox
from rig_msgs.msg import ObjectState, ObjectStates

pytestmark = pytest.mark.ros
HEARD = []
LATE_S = 0.2
"""What a mark may take: a look at what waits, and connections."""


@pytest.fixture
def ros(virtual_graph, monkeypatch):
    git = SimpleNamespace(run=lambda *_, **__: SimpleNamespace(stdout="abc"), TimeoutExpired=TimeoutError)
    monkeypatch.setattr(record_program, "subprocess", git)
    monkeypatch.setattr(Speaker, "play", lambda _, sound: HEARD.append(sound))
    HEARD.clear()
    return virtual_graph


@pytest.fixture
def program(ros, tmp_path):
    latched = rospy.Publisher("kuka/mode", String, latch=True, queue_size=1)
    latched.publish("servo")
    started = ros.run(
        *("leap_rig", "record_episodes.py", f"{tmp_path}/session", "--task", "lift the cup", "--operator", "7"),
        *("--countdown", "2", "--success", "lifted", "--reset", "--gesture", "left", "--longest", "60"),
    )
    clock.sleep(LATE_S)
    yield started
    started.send_signal(signal.SIGINT)
    assert started.wait(1.0) == 0, started.log


@pytest.fixture
def objects(ros):
    """Publishes where the cup is."""
    publisher = rospy.Publisher("simulation/object_states", ObjectStates, queue_size=10)

    def publish(clearance, touches):
        message = ObjectStates()
        where = Pose(Point(0.5, 0.0, 0.1), Quaternion(0.0, 0.0, 0.0, 1.0))
        message.objects = [ObjectState("cup", where, clearance, 0.0, touches)]
        publisher.publish(message)

    return publish


def mark(name):
    answer = call(f"episodes/{name}", Trigger, timeout=5.0, wait=5.0)
    clock.sleep(LATE_S)
    return answer.success, answer.message


def topics_of(folder):
    return [message.topic for message in messages(folder / "messages.mcap")]


def test_an_episode_is_a_recording_with_a_label(program, objects, ros, tmp_path):
    resets = []
    rospy.Service("simulation/reset", Trigger, lambda _: resets.append(1) or TriggerResponse(True, ""))
    goals = rospy.Publisher("kuka/gripper_control", Bool, queue_size=10)
    state = ros.record("episodes/state", DiagnosticStatus)
    session = tmp_path / "session"
    assert mark("success") == (False, "There is no episode yet; begin one.")
    assert mark("begin") == (True, "Begins in 2 s.")
    goals.publish(True)  # before the episode
    clock.sleep(2.0)
    assert resets == [1]
    (first,) = episode_folders(session)
    assert read_label(first).outcome == UNFINISHED, "what a killed recorder would leave"
    for _ in range(5):
        goals.publish(True)
        objects(0.06, ["reflex/distal_1"])
        clock.sleep(0.1)
    clock.sleep(0.5)
    assert topics_of(first).count("/kuka/gripper_control") == 5, "on the disk while it runs"
    assert mark("begin")[0] is False
    assert mark("success") == (True, "Episode 0 has ended: success.")
    goals.publish(True)  # after the episode
    clock.sleep(LATE_S)
    assert HEARD == [Beep.COUNT, Beep.COUNT, Beep.BEGIN, Beep.END]
    label = read_label(first)
    assert (label.said, label.measured, label.task, label.operator) == (SUCCESS, SUCCESS, "lift the cup", "7")
    assert "cup is in the hand" in label.why
    manifest, remark = verify(first)
    assert not remark and manifest["task"] == "lift the cup" and manifest["ended_by"] == "success"
    found = topics_of(first)
    assert found.count("/kuka/gripper_control") == 5 and found.count("/kuka/mode") == 1
    assert found.count("/simulation/object_states") == 5
    assert mark("failure") == (True, "Episode 0 is labelled failure.")
    assert read_label(first).outcome == FAILURE and verify(first)[0] == manifest
    assert state[-1].message == "Episode 0 is labelled failure."
    assert {v.key: v.value for v in state[-1].values} == {"episode": "1", "running": "False", "failure": "1"}


def test_a_second_episode_has_what_was_latched_before_the_first_and_is_judged_by_itself(program, objects, tmp_path):
    for number in range(2):
        assert mark("begin")[0]
        clock.sleep(2.0)
        if number == 0:
            objects(0.06, ["reflex/distal_1"])
        assert mark("failure")[0]
    session = tmp_path / "session"
    assert [read_label(folder).measured for folder in episode_folders(session)] == [SUCCESS, ""]
    assert [topics_of(episode_folder(session, i)).count("/kuka/mode") for i in range(2)] == [1, 1]
    assert "The objects stay where they are" in program.log, "nothing resets this world"


def test_what_waits_from_before_an_episode_is_not_in_it():
    inbox, kind = Inbox(), MessageKind("a/B", "", is_latched=True)
    inbox.put("/a", MessageKind("a/B", ""), b"1")
    for origin, data in (("/one", b"2"), ("/other", b"3"), ("/one", b"4")):
        inbox.put("/b", kind, data, origin)
    before = inbox.now
    latched = inbox.take_latched()
    assert sorted(one.data for one in latched) == [b"3", b"4"] and all(one.received >= before for one in latched)
    assert inbox.take() == [] and not inbox.received


def test_a_discarded_episode_stays_but_is_not_chosen(program, tmp_path):
    assert mark("begin")[0]
    clock.sleep(2.0)
    assert mark("again") == (True, "Episode 0 has ended: discarded.")
    clock.sleep(2.0)
    assert mark("success") == (True, "Episode 1 has ended: success.")
    session = tmp_path / "session"
    assert chosen(session) == [episode_folder(session, 1)] and len(episode_folders(session)) == 2


def test_a_hundred_episodes_leave_nothing_behind(program, objects, tmp_path):
    """The first twenty fill caches."""
    rospy.Service("simulation/reset", Trigger, lambda _: TriggerResponse(True, ""))
    rows, folder = rospy.Publisher("operator_view/rows", String, queue_size=10), Path("/proc/self/fd")

    def record(count):
        runs = False
        for ending in itertools.islice(itertools.cycle(("again", "success", "discard", "failure")), count):
            assert runs or mark("begin")[0]
            clock.sleep(2.0)
            for _ in range(10):
                objects(0.06, ["reflex/distal_1"])
                rows.publish("x" * 5000)
                clock.sleep(0.01)
            assert mark(ending)[0]
            runs = ending == "again"
        return threading.active_count(), len(list(folder.iterdir()))

    before = record(20)
    gc.collect()
    tracemalloc.start()
    try:
        assert record(80) == before, "threads, open files"
        gc.collect()
        kept = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    print(f"kept of 80 episodes: {kept / 1000:.0f} kB")
    assert kept < 80 * 5000, "an episode's messages have 50 kB"
    session = tmp_path / "session"
    outcomes = Counter(read_label(one).outcome for one in episode_folders(session))
    assert outcomes == {SUCCESS: 25, FAILURE: 25, DISCARDED: 50}
    assert [topics_of(one).count("/operator_view/rows") for one in episode_folders(session)] == [10] * 100


def test_the_cockpit_and_a_fist_of_the_second_hand_mark_too(program, ros, tmp_path):
    marks = rospy.Publisher("cockpit/episode_mark", String, queue_size=10)
    hands = rospy.Publisher("leap_motion/leap_device", Human, queue_size=10)
    clock.sleep(LATE_S)
    marks.publish(json.dumps({"mark": "begin", "text": "a note"}))
    clock.sleep(LATE_S + 2.0)
    for grab in [0.0] * 3 + [1.0] * 12:
        message = Human(right_hand=Hand(is_present=True), left_hand=Hand(is_present=True, grab_strength=grab))
        hands.publish(message)
        clock.sleep(0.1)
    clock.sleep(LATE_S)
    label = read_label(episode_folder(tmp_path / "session", 0))
    assert label.said == SUCCESS and label.note == "a note"
    for text, said in (
        ("nonsense", "The cockpit's mark is 'nonsense'"),
        ('{"mark": 5, "text": ""}', "The mark is '5'"),
    ):
        marks.publish(text)
        clock.sleep(LATE_S)
        assert said in program.log


def test_the_end_of_the_session_ends_its_episode_without_an_outcome(program, objects, tmp_path):
    assert mark("begin")[0]
    clock.sleep(2.0)
    objects(0.0, ["table"])
    clock.sleep(LATE_S)
    program.send_signal(signal.SIGINT)
    assert program.wait(1.0) == 0
    label = read_label(episode_folder(tmp_path / "session", 0))
    assert label.said == "" and label.measured == FAILURE and label.outcome == FAILURE
    assert "1 failure" in program.log
