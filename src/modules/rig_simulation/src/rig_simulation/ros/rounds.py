"""Scenarios of several rounds, each with another scene: the operator picks the cup up each time (`episodes`), or a
policy does and the operator takes over (`policy`). Where record_episodes.py runs, each round is an episode of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rospy
from std_srvs.srv import SetBool, Trigger

from common import clock
from common.episode_marks import BEGIN, FAILURE, SUCCESS
from common.errors import RigError
from common.modes import Mode
from common.ros.service_calls import ServiceFailed, call
from kuka_msgs.srv import setGripperControl, setKukaControl
from rig_simulation.node_parameters import EPISODES, NEEDED, NEVER, POLICY
from rig_simulation.operator import assisted_grasp as assisted
from rig_simulation.operator.cup_scenes import CUP, cup_scene
from rig_simulation.operator.pick_and_place import PICK, TAKE_OVER, PickAndPlace, PickStep, PickView, Plan
from rig_simulation.operator.steering import Move
from rig_simulation.ros.scenarios import PERIOD_S, SERVICE_TIMEOUT_S, Scenario
from rig_simulation.world.scene import scene_from

LIFTED_M, HELD_S = 0.05, 1.0
READY_S = 60.0  # longest time until the arm is at home
OPEN_S = 1.5  # for the fingers


class RoundsScenario(Scenario):
    """`rounds` of one task, the first with the scene of `seed`. Publishes `rounds`, and of those that are over `good`
    and `seconds`."""

    name: str

    def __init__(self, rounds: int, seed: int, leapd: Any, world: Any) -> None:
        super().__init__(self.name, leapd, world)
        if CUP not in self._shapes:
            raise RigError(f"The scenario {self.name} needs an object {CUP!r}; the scene has {sorted(self._shapes)}.")
        self._rounds, self._seed = rounds, seed
        self._scene = world.ask("scene")["scene"]
        self._round = self._good = 0
        self._seconds: list[float] = []
        self._lifted_since: float | None = None

    def run(self) -> None:
        """Runs all rounds."""
        for number in range(1, self._rounds + 1):
            self._round = number
            self._prepare()
            self._start()
            began = clock.monotonic()
            result = PickStep("begin")
            while not rospy.is_shutdown() and not result.over:
                clock.sleep(PERIOD_S)
                result = self._step(clock.monotonic())
                if result.move is not None:
                    self._leapd.ask("reach", **result.move.fields)
                if not result.over:
                    self._publish(result)
            if rospy.is_shutdown():
                return  # the round is neither good nor bad
            self._seconds.append(clock.monotonic() - began)
            good = self._lifted_since is not None and not result.failure
            self._good += good
            self._mark(SUCCESS if good else FAILURE)
            self._end()
            self._leapd.ask(assisted.HIDE)
            rospy.loginfo("Round %d of %d: %s.", self._round, self._rounds, result.failure or "the cup is lifted")
        self._publish(PickStep("done"))

    @property
    def view(self) -> PickView:
        """What the operator sees; also follows how long the cup is held."""
        seen, now = self._objects()[CUP], clock.monotonic()
        if seen["clearance"] < LIFTED_M or not any(name.startswith("reflex/") for name in seen["touches"]):
            self._lifted_since = None
        elif self._lifted_since is None:
            self._lifted_since = now
        return PickView(self._arm.grip, seen["top"], seen["clearance"], self._arm.streams)

    def _lifted(self, now: float) -> bool:
        return self._lifted_since is not None and now - self._lifted_since >= HELD_S

    def _prepare(self) -> None:
        """Brings the arm home with an open hand, sets the next scene, and switches the controls on."""
        self._publish(PickStep("prepare"))
        self._switch(False)
        self._wait(lambda: self._arm.mode == Mode.HOME, "the arm is at home")
        clock.sleep(OPEN_S)
        scene = cup_scene(self._scene, self._seed + self._round - 1)
        self._world.ask("set_scene", scene=scene)
        self._shapes, self._lifted_since = scene_from(scene).objects, None
        self._switch(True)

    def _switch(self, on: bool) -> None:
        for service, kind in (("kuka/gripper_control", setGripperControl), ("kuka/kuka_control", setKukaControl)):
            call(service, kind, on, timeout=SERVICE_TIMEOUT_S, wait=SERVICE_TIMEOUT_S)

    def _wait(self, condition: Any, what: str) -> None:
        began = clock.monotonic()
        while not condition():
            if rospy.is_shutdown():
                raise rospy.ROSInterruptException(f"shut down while waiting until {what}")
            if clock.monotonic() - began > READY_S:
                raise RigError(f"Timed out after {READY_S:g} s, waiting until {what}.")
            clock.sleep(PERIOD_S)

    def _mark(self, mark: str) -> None:
        try:
            answer = call(f"episodes/{mark}", Trigger, timeout=SERVICE_TIMEOUT_S)
        except ServiceFailed:
            return  # nobody records
        if not answer.success and mark == BEGIN:
            raise RigError(f"episodes/{mark}: {answer.message}")
        if not answer.success:  # a recorder that was started within the round has no episode yet
            rospy.logwarn("episodes/%s: %s", mark, answer.message)

    def _publish(self, result: PickStep, **more: str) -> None:
        seconds = ",".join(f"{one:.1f}" for one in self._seconds)
        super()._publish(result, rounds=str(self._round), good=str(self._good), seconds=seconds, **more)

    def _end(self) -> None:
        """Ends a round."""


class EpisodesScenario(RoundsScenario):
    """The operator picks up; how fast and from how high differs."""

    name = EPISODES

    def _start(self) -> None:
        rng = np.random.default_rng([self._seed + self._round, 1])
        self._plan = Plan(speed=float(rng.uniform(0.08, 0.14)), clearance=float(rng.uniform(0.10, 0.14)), hold=1.5)
        self._come_in()
        self._wait(self._follows, "the tool follows the hand")
        self._mark(BEGIN)

    def _come_in(self) -> None:
        self._operator = PickAndPlace(self._plan, self._arm.center_line, PICK)
        self._show_hand()

    def _follows(self) -> bool:
        if self._starts_over(clock.monotonic()):
            self._come_in()
        return self._arm.streams

    def _step(self, now: float) -> PickStep:
        return self._operator.step(self.view, now)


class PolicyScenario(RoundsScenario):
    """A program that publishes leap_kuka/policy_actions picks up, for at most `longest` s. `takes_over`: when the
    operator does. Also publishes `taken`, in how many rounds that was."""

    name = POLICY
    longest = 30.0

    def __init__(self, rounds: int, seed: int, takes_over: str, leapd: Any, world: Any) -> None:
        super().__init__(rounds, seed, leapd, world)
        self._takes_over, self._taken = takes_over, 0

    def _start(self) -> None:
        self._operator: PickAndPlace | _Nudge | None = None
        self._gave_back = False
        self._mark(BEGIN)
        self._wait(lambda: self._let(True), "the policy may steer")
        self._began = clock.monotonic()

    def _step(self, now: float) -> PickStep:
        view, spent = self.view, now - self._began
        if self._operator is not None:
            return self._helped(self._operator, view, now)
        if self._lifted(now):
            return PickStep("done")
        if spent > self.longest:
            return PickStep("policy", failure=f"the policy did not lift the cup within {self.longest:g} s")
        if self._takes_over != NEVER and not self._gave_back and self._needs_help(view, spent):
            picks = PickAndPlace(Plan(), self._arm.center_line, TAKE_OVER)
            self._operator = picks if self._takes_over == NEEDED else _Nudge()
            self._taken += 1
            self._show_hand()
        return PickStep("policy")

    def _helped(self, operator: PickAndPlace | _Nudge, view: PickView, now: float) -> PickStep:
        result = operator.step(view, now)
        if result.failure or (result.over and isinstance(operator, PickAndPlace)):
            return result
        if not result.over:
            return PickStep(f"hand: {result.step}", result.move)
        self._leapd.ask(assisted.HIDE)
        self._operator, self._gave_back = None, True
        self._began = now
        return PickStep("policy")

    def _needs_help(self, view: PickView, spent: float) -> bool:
        late_s, low_m, aside_m, nudge_s = 11.0, 0.11, 0.025, 2.5
        if self._takes_over != NEEDED:
            return self._round == 1 and spent > nudge_s
        aside = math.hypot(*(view.grip - view.top)[:2])
        return view.clearance < LIFTED_M and (
            spent > late_s or (view.grip[2] - view.top[2] < low_m and aside > aside_m)
        )

    def _end(self) -> None:
        self._let(False)

    @staticmethod
    def _let(on: bool) -> bool:
        service = "leap_kuka/run_policy"
        return bool(call(service, SetBool, on, timeout=SERVICE_TIMEOUT_S, wait=SERVICE_TIMEOUT_S).success)

    def _publish(self, result: PickStep, **more: str) -> None:
        super()._publish(result, taken=str(self._taken), **more)


class _Nudge:
    """A hand that leads the tool aside once it follows, and is done."""

    def __init__(self) -> None:
        self._began: float | None = None
        self._since: float | None = None

    def step(self, view: PickView, now: float) -> PickStep:
        """Takes an observation at the time `now` [s]; returns what to do."""
        aside_m, moves_s, stays_s, patience_s = (0.06, 0.03, 0.0), 1.2, 2.5, 30.0
        if self._began is None:
            self._began = now
        if self._since is None and now - self._began > patience_s:
            return PickStep("wait", failure=f"the arm did not follow within {patience_s:g} s")
        if self._since is None and view.following:
            self._since = now
            return PickStep("aside", Move(np.array(aside_m), 0.0, 0.0, moves_s))
        return PickStep("done" if self._since is not None and now - self._since > stays_s else "wait")
