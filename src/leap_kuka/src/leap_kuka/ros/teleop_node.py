"""The node leap_kuka_node: Human messages in, the frames of hand, desired tool and desired flange out on tf. The
service leap_kuka/hold_tool holds the tool for a hand; after leap_kuka/run_policy a program brings it where its actions
say, while no hand steers."""

from __future__ import annotations

import dataclasses

import numpy as np
import rospy
from geometry_msgs.msg import Transform, TransformStamped
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, SetBoolRequest
from tf2_msgs.msg import TFMessage

from common import clock
from common.config import required
from common.frames import BASE, FLANGE_DESIRED, HAND, HAND_FILTERED, ONE_ARM, TOOL_DESIRED, VIRTUAL_LEAP, ArmFrames
from common.poses import read_only
from common.robot_hand import HAND as ROBOT_HAND
from common.ros.conversions import pose_in, transform_message
from common.ros.diagnostics import Diagnostics, StageTimes
from common.ros.node import run
from common.ros.params import arm_frames, wait_for_config, wait_for_param
from common.ros.policy_input import PolicyInput
from common.ros.publishing import DirectPublisher
from common.ros.raw_tf import publisher_of
from common.sentences import without_numbers
from leap_kuka.arm_choice import BOTH, elsewhere
from leap_kuka.config import OPERATOR_INPUT, RELATIVE, ArmPlacement, LeapConfig
from leap_kuka.kept_tool import no_measured_tool
from leap_kuka.ros.arm_choice_node import CHOSEN_ARM
from leap_kuka.ros.hand_to_arm import DelayMonitor
from leap_kuka.ros.measured_tool import MeasuredTool
from leap_kuka.ros.reach import ReachCheck
from leap_kuka.ros.stream_status import TeleopReport
from leap_kuka.scaling import Scaling
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import TeleopResult
from leap_kuka.tool_hold import HoldAnswer
from leap_motion.frames import TrackingFrame
from leap_motion.ros.tracking import ReceivedPalms, Subscribe, subscribe
from rig_msgs.msg import KukaStatus, OperatorInput, PolicyActions
from rig_msgs.srv import HoldTool, HoldToolRequest


class ArmTeleopNode:
    """Runs the chain on each frame, and watches for the stream falling silent. `of`: namespace of the arm with a
    slash, in a node for several."""

    def __init__(
        self,
        teleop: ArmTeleop,
        reach: ReachCheck,
        engagement: str,
        subscribe: Subscribe,
        frames: ArmFrames = ONE_ARM,
        of: str = "",
    ) -> None:
        self._teleop = teleop
        self._reach = reach
        self._base = frames(BASE)
        self._virtual = frames(VIRTUAL_LEAP)
        self._hand = frames(HAND)
        self._filtered = frames(HAND_FILTERED)
        self._tool = frames(TOOL_DESIRED)
        self._flange = frames(FLANGE_DESIRED)
        self._bad_input = ""
        self._lock = clock.Lock()
        self._tf = DirectPublisher("/tf", TFMessage, queue_size=10)
        self._sent: dict[str, tuple[np.ndarray, Transform]] = {}  # poses of the newest message, by frame; read-only
        self._stage_times = StageTimes("leap_kuka", of)
        self._report = TeleopReport(engagement, teleop.switches.enabling_needed, teleop.box, self._virtual, of)
        self._hand_to_arm = DelayMonitor(teleop.T_tool_flange, frames)
        self._servo = False
        rospy.Subscriber(f"{of}kuka/status", KukaStatus, self._on_status, queue_size=1, tcp_nodelay=True)
        operator_input = f"{of}leap_kuka/operator_input"
        rospy.Subscriber(operator_input, OperatorInput, self._on_input, queue_size=10, tcp_nodelay=True)
        rospy.Service(f"{of}leap_kuka/hold_tool", HoldTool, self._on_hold_request)
        self._policy = PolicyInput(PolicyActions, self._base, len(ROBOT_HAND.motors), of)
        self._policy_fault = ""
        rospy.Service(f"{of}leap_kuka/run_policy", SetBool, self._on_run_policy)
        if teleop.switches.elsewhere:  # the topic is that of all arms
            self._arm = frames.tf_prefix
            rospy.Subscriber(CHOSEN_ARM, String, self._on_choice, queue_size=10, tcp_nodelay=True)
        Diagnostics("leap_kuka", self._diagnostics, of)
        subscribe(self._on_frame, ReceivedPalms)

    def watch(self) -> None:
        """Watches the stream until ROS shuts down."""
        while not rospy.is_shutdown():
            with self._lock:
                silent = self._teleop.silence(clock.monotonic())
                if silent is not None:
                    self._report.update(silent)
            self._report.flush()
            clock.sleep(0.1)

    def _on_frame(self, frame: TrackingFrame, stamp: rospy.Time) -> None:
        action = self._policy.now
        with self._lock:
            result = self._teleop.step(frame, clock.monotonic(), None if action is None else action.T_base_tool)
            self._report_lead()
            if result.usable:
                self._tf.publish(self._transforms(result, stamp))
                self._stage_times.done(stamp)
            self._report.update(result)
        if self._servo and result.owner is not None:
            for hand in frame.hands:
                if (hand.id, hand.is_left) == result.owner:
                    self._hand_to_arm.palm.add(stamp.to_sec(), hand.palm.tolist())

    def _on_status(self, status: KukaStatus) -> None:
        self._servo = status.mode == KukaStatus.SERVO
        with self._lock:
            o = status.scaling_offset
            offset = read_only([o.x, o.y, o.z])
            self._reach.scaling = dataclasses.replace(self._reach.scaling, factor=status.scaling_factor, offset=offset)
            now = clock.monotonic()
            self._teleop.control(status.control_on, status.mode, status.scaling_factor, now, offset)

    def _on_input(self, message: OperatorInput) -> None:
        age = (rospy.Time.now() - message.header.stamp).to_sec()
        with self._lock:
            device = self._teleop.switches.device
            now, program = clock.monotonic(), publisher_of(message)
            refused = device.take(message.enabled, message.clutch, message.source, age, now, program)
        if refused and not self._bad_input:
            rospy.logwarn("The operator input is refused: %s.", refused)
        self._bad_input = refused or ""

    def _on_choice(self, message: String) -> None:
        with self._lock:
            self._teleop.choose(elsewhere(message.data, self._arm), message.data != BOTH)

    def _on_run_policy(self, request: SetBoolRequest) -> tuple[bool, str]:
        self._policy.clear()  # nobody waited for what came before
        with self._lock:
            fault = self._teleop.allow_lead(request.data, clock.monotonic())
        if fault:
            return False, f"The policy's actions do not count: {fault}."
        sentence = f"The policy's actions {'count' if request.data else 'no longer count'}."
        rospy.loginfo(sentence)
        return True, sentence

    def _report_lead(self) -> None:
        """Logs what keeps a policy from the tool, once, whatever numbers it has."""
        fault = self._teleop.lead_fault
        kind = without_numbers(fault)
        if fault and kind != self._policy_fault:
            rospy.logwarn("The policy does not steer the tool: %s.", fault)
        self._policy_fault = kind

    def _on_hold_request(self, request: HoldToolRequest) -> tuple[bool, str]:
        answer = self._hold(request)
        (rospy.loginfo if answer.success else rospy.logwarn)(answer.sentence)
        return answer.success, answer.sentence

    def _hold(self, request: HoldToolRequest) -> HoldAnswer:
        with self._lock:
            if request.duration == 0.0:
                return self._teleop.end_hold()
            try:
                T_base_tool = pose_in(self._base, request.tool)
            except ValueError as error:
                return HoldAnswer(False, f"The tool is not held: {error}.")
            return self._teleop.hold(T_base_tool, request.duration, clock.monotonic())

    def _transforms(self, result: TeleopResult, stamp: rospy.Time) -> TFMessage:
        """Returns all tf frames of one tracking frame in one message, so that a listener gets all of them or none."""
        T_virtual_tool = result.T_virtual_tool
        T_virtual_flange = None if T_virtual_tool is None else T_virtual_tool @ self._teleop.T_tool_flange
        below = [
            (result.T_virtual_hand, self._hand),
            (result.T_virtual_filtered, self._filtered),
            (T_virtual_tool, self._tool),
            (T_virtual_flange, self._flange),
        ]
        poses = [(result.T_base_virtual, self._base, self._virtual)]
        poses += [(T, self._virtual, child) for T, child in below if T is not None]
        before, self._sent = self._sent, {}
        for T, _, child in poses:
            T_before, message = before.get(child, (None, None))
            self._sent[child] = T, message if T is T_before else transform_message(T)
        return TFMessage([
            TransformStamped(Header(0, stamp, parent), child, self._sent[child][1]) for _, parent, child in poses
        ])  # fmt: skip

    def _diagnostics(self):
        level, reason, state = self._report.text
        rate = self._teleop.frame_rate
        values = {"state": state, "frame_rate": "" if rate is None else f"{rate:.1f}"}
        return level, reason, {**values, **self._hand_to_arm.values(), **dataclasses.asdict(self._teleop.counts)}


def read_arm_placement(of: str = "") -> ArmPlacement:
    """Waits for the arm's parameters, of which the controller uploads kuka/ws_center last, and returns them. `of`:
    namespace of the arm with a slash, in a node for several."""
    for key in required(ArmPlacement):
        wait_for_param(f"{of}kuka/{key}")
    return wait_for_config(ArmPlacement, f"{of}kuka", others=rospy.get_param(f"{of}kuka"))


def start(subscribe: Subscribe = subscribe, of: str = "") -> None:
    """Follows the tracking frames of `subscribe` until ROS shuts down; `of` as of ArmTeleopNode."""
    leap = wait_for_config(LeapConfig, f"{of}leap", others=(OPERATOR_INPUT,))
    arm = read_arm_placement(of)
    frames = arm_frames(of)
    reach = ReachCheck(Scaling(arm.ws_center), frames, of)
    measured = MeasuredTool(arm.T_flange_tool, frames, of) if leap.engagement == RELATIVE else no_measured_tool
    ArmTeleopNode(ArmTeleop(leap, arm, reach, measured), reach, leap.engagement, subscribe, frames, of).watch()


def main() -> None:
    run("leap_kuka_node", start)
