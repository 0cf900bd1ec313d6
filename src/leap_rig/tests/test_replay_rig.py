"""A recording of a running rig drives a running rig as a tracker: the same texts give the same desired tool."""

from __future__ import annotations

import signal

import numpy as np
import pytest

from leap_rig.recording import read
from rig_simulation.control_port import ControlClient

pytest.importorskip("rig_msgs.srv")
import rospy

from leap_rig.recording.ros import record_program

pytestmark = pytest.mark.ros

DRIVER = "leap_driver"
SECONDS = 4.0
NEAR_M = 1e-3
PORT, CONTROL_PORT = 26437, 26438


def nearest(poses, others):
    """Returns for each position of `poses`, shape (n, 4, 4), how far the path through `others` passes it [m]."""
    a, b = others[:-1, :3, 3], others[1:, :3, 3]
    p, way = poses[:, None, :3, 3], (b - a)[None]
    along = np.sum((p - a) * way, axis=2) / np.maximum(np.sum(way**2, axis=2), 1e-12)
    foot = a + np.clip(along, 0.0, 1.0)[..., None] * way
    return np.min(np.linalg.norm(p - foot, axis=2), axis=1)


def test_a_recording_of_a_running_rig_replays_through_the_whole_chain(rig, tmp_path, monkeypatch):
    monkeypatch.setattr(record_program, "_commit", lambda _: "")  # which starts git
    folder = tmp_path / "circles"
    rig.signal(DRIVER, signal.SIGINT)
    assert rig.exit_code(DRIVER) == 0
    rospy.set_param(f"{DRIVER}/port", PORT)
    rig.start(DRIVER)
    recorder = rig.run("leap_rig", "record.py", str(folder))
    rig.wait(lambda: "frames" in recorder.log, "the recorder")
    assert rig.control(True).success, "before the hand comes in: one that is there does not count"
    ports = "--port", str(PORT), "--control-port", str(CONTROL_PORT)
    operator = rig.run("rig_simulation", "leapd.py", "--paused", *ports)
    # The recording holds how the hand comes in: after an engagement only such a hand counts.
    rig.wait(lambda: "control port" in operator.log, "the operator's service")
    rig.stream.clear()
    rig.wait(lambda: any("no hand is seen" in why for _, why in rig.stream), "frames without a hand")
    ControlClient("127.0.0.1", CONTROL_PORT).ask("play")
    rig.wait(lambda: "servo" in rig.modes, "the arm to follow the operator", 15.0)
    rig.watch(SECONDS)
    assert rig.end_program(recorder) == 0 and rig.end_program(operator) == 0
    assert rig.control(False).success
    rig.wait_for_mode("home")
    rig.wait(lambda: rig.stream_state == "waiting", "the end of the stream")
    run = read(folder)
    assert len(run.desired) > 100 and len(run.goals) > 100, run.remark
    recorded = run.desired[run.desired_times > run.desired_times[-1] - SECONDS / 2.0]
    assert np.max(np.ptp(recorded[:, :3, 3], axis=0)) > 0.05, "the hand moved"

    assert rig.control(True).success
    rig.modes.clear()
    rig.desired.clear()
    since = rig.arm.now.time
    program = rig.run("leap_rig", "replay.py", str(folder), "--tracker", "--port", str(PORT))
    rig.wait_for_modes("pick_up", "servo")
    assert program.wait(60.0) == 0, program.log
    np.testing.assert_allclose(rig.desired, run.desired, atol=1e-6)
    samples = rig.arm.since(since)
    followed = np.array([sample.T_base_tool for sample in samples])
    assert max(sample.tool_speed for sample in samples) < 0.71 and rig.arm.now.safety_stop is None
    assert np.max(nearest(recorded, followed)) < NEAR_M
