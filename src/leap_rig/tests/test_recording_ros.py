"""The programs record.py and replay.py on a graph of their own."""

import os
import signal
import threading
import time

import numpy as np
import pytest

from leap_motion.service.server import LeapService
from leap_rig.recording import read

pytestmark = pytest.mark.ros

GOALS = np.round(np.random.default_rng(1).uniform(-1.0, 1.0, (3, 7)), 6)
EMPTY = '{{"currentFrameRate":110.5,"hands":[],"id":{i},"note":"é \\u0000  ","pointables":[],"timestamp":{t}}}'


class Tracker:
    """A Leap service that sends frames without hands, each text another."""

    def __init__(self):
        self._service = LeapService(port=0)
        self.port, self.sent, self._stop = self._service.port, [], threading.Event()
        for job in (self._service.run, self._send):
            threading.Thread(target=job, daemon=True).start()

    def _send(self):
        while not self._stop.wait(0.01):
            i = len(self.sent)
            self.sent.append(EMPTY.format(i=i, t=9000 * i))
            self._service.offer(self.sent[-1])

    def close(self):
        self._stop.set()
        self._service.stop()


@pytest.fixture
def tracker():
    service = Tracker()
    yield service
    service.close()


def started(program, wait_until):
    wait_until(lambda: "frames" in program.log_path.read_text() or program.poll() is not None, 20.0, "the live line")
    assert program.poll() is None, program.log_path.read_text()


@pytest.fixture
def publish(ros):
    """Publishes goals and a desired tool frame."""
    import rospy
    from tf2_msgs.msg import TFMessage

    from common.frames import BASE, TOOL_DESIRED, VIRTUAL_LEAP
    from common.poses import pose
    from common.ros.conversions import stamped_transform
    from rig_msgs.msg import SentGoals

    goals = rospy.Publisher("kuka/sent_goals", SentGoals, queue_size=10)
    tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
    half = pose(np.eye(3), [0.1, 0.2, 0.3])

    def now():
        stamp = rospy.Time.now()
        goals.publish([stamp] * 3, GOALS.ravel(), [0.0, 0.0, 0.25])
        chain = ((BASE, VIRTUAL_LEAP), (VIRTUAL_LEAP, TOOL_DESIRED))
        tf.publish(TFMessage([stamped_transform(half, *frames, stamp) for frames in chain]))

    return now


def test_a_run_is_stored_and_a_killed_recorder_leaves_all_but_the_last_second(
    ros, tracker, publish, processes, tmp_path, wait_until
):
    import rospy

    rospy.set_param("leap_driver/code", "")
    rospy.set_param("secret/code", "123456")
    ros.run("leap_motion", "leap_driver.py", f"_port:={tracker.port}")
    programs = [
        ros.run("leap_rig", "record.py", f"{tmp_path}/{name}", "--task", "a test") for name in ("ended", "killed")
    ]
    for program in programs:
        started(program, wait_until)

    def is_stored(folder):
        run = read(folder)
        return len(run.frames) > 60 and time.time() - run.frame_times[-1] < 1.0 and len(run.goals) and len(run.desired)

    folders = [tmp_path / name for name in ("ended", "killed")]
    wait_until(lambda: (publish(), all(map(is_stored, folders)))[1], 20.0, "the frames", poll=0.1)
    killed_at = time.time()
    os.killpg(programs[1].pid, signal.SIGKILL)
    assert processes.end(programs[0]) == 0, programs[0].log_path.read_text()
    again = ros.run("leap_rig", "record.py", f"{tmp_path}/ended")
    run = read(tmp_path / "ended")
    assert not run.remark and run.manifest["ended_by"] == "Ctrl-C" and run.manifest["task"] == "a test"
    assert "Recorded" in programs[0].log_path.read_text()
    frames = [text for text in run.frames if '"event"' not in text]  # the driver may connect while it is recorded
    assert len(frames) > 50 and frames == [text for text in tracker.sent if text in set(frames)]
    assert np.all(np.diff(run.frame_times) > 0) and abs(run.frame_times[-1] - killed_at) < 30.0
    assert len(run.goals) >= 3 and not len(run.goals) % 3
    np.testing.assert_array_equal(run.goals[-3:], GOALS)
    np.testing.assert_array_equal(run.goal_velocities[-3:], [0.0, 0.0, 0.25])
    np.testing.assert_allclose(run.desired[-1][:3, 3], [0.2, 0.4, 0.6])
    assert len(run.desired) == len(run.desired_times)
    assert "123456" not in "".join(file.read_text() for file in (tmp_path / "ended").glob("*.[yj]*"))
    killed = read(tmp_path / "killed")
    assert "not completed" in killed.remark and killed.frame_times[-1] > killed_at - 1.0 * 3.0
    assert again.wait(20.0) == 1 and "exists already" in again.log_path.read_text()


def test_a_slow_disk_is_reported_with_the_next_chunk(tmp_path):
    from leap_rig.recording.recording_files import MessageKind, RecordingWriter, messages, verify
    from leap_rig.recording.ros.record_program import Inbox, _store

    writer, inbox, kind = RecordingWriter(tmp_path / "run", {}, {}, 1, 4096), Inbox(100), MessageKind("a/B", "")
    for rounds in (1, 2, 3):
        inbox.put("/a", kind, bytes(60))
        inbox.put("/a", kind, bytes(60))  # for which there is no room
        _store(inbox, writer)
        assert len(list(messages(tmp_path / "run" / "messages.mcap"))) == rounds
        assert verify(tmp_path / "run")[0]["dropped"] == {"/a": rounds}


def test_what_comes_after_the_last_chunk_is_not_called_recorded(tmp_path, capsys):
    from leap_rig.recording.recording_files import MessageKind, RecordingWriter, messages
    from leap_rig.recording.ros.record_program import Inbox, _end, _LiveLine, _store

    writer, inbox, kind = RecordingWriter(tmp_path / "run", {}, {}, 1, 4096), Inbox(), MessageKind("a/B", "")
    inbox.put("/a", kind, bytes(60))
    _store(inbox, writer)
    inbox.put("/a", kind, bytes(60))
    assert _end(writer, inbox, _LiveLine(inbox, writer), "the test", tmp_path / "run", 0) == 0
    assert len(list(messages(tmp_path / "run" / "messages.mcap"))) == 1
    assert "Recorded 1 messages" in capsys.readouterr().out


def test_a_parameter_chooses_no_place_on_the_disk(tmp_path, capsys):
    from leap_rig.recording.recording_files import RecordingWriter
    from leap_rig.recording.ros.record_program import _files

    source = tmp_path / "calibration.yaml"
    source.write_text("a: 1")
    names = ["../../victim", str(tmp_path / "victim"), "a/b", "manifest", "messages", "", "x" * 300, "ü"]
    parameters = {**{name: str(source) for name in names}, "deep": {"../victim": str(source), "good": str(source)}}
    files = _files({**parameters, "manifest": str(source.with_suffix(".json"))})
    source.with_suffix(".json").write_text("{}")
    files |= _files({"manifest": str(source.with_suffix(".json"))})
    assert set(files) <= {"deep.good.yaml", "messages.yaml", "parameters.yaml"} and "deep.good.yaml" in files
    assert "left out" in capsys.readouterr().err
    RecordingWriter(tmp_path / "home" / "run", {}, files, 1, 4096)
    assert not list(tmp_path.rglob("victim*"))


def test_secrets_and_bytes_among_the_parameters(tmp_path):
    from xmlrpc.client import Binary, DateTime

    import yaml

    from leap_rig.recording.ros.record_program import _files

    parameters = {
        "leap_driver": {"code": "123456", "list": [{"code": "123456"}, [{"password": "123456"}]]},
        "picture": Binary(b"\x00\xff"), "when": DateTime(0), "fine": [1.5, "x"],
    }  # fmt: skip
    (content,) = _files(parameters).values()
    assert b"123456" not in content
    assert yaml.safe_load(content)["fine"] == [1.5, "x"]


@pytest.mark.parametrize("seconds", ["nan", "-1", "0", "x"])
def test_an_impossible_duration_is_refused_before_anything_is_made(tmp_path, seconds, capsys):
    from leap_rig.recording.ros.record_program import _parser

    with pytest.raises(SystemExit):
        _parser().parse_args([f"{tmp_path}/run", f"--seconds={seconds}"])
    assert "--seconds" in capsys.readouterr().err


@pytest.mark.parametrize("topic", ["", "/", "bad topic", "a//b", "/a/", "~private", "ü", "1st"])
def test_what_can_be_no_topic_is_refused_before_anything_is_made(tmp_path, topic, capsys):
    from leap_rig.recording.ros.record_program import _parser

    with pytest.raises(SystemExit):
        _parser().parse_args([f"{tmp_path}/run", "--topic", "/good", topic])
    assert f"{topic!r} is no topic" in capsys.readouterr().err
    assert _parser().parse_args(["run", "--topic", "good", "/b/c1"]).topic == ["/good", "/b/c1"]


def test_a_further_topic_of_which_nothing_came_is_named(ros, tmp_path, monkeypatch, capsys):
    from leap_rig.recording.ros import record_program

    monkeypatch.setattr(record_program.rospy, "init_node", lambda *_, **__: None)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        options = [f"{tmp_path}/run", "--seconds", "0.1", "--topic", "mistyped", "/tf"]
        assert record_program.record(record_program._parser().parse_args(options)) == 0
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert "record: nothing came on /mistyped, /tf: " in capsys.readouterr().err


@pytest.mark.parametrize("moment", ["_subscribe", "RecordingWriter"])
def test_an_interruption_while_the_recorder_starts_leaves_a_completed_recording(ros, tmp_path, monkeypatch, moment):
    from leap_rig.recording.ros import record_program

    real = getattr(record_program, moment)
    monkeypatch.setattr(record_program.rospy, "init_node", lambda *_, **__: None)
    monkeypatch.setattr(record_program, moment, lambda *given: (os.kill(os.getpid(), signal.SIGINT), real(*given))[1])
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        assert record_program.record(record_program._parser().parse_args([f"{tmp_path}/run"])) == 0
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    run = read(tmp_path / "run")
    assert not run.remark and run.manifest["ended_by"] == "Ctrl-C"
