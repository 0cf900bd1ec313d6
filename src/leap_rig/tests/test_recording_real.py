"""The program record.py as a process: what a tracker sends reaches the disk, also if the recorder is killed."""

import os
import re
import signal
import threading

import pytest
import yaml

from leap_motion.service.server import LeapService
from leap_rig.recording import read
from leap_rig.recording.recording_files import PARAMETERS

pytest.importorskip("rig_msgs.srv")
import rospy

from leap_rig.recording.ros.record_program import _commit

pytestmark = [pytest.mark.ros, pytest.mark.real]

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


def test_what_the_tracker_sent_is_on_the_disk_when_the_recorder_is_killed(ros, tracker, tmp_path, wait_until):
    ros.run("leap_motion", "leap_driver.py", f"_port:={tracker.port}")
    rospy.set_param("robot_description", "<robot/>")  # which rospy's cache of the recorder does not know
    program = ros.run("leap_rig", "record.py", f"{tmp_path}/run", "--task", "a test")
    wait_until(lambda: "frames" in program.log_path.read_text() or program.poll() is not None, 20.0, "the live line")
    wait_until(lambda: len(read(tmp_path / "run").frames) > 60, 20.0, "frames on the disk", poll=0.1)
    on_disk = read(tmp_path / "run").frames
    os.killpg(program.pid, signal.SIGKILL)
    program.wait(20.0)
    run = read(tmp_path / "run")
    assert yaml.safe_load((tmp_path / "run" / PARAMETERS).read_text())["robot_description"] == "<robot/>"
    assert run.frames[: len(on_disk)] == on_disk
    frames = [text for text in run.frames if '"event"' not in text]  # the driver may connect while it is recorded
    assert frames == [text for text in tracker.sent if text in set(frames)]
    assert "not completed" in run.remark


def test_its_version_is_asked_for_without_a_lock(processes, tmp_path):
    """On a full disk a killed git would leave the index locked."""

    def git(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@b")
        assert processes.start("git", "-C", str(tmp_path), *who, *words).wait(60.0) == 0

    source, index = tmp_path / "source.py", tmp_path / ".git" / "index"
    assert _commit(source) == ""
    source.write_text("a = 1\n")
    git("init", "-q")
    git("add", "source.py")
    git("commit", "-q", "-m", "one")
    os.utime(source, (1.0, 1.0))  # which git would note in the index
    before = index.read_bytes()
    assert re.fullmatch("[0-9a-f]{7,}", _commit(source))
    assert index.read_bytes() == before
    source.write_text("a = 2\n")
    assert re.fullmatch("[0-9a-f]{7,}-dirty", _commit(source))
    installed = tmp_path / "source_of_an_install_space.py"
    installed.write_text("a = 1\n")
    assert _commit(installed) == ""
