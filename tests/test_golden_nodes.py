"""Recorded hands through the nodes in virtual time, compared with what is stored of the pure chain, by bounds.

The nodes run on a graph whose messages take no time: leap_kuka_node, leap_hand_node and the controller, whose cycles
and drives are those of the pure chain. Whether the arm can come is asked there directly, as the answer of a service
comes some frames later.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from common import clock
from common.frames import ONE_ARM, TOOL_DESIRED, VIRTUAL_LEAP
from golden.chain import BEGIN_S, SWITCHED_ON, Trace, World
from golden.runs import RUNS, Missing
from golden.stored import Stored, differences, stored
from leap_kuka.scaling import Scaling

pytest.importorskip("rig_msgs.srv")
import rospy
from tf2_msgs.msg import TFMessage

from common.ros.conversions import pose_from_transform
from kuka_control.loop import assembly
from kuka_control.ros import controller_node
from kuka_control.ros.controller_node import _Node
from kuka_control.ros.state_publisher import GoalPublisher
from kuka_msgs.srv import setGripperControl, setKukaControl, setScalingFactor
from leap_hand.force_limit import ForceLimit
from leap_hand.ros.teleop_node import HandTeleopNode
from leap_hand.teleop import HandTeleop
from leap_kuka.ros.teleop_node import ArmTeleopNode
from leap_kuka.teleop import ArmTeleop
from leap_motion.codec import LeapProtocolError, read_message
from leap_motion.frames import LeapFrame
from leap_motion.ros.human import FrameMessage, Human
from leap_motion.ros.tracking import subscribe
from reflex_msgs.msg import Finger, Hand, Motor, RadianServoCommands
from rig_msgs.msg import KukaStatus, OperatorInput
from simulated import graph, graph_parts, scheduler

pytestmark = pytest.mark.ros

BOUNDS = {"tools": 1e-6, "hands": 1e-5, "goals": 1e-4}
"""m and no unit, rad, rad: messages hold confidence and bone centres as float32, and stamps in nanoseconds."""
SENSITIVE = {"confidence-74fps": {"goals": 0.01}}
"""Its last second goes along the inner sphere, where limits act by turns on less than messages round."""
LATE_S = 0.0041  # of a change of state: a cycle
ON_S = max(at for at, _, _ in SWITCHED_ON)  # before, the hand opens when the controller first says that it is off
FRAMES, FRAMES_OF_HAND = "leap_motion/leap_device", "leap_motion/leap_device_of_hand"
"""A frame comes to the hand's node once that of the arm has said whose hand it follows; else it hears that too late."""
START_S = 1.0  # until all have connected, a multiple of the period of the nodes' watches
SOON_S, BEFORE_S = 1e-9, 1e-8  # until what was sent is done, and all that is sent at a time


class NodeChain:
    """The nodes, and what the world brings them."""

    def __init__(self, graph, patch, run):
        patch.setattr(graph_parts, "DELAY_S", 0.0)
        self.start = BEGIN_S - START_S
        self.world, self.graph = World(run), graph
        self.tool = self.command = self.last = None
        graph.start("leap_kuka_node", self.arm_node)
        graph.start("leap_hand_node", self.hand_node, "leap_hand_node", f"{FRAMES}:={FRAMES_OF_HAND}")
        patch.setattr(controller_node.DesiredTool, "wait", lambda desired, _: self.wait(desired))
        patch.setattr(controller_node, "HandOpening", lambda: SimpleNamespace(at=lambda _: self.world.opening))
        self.controller = graph.start("kuka_real_time_node", self.controller_node)
        rospy.Subscriber("/tf", TFMessage, self.on_tf)
        rospy.Subscriber("reflex_takktile/radian_hand_command", RadianServoCommands, self.on_command)
        kinds = {
            **{FRAMES: Human, FRAMES_OF_HAND: Human, "reflex_takktile/hand_state": Hand},
            **{"kuka/status": KukaStatus, "leap_kuka/operator_input": OperatorInput},
        }
        self.publishers = {name: rospy.Publisher(name, kind, queue_size=10) for name, kind in kinds.items()}
        self.services = {
            "control": rospy.ServiceProxy("kuka/kuka_control", setKukaControl),
            "gripper": rospy.ServiceProxy("kuka/gripper_control", setGripperControl),
            "scale": rospy.ServiceProxy("kuka/scaling_factor", setScalingFactor),
        }

    def run(self) -> Trace:
        assert self.controller.wait(1e4) == 0, self.controller.log
        return self.world.trace

    # The nodes.

    def begin(self, name):
        rospy.init_node(name)
        clock.sleep(self.start - clock.monotonic())

    def arm_node(self):
        self.begin("leap_kuka_node")
        world = self.world
        teleop = ArmTeleop(world.leap, world.placement, world.can_reach, world.measured_tool)
        reach = SimpleNamespace(scaling=Scaling(world.placement.ws_center))
        self.arm = ArmTeleopNode(teleop, reach, world.leap.engagement, subscribe)
        self.arm.watch()

    def hand_node(self):
        self.begin("leap_hand_node")
        teleop = HandTeleop(self.world.hand, False, self.world.leap.hand)
        self.hand = HandTeleopNode(teleop, ForceLimit(self.world.hand))
        self.first = self.hand._result
        self.hand._state_received.set()
        self.hand.run(subscribe)

    def controller_node(self):
        self.begin("kuka_real_time_node")
        world = self.world
        link = SimpleNamespace(arm=world.arm, goals=GoalPublisher(), close=lambda: None)
        loop = assembly.real_time_loop(world.config, world.rig)
        self.node = _Node(world.config, world.rig, link, lambda: loop, ONE_ARM)
        self.node.spin(None)

    def wait(self, desired):
        """In place of DesiredTool.wait: until the next cycle of the world."""
        self.see()
        if not self.world.advance(self):
            raise SystemExit
        self.at(self.world.now)
        clock.sleep(max(self.world.now - clock.monotonic(), 0.0))
        self.graph.scheduler.now = self.world.now  # in floats, as a time-out ends after a number of cycles
        self.see()
        desired._look()
        return desired._newest

    def see(self):
        """Notes what has changed."""
        world, step = self.world, self.node._step
        newest = self.arm._report._newest
        if newest is not None:
            world.trace.say(world.now, "leap_kuka", newest.state.value)
        if self.hand._result is not self.first:
            world.trace.say(world.now, "leap_hand", self.hand._result.state.value)
        if step is not None:
            world.trace.say(world.now, "kuka", step.mode.value)
            if step.mode is not world.mode:
                world.mode = step.mode
                self.status()

    # What the world brings.

    @staticmethod
    def at(now):
        """Waits until just before a time, at which what follows is done."""
        clock.sleep(max(now - BEFORE_S - clock.monotonic(), 0.0))

    def send(self, name, message):
        self.publishers[name].publish(message)
        clock.sleep(SOON_S)

    def switched(self, what, value, now):
        if what == "input":  # at once, as frames of this cycle are still to come
            message = OperatorInput(enabled=value[0], clutch=value[1], source="service")
            message.header.stamp = rospy.Time.now()
            self.send("leap_kuka/operator_input", message)
        else:
            assert self.services[what](value).success
            self.status()

    def frame(self, text, now):
        self.at(now)
        self.tool = self.command = None
        try:
            frame = read_message(text)
        except LeapProtocolError:
            return None, None
        if isinstance(frame, LeapFrame) and (frame.id, frame.timestamp_us) != self.last:
            self.last = frame.id, frame.timestamp_us
            message = FrameMessage(frame, rospy.Time.now())
            self.send(FRAMES, message)
            self.send(FRAMES_OF_HAND, message)
            self.see()
        return self.tool, self.command

    def look(self, now):
        felt = self.world.feedback
        fingers = [Finger(pressure=pressures) for pressures in felt.pressures]
        motors = [Motor(joint_angle=angle, load=load) for angle, load in zip(felt.angles, felt.loads)]
        self.send("reflex_takktile/hand_state", Hand(fingers, [*motors, Motor()]))
        self.status()

    def status(self):
        world = self.world
        on, scale = world.switches.control_on, world.switches.scale
        self.send("kuka/status", KukaStatus(mode=world.mode.value, control_on=on, scaling_factor=scale))

    # What they send.

    def on_tf(self, message):
        poses = {t.child_frame_id: pose_from_transform(t.transform) for t in message.transforms}
        if TOOL_DESIRED in poses:
            self.tool = np.asarray(poses[VIRTUAL_LEAP] @ poses[TOOL_DESIRED])

    def on_command(self, message):
        self.command = np.array(message.radian_commands)


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
def test_the_nodes_make_of_it_what_the_pure_chain_makes(monkeypatch, name):
    try:
        run = RUNS[name]()
    except Missing as missing:
        pytest.skip(str(missing))
    old = Stored.read(name)
    monkeypatch.setattr(scheduler, "START_S", BEGIN_S - 2.0 * START_S)
    with graph.Graph() as virtual:
        trace = NodeChain(virtual, monkeypatch, run).run()
    new = stored(trace)
    expected, found = states(old.events), states(new.events)
    for who in ("kuka:", "leap_kuka:", "leap_hand:"):
        of_old, of_new = ([change for change in changes if change[1] == who] for changes in (expected, found))
        assert [state for _, _, state in of_new] == [state for _, _, state in of_old], who
        late = [abs(a[0] - b[0]) for a, b in zip(of_old, of_new) if a[0] > ON_S]
        assert max(late) <= LATE_S, who
    found = differences(old, Stored(new.means, new.counts, old.events), {**BOUNDS, **SENSITIVE.get(name, {})})
    assert not found, f"{name}: {' '.join(found)}"
