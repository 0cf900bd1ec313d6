"""The two controllers as ROS nodes: parameters -> rig -> robot -> control loop -> topics, tf and services."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common.errors import DeviceError, RigError
from common.ros import node
from common.ros.diagnostics import Diagnostics, StageTimes
from common.ros.params import wait_for_config
from kst import KstError
from kuka_control.loop import assembly
from kuka_control.loop.commands import End, Event, Inputs, Servo, Step
from kuka_control.loop.control_loop import ControlLoop
from kuka_control.loop.controller import Controller
from kuka_control.loop.reconnect import ReconnectSupervisor
from kuka_control.loop.switches import Switches
from kuka_control.model.config import ControllerConfig, PtpConfig, RealTimeConfig, neighbours
from kuka_control.model.mode import Mode
from kuka_control.model.rig import Rig
from kuka_control.ros.desired_tool import DesiredTool
from kuka_control.ros.dh_file import dh_deviations
from kuka_control.ros.robot_link import RobotLink, ends_soon
from kuka_control.ros.services import Services
from kuka_control.ros.state_publisher import Snapshot, StatePublisher
from kuka_control.ros.tool_check_service import ToolCheckService
from kuka_control.ros.workspace_markers import publish_workspace

PARAMETERS_S = 15.0
"""If only some parameters are set, such as those for leap_kuka alone, wait this long for the others [s]."""

RETRY_POLL_S = 0.05
"""Polling interval of the switches while the robot is out of reach [s]."""

SWITCH_INTERVAL_S = 5e-4
"""The control loop waits at most this long for another thread of this process [s]."""


def real_time_main() -> None:
    """The node kuka_real_time_node."""
    node.run("kuka_real_time_node", lambda: _run(RealTimeConfig, assembly.real_time_loop))


def ptp_main() -> None:
    """The node kuka_ptp_node."""
    node.run("kuka_ptp_node", lambda: _run(PtpConfig, assembly.ptp_loop))


def _run(schema: type[ControllerConfig], make_loop: Callable[[ControllerConfig, Rig], ControlLoop]) -> None:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    config = wait_for_config(schema, "kuka", others=neighbours(schema), patience=PARAMETERS_S)
    rig = Rig.of(config, dh_deviations(config))
    link = RobotLink(config, rig)
    try:
        rospy.set_param("kuka/ws_center", rig.home.centre.tolist())
        rospy.set_param("kuka/joints_home", rig.home.q.tolist())
        _Node(config, rig, link, partial(make_loop, config, rig)).spin()
    finally:
        link.close()
        rospy.loginfo("The connection to the robot is closed.")


class _Node:
    """Everything that lives once the arm was connected."""

    def __init__(
        self, config: ControllerConfig, rig: Rig, link: RobotLink, make_loop: Callable[[], ControlLoop]
    ) -> None:
        self._link = link
        self._make_loop = make_loop
        self._loop: ControlLoop | ReconnectSupervisor = make_loop()
        self._controller = Controller(link.arm, self._loop)
        self._switches = Switches()
        self._rest_period = 1.0 / config.rate_joints
        self._servo_period = 1.0 / getattr(config, "rate_servo", config.rate_joints)
        self._state = StatePublisher(rig, config.rate_joints, config.rate_state)
        self._markers = publish_workspace(rig.workspace, rig.home.centre)
        self._stages = StageTimes("kuka_control")
        self._desired = DesiredTool()
        self._step = None
        self._services = Services(self._switches)
        self._tool_check = ToolCheckService(rig, self._for_tool_check)

    def spin(self) -> None:
        """Runs the control loop until it completes or ROS shuts down; waits for a lost robot.

        Raises:
            RigError: the controller ended because of a fault.
        """
        self._state.start()
        Diagnostics("kuka_control", self._diagnosis)
        try:
            while not rospy.is_shutdown():
                try:
                    return self._run_loop()
                except KstError as error:
                    if not self._stand_by(error):
                        return
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():  # then the topics close during a cycle
                raise
        finally:
            self._state.stop()

    def _run_loop(self) -> None:
        deadline = 0.0
        while not rospy.is_shutdown():
            desired = self._desired.wait(deadline)
            started = time.monotonic()
            self._cycle(desired)
            deadline = started + (self._servo_period if self._controller.in_servo else self._rest_period)
            if isinstance(self._step.command, End):
                return self._end(self._step.command)

    def _stand_by(self, error: KstError) -> bool:
        """Waits until the robot is connected again; False: this controller is to end before.

        Raises:
            DeviceError: the robot was lost on the way to the end.
        """
        self._services.hold("the robot is out of reach")
        if ends_soon():
            rospy.loginfo("The robot's controller ended while this controller shut down: %s.", error)
            return False
        if self._switches.read().exit_requested:
            raise DeviceError(f"The robot is out of reach: {error}. The arm is not at its zero position.") from error
        supervisor = self._loop = ReconnectSupervisor(error, self._loop.counts, self._make_loop, time.monotonic())
        self._controller.restart(self._link.arm, supervisor)
        rospy.logerr(supervisor.reason)
        self._show(supervisor.waiting())
        self._link.close()
        while not self._switches.read().exit_requested:
            if rospy.is_shutdown():
                return False
            if time.monotonic() < supervisor.next_try:
                time.sleep(RETRY_POLL_S)
                continue
            try:
                self._link.again()
            except KstError as failure:
                self._say(supervisor.failed(failure, time.monotonic()))
                self._show(supervisor.waiting())
                continue
            self._controller.restart(self._link.arm, supervisor)
            self._say(supervisor.connected())
            self._services.release()
            return True
        return False

    def _for_tool_check(self) -> tuple[Mode, np.ndarray | None, float]:
        step = self._step
        return Mode.STARTING if step is None else step.mode, self._link.arm.state.joints, self._switches.read().scale

    def _end(self, command: End) -> None:
        if command.fault is not None:
            raise RigError(command.fault)

    def _cycle(self, desired) -> None:
        inputs = Inputs(desired, rospy.get_time(), self._switches.read())
        step = self._controller.cycle(inputs, time.monotonic())
        if isinstance(step.command, Servo) and step.command.stamp is not None:
            self._stages.done(self._desired.stamp)
        self._show(step)
        self._say(step.events)

    def _show(self, step: Step) -> None:
        self._step = step
        self._switches.report(step.mode, self._loop.stopped_because)
        self._state.show(
            Snapshot(
                self._link.arm.state,
                step,
                self._switches.read(),
                self._controller.moving,
                self._controller.in_servo,
                self._link.arm.round_trip,
            )
        )

    @staticmethod
    def _say(events: tuple[Event, ...]) -> None:
        for event in events:
            {"info": rospy.loginfo, "warn": rospy.logwarn, "error": rospy.logerr}[event.level](event.sentence)

    def _diagnosis(self):
        step = self._step
        estimated = ", ".join(self._link.arm.estimated_in_servo)
        counts = {**self._loop.counts, "missed_answers": self._controller.missed, "estimated_in_servo": estimated}
        if step is None:
            return DiagnosticStatus.OK, "starting", {"mode": Mode.STARTING.value, **counts}
        level = DiagnosticStatus.ERROR if self._loop.stopped_because else DiagnosticStatus.OK
        return level, step.reason, {"mode": step.mode.value, **counts}
