"""A controller on an arm without a wire, an operator and a hand, in simulated time; for tests of the control loops."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from common.config import parse
from common.poses import read_only
from common.rotations import rotation_about
from kst import MotionInterrupted, MotionRefused, MotionStopped
from kuka_control.limits.collision import NearestPair, PathCheck
from kuka_control.loop import assembly
from kuka_control.loop.arm import Arm, ArmState
from kuka_control.loop.commands import End, Inputs
from kuka_control.loop.controller import Controller
from kuka_control.loop.moves import MoveGoal, MovePlanner
from kuka_control.loop.transitions import State, transitions_among
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.rig import Rig
from kuka_control.model.robot_shape import Opening
from kuka_control.model.switches import SwitchState

CONFIG = Path(__file__).parents[1] / "config"
CLOCK = 1.7e9
DT = 0.004
SLOW, FAST = 0.15, 0.25


@functools.lru_cache(maxsize=None)
def rig(schema, lifted=False, **changes):
    """Returns a configuration and its rig, whose workspace may be lifted."""
    name = "rt" if schema is RealTimeConfig else "ptp"
    values = yaml.safe_load((CONFIG / f"kuka_params_{name}.yaml").read_text())
    # Without the collision guard, which costs time; its own tests switch it on.
    settings = parse(schema, {**values, "collision_guard": False, **changes}, "kuka/")
    return settings, Rig.of(settings, lifted=lifted)


@functools.lru_cache(maxsize=None)
def planner(schema, **changes):
    settings, arm = rig(schema, **changes)
    line = assembly.line_limits(settings, arm) if schema is RealTimeConfig else None
    return MovePlanner(arm, {"aside": Q_ASIDE}, SLOW, FAST, line)


HOME = rig(RealTimeConfig)[1].home
Q_ASIDE = HOME.q + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


class FakeArm(Arm):
    """Moves to its goals with `speed` [rad/s], records commands; `held`: a safety stop; `refuse`: what it refuses.

    `shift`: its joints are measured so much off [rad]; `frozen`: they are measured there. `touches`: a tuple of
    the external torques at which its PTP motion ends, shape (7,) [Nm], or None; `ranges`: in which it continues.
    `stopped`: why the robot stops it; `abilities`: of the robot's application.
    """

    abilities = frozenset()

    def __init__(self):
        self.speed = 1.0
        self.q = np.full(7, 0.1)
        self.goal = self.q
        self.mode = "idle"
        self.commands = []
        self.goals = []
        self.held = False
        self.refuse = None
        self.fail = None
        self.shift = 0.0
        self.touches = self.ranges = self.stopped = None
        self._measure()

    def tick(self, dt):
        if not self.held and np.isfinite(self.goal).all():
            self.q = self.q + np.clip(self.goal - self.q, -self.speed * dt, self.speed * dt)

    def read(self):
        self._fail()
        self._refuse("read")
        self._measure()

    def start_ptp(self, q, velocity, torques=None):
        assert self.mode == "idle"
        self._fail()
        self.commands.append(("ptp", tuple(np.round(q, 9)), velocity))
        self._refuse("start")
        self.goal, self.mode, self.ranges = q, "ptp", torques

    def start_guiding(self):
        assert self.mode == "idle"
        self.commands.append(("guide",))
        self._refuse("start_guiding")
        self.goal, self.mode = np.full(7, np.inf), "ptp"

    def ptp_arrived(self):
        assert self.mode == "ptp"
        self._refuse("end")
        if self.stopped is not None:
            self.mode, self.goal = "idle", self.q
            self._stop()
        if self.touches is not None:
            (torques,), self.touches = self.touches, None
            self.mode, self.goal = "idle", self.q
            raise MotionInterrupted("a torque", torques=torques)
        if np.array_equal(self.q, self.goal):
            self.mode = "idle"
            return True
        return False

    def start_servo(self):
        assert self.mode == "idle"
        self._fail()  # as at the real arm: an answer that is missing after servo mode began is pending
        self.commands.append(("start_servo",))
        self._refuse("start_servo")
        self.mode, self.goal = "servo", self.q
        self.read()

    def servo(self, q):
        assert self.mode == "servo"
        self._fail()
        self._refuse("servo")
        self._stop()
        self.goals.append(q)
        self.goal = q
        self._measure()

    def stop_servo(self):
        assert self.mode == "servo"
        self.commands.append(("stop_servo",))
        self._refuse("stop_servo")
        self.mode, self.goal = "idle", self.q

    def stop(self):
        self.commands.append(("stop",))
        self.stopped = "the client"

    def close(self):
        self.mode = "closed"

    def _stop(self):
        reason, self.stopped = self.stopped, None
        if reason is not None:
            raise MotionStopped("stopped", reason=reason)

    def _measure(self):
        self.state = ArmState(read_only(self.q + self.shift))

    def _refuse(self, what):
        if self.refuse == what:
            self.mode = self.mode if what == "read" else "idle"
            raise MotionRefused("nak")

    def _fail(self):
        if self.fail is not None:
            raise self.fail


FOLDED = Opening((3.1, 3.1, 3.1), (0.0, 0.0, 0.0), 0.0)  # of the hand


class World:
    """A controller, its fake arm, a person at the switches, and a hand that publishes at 100 Hz while it is shown."""

    def __init__(self, schema=RealTimeConfig, arm=None, **changes):
        settings, self.rig = rig(schema, **changes)
        make = assembly.real_time_loop if schema is RealTimeConfig else assembly.ptp_loop
        self.arm = FakeArm() if arm is None else arm
        self.loop = make(settings, self.rig)
        self.loop.open_hand(FOLDED)
        self.controller = Controller(self.arm, self.loop)
        self.now = 100.0
        self._control_on = False
        self.enable_count = 0
        self.exit_requested, self.exit_in_place = False, None
        self.scale = 1.0
        self.stop_count = 0  # how often the enabling device was released
        self.tool = None
        self.clock, self.skew = CLOCK, 0.0  # the wall clock at the start, and how far stamps are ahead of it [s]
        self.conflict = None
        self.foreign = False  # whether a node publishes the tool frame instead of the hand
        self.engagement = None  # of the hand
        self.newest = None
        self.missing = None  # what is said while no desired tool frame comes
        self.move = None
        self.number = 0
        self.planner = planner(schema, **changes)
        self.events = []
        self.modes = []
        self.steps = []
        self.table = transitions_among(self.loop.STATES)
        self.taken = set()
        self.state = State.STARTING

    def run(self, seconds, tool=None):
        """`tool`: a tool frame that is published, or a function of time [s] that returns one."""
        start = self.now
        for i in range(max(1, round(seconds / DT))):
            if tool is not None and i % 3 == 0:
                T = tool(self.now - start) if callable(tool) else tool
                stamp, hand = self.clock + self.now + self.skew, self.engagement
                self.newest = DesiredFrame(T, stamp, self.conflict, foreign=self.foreign, engagement=hand)
            exits = {"exit_requested": self.exit_requested, "exit_in_place": self.exit_in_place}
            stop = {"stop_count": self.stop_count, "stop_because": "the enabling device was released"}
            switches = SwitchState(self.control_on, self.enable_count, scale=self.scale, **exits, **stop)
            inputs = Inputs(self.newest, self.clock + self.now, switches, self.move, self.missing)
            step = self.controller.cycle(inputs, self.now)
            self.events += [e.sentence for e in step.events]
            if not self.modes or self.modes[-1] != step.mode:
                self.modes.append(step.mode)
            self.steps.append(step)
            for pair in step.transitions:
                self.state = self.table[pair].target
                self.taken.add(pair)
            self.arm.tick(DT)
            self.now += DT
            if isinstance(step.command, End):
                break
        return self

    def until(self, mode, seconds, tool=None):
        """Runs until a mode is entered, for so many seconds at most."""
        end = self.now + seconds
        while self.now < end and not (self.steps and self.mode == mode):
            self.run(3 * DT, tool)
        assert self.mode == mode, self.steps[-1].reason
        return self

    def until_state(self, state, tool=None):
        """Runs cycle by cycle until a state is entered, for 12 s at most; a frame is published in each."""
        start = self.now
        while self.state is not state:
            self.run(DT, tool(self.now - start) if callable(tool) else tool)
            assert self.now < start + 12.0, f"{self.state} instead of {state}: {self.steps[-1].reason}"
        return self

    def at_home(self):
        self.until("home", 4.0)
        np.testing.assert_allclose(self.arm.q, self.rig.home.q)
        self.arm.commands.clear()
        self.modes.clear()
        return self

    def following(self, tool=None):
        self.at_home()
        self.control_on = True
        tool = tool if tool is not None else shifted(0.0, 0.0, 0.0)
        self.until("servo", 4.0, tool).run(76 * DT, tool)  # to a cycle with a frame
        self.arm.commands.clear()
        self.modes.clear()
        return self

    def ask(self, target, **goal):
        """A program asks for a motion."""
        self.number += 1
        self.move = self.planner.plan(self.number, MoveGoal(target, **goal), self.arm.state.joints)
        return self

    def cancel(self):
        if self.move is not None:
            self.move = replace(self.move, cancelled=True)

    @property
    def progress(self):
        return self.steps[-1].move

    @property
    def control_on(self):
        return self._control_on

    @control_on.setter
    def control_on(self, on):
        self.enable_count += on and not self._control_on
        self._control_on = on

    @property
    def mode(self):
        return self.steps[-1].mode


def shifted(x, y, z):
    """The home tool frame, shifted [m]."""
    T = HOME.T_base_tool.copy()
    T[:3, 3] += (x, y, z)
    return T


def at_rate(world, rate, tool, seconds):
    """Frames at a rate [Hz]."""
    start, frame = world.now, -1
    while world.now - start < seconds:
        number = int((world.now - start) * rate)
        fresh, frame = number > frame, number
        world.run(DT, tool(number / rate) if fresh else None)
    return world


def reached(world, tool):
    return np.linalg.norm(world.rig.kinematics.forward(world.arm.q)[:3, 3] - tool[:3, 3]) < 1e-3


def block(world):
    """A body is in the way of every motion from now on."""
    pair = NearestPair(("palm", "post"), 0.003, (np.zeros(3), np.zeros(3)), (1.0, 0.0, 0.0), False)
    world.loop._settings.guard.check = lambda *_: PathCheck(iter([pair]))


def ptp(q, velocity):
    return ("ptp", tuple(np.round(q, 9)), velocity)


def tipped(angle, x=0.0, y=0.0, z=0.0):
    """The home tool frame, shifted [m] and tipped [rad] towards the base; by 80 deg the arm does not come near."""
    T = shifted(x, y, z)
    T[:3, :3] = T[:3, :3] @ rotation_about(1, angle)
    return T


def out_of_reach_and_back(turn=0.0, jump=0.0):
    """Up and tipped so far that the arm cannot come near, 17 cm aside there, and slowly down again, in 9 s.

    Up there the tool also turns by `turn` [rad] about the vertical, and jumps aside by `jump` [m].
    """

    def tool(t):
        up, aside = (np.interp(t, times, (0.0, 1.0)) for times in ((0.0, 2.0), (2.5, 4.5)))
        up -= np.interp(t, (5.0, 9.0), (0.0, 1.0))
        T = tipped(1.4 * up, 0.12 * aside + jump * (t > 3.0), 0.12 * aside, 0.15 * up)
        T[:3, :3] = rotation_about(2, turn * aside) @ T[:3, :3]
        return T

    return tool
