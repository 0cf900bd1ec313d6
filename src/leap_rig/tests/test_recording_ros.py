"""The program record.py: what it stores of a graph, and when."""

import signal
from types import SimpleNamespace

import numpy as np
import pytest

from common import clock
from leap_rig.recording import read

pytest.importorskip("rig_msgs.srv")
from xmlrpc.client import Binary, DateTime

import rospy
import yaml
from tf2_msgs.msg import TFMessage

from common.frames import BASE, TOOL_DESIRED, VIRTUAL_LEAP
from common.poses import pose
from common.ros.conversions import stamped_transform
from leap_motion.msg import RawFrame
from leap_rig.recording.recording_files import MessageKind, RecordingWriter, messages, verify
from leap_rig.recording.ros import record_program
from leap_rig.recording.ros.record_program import Inbox, _end, _files, _LiveLine, _parser, store
from rig_msgs.msg import SentGoals

pytestmark = pytest.mark.ros

GOALS = np.round(np.random.default_rng(1).uniform(-1.0, 1.0, (3, 7)), 6)
LATE_S = 0.01
"""What connections and messages may take."""


@pytest.fixture
def ros(virtual_graph, monkeypatch):
    git = SimpleNamespace(run=lambda *_, **__: SimpleNamespace(stdout="abc"), TimeoutExpired=TimeoutError)
    monkeypatch.setattr(record_program, "subprocess", git)
    return virtual_graph


@pytest.fixture
def texts(ros):
    """What a tracker sends at 100 Hz, each text another."""
    publisher, sent = rospy.Publisher("leap_motion/raw_frames", RawFrame, queue_size=10), []

    def send():
        while True:
            i = len(sent)
            sent.append(f'{{"currentFrameRate":110.5,"hands":[],"id":{i},"note":"é \\u0000  ","timestamp":{9000 * i}}}')
            publisher.publish(RawFrame(rospy.Time.now(), sent[-1]))
            clock.sleep(0.01)

    clock.Thread(target=send, daemon=True).start()
    return sent


@pytest.fixture
def publish(ros):
    """Publishes goals and a desired tool frame."""
    goals = rospy.Publisher("kuka/sent_goals", SentGoals, queue_size=10)
    tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
    half = pose(np.eye(3), [0.1, 0.2, 0.3])

    def now():
        stamp = rospy.Time.now()
        goals.publish([stamp] * 3, GOALS.ravel(), [0.0, 0.0, 0.25])
        chain = ((BASE, VIRTUAL_LEAP), (VIRTUAL_LEAP, TOOL_DESIRED))
        tf.publish(TFMessage([stamped_transform(half, *frames, stamp) for frames in chain]))

    return now


def test_a_run_is_stored_and_a_killed_recorder_leaves_all_but_the_last_moment(ros, texts, publish, tmp_path):
    rospy.set_param("leap_driver/code", "")
    rospy.set_param("secret/code", "123456")
    programs = [
        ros.run("leap_rig", "record.py", f"{tmp_path}/{name}", "--task", "a test") for name in ("ended", "killed")
    ]
    for _ in range(10):
        clock.sleep(0.25)
        publish()
    killed_at = clock.time()
    programs[1].send_signal(signal.SIGKILL)
    programs[0].send_signal(signal.SIGINT)
    assert programs[0].wait(0.1) == 0, programs[0].log
    again = ros.run("leap_rig", "record.py", f"{tmp_path}/ended")
    assert again.wait(0.1) == 1 and "exists already" in again.log
    run = read(tmp_path / "ended")
    assert not run.remark and run.manifest["ended_by"] == "Ctrl-C" and run.manifest["task"] == "a test"
    assert "Recorded" in programs[0].log and "dropped 0" in programs[0].log
    assert len(run.frames) >= 248 and list(run.frames) == texts[texts.index(run.frames[0]) :][: len(run.frames)]
    assert np.all(np.diff(run.frame_times) > 0) and 0.0 <= killed_at - run.frame_times[-1] <= 0.01 + LATE_S
    assert len(run.goals) in (27, 30)  # those of the end may be under way
    np.testing.assert_array_equal(run.goals[-3:], GOALS)
    np.testing.assert_array_equal(run.goal_velocities[-3:], [0.0, 0.0, 0.25])
    np.testing.assert_allclose(run.desired[-1][:3, 3], [0.2, 0.4, 0.6])
    assert len(run.desired) == len(run.desired_times)
    assert "123456" not in "".join(file.read_text() for file in (tmp_path / "ended").glob("*.[yj]*"))
    killed = read(tmp_path / "killed")
    assert "not completed" in killed.remark
    assert 0.0 <= killed_at - killed.frame_times[-1] <= 0.4 + 0.01 + LATE_S


def test_a_slow_disk_is_reported_with_the_next_chunk(tmp_path):
    writer, inbox, kind = RecordingWriter(tmp_path / "run", {}, {}, 1, 4096), Inbox(100), MessageKind("a/B", "")
    for rounds in (1, 2, 3):
        inbox.put("/a", kind, bytes(60))
        inbox.put("/a", kind, bytes(60))  # for which there is no room
        store(inbox, writer)
        assert len(list(messages(tmp_path / "run" / "messages.mcap"))) == rounds
        assert verify(tmp_path / "run")[0]["dropped"] == {"/a": rounds}


def test_what_comes_after_the_last_chunk_is_not_called_recorded(tmp_path, capsys):
    writer, inbox, kind = RecordingWriter(tmp_path / "run", {}, {}, 1, 4096), Inbox(), MessageKind("a/B", "")
    inbox.put("/a", kind, bytes(60))
    store(inbox, writer)
    inbox.put("/a", kind, bytes(60))
    assert _end(writer, inbox, _LiveLine(inbox, writer), "the test", tmp_path / "run", 0) == 0
    assert len(list(messages(tmp_path / "run" / "messages.mcap"))) == 1
    assert "Recorded 1 messages" in capsys.readouterr().out


def test_a_parameter_chooses_no_place_on_the_disk(tmp_path, capsys):
    source = tmp_path / "calibration.yaml"
    source.write_text("a: 1")
    names = ["../../victim", str(tmp_path / "victim"), "a/b", "manifest", "messages", "", "x" * 300, "ü"]
    parameters = {**{name: str(source) for name in names}, "deep": {"../victim": str(source), "good": str(source)}}
    files = _files({**parameters, "manifest": str(source.with_suffix(".json"))})
    source.with_suffix(".json").write_text("{}")
    files.update(_files({"manifest": str(source.with_suffix(".json"))}))
    assert set(files) <= {"deep.good.yaml", "messages.yaml", "parameters.yaml"} and "deep.good.yaml" in files
    assert "left out" in capsys.readouterr().err
    RecordingWriter(tmp_path / "home" / "run", {}, files, 1, 4096)
    assert not list(tmp_path.rglob("victim*"))


def test_secrets_and_bytes_among_the_parameters(tmp_path):
    parameters = {
        "leap_driver": {"code": "123456", "list": [{"code": "123456"}, [{"password": "123456"}]]},
        "picture": Binary(b"\x00\xff"), "when": DateTime(0), "fine": [1.5, "x"],
    }  # fmt: skip
    (content,) = _files(parameters).values()
    assert b"123456" not in content
    assert yaml.safe_load(content)["fine"] == [1.5, "x"]


@pytest.mark.parametrize("seconds", ["nan", "-1", "0", "x"])
def test_an_impossible_duration_is_refused_before_anything_is_made(tmp_path, seconds, capsys):
    with pytest.raises(SystemExit):
        _parser().parse_args([f"{tmp_path}/run", f"--seconds={seconds}"])
    assert "--seconds" in capsys.readouterr().err


@pytest.mark.parametrize("topic", ["", "/", "bad topic", "a//b", "/a/", "~private", "ü", "1st"])
def test_what_can_be_no_topic_is_refused_before_anything_is_made(tmp_path, topic, capsys):
    with pytest.raises(SystemExit):
        _parser().parse_args([f"{tmp_path}/run", "--topic", "/good", topic])
    assert f"{topic!r} is no topic" in capsys.readouterr().err
    assert _parser().parse_args(["run", "--topic", "good", "/b/c1"]).topic == ["/good", "/b/c1"]


def test_a_further_topic_of_which_nothing_came_is_named(ros, tmp_path):
    program = ros.run("leap_rig", "record.py", f"{tmp_path}/run", "--seconds", "0.1", "--topic", "mistyped", "/tf")
    assert program.wait(0.4 + LATE_S) == 0
    assert "record: nothing came on /mistyped, /tf: " in program.log
    assert read(tmp_path / "run").manifest["ended_by"] == "the end of 0.1 s"


@pytest.mark.parametrize("moment", ["_subscribe", "RecordingWriter"])
def test_an_interruption_while_the_recorder_starts_leaves_a_completed_recording(ros, tmp_path, monkeypatch, moment):
    real = getattr(record_program, moment)
    monkeypatch.setattr(
        record_program, moment, lambda *given: (ros.here.send_signal(signal.SIGINT), clock.sleep(0.01), real(*given))[2]
    )
    assert ros.run("leap_rig", "record.py", f"{tmp_path}/run").wait(1.0) == 0
    run = read(tmp_path / "run")
    assert not run.remark and run.manifest["ended_by"] == "Ctrl-C"
