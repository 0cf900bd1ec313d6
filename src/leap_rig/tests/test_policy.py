"""A policy on the whole simulated rig: it moves arm and fingers, the operator takes over at any instant, and nothing
jumps."""

from __future__ import annotations

import signal
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("kuka_msgs.srv")
import rospy
from std_srvs.srv import SetBool, Trigger

from campaign.hand_puppet import PERIOD_S
from campaign.rig import TELEOP
from common import clock
from common.poses import pose
from common.ros.conversions import message_from_pose
from common.ros.node import repeat
from common.ros.service_calls import call
from leap_rig.operator.ros.speaker import Speaker
from leap_rig.recording.dataset import INTERVENTION, POLICY_LED, exported_episodes
from leap_rig.recording.ros import record_program
from leap_rig.recording.session import episode_folder
from rig_msgs.msg import PolicyActions

pytestmark = pytest.mark.ros

SPEED_M_S, CIRCLE_S = 0.08, 4.0
FINGERS = [0.4, 0.5, 0.6, 0.1]


class CirclingPolicy:
    """Lets the tool circle from where it is, in chunks of 0.8 s, five times a second."""

    def __init__(self, rig):
        self._rig = rig
        self._publisher = rospy.Publisher("leap_kuka/policy_actions", PolicyActions, queue_size=1)
        self.offset = np.zeros(3)
        repeat(self._act, 0.2, "policy")

    def _act(self):
        T = self._rig.desired[-1] if self._rig.desired else self._rig.arm.now.T_base_tool
        turn = 2.0 * np.pi * clock.monotonic() / CIRCLE_S
        step = 0.1 * SPEED_M_S * np.array([np.cos(turn), np.sin(turn), 0.0])
        tools = [pose(T[:3, :3], T[:3, 3] + i * step + self.offset) for i in range(1, 9)]
        message = PolicyActions(period=0.1, tool=[message_from_pose(T) for T in tools], fingers=FINGERS * len(tools))
        message.header.stamp, message.header.frame_id = rospy.Time.now(), "kuka/base_frame"
        self._publisher.publish(message)


@pytest.fixture
def policy(rig):
    """The rig with relative engagement, control on, and a policy that may act."""
    rig.signal(TELEOP, signal.SIGINT)
    rig.exit_code(TELEOP)
    rospy.set_param("leap/engagement", "relative")
    rospy.set_param("leap/hold_time", 30.0)
    rig.stream_state = ""
    rig.start(TELEOP)
    rig.wait(lambda: rig.stream_state == "waiting", "the node to start again")
    policy = CirclingPolicy(rig)
    assert rig.control(True).success and rig.gripper(True).success
    rig.watch(1.0)
    assert rig.mode == "home" and not rig.desired, "nobody has said that it may"
    assert rig.call("leap_kuka/run_policy", SetBool, True).success
    return policy


def desired_places(rig):
    return np.array([T[:3, 3] for T in rig.desired])


@pytest.mark.parametrize("takeovers", [5, pytest.param(100, marks=[pytest.mark.long, pytest.mark.timeout(3600)])])
def test_a_policy_moves_arm_and_fingers_and_the_operator_takes_over_without_a_jump(rig, policy, takeovers):
    rig.wait_for_mode("servo")
    rig.watch(4.0)
    ways = np.ptp([sample.T_base_tool[:3, 3] for sample in rig.arm.since(rig.arm.now.time - 4.0)], axis=0)
    assert ways[:2].min() > 0.05 and ways[2] < 0.01, "the circle"
    assert np.abs(np.subtract(rig.robot_hand.ask("state")["angles"], FINGERS)).max() < 0.2 < min(FINGERS[:3])
    rng, stood, changes = np.random.default_rng(1), [], []
    for _ in range(takeovers):
        rig.watch(float(rng.uniform(0.5, 2.0)))
        rig.hand.show()
        rig.wait(lambda: rig.stream_state == "running", "the operator to take over")
        changes.append(len(rig.desired))
        rig.watch(1.0)
        stood.append(np.ptp(np.array([T[:3, 3] for T in rig.desired[-50:]]), axis=0).max())
        rig.hand.hide()
        rig.wait(lambda: rig.stream_state == "waiting" and "a program steers" in rig.stream[-1][1], "the policy again")
        changes.append(len(rig.desired))
    steps = np.linalg.norm(np.diff(desired_places(rig), axis=0), axis=1)
    at = np.concatenate([steps[change - 5 : change + 5] for change in changes])  # frames around each change
    # A chunk begins 8 mm ahead; while it fades in, the tool moves with three times the policy's speed at most.
    bound = 3.0 * SPEED_M_S * PERIOD_S
    largest = (
        f"largest step {1e3 * steps.max():.2f} mm, at a change {1e3 * at.max():.2f} mm, bound {1e3 * bound:.2f} mm"
    )
    print(f"{takeovers} takeovers: {largest}")
    assert steps.max() <= bound
    assert max(stood) < 0.01
    assert not [text for _, _, text in rig.said if "safety stop" in text.lower()]


@pytest.mark.parametrize("offset", [(0.0, 0.0, -0.3), (np.nan, 0.0, 0.0)])
def test_actions_that_jump_or_are_no_numbers_leave_the_tool_where_it_is(rig, policy, offset):
    rig.wait_for_mode("servo")
    rig.watch(1.0)
    policy.offset = np.array(offset)
    rig.watch(1.5)
    stays = rig.desired[-1][:3, 3]
    rig.watch(1.0)
    np.testing.assert_allclose(rig.desired[-1][:3, 3], stays, atol=1e-9)
    assert rig.mode == "servo" and max(sample.speed for sample in rig.arm.since(rig.arm.now.time - 0.5)) < 0.01
    policy.offset = np.zeros(3)
    rig.watch(2.0)
    assert np.linalg.norm(rig.desired[-1][:3, 3] - stays) > 0.02, "it continues"


def test_an_exported_episode_says_when_the_operator_led_and_when_the_policy(rig, policy, tmp_path, monkeypatch):
    git = SimpleNamespace(run=lambda *_, **__: SimpleNamespace(stdout="abc"), TimeoutExpired=TimeoutError)
    monkeypatch.setattr(record_program, "subprocess", git)
    monkeypatch.setattr(Speaker, "play", lambda *_: None)
    session, fps, at = tmp_path / "circles", 50, []
    program = rig.graph.run(
        "leap_rig", "record_episodes.py", f"{session}/", "--task", "circle", "--countdown", "0", "--operator", "7"
    )
    rig.wait_for_mode("servo")
    rig.watch(1.0)
    assert call("episodes/begin", Trigger, timeout=5.0, wait=5.0).success
    rig.watch(2.0)
    at.append(clock.time())
    rig.hand.show()
    rig.wait(lambda: rig.stream_state == "running", "the operator to take over")
    at.append(clock.time())
    rig.watch(1.5)
    at.append(clock.time())
    rig.hand.hide()
    rig.wait(lambda: rig.stream_state == "waiting" and "a program steers" in rig.stream[-1][1], "the policy again")
    at.append(clock.time())
    rig.watch(1.0)
    assert call("episodes/success", Trigger, timeout=5.0).success
    rig.watch(0.5)
    program.send_signal(signal.SIGINT)
    assert program.wait(5.0) == 0, program.log
    (one,) = exported_episodes([episode_folder(session, 0)], fps, "")
    taken, led = one.leader[INTERVENTION], one.leader[POLICY_LED]
    np.testing.assert_array_equal(led, ~taken)
    rows = np.flatnonzero(taken)
    np.testing.assert_array_equal(rows, np.arange(rows[0], rows[-1] + 1))
    begins, ends = one.rows.times[rows[[0, -1]]] + 1.0 / fps
    assert at[0] < begins <= at[1] + 1.5 / fps and at[2] - 1.0 / fps < ends < at[3] + 1.0 / fps
    desired = one.signals.rows["action.desired_tool"][:, :2]
    stays, circles = (np.median(np.linalg.norm(np.diff(desired[part], axis=0), axis=1)) * fps for part in (taken, led))
    assert stays < 0.01 < 0.5 * SPEED_M_S < circles, "the hand stands; the policy circles"
