"""Recorded hands through the nodes with time handed in, compared with what is stored of the pure chain, by bounds.

The nodes are those of the rig, in this process: driver's message, leap_kuka_node, leap_hand_node, and a controller from
the tf messages to the goals. Messages between them pass as bytes; no time passes, and no device is simulated.
"""

from __future__ import annotations

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

from common import clock
from common.frames import ONE_ARM
from golden.chain import BEGIN_S, CLOCK_S, Trace, World
from golden.runs import RUNS, Missing
from golden.stored import Stored, differences, stored

pytestmark = pytest.mark.ros

BOUNDS = {"tools": 1e-6, "hands": 1e-5, "goals": 1e-4}
"""m and no unit, rad, rad: messages hold confidence and bone centres as float32, and stamps in nanoseconds."""
LATE_S = 0.0041  # of a change of state: a cycle


class Done(Exception):
    """The run is over, or a loop has gone round once."""


class HandedIn:
    """Stands for common.clock; it is set."""

    def __init__(self) -> None:
        self.now, self._set = BEGIN_S, None

    def __getattr__(self, name):
        return getattr(clock, name)

    def monotonic(self):
        import rospy

        if self.now != self._set:  # it is asked five times a step
            self._set = self.now
            rospy.rostime._set_rostime(rospy.Time.from_sec(CLOCK_S + self.now))
        return self.now

    def sleep(self, _seconds):
        raise Done


class NodeChain:
    """The nodes, in lockstep with the world."""

    def __init__(self, world, patch):
        import rospy

        from kuka_control.ros import controller_node, desired_tool, services, state_publisher
        from leap_hand.force_limit import ForceLimit
        from leap_hand.ros import teleop_node as hand
        from leap_hand.teleop import HandTeleop
        from leap_kuka.ros import hand_to_arm, stream_status
        from leap_kuka.ros import teleop_node as arm
        from leap_kuka.teleop import ArmTeleop
        from leap_motion.ros.tracking import FramesHere

        self.world, self.clock = world, HandedIn()
        for module in (controller_node, desired_tool, arm, stream_status, hand_to_arm, hand, state_publisher):
            if hasattr(module, "clock"):
                patch.setattr(module, "clock", self.clock)
        self.clock.monotonic()
        nothing = SimpleNamespace(move=None, show=lambda *_: None, collision=lambda _: None, shutdown=lambda *_: None)
        for owner, name in ((rospy, "Service"), (arm, "Diagnostics"), (hand, "Diagnostics"), (services, "Services"),
                            (controller_node, "Services"), (controller_node, "MoveServer"),
                            (controller_node, "GuardView"), (controller_node, "HandOpening"),
                            (controller_node, "Switches")):  # fmt: skip
            patch.setattr(owner, name, lambda *_, **__: nothing)
        self.frames, self.tool, self.command, self.last = FramesHere(), None, None, None

        def subscribe(on_frame, kind):
            self.frames.subscribe(on_frame, kind)

        teleop = ArmTeleop(world.leap, world.placement, world.can_reach, world.measured_tool)
        self.arm = arm.ArmTeleopNode(teleop, SimpleNamespace(scale=1.0), world.leap.engagement, subscribe)
        self.arm._tf = SimpleNamespace(publish=self._on_tf)
        self.hand = hand.HandTeleopNode(HandTeleop(world.hand, False), ForceLimit(world.hand))
        self.hand._commands = SimpleNamespace(
            publish=lambda message: setattr(self, "command", np.array(message.radian_commands))
        )
        self.hand._state_received.set()
        self.first = self.hand._result
        with contextlib.suppress(Done):
            self.hand.run(subscribe)
        self.arm._status._status = SimpleNamespace(publish=self._on_stream)

        link = SimpleNamespace(arm=world.arm, goals=SimpleNamespace(publish=lambda: None), close=lambda: None)
        from kuka_control.loop import algorithms

        self.controller = controller_node._Node(
            world.config, world.rig, link, lambda: algorithms.real_time_loop(world.config, world.rig), ONE_ARM
        )
        self.desired, self.controller._desired = self.controller._desired, self
        self.controller._opening = SimpleNamespace(at=lambda _: world.opening)
        self.controller._switches = self
        self.show, self.controller._show = self.controller._show, self._show
        self.stamp = None

    def run(self) -> Trace:
        with contextlib.suppress(Done):
            self.controller._run_loop()
        return self.world.trace

    # What the controller asks: its input, and its switches.

    def wait(self, _deadline):
        if not self.world.advance(self):
            raise Done
        self._at(self.world.now)
        self.desired._look()
        self.stamp = self.desired.stamp
        return self.desired._newest

    @property
    def now(self):
        return self.world.switches

    def report(self, *_):
        pass

    def _show(self, step):
        self.show(step)
        if step.mode is not self.world.mode:
            self.world.mode = step.mode
            self._status(self.world.now)
        self.world.trace.say(self.world.now, "kuka", step.mode.value)

    # What the world brings.

    def switched(self, what, value, now):
        from std_msgs.msg import Bool

        from rig_msgs.msg import OperatorInput

        self._at(now)
        if what == "gripper":
            self.hand._on_gripper(Bool(value))
        elif what == "input":
            message = OperatorInput(enabled=value[0], clutch=value[1], source="service")
            message.header.stamp = self._stamp(now)
            message._connection_header = {"callerid": "operator"}
            self.arm._on_input(message)
        else:
            self._status(now)

    def frame(self, text, now):
        from leap_motion.codec import LeapProtocolError, read_message
        from leap_motion.frames import LeapFrame
        from leap_motion.ros.human import FrameMessage

        self._at(now)
        self.tool = self.command = None
        with contextlib.suppress(LeapProtocolError):
            frame = read_message(text)
            if isinstance(frame, LeapFrame) and (frame.id, frame.timestamp_us) != self.last:
                self.last = frame.id, frame.timestamp_us
                self.frames.pass_on(FrameMessage(frame, self._stamp(now)))
                self._say_states(now)
        return self.tool, self.command

    def look(self, now):
        self._at(now)
        self.hand._force_limit.update(self.world.feedback, now)
        self._status(now)
        with contextlib.suppress(Done):
            self.arm.watch()
        self.hand._carry_out(self.hand._teleop.silence(now))
        self._say_states(now)

    def _say_states(self, now):
        newest = self.arm._status._newest
        if newest is not None:
            self.world.trace.say(now, "leap_kuka", newest.state.value)
        if self.hand._result is not self.first:
            self.world.trace.say(now, "leap_hand", self.hand._result.state.value)

    def _at(self, now):
        self.clock.now = now
        self.clock.monotonic()

    def _stamp(self, now):
        import rospy

        return rospy.Time.from_sec(CLOCK_S + now)

    def _status(self, now):
        from rig_msgs.msg import KukaStatus

        self._at(now)
        switches = self.world.switches
        self.arm._on_status(
            KukaStatus(mode=self.world.mode.value, control_on=switches.control_on, scaling_factor=switches.scale)
        )

    def _on_tf(self, message):
        import io

        from common.frames import TOOL_DESIRED, VIRTUAL_LEAP
        from common.ros.conversions import pose_from_transform
        from kuka_control.ros.tf_message import RawTfMessage

        buffer = io.BytesIO()
        message.serialize(buffer)
        raw = RawTfMessage().deserialize(buffer.getvalue())
        raw._connection_header = {"callerid": "/leap_kuka_node"}
        self.desired.callback(raw)
        poses = {t.child_frame_id: pose_from_transform(t.transform) for t in message.transforms}
        if TOOL_DESIRED in poses:
            self.tool = np.asarray(poses[VIRTUAL_LEAP] @ poses[TOOL_DESIRED])

    def _on_stream(self, message):
        import io

        buffer = io.BytesIO()
        message.serialize(buffer)
        self.hand._on_stream(type(message)().deserialize(buffer.getvalue()))


def states(events):
    """Returns time [s], who and state of each change of a state."""
    found, last = [], {}
    for event in events:
        at, who, what = event.split(maxsplit=2)
        state = what.split(":")[0].split(",")[0]
        if who in ("kuka:", "leap_kuka:", "leap_hand:") and last.get(who) != state:
            last[who] = state
            found.append((float(at), who, state))
    return found


@pytest.mark.parametrize("name", RUNS)
def test_the_nodes_make_of_it_what_the_pure_chain_makes(ros, monkeypatch, name):
    import rospy

    try:
        run = RUNS[name]()
    except Missing as missing:
        pytest.skip(str(missing))
    old = Stored.read(name)
    try:
        trace = NodeChain(World(run), monkeypatch).run()
    finally:
        rospy.rostime.switch_to_wallclock()
    new = stored(trace)
    expected, found = states(old.events), states(new.events)
    for who in ("kuka:", "leap_kuka:", "leap_hand:"):
        of_old, of_new = ([change for change in changes if change[1] == who] for changes in (expected, found))
        assert [state for _, _, state in of_new] == [state for _, _, state in of_old], who
        assert max(abs(a[0] - b[0]) for a, b in zip(of_old, of_new)) <= LATE_S, who
    found = differences(old, Stored(new.means, new.counts, old.events), BOUNDS)
    assert not found, f"{name}: {' '.join(found)}"
