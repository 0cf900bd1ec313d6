"""The node grasp_execution: has the arm wait above a proposed grasp for an operator's hand and reports the outcome.

Services: grasping/execute and grasping/cancel (std_srvs/Trigger). Out: grasping/state, grasping/outcome,
grasping/proposal_marker. In: see execution_io.py. Asks kuka/check_tool_pose and leap_kuka/hold_tool; moves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Pose, PoseStamped
from std_srvs.srv import Trigger, TriggerResponse

from common import clock
from common.config import parse, required, vector
from common.errors import DeviceError
from common.frames import BASE
from common.mounting import ToolConfig, mounting_field, mounting_frame
from common.ros.conversions import stamped_pose
from common.ros.diagnostics import Diagnostics
from common.ros.inputs import FaultLog
from common.ros.node import run, while_running
from common.ros.params import private_config, wait_for_param
from common.ros.service_calls import call
from common.teleop_record import HELD
from grasping.execution import execution
from grasping.execution.grasp_watch import GraspWatchConfig
from grasping.pipeline.tool_pose import ToolPoseConfig
from grasping.ros.execution_io import NO_GRASP, ExecutionDisplay, ExecutionInputs, proposals_from
from rig_msgs.srv import CheckToolPose, HoldTool

SECTIONS = {"watch": GraspWatchConfig, "tool_pose": ToolPoseConfig}


@dataclass(frozen=True)
class ExecutionArmConfig(ToolConfig):
    """The arm's parameters under kuka/."""

    center_line: np.ndarray = vector(3, doc="middle of the workspace seen from above")
    mounting: np.ndarray = mounting_field()

    def faults(self) -> list[str]:
        return super().faults() + ([] if np.any(self.center_line) else ["center_line is the zero vector."])


class ExecutionNode:
    """Answers the services and runs the execution."""

    def __init__(
        self, config: execution.ExecutionConfig, watch: GraspWatchConfig, tool: ToolPoseConfig, arm: ExecutionArmConfig
    ) -> None:
        self._config = config
        self._tool = tool
        self._home = mounting_frame(arm.center_line, arm.mounting)
        self._execution = execution.Execution(config, watch, self._home.up)
        self._lock = clock.Lock()
        self._asking = clock.Lock()
        self._grasp = NO_GRASP
        self._goal = None
        self._counts = {"executed": 0, "refused": 0, "held": 0, "not_held": 0}
        self._inputs = ExecutionInputs(arm.T_flange_tool, config.silence)
        self._display = ExecutionDisplay()
        self._log = FaultLog()
        Diagnostics("grasp_execution", self._diagnose)
        rospy.Service("grasping/execute", Trigger, self._on_execute)
        rospy.Service("grasping/cancel", Trigger, self._on_cancel)
        rospy.on_shutdown(lambda: self._end("The node grasp_execution ended."))

    def spin(self) -> None:
        period_s = 0.05
        while not rospy.is_shutdown():
            with while_running(), self._lock:
                outcome = self._execution.step(self._inputs.observe(), clock.monotonic())
                self._publish(outcome)
            self._release(outcome)
            clock.sleep(period_s)

    def _on_execute(self, _) -> TriggerResponse:
        if not self._asking.acquire(blocking=False):
            return TriggerResponse(False, "Another execution is being requested.")
        try:
            refusal = self._begin()
        finally:
            self._asking.release()
        if refusal is not None:
            self._counts["refused"] += 1
            rospy.logwarn("No grasp is executed: %s", refusal)
            return TriggerResponse(False, refusal)
        sentence = f"The arm goes before the grasp {self._grasp.id} and waits there for a hand."
        rospy.loginfo(sentence)
        return TriggerResponse(True, sentence)

    def _begin(self) -> str | None:
        """Begins an execution, or returns why not, one sentence."""
        if self._execution.running:
            return f"The grasp {self._grasp.id} is being executed; cancel it first."
        inputs, message = self._inputs, self._inputs.grasps
        proposals = None if message is None else proposals_from(message, rospy.Time.now())
        request = execution.ExecutionRequest(proposals, inputs.controller, inputs.hand_followed, self._config.fresh)
        chosen = execution.choose(request)
        if isinstance(chosen, execution.Refusal):
            return chosen.sentence
        goal = execution.tool_goal(chosen, self._tool, self._home.R_base_tool, self._home.up)
        if isinstance(goal, execution.Refusal):
            return goal.sentence
        refusal = self._hold_above(goal)
        if refusal is not None:
            return refusal
        with self._lock:
            self._grasp, self._goal = next(g for g in message.grasps if g.id == chosen.id), goal
            self._counts["executed"] += 1
            self._execution.start(goal.T_base_above, clock.monotonic())
            self._display.show(self._execution, self._grasp, goal)
        return None

    def _check(self, T_base_tool: np.ndarray) -> tuple[Pose, str | None]:
        """Returns the desired tool frame, and why the arm does not reach it, None if it does."""
        tool = stamped_pose(T_base_tool, BASE, rospy.Time.now())
        try:
            answer = call("kuka/check_tool_pose", CheckToolPose, tool, timeout=self._config.answer_time)
        except DeviceError as error:
            return Pose(), f"It is unknown whether the arm reaches the grasp: {error}."
        return answer.desired, None if answer.success else answer.message

    def _hold_above(self, goal: execution.ToolGoal) -> str | None:
        """Requests that the tool is held before the grasp; returns why it is not, one sentence, or None."""
        for T_base_tool in (goal.T_base_tool, goal.T_base_above):
            desired, refusal = self._check(T_base_tool)
            if refusal is not None:
                return refusal
        tool = PoseStamped(pose=desired)
        tool.header.frame_id = BASE
        config = self._config
        try:
            answer = call("leap_kuka/hold_tool", HoldTool, tool, config.wait_for_hand, timeout=config.answer_time)
        except DeviceError as error:
            self._let_go()
            return f"The tool is not held: {error}."
        return None if answer.success else answer.message

    def _on_cancel(self, _) -> TriggerResponse:
        with self._asking:
            if not self._end("The operator cancelled the execution."):
                if self._inputs.observe().hold == HELD:
                    self._let_go()
                return TriggerResponse(True, "No grasp is being executed.")
        return TriggerResponse(True, "The execution is over; a hand that steers the arm keeps control.")

    def _end(self, sentence: str) -> bool:
        """Ends the execution; returns whether there was one."""
        with while_running(), self._lock:
            if not self._execution.running:
                return False
            outcome = self._execution.end(sentence)
            self._publish(outcome)
        self._release(outcome)
        return True

    def _publish(self, outcome: execution.ExecutionOutcome | None) -> None:
        if outcome is not None:
            self._counts["held" if outcome.held else "not_held"] += 1
            self._display.publish(outcome, self._grasp)
        self._display.show(self._execution, self._grasp, self._goal)

    def _release(self, outcome: execution.ExecutionOutcome | None) -> None:
        if outcome is not None and outcome.release:
            self._let_go()

    def _let_go(self) -> None:
        """Cancels the hold; without an answer, the hold stops when its time is over."""
        try:
            call("leap_kuka/hold_tool", HoldTool, PoseStamped(), 0.0, timeout=self._config.answer_time)
        except DeviceError as error:
            rospy.logwarn("The tool may still be held, for %g s at most: %s.", self._config.wait_for_hand, error)

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {"state": self._execution.state.value, "episode": self._execution.episode, **self._counts}
        missing = self._log(self._inputs.missing())
        if missing:
            return DiagnosticStatus.WARN, f"No grasp can be executed: {missing}.", values
        return DiagnosticStatus.OK, self._execution.reason, values


def _run() -> None:
    config = private_config(execution.ExecutionConfig, others=SECTIONS)
    sections = {name: private_config(schema, name) for name, schema in SECTIONS.items()}
    rospy.loginfo("%s; %s", config, "; ".join(str(section) for section in sections.values()))
    for name in required(ExecutionArmConfig):
        wait_for_param(f"kuka/{name}")
    given = rospy.get_param("kuka")
    arm = parse(ExecutionArmConfig, given, "kuka/", others=given)
    ExecutionNode(config, sections["watch"], sections["tool_pose"], arm).spin()


def main() -> None:
    run("grasp_execution", _run)
