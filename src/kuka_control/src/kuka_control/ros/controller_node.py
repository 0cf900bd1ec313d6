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
from common.ros.diagnostics import Diagnostics
from common.ros.params import wait_for_config
from common.ros.stage_times import StageTimes
from kst.client import KstClient
from kst.errors import NoServer
from kuka_control import assembly
from kuka_control.arm import KstArm
from kuka_control.assembly import Rig
from kuka_control.commands import End, Event, Servo
from kuka_control.config import ArmConfig, PtpConfig, RealTimeConfig, neighbours
from kuka_control.control_loop import ControlLoop
from kuka_control.controller import Controller, Inputs
from kuka_control.ros.desired_tool import DesiredTool
from kuka_control.ros.dh_file import dh_deviations
from kuka_control.ros.services import Services
from kuka_control.ros.state_publisher import Snapshot, StatePublisher
from kuka_control.ros.tool_check_service import ToolCheckService
from kuka_control.ros.workspace_markers import publish_workspace
from kuka_control.switches import Switches
from kuka_control.wrench import wrench_at_tool

PARAMETERS_S = 15.0
"""How long some of the parameters may be there before the others, such as those for leap_kuka alone [s]."""

CONNECT_PATIENCE_S = 20.0
CONNECT_RETRY_S = 0.5

SWITCH_INTERVAL_S = 5e-4
"""How long the control loop waits at most for another thread of this process [s]."""

SHUTDOWN_S = 0.5
"""A lost connection is no fault if ROS is to shut down within this time [s]."""


def real_time_main() -> None:
    """The node kuka_real_time_node."""
    node.run("kuka_real_time_node", lambda: _run(RealTimeConfig, assembly.real_time_loop))


def ptp_main() -> None:
    """The node kuka_ptp_node."""
    node.run("kuka_ptp_node", lambda: _run(PtpConfig, assembly.ptp_loop))


def _run(schema: type[ArmConfig], make_loop: Callable[[ArmConfig, Rig], ControlLoop]) -> None:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    config = wait_for_config(schema, "kuka", others=neighbours(schema), patience=PARAMETERS_S)
    rig = Rig.of(config, dh_deviations(config))
    arm = _connect(config, rig)
    try:
        rospy.set_param("kuka/ws_center", rig.home.centre.tolist())
        rospy.set_param("kuka/joints_home", rig.home.q.tolist())
        _Node(config, rig, arm, make_loop(config, rig)).spin()
    finally:
        arm.close()
        rospy.loginfo("The connection to the robot is closed.")


def _connect(config: ArmConfig, rig: Rig) -> KstArm:
    """Connects; a server that is not there yet, because it is started at the same time, is tried again for a while."""
    rospy.loginfo("Connecting to the robot at %s:%d.", config.ip, config.port)
    deadline = time.monotonic() + CONNECT_PATIENCE_S
    waiting = False
    while not rospy.is_shutdown():
        try:
            client = KstClient.connect(config.ip, config.port, tool=rig.T_flange_tool)
            return KstArm(client, partial(wrench_at_tool, rig.kinematics))
        except DeviceError as error:
            if not isinstance(error, NoServer) or time.monotonic() > deadline:
                if _ends_soon():
                    break
                sentence = f"There is no connection to the robot at {config.ip}:{config.port}: {error}."
                raise DeviceError(sentence) from error
            if not waiting:
                rospy.logwarn("%s. Trying for %g s.", error, CONNECT_PATIENCE_S)
            waiting = True
            time.sleep(CONNECT_RETRY_S)
    raise rospy.ROSInterruptException("shut down while connecting")


class _Node:
    """Everything that lives while the arm is connected."""

    def __init__(self, config: ArmConfig, rig: Rig, arm: KstArm, loop: ControlLoop) -> None:
        self._arm = arm
        self._loop = loop
        self._controller = Controller(arm, loop)
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
        """Runs the control loop until it ends, or ROS does.

        Raises:
            RigError: the controller ended because of a fault.
        """
        self._state.start()
        Diagnostics("kuka_control", self._diagnosis)
        deadline = 0.0
        try:
            while not rospy.is_shutdown():
                desired = self._desired.wait(deadline)
                started = time.monotonic()
                self._cycle(desired)
                deadline = started + (self._servo_period if self._controller.in_servo else self._rest_period)
                if isinstance(self._step.command, End):
                    return self._end(self._step.command)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():  # then the topics close during a cycle
                raise
        except DeviceError as error:
            if _ends_soon():
                rospy.loginfo("The robot's controller ended while this controller shut down: %s.", error)
                return
            raise DeviceError(
                f"The robot is out of reach: {error}. Start MatlabToolboxServer on the smartPad again, "
                "then this controller."
            ) from error
        finally:
            self._state.stop()

    def _for_tool_check(self) -> tuple[str, np.ndarray | None, float]:
        step = self._step
        return "starting" if step is None else step.mode, self._arm.state.joints, self._switches.read().scale

    def _end(self, command: End) -> None:
        if command.fault is not None:
            raise RigError(command.fault)

    def _cycle(self, desired) -> None:
        switched = self._switches.read()
        inputs = Inputs(
            desired=desired,
            clock=rospy.get_time(),
            control_on=switched.control_on,
            engagements=switched.engagements,
            scale=switched.scale,
            exit_requested=switched.exit_requested,
        )
        step = self._step = self._controller.cycle(inputs, time.monotonic())
        if isinstance(step.command, Servo) and step.command.stamp is not None:
            self._stages.done(self._desired.stamp)
        self._switches.report(step.mode, self._loop.stopped_because)
        self._state.show(
            Snapshot(
                self._arm.state,
                step,
                switched,
                self._controller.moving,
                self._controller.in_servo,
                self._arm.round_trip,
            )
        )
        for event in step.events:
            _log(event)

    def _diagnosis(self):
        step = self._step
        estimated = ", ".join(self._arm.estimated_in_servo)
        counts = {**self._loop.counts, "missed_answers": self._controller.missed, "estimated_in_servo": estimated}
        if step is None:
            return DiagnosticStatus.OK, "starting", {"mode": "starting", **counts}
        level = DiagnosticStatus.ERROR if self._loop.stopped_because else DiagnosticStatus.OK
        return level, step.reason, {"mode": step.mode, **counts}


def _ends_soon() -> bool:
    """Returns whether ROS shuts down: when all is ended at once, the robot's controller may be gone a moment before."""
    deadline = time.monotonic() + SHUTDOWN_S
    while not rospy.core.is_shutdown_requested() and not rospy.is_shutdown():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def _log(event: Event) -> None:
    {"info": rospy.loginfo, "warn": rospy.logwarn, "error": rospy.logerr}[event.level](event.sentence)
