"""The two controllers as ROS nodes: parameters -> rig -> robot -> control loop -> topics, tf and services."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common import clock
from common.errors import ConfigError, DeviceError, RigError
from common.frames import ArmFrames
from common.modes import Mode
from common.numbers import SWITCH_INTERVAL_S
from common.ros import master, node
from common.ros.diagnostics import Diagnostics, StageTimes
from common.ros.files import read_yaml
from common.ros.params import arm_frames, wait_for_config
from common.ros.service_calls import ask_master
from common.ros.simulated_devices import SimulatedDevices
from common.rotations import quaternion_from_rotation
from common.simulated import WITHOUT_HARDWARE
from kst import ApplicationSettings, KstClient, KstError, NoServer, ReplyTimeout, SoftSettings
from kuka_control.loop import assembly
from kuka_control.loop.arm import KstArm
from kuka_control.loop.commands import End, Event, Inputs, Servo, Step
from kuka_control.loop.control_loop import ControlLoop
from kuka_control.loop.controller import Controller, ReconnectSupervisor
from kuka_control.model.config import ControllerConfig, PtpConfig, RealTimeConfig, neighbours
from kuka_control.model.joint_configurations import named_configurations
from kuka_control.model.rig import Rig
from kuka_control.model.switches import Switches
from kuka_control.model.target import MotionScaling
from kuka_control.model.tool_load import wrench_at_tool
from kuka_control.numbers import AGAIN_TIMEOUT_S, BRAKING_S, PROBE_S, TIMEOUT_S
from kuka_control.ros.arm_placement import placed_beside_others
from kuka_control.ros.desired_tool import DesiredTool
from kuka_control.ros.emergency import TOLD_TO_STOP
from kuka_control.ros.enabling import EnablingWatch
from kuka_control.ros.guard_view import GuardView, HandOpening
from kuka_control.ros.moves import MoveServer
from kuka_control.ros.panel_process import control_panel
from kuka_control.ros.parameter_server import dh_deviations, guard_obstacles, running, shipped
from kuka_control.ros.services import Services, offer_tool_check
from kuka_control.ros.state_publisher import GoalPublisher, Snapshot, StatePublisher, publish_workspace

NAMED_POSITIONS = "joint_configurations.yaml"
PARAMETERS_S = 15.0  # if only some parameters are set, such as those for leap_kuka, wait this long for the others [s]
RETRY_POLL_S = 0.05  # polling interval of the switches while the robot is out of reach [s]
PATIENCE_S = 20.0  # how long a server that does not run yet is tried again at the start [s]
LONGEST_PERIOD_S = 0.025  # of the control loop, so that pauses of the desired tool frame are seen [s]
SHUTDOWN_S = 0.5  # a lost connection is no fault if ROS is to shut down within this time [s]


LIFTED = "The workspace is lifted: no bound keeps the tool from the table, the base and people; only its centre counts."
LIFT_REFUSED = (
    "--lift-workspace is refused: kuka/ip is {ip}, which is not an address of this machine, so the robot may be a real "
    "one; leave the option out, or add --i-know."
)
LIFT_BESIDE = (
    "--lift-workspace is refused: the parameter arms places another arm beside this one, and only their workspaces "
    "keep them apart; leave the option out."
)


class RobotLink:
    """Holds the connection to the robot, `arm`: made at the start, made again after it was lost, closed at the end.
    `goals`: what is sent over it. A server that is not there yet at the start, because it is started at the same
    time, is tried again for a while. Raises DeviceError: there is no connection."""

    def __init__(self, config: ControllerConfig, rig: Rig) -> None:
        self._config = config
        self._rig = rig
        self.goals = GoalPublisher()
        rospy.loginfo("Connecting to the robot at %s:%d.", config.ip, config.port)
        self.arm = self._first()

    def close(self) -> None:
        """Leaves servo mode and closes the connection; never raises."""
        self.arm.close()

    def stop(self) -> str | None:
        """Stops the arm where the robot can do that; returns what to say of it, a part of a sentence. From any
        thread, also while the control loop hangs."""
        if "stop" not in self.arm.abilities:
            return None
        try:
            self.arm.stop()
        except KstError as error:
            return f"the robot could not be told to stop ({error}), but stops as its client is gone"
        return TOLD_TO_STOP

    def again(self) -> None:
        """Tries once to connect, or raises KstError; `arm` is another one then."""
        before, self.arm = self.arm, self._connected(AGAIN_TIMEOUT_S)
        before.close()

    def _first(self) -> KstArm:
        retry_s = 0.5
        config, waiting = self._config, False
        deadline = clock.monotonic() + PATIENCE_S
        while not rospy.is_shutdown():
            try:
                return self._connected(TIMEOUT_S)
            except KstError as error:
                if not isinstance(error, NoServer) or clock.monotonic() > deadline:
                    if ends_soon():
                        break
                    sentence = f"There is no connection to the robot at {config.ip}:{config.port}: {error}."
                    if not config.on_this_machine:
                        sentence = f"{sentence} {WITHOUT_HARDWARE}"
                    raise DeviceError(sentence) from error
                if not waiting:
                    rospy.logwarn("%s. Trying for %g s.", error, PATIENCE_S)
                waiting = True
                clock.sleep(retry_s)
        raise rospy.ROSInterruptException("shut down while connecting")

    def _connected(self, timeout: float) -> KstArm:
        config, rig = self._config, self._rig
        application, weighed = None, False
        if config.robot_server == "leap_rig":
            mass, centre = config.tool_mass, config.tool_center_of_mass
            application = ApplicationSettings(config.watchdog_brake, config.watchdog_end, mass, centre)
            weighed = mass > 0.0
        client = KstClient.connect(
            config.ip, config.port, tool=rig.T_flange_tool, timeout=timeout, application=application
        )
        try:
            guarded = config.ptp_contact_torque > 0.0
            wrench = partial(wrench_at_tool, rig.kinematics)
            return KstArm(client, wrench, self.goals.sent, guarded, weighed, soft_settings(config))
        except KstError:
            client.close()
            raise


def soft_settings(config: ControllerConfig) -> SoftSettings | None:
    """Returns how a soft arm yields; None with PTP motions alone."""
    if not isinstance(config, RealTimeConfig):
        return None
    springs = config.soft_stiffness, config.soft_turning_stiffness, config.soft_damping
    return SoftSettings(*springs, config.soft_force, config.soft_moment, config.soft_path)


def ends_soon() -> bool:
    """Returns whether ROS shuts down: when all is ended at once, the robot's controller may be gone a moment before."""
    deadline = clock.monotonic() + SHUTDOWN_S
    while not rospy.core.is_shutdown_requested() and not rospy.is_shutdown():
        if clock.monotonic() > deadline:
            return False
        clock.sleep(0.02)
    return True


def real_time_main() -> None:
    _main("kuka_real_time_node", RealTimeConfig, assembly.real_time_loop)


def ptp_main() -> None:
    _main("kuka_ptp_node", PtpConfig, assembly.ptp_loop)


def _main(name: str, schema: type[ControllerConfig], make_loop: Callable[[ControllerConfig, Rig], ControlLoop]) -> None:
    parser = argparse.ArgumentParser(description=f"The node {name}, with the control panel unless gui:=false.")
    parser.add_argument(
        "--lift-workspace", action="store_true", help="in simulation: the tool may go anywhere, also into the table"
    )
    parser.add_argument("--i-know", action="store_true", help="lift the workspace of a real robot, too")
    options = parser.parse_args(rospy.myargv()[1:])

    def main() -> None:
        with control_panel():
            _run(schema, make_loop, options)

    node.run(name, main)


def _run(
    schema: type[ControllerConfig],
    make_loop: Callable[[ControllerConfig, Rig], ControlLoop],
    options: argparse.Namespace,
) -> None:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    config = wait_for_config(schema, "kuka", others=neighbours(schema), patience=PARAMETERS_S)
    frames = arm_frames()
    beside = None if config.on_this_machine else SimulatedDevices(f"arm at {config.ip}")
    if beside is not None:
        beside.refuse()
    if options.lift_workspace:
        if not (config.on_this_machine or options.i_know):
            raise ConfigError([LIFT_REFUSED.format(ip=config.ip)])
        rospy.logwarn(LIFTED)
    rig = Rig.of(config, dh_deviations(config), guard_obstacles(config), options.lift_workspace)
    arms = rospy.search_param("arms")
    uri = ask_master("lookupNode", rospy.get_name())
    rospy.set_param("kuka/running", running(config, None if arms is None else rospy.get_param(arms), uri))
    placed = None if arms is None else placed_beside_others(config, frames, arms, PARAMETERS_S)
    if placed is not None:
        if options.lift_workspace:
            raise ConfigError([LIFT_BESIDE])
        rig = replace(rig, obstacles=(*(rig.obstacles or ()), *placed.walls))
    link = RobotLink(config, rig)
    try:
        rospy.set_param("kuka/joints_home", rig.home.q.tolist())
        rospy.set_param("kuka/rotation_home", quaternion_from_rotation(rig.home.T_base_tool[:3, :3]).tolist())
        rospy.set_param("kuka/ws_center", rig.home.centre.tolist())  # the last: leap_kuka reads when this is there
        _Node(config, rig, link, partial(make_loop, config, rig), frames, beside).spin(
            None if placed is None else placed.T_world_base
        )
    finally:
        link.close()
        rospy.loginfo("The connection to the robot is closed.")


class _Node:
    """Everything that lives once the arm was connected."""

    def __init__(
        self,
        config: ControllerConfig,
        rig: Rig,
        link: RobotLink,
        make_loop: Callable[[], ControlLoop],
        frames: ArmFrames,
        beside: SimulatedDevices | None = None,
    ) -> None:
        self._beside = beside
        self._link = link
        self._lifted = rig.workspace.lifted
        self._make_loop = make_loop
        self._loop: ControlLoop | ReconnectSupervisor = make_loop()
        self._controller = Controller(link.arm, self._loop)
        stops = config.robot_server == "leap_rig"
        softens = stops and isinstance(config, RealTimeConfig)
        self._switches = Switches(getattr(config, "compliance", "stiff") == "soft", config.stiff_because)
        self._rest_period = min(1.0 / config.rate_joints, LONGEST_PERIOD_S)
        self._servo_period = 1.0 / getattr(config, "rate_servo", config.rate_joints)
        self._state = StatePublisher(rig, config, link.goals, frames)
        self._markers = publish_workspace(rig.workspace, rig.home.centre, frames)
        self._stages = StageTimes("kuka_control")
        self._desired = DesiredTool(frames)
        self._opening = HandOpening()
        self._guard_view = GuardView(config, rig, self._for_guard_view, frames)
        self._step: Step | None = None
        named = read_yaml(Path(config.named_positions) if config.named_positions else shipped(NAMED_POSITIONS))
        planner = assembly.move_planner(config, rig, named_configurations(named, rig.model))
        guide = {"unguided": config.unguided} if stops else {}
        self._moves = MoveServer(planner, lambda: (self._step, self._link.arm.measured_joints), frames, stops, **guide)
        guides = self._moves.guide if stops else None
        self._services = Services(self._switches, lambda: self._link.stop(), stops, softens, guides)
        self._enabling = EnablingWatch(self._services.stop_motion) if stops else None
        master.watch.lost.append(lambda _: self._services.disengage())
        offer_tool_check(rig, self._for_tool_check, self._guard_view.collision, frames)

    def spin(self, T_world_base: np.ndarray | None) -> None:
        """Runs the control loop until it completes or ROS shuts down; waits for a lost robot. RigError: a fault.
        `T_world_base`: where the base stands beside other arms, shape (4, 4) [m]; None for an only arm."""
        self._state.start(T_world_base)
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
            with contextlib.suppress(KstError):
                self._brake()
            self._state.stop()
            with contextlib.suppress(rospy.ROSException):
                self._moves.abort("The controller has ended.")

    def _brake(self) -> None:
        """Brings the stream of goals to rest if ROS shuts down meanwhile: without goals the arm would stop abruptly."""
        off = replace(self._switches.now, control_on=False)
        deadline = clock.monotonic() + BRAKING_S
        while self._controller.in_servo and clock.monotonic() < deadline:
            self._controller.cycle(Inputs(switches=off), clock.monotonic())
            clock.sleep(self._servo_period)

    def _run_loop(self) -> None:
        deadline = 0.0
        while not rospy.is_shutdown():
            desired = self._desired.wait(deadline)
            if self._beside is not None:
                self._beside.check()
            if self._enabling is not None:
                self._enabling.check()
            started = clock.monotonic()
            self._loop.open_hand(self._opening.at(started))
            inputs = Inputs(desired, rospy.get_time(), self._switches.now, self._moves.move, self._desired.missing)
            step = self._controller.cycle(inputs, clock.monotonic())
            if isinstance(step.command, Servo) and step.command.stamp is not None:
                self._stages.done(self._desired.stamp)
            self._show(step)
            self._say(step.events)
            deadline = started + (self._servo_period if self._controller.in_servo else self._rest_period)
            if isinstance(step.command, End):
                if step.command.fault is not None:
                    raise RigError(step.command.fault)
                return

    def _stand_by(self, error: KstError) -> bool:
        """Waits until the robot answers again or is connected again; False: this controller is to end before. Raises
        DeviceError: the robot was lost on the way to the end."""
        exits = self._switches.now.exit_requested
        self._services.hold("the robot does not answer")
        self._moves.abort("The robot does not answer; where the arm is now is not known.")
        supervisor = self._loop = ReconnectSupervisor(
            error, self._loop.counts, self._make_loop, not self._link.arm.abilities
        )
        self._controller.restart(self._link.arm, supervisor)
        if isinstance(error, ReplyTimeout):
            rospy.logerr(supervisor.reason)
            self._show(supervisor.waiting())
            try:
                deadline = clock.monotonic() + PROBE_S
                while clock.monotonic() < deadline and not (rospy.is_shutdown() or self._exit_asked(exits)):
                    if self._controller.regained():
                        self._regained(supervisor)
                        return True
                    clock.sleep(RETRY_POLL_S)
            except KstError as failure:
                error = failure
        self._services.hold("the robot is out of reach")
        if ends_soon():
            rospy.loginfo("The robot's controller ended while this controller shut down: %s.", error)
            return False
        if exits:
            raise DeviceError(f"The robot is out of reach: {error}. The arm is not at its zero position.") from error
        self._say(supervisor.lost(error, clock.monotonic()))
        self._show(supervisor.waiting())
        self._link.close()
        while not self._switches.now.exit_requested:
            if rospy.is_shutdown():
                return False
            if clock.monotonic() < supervisor.next_try:
                clock.sleep(RETRY_POLL_S)
                continue
            try:
                self._link.again()
            except KstError as failure:
                self._say(supervisor.failed(failure, clock.monotonic()))
                self._show(supervisor.waiting())
                continue
            self._controller.restart(self._link.arm, supervisor)
            self._regained(supervisor)
            return True
        return False

    def _exit_asked(self, before: bool) -> bool:
        """Returns whether the exit was requested after the robot fell silent; one from `before` waits for the robot."""
        return self._switches.now.exit_requested and not before

    def _regained(self, supervisor: ReconnectSupervisor) -> None:
        self._say(supervisor.connected())
        self._services.release()

    def _for_guard_view(self) -> tuple[np.ndarray | None, float]:
        return self._link.arm.state.joints, self._loop.guard_scale if self._controller.in_servo else 1.0

    def _for_tool_check(self) -> tuple[Mode, np.ndarray | None, MotionScaling]:
        step, scaling = self._step, MotionScaling(self._switches.now.scale)
        if step is not None and step.scaling is not None and step.scaling.factor == scaling.factor:
            scaling = step.scaling
        return Mode.STARTING if step is None else step.mode, self._link.arm.state.joints, scaling

    def _show(self, step: Step) -> None:
        self._step = step
        self._moves.show(step, self._link.arm.measured_joints)
        arm, controller = self._link.arm, self._controller
        loop, guided = self._loop, self._moves.guided
        stops = controller.moving and "stop" in arm.abilities
        self._switches.report(step.mode, loop.stopped_because, loop.when_enabled, loop.exit_in_place, stops, guided)
        self._state.show(
            Snapshot(
                *(arm.state, step, self._switches.now, controller.moving, controller.in_servo),
                *(arm.round_trip, arm.reckoned, arm.server, arm.abilities, guided),
            )
        )

    @staticmethod
    def _say(events: tuple[Event, ...]) -> None:
        for event in events:
            {"info": rospy.loginfo, "warn": rospy.logwarn, "error": rospy.logerr}[event.level](event.sentence)

    def _diagnosis(self):
        step = self._step
        estimated = ", ".join(self._link.arm.estimated_in_servo)
        controller = self._controller
        answers = {"missed_answers": controller.missed, "holds": controller.holds}
        counts = {**self._loop.counts, **answers, "estimated_in_servo": estimated}
        counts["workspace"] = "lifted" if self._lifted else "kept"
        counts["clock_offset"] = f"{self._desired.offset:.3f}"
        if step is None:
            return DiagnosticStatus.OK, "starting", {"mode": Mode.STARTING.value, **counts}
        level, reason = DiagnosticStatus.WARN if step.inhibited else DiagnosticStatus.OK, step.reason
        if self._lifted:
            level, reason = DiagnosticStatus.WARN, f"{reason} {LIFTED}"
        if self._loop.stopped_because:
            level = DiagnosticStatus.ERROR
        return level, reason, {"mode": step.mode.value, **counts}
