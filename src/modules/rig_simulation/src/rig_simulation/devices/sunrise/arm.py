"""The arm of the simulated controller: joints that move, a safety stop, torques. No threads; time is handed in. Joint
angles in rad, positions in m in `kuka/base_frame`, forces in N and torques in Nm."""

from __future__ import annotations

import collections
import dataclasses
import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from common.poses import read_only
from rig_description.hand import tool_body
from rig_simulation.devices.sunrise.compliance import GivesUp, Softness, SoftServo
from rig_simulation.devices.sunrise.paths import JointMove
from rig_simulation.devices.sunrise.robot import CYCLE_S, LAWS, MIN_TRAJECTORY_TIME_S, Drives, Robot

FULL_SPEED_TIME_S = 0.1  # time until a joint at its acceleration limit reaches full speed; the data sheet has none
MOTION_FRACTION = 0.4  # of the acceleration limit for planned motions; the rest is reserved for braking on the path
TRAIL_STEP_RAD = 1e-3


@dataclasses.dataclass(frozen=True)
class ArmSettings:
    """Settings of the arm."""

    torque_limit: float = 25.0  # safety stop above this external torque of any joint [Nm]
    speed_limit: float = 0.8  # safety stop above this speed of the tool point [m/s]
    servo_law: str = "lts"  # "lts" or "none"
    trajectory_time: float = MIN_TRAJECTORY_TIME_S  # minimum trajectory time of DirectServo [s]
    tool_weight: bool = False  # whether the hand's weight counts as external, as the toolbox's tool has no mass


class ArmEnvironment(Protocol):
    """What the arm touches."""

    def follow(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Advances by dt [s] to where the drives hold the angles q [rad] at the speeds v [rad/s], shape (7,); returns
        the torques of contacts and load on the joints, shape (7,) [Nm], as the controller estimates them."""

    @property
    def reaction(self) -> np.ndarray:
        """The same torques as they are, without the time that the estimate takes."""


class SimulatedArm:
    """The arm; starts at rest in the zero position. Without an environment it touches nothing. `goal`, shape (7,)
    [rad], is the last goal of the servo mode."""

    def __init__(self, robot: Robot, settings: ArmSettings, environment: ArmEnvironment | None = None) -> None:
        back_off_speed_rad_s = 0.05
        trail_length = 1000
        history_steps = 5000
        self.robot = robot
        self.settings = settings
        self._environment = environment
        self.time: float | None = None  # up to which the arm has moved [s]
        self.q, self.v = np.zeros(7), np.zeros(7)  # joint angles [rad] and speeds; replaced, never changed
        self._v_before, self._last_dt = self.v, CYCLE_S
        self.T_flange_tool = np.eye(4)  # the attached tool
        self.hand = tool_body()  # what is on the flange
        self.goal = np.zeros(7)
        self.safety_stop: str | None = None  # cause of the active safety stop
        self.stops = 0  # safety stops so far
        self.emergency_stop = False  # whether its button is pressed
        self.tool_speed = self.max_tool_speed = 0.0  # of the tool point, now and highest so far [m/s]
        self.acceleration = read_only(robot.max_speed / FULL_SPEED_TIME_S)
        self.motion_acceleration = read_only(MOTION_FRACTION * self.acceleration)
        # Of the last steps: time [s], joints [rad] and their speeds [rad/s], speed of the tool point [m/s].
        self.history: collections.deque[tuple[float, np.ndarray, np.ndarray, float]] = collections.deque(
            maxlen=history_steps
        )
        self._drives = Drives(robot.max_speed, self.acceleration, settings.trajectory_time)
        self._law = LAWS[settings.servo_law]
        self.in_servo = False  # whether the servo mode runs
        self.destination: np.ndarray | None = None  # of the servo mode in place of its law's, shape (7,) [rad]
        self._known: list[tuple[float, np.ndarray]] = [(0.0, np.zeros(3))] * 2  # that it reckons with
        self.gave_up = ""  # why the controller ended the servo mode or the hand guiding
        self._soft: SoftServo | None = None  # in servo mode
        self._guide: SoftServo | None = None  # while a hand may guide the arm
        self.enabling = False  # whether the enabling switch of the hand guiding is pressed
        self._guided = False  # whether it was, since the hand guiding began
        self._motion: JointMove | None = None
        self._break_when: Callable[[SimulatedArm], str] | None = None
        self.broken_by = ""  # what broke the last planned motion
        self._motion_time, self._motion_rate = 0.0, 1.0
        self._braking_time = math.inf  # longest, of a planned motion that is to stop at once [s]
        self._breaking = False
        self._joint_torque, self._tool_force, self._touch_torque = np.zeros(7), np.zeros(3), np.zeros(7)
        self._trail: collections.deque[np.ndarray] = collections.deque(maxlen=trail_length)
        self._backing_off = False
        self._back_drives = Drives(np.full(7, back_off_speed_rad_s), self.acceleration, settings.trajectory_time)
        self._steps = 0
        self._checked_goal: np.ndarray | None = None  # the last goal within the joint range

    def advance(self, now: float) -> None:
        """Moves the arm up to the time `now` [s]; after a longer delay it skips all but 1 s, in an
        environment all but 0.05 s."""
        max_catch_up_s = 1.0
        max_catch_up_in_environment_s = 0.05  # the arm rather loses time: steps take longer there, and requests wait
        longest = max_catch_up_s if self._environment is None else max_catch_up_in_environment_s
        if self.time is None or now - self.time > longest + CYCLE_S:
            self.time = now if self.time is None else now - longest
        if self.asleep:
            self.time = max(self.time, now)
            return
        for _ in range(int((now - self.time) / CYCLE_S + 1e-6)):
            self.step(CYCLE_S)

    def step(self, dt: float) -> None:
        """Moves the arm by one step of dt [s]."""
        safety_period_steps = 4
        v_before = self.v
        if self._motion is not None:
            self._step_motion(self._motion, dt)
        elif self._guide is not None:
            self._step_guide(self._guide, dt)
        elif self._backing_off:
            self._step_back(dt)
        elif self.in_servo and self.safety_stop is None:
            self._step_servo(dt)
        else:
            self._move(self._drives.brake(self.v, dt), dt)
        self._v_before, self._last_dt = v_before, dt
        if self.time is not None:
            self.time += dt
        if self._environment is not None:
            self._touch_torque = self._environment.follow(self.q, self.v, dt)
        self._steps += 1
        comes_to_rest = self.resting and v_before.any()
        if self._steps % safety_period_steps == 0 or comes_to_rest:
            self._check_safety()
        if self.time is not None:
            self.history.append((self.time, self.q, self.v, self.tool_speed))

    @property
    def braking(self) -> bool:
        """Whether a planned motion or hand guiding is under way and brakes for good."""
        return self.in_motion and self._breaking

    @property
    def resting(self) -> bool:
        """Whether the arm is at rest and nothing will move it by itself."""
        driven = self.in_motion or (self.in_servo and self.safety_stop is None) or self._backing_off
        return not driven and not self.v.any()

    @property
    def asleep(self) -> bool:
        """Whether steps may be skipped: the arm rests, and it has no environment that could move."""
        return self.resting and self._environment is None

    @property
    def in_motion(self) -> bool:
        """Whether a planned motion or hand guiding is under way, also while a safety stop pauses it."""
        return self._motion is not None or self._guide is not None

    def start_motion(self, motion: JointMove, break_when: Callable[[SimulatedArm], str] | None = None) -> None:
        """Starts a planned motion from the present joint angles; it brakes and ends once `break_when` says what it is
        broken by."""
        self._motion, self._break_when, self.broken_by, self.gave_up = motion, break_when, "", ""
        self._motion_time, self._breaking, self._braking_time = 0.0, False, math.inf
        self._motion_rate = 1.0 if self.safety_stop is None else 0.0
        self._check_safety()

    def break_motion(self, at_once: bool = False) -> None:
        """Brakes a planned motion, which ends there; `at_once`: from its present speed in no more time than that takes,
        instead of in the time that its greatest speed would take."""
        self._breaking = True
        if at_once:
            self._braking_time = max(CYCLE_S, float(np.max(np.abs(self.v) / self.motion_acceleration)))

    def start_servo(self) -> None:
        """Starts the servo mode with the present joint angles as goal."""
        self.in_servo, self.destination, self._soft, self.gave_up = True, None, None, ""
        self.goal = self.q.copy()

    def stop_servo(self) -> None:
        self.in_servo = False

    def soften(self, softness: Softness) -> None:
        """Makes the servo mode soft that has just begun."""
        self._soft = self._soft_servo(softness)

    def start_guiding(self) -> None:
        """Lets a hand move the arm while the enabling switch is pressed; its release ends that."""
        self._guide, self._guided = self._soft_servo(Softness("FLOAT")), False
        self._breaking, self.gave_up = False, ""

    def _soft_servo(self, softness: Softness) -> SoftServo:
        return SoftServo(self.robot, softness, self.T_flange_tool, self.q, self.acceleration)

    @property
    def load_is_right(self) -> bool:
        """Whether what pulls at the arm is what the controller reckons with, so that it may be soft."""
        most_nm = 3.0  # an assumption: the controller's own bound is not published
        weights = [(self.hand.mass, self.hand.com), *((-mass, com) for mass, com in self._known)]
        torque = self._contact_torques + sum(self.robot.weight(self.q, *each) for each in weights)
        return bool(np.max(np.abs(torque)) <= most_nm)

    def attach(self, T_flange_tool: np.ndarray) -> None:
        """Attaches a tool, shape (4, 4), in place of the last one."""
        self.T_flange_tool = read_only(T_flange_tool)
        self._check_safety()

    def state_load(self, tool: tuple[float, np.ndarray], load: tuple[float, np.ndarray]) -> None:
        """Takes which tool and which held load the controller reckons with: mass [kg], centre of mass in the flange
        frame, shape (3,) [m]."""
        self._known = [tool, load]
        self._check_safety()

    def set_external_torque(self, torque: np.ndarray) -> None:
        """Sets the external torques on the joints, shape (7,) [Nm], in addition to those of the tool force."""
        self._joint_torque = read_only(torque)
        self._check_safety()

    def set_tool_force(self, force: np.ndarray) -> None:
        """Sets the external force on the tool point, shape (3,) [N], along the tool's axes."""
        self._tool_force = read_only(force)
        self._check_safety()

    def press_emergency_stop(self, pressed: bool) -> None:
        """Presses or releases the button of the emergency stop; the safety stop remains until `release`."""
        self.emergency_stop = pressed
        self._check_safety()

    def release(self) -> None:
        """Ends a safety stop, as the run key does; a planned motion resumes. Raises ValueError if no stop is active,
        its cause persists, or the arm still brakes."""
        if self.safety_stop is None:
            raise ValueError("No safety stop is active; kuka/status reports what the arm waits for.")
        if self.emergency_stop:
            raise ValueError("The emergency stop is pressed; release its button first.")
        cause = self._torque_fault()
        if cause:
            raise ValueError(f"The cause of the safety stop persists: {cause} Back off (simulation/back_off) first.")
        if self.v.any():
            raise ValueError("The arm is still braking; release it again after a second.")
        self.safety_stop = None
        self._backing_off = False

    def back_off(self) -> None:
        """Moves an arm in a safety stop slowly back along its path, as with the smartPad's jog keys, until no external
        torque exceeds half of the limit; raises ValueError if no stop is active."""
        if self.safety_stop is None:
            raise ValueError("No safety stop is active, so there is nothing to back off from.")
        self._backing_off = True

    @property
    def tool(self) -> np.ndarray:
        """Pose of the tool in the base, shape (4, 4)."""
        return self.robot.flange(self.q) @ self.T_flange_tool

    @property
    def tool_force(self) -> np.ndarray:
        """Force on the tool point, shape (3,) [N], along the tool's axes."""
        return self._tool_force + self._touch_wrench[:3]

    @property
    def tool_moment(self) -> np.ndarray:
        """Moment on the tool point, shape (3,) [Nm], about the tool's axes."""
        return self._touch_wrench[3:]

    @property
    def external_torques(self) -> np.ndarray:
        """External torques on the joints as the controller estimates them, shape (7,) [Nm]."""
        return self._with_weight(self._contact_torques)

    def _with_weight(self, torque: np.ndarray) -> np.ndarray:
        """Returns the torques, shape (7,) [Nm], and with them those of the hand's weight, less what the controller
        reckons with."""
        tool, load = self._known
        if self.settings.tool_weight:
            torque = torque + self.robot.weight(self.q, self.hand.mass, self.hand.com)
            if tool[0]:
                torque = torque - self.robot.weight(self.q, *tool)
        return torque - self.robot.weight(self.q, *load) if load[0] else torque

    @property
    def _contact_torques(self) -> np.ndarray:
        torque = self._joint_torque + self._touch_torque
        if not self._tool_force.any():
            return torque
        return torque + self.robot.jacobian(self.q, self.T_flange_tool)[:3].T @ self._tool_force

    @property
    def measured_torques(self) -> np.ndarray:
        """Torques of the drives: those of gravity and motion minus those of contacts, shape (7,) [Nm]."""
        a = (self.v - self._v_before) / self._last_dt
        return self.robot.torques(self.q, self.v, a) - self._contact_torques

    @property
    def _touch_wrench(self) -> np.ndarray:
        """Force and moment on the tool point that best explain the torques of touch and weight, shape (6,)."""
        torque = self._with_weight(self._touch_torque)
        if not torque.any():
            return np.zeros(6)
        return self.robot.wrench(self.q, self.T_flange_tool, torque)

    def _step_motion(self, motion: JointMove, dt: float) -> None:
        back_off_fraction = 0.1  # a planned motion backs off at this fraction of its speed
        if self._break_when is not None and not self.broken_by:
            self.broken_by = self._break_when(self)
            self._breaking = self._breaking or bool(self.broken_by)
        wanted = 0.0 if self._breaking or self.safety_stop is not None else 1.0
        if self._still_backing_off(self._motion_time > 0.0):
            wanted = -back_off_fraction
        change = dt / min(
            motion.braking_time, self._braking_time
        )  # as fast as it was planned; of a real arm's braking nothing is published
        rate = self._motion_rate + min(max(wanted - self._motion_rate, -change), change)
        self._motion_time += 0.5 * (rate + self._motion_rate) * dt
        self._motion_rate = rate
        q = motion.at(self._motion_time)
        self.v, self.q = (q - self.q) / dt, q
        over = self._motion_time >= motion.duration or (self._breaking and rate == 0.0)
        if over:
            self._motion = None
        if over or rate == 0.0:
            self.v = np.zeros(7)

    def _step_back(self, dt: float) -> None:
        if self._trail and np.max(np.abs(self._trail[-1] - self.q)) < TRAIL_STEP_RAD:
            self._trail.pop()
        if self._still_backing_off(bool(self._trail)):
            self._move(self._back_drives.towards(self._trail[-1] - self.q, self.v, dt), dt)
        else:
            self._move(self._drives.brake(self.v, dt), dt)

    def _still_backing_off(self, path_left: bool) -> bool:
        free_fraction = 0.5  # the arm backs off until every external torque is below this fraction of the limit
        if self._backing_off:
            free = np.max(np.abs(self.external_torques)) <= free_fraction * self.settings.torque_limit
            self._backing_off = path_left and not free
        return self._backing_off

    def _step_servo(self, dt: float) -> None:
        if self.goal is not self._checked_goal:
            if not self.robot.within_range(self.goal):
                self.in_servo = False
                return
            self._checked_goal = self.goal
        to = self.goal if self.destination is None else self.destination
        if self._soft is not None:
            self._step_soft(self._soft, to, dt)
            return
        way = self._law(to - self.q) if self.destination is None else to - self.q
        self._move(self._drives.towards(way, self.v, dt), dt)

    def _step_soft(self, soft: SoftServo, goal: np.ndarray, dt: float) -> None:
        touch = self._touch_torque if self._environment is None else self._environment.reaction
        torque = self.external_torques - self._touch_torque + touch
        try:
            self._move(soft.step(goal, self.q, self.v, torque, dt), dt)
            joint = np.flatnonzero((self.q < self.robot.lower) | (self.q > self.robot.upper))
            if joint.size:
                raise GivesUp(f"joint {joint[0] + 1} is at the end of its range")
        except GivesUp as error:
            self.gave_up, self.in_servo, self._guide = str(error), False, None

    def _step_guide(self, guide: SoftServo, dt: float) -> None:
        self._guided = self._guided or self.enabling
        if self.enabling and not self._breaking and self.safety_stop is None:
            self._step_soft(guide, self.q, dt)
            return
        self._move(self._drives.brake(self.v, dt), dt)
        if not self.v.any() and (self._breaking or self._guided):
            self._guide = None

    def _move(self, v: np.ndarray, dt: float) -> None:
        self.q = self.q + v * dt
        self.v = v

    def _check_safety(self) -> None:
        self.tool_speed = self.robot.tool_speed(self.q, self.v, self.T_flange_tool)
        self.max_tool_speed = max(self.max_tool_speed, self.tool_speed)
        if self.safety_stop is not None:
            return
        if not self._trail or max(map(abs, (self._trail[-1] - self.q).tolist())) > TRAIL_STEP_RAD:
            self._trail.append(self.q)
        cause = "The emergency stop is pressed." if self.emergency_stop else self._torque_fault()
        if not cause and self.tool_speed > self.settings.speed_limit:
            cause = f"The tool moves at {self.tool_speed:.3f} m/s (limit {self.settings.speed_limit:g})."
        if cause:
            self.safety_stop = cause
            self.stops += 1

    def _torque_fault(self) -> str | None:
        limit = self.settings.torque_limit
        torque = list(map(abs, self.external_torques.tolist()))
        joint = torque.index(max(torque))
        if not torque[joint] > limit:
            return None
        return f"The external torque of joint {joint + 1} is {torque[joint]:.1f} Nm (limit {limit:g})."
