"""The scenarios of the simulated operator on the running rig: its observations, actions and progress. seen_arm.py
publishes the progress; each of several arms has its own, in its namespace. assisted_grasp uses the topics and services
of the nodes ggcnn and grasp_execution, and adds `round_values`."""

from __future__ import annotations

import abc

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import SetBool, Trigger

from common import clock
from common.arms import arms_from
from common.errors import RigError
from common.modes import ExecutionState, Mode
from common.poses import inverse
from common.ros.conversions import array
from common.ros.service_calls import ServiceFailed, call
from common.rotations import rotation_from_quaternion
from grasp_msgs.msg import GraspList, GraspOutcome
from rig_msgs.msg import GuardState, TeleopState
from rig_simulation.control_port import ControlClient
from rig_simulation.operator import assisted_grasp as assisted
from rig_simulation.operator.clutching import Clutching
from rig_simulation.operator.pick_and_place import PickAndPlace, PickStep, PickView, Plan, heading, turn_to
from rig_simulation.operator.visits import Visits
from rig_simulation.operator.wall import WallView, WallVisit
from rig_simulation.ros.seen_arm import SeenArm
from rig_simulation.world.scene import scene_from

PERIOD_S = 0.1
SERVICE_TIMEOUT_S = 10.0


class Scenario(abc.ABC):
    """The scenario `name`: observes the rig, moves the operator's hand, and publishes the progress when it changes.
    `leapd` and `world` are the control ports of the simulated Leap service, which must run guided, and of the world.
    `arm`: of several, its namespace, which is also the side of the hand that steers it. Raises RigError if the arm is
    not upright."""

    def __init__(self, name: str, leapd: ControlClient, world: ControlClient, arm: str = "") -> None:
        self._leapd, self._world = leapd, world
        self._side = {"side": arm} if arm else {}
        self._arm = SeenArm(name, arm)
        arms = arms_from(rospy.get_param("arms"), "arms/") if arm else None
        self._T_base_world = np.eye(4) if arms is None else inverse(arms.placements[arm].T_world_base)
        self._shapes = scene_from(world.ask("scene")["scene"]).objects
        self._visits = Visits()

    def run(self) -> None:
        """Runs until the scenario is over or ROS shuts down, then takes the hand away; DeviceError if devices fail."""
        self._start()
        while not rospy.is_shutdown():
            clock.sleep(PERIOD_S)
            if self._arm.grip is None:
                continue
            result = self._step(clock.monotonic())
            if result.move is not None:
                self._leapd.ask("reach", **result.move.fields, **self._side)
            self._publish(result)
            if result.over:
                break
        self._leapd.ask(assisted.HIDE, **self._side)

    def _show_hand(self) -> None:
        """Brings the hand into the interaction box, from the operator's side of it."""
        entry_m = 0.25  # the hand enters so far in front of the workspace's centre
        entry_s = 1.0  # and needs so long to it
        self._leapd.ask(assisted.SHOW, back=entry_m, **self._side)
        self._leapd.ask("reach", seconds=entry_s, **self._side)
        self._visits.enter(clock.monotonic())

    def _starts_over(self, now: float) -> bool:
        """Takes the hand away and starts over if the arm does not follow; returns whether that happened."""
        away_s = 2.0  # the hand is out of view before it comes in again
        if not self._visits.over(self._arm.following, now):
            return False
        rospy.logwarn("The arm does not follow: the hand leaves the view, comes in again, and starts over.")
        self._leapd.ask(assisted.HIDE, **self._side)
        clock.sleep(away_s)
        self._start()
        return True

    @abc.abstractmethod
    def _start(self) -> None:
        """Prepares the first step."""

    @abc.abstractmethod
    def _step(self, now: float) -> PickStep:
        """Advances the operator."""

    def _publish(self, result: PickStep, **more: str) -> None:
        self._arm.tell(result.step, result.failure, **more)

    def _objects(self) -> dict[str, dict]:
        """Returns the states of the objects, with `top`, the centre of the upper side in the base, shape (3,) [m]."""
        found = self._world.ask("objects")["objects"]
        for name, seen in found.items():
            top = np.add(seen["position"], (0.0, 0.0, self._shapes[name].height / 2.0))
            seen["top"] = self._T_base_world[:3, :3] @ top + self._T_base_world[:3, 3]
        return found


class PickScenario(Scenario):
    """Picks the object `thing` up and puts it down; raises RigError if the scene has no such object. With several arms
    the published values name the `thing`."""

    def __init__(self, name: str, thing: str, leapd: ControlClient, world: ControlClient, arm: str = "") -> None:
        super().__init__(name, leapd, world, arm)
        self._named = {"thing": thing} if arm else {}
        self._thing = thing
        if thing not in self._shapes:
            raise RigError(f"The scenario {name} needs an object {thing!r}; the scene has {sorted(self._shapes)}.")

    def _start(self) -> None:
        self._show_hand()
        self._operator = PickAndPlace(Plan(), self._arm.center_line)

    def _step(self, now: float) -> PickStep:
        if self._starts_over(now):
            return PickStep("wait")
        seen = self._objects()[self._thing]
        return self._operator.step(PickView(self._arm.grip, seen["top"], seen["clearance"], self._arm.following), now)

    def _publish(self, result: PickStep, **more: str) -> None:
        super()._publish(result, **self._named, **more)


class WallScenario(Scenario):
    """Steers against the objects, along them and back; `smallest_mm`, `held_s` and `way_back` tell how it went."""

    def __init__(self, name: str, leapd: ControlClient, world: ControlClient) -> None:
        super().__init__(name, leapd, world)
        self._guard: GuardState | None = None
        rospy.Subscriber("kuka/guard", GuardState, self._take_guard, queue_size=1)

    def _start(self) -> None:
        self._operator = WallVisit()
        self._show_hand()

    def _step(self, now: float) -> PickStep:
        guard = self._guard
        if guard is None or not guard.on or self._starts_over(now):
            return PickStep("wait")
        view = WallView(self._arm.grip, self._arm.following, guard.distance, guard.margin, guard.scale)
        return self._operator.step(view, now)

    def _publish(self, result: PickStep, **more: str) -> None:
        made = self._operator
        if result.over:
            more = {"smallest_mm": f"{1e3 * made.smallest:.1f}", "held_s": f"{made.held:.1f}"}
            more["way_back"] = str(not result.failure).lower()
        super()._publish(result, **more)

    def _take_guard(self, message: GuardState) -> None:
        self._guard = message


class ClutchScenario(Scenario):
    """Moves the tool by strokes with a clutch in between: a service, or the fist of a second hand (`two_hands`)."""

    def __init__(self, name: str, two_hands: bool, leapd: ControlClient, world: ControlClient) -> None:
        super().__init__(name, leapd, world)
        self._two_hands, self._state = two_hands, ""
        rospy.Subscriber("leap_kuka/state", TeleopState, self._take_state, queue_size=10)

    def _start(self) -> None:
        if self._visits.count:
            self._clutch(False)
        self._operator = Clutching()
        self._show_hand()

    def _step(self, now: float) -> PickStep:
        if self._starts_over(now):
            return PickStep("wait")
        result = self._operator.step(self._arm.grip, self._state, self._arm.following, now)
        if result.clutch is not None:
            self._clutch(result.clutch)
        return result

    def _clutch(self, pressed: bool) -> None:
        if self._two_hands:
            self._leapd.ask("second", curl=1.0 if pressed else 0.0)
        else:
            call("leap_kuka/set_clutch", SetBool, pressed, timeout=SERVICE_TIMEOUT_S, wait=SERVICE_TIMEOUT_S)

    def _publish(self, result: PickStep, **more: str) -> None:
        operator = self._operator
        super()._publish(
            result,
            clutched=str(operator.clutched),
            travel_mm=f"{1e3 * operator.travel:.0f}",
            engagement_step_mm=f"{1e3 * operator.engagement_step:.1f}",
        )

    def _take_state(self, message: TeleopState) -> None:
        self._state = message.state


class AssistedScenario(Scenario):
    """Executes proposed grasps, and corrects them by hand; `rounds`: number of grasps."""

    def __init__(self, name: str, rounds: int, leapd: ControlClient, world: ControlClient) -> None:
        hold_s = 2.0
        super().__init__(name, leapd, world)
        self._operator = assisted.AssistedGrasp(
            assisted.OperatorHabits(rounds), Plan(hold=hold_s), self._arm.center_line
        )
        self._grasps: GraspList | None = None
        self._execution: dict[str, str] = {}
        self._outcome: assisted.GraspReport | None = None
        rospy.Subscriber("ggcnn/out/grasps", GraspList, self._take_grasps, queue_size=1)
        rospy.Subscriber("grasping/state", DiagnosticStatus, self._take_execution, queue_size=10)
        rospy.Subscriber("grasping/outcome", GraspOutcome, self._take_outcome, queue_size=10)

    def _start(self) -> None:
        network_start_s = 180.0  # on a busy machine, the libraries of the network take more than a minute to load
        deadline = clock.monotonic() + network_start_s
        while not rospy.is_shutdown() and self._grasps is None and clock.monotonic() < deadline:
            self._publish(PickStep("network starts"))
            clock.sleep(PERIOD_S)

    def _step(self, now: float) -> assisted.AssistedStep:
        result = self._operator.step(self._view(), now)
        if result.request == assisted.SHOW:
            self._show_hand()
        elif result.request == assisted.HIDE:
            self._leapd.ask(assisted.HIDE)
        elif result.request:
            try:
                answer = call(f"grasping/{result.request}", Trigger, timeout=SERVICE_TIMEOUT_S, wait=SERVICE_TIMEOUT_S)
                success, message = answer.success, answer.message
            except ServiceFailed as error:
                success, message = False, str(error)
            rospy.loginfo("grasping/%s: %s", result.request, message)
            if result.request == assisted.EXECUTE:
                self._operator.answer(success, message, clock.monotonic())
        return result

    def _publish(self, result: PickStep, **more: str) -> None:
        super()._publish(result, **(round_values(result.round) if isinstance(result, assisted.AssistedStep) else more))

    def _view(self) -> assisted.AssistedView:
        fingers = heading(self._arm.R)
        objects = {}
        for name, seen in self._objects().items():
            turn = turn_to(self._shapes[name], rotation_from_quaternion(seen["quaternion"]), fingers)
            objects[name] = assisted.ObservedObject(seen["top"], seen["clearance"], turn)
        proposal, complaint = self._best()
        return assisted.AssistedView(
            grip=self._arm.grip,
            heading=fingers,
            approach=self._arm.R[:, 2],
            following=self._arm.streams and self._arm.following,
            at_home=self._arm.mode == Mode.HOME,
            objects=objects,
            proposal=proposal,
            complaint=complaint,
            execution=self._execution.get("state", ExecutionState.IDLE.value),
            reason=self._execution.get("reason", ""),
            outcome=self._outcome,
        )

    def _best(self) -> tuple[assisted.ProposedGrasp | None, str]:
        """Returns the best reachable grasp of a fresh image, or None and the reason."""
        fresh_s = 2.0  # proposals of an older image are ignored
        grasps = self._grasps
        if grasps is None:
            return None, "no list of grasps has arrived yet"
        age = (rospy.Time.now() - grasps.header.stamp).to_sec()
        if age > fresh_s:
            return None, f"the newest image is {age:.1f} s old"
        for grasp in grasps.grasps:
            if grasp.reachable and grasp.pose_base.header.frame_id:
                return assisted.ProposedGrasp(grasp.id, array(grasp.pose_base.pose.position)), ""
        return None, grasps.grasps[0].reason if grasps.grasps else grasps.reason

    def _take_grasps(self, message: GraspList) -> None:
        self._grasps = message

    def _take_execution(self, message: DiagnosticStatus) -> None:
        self._execution = {value.key: value.value for value in message.values}

    def _take_outcome(self, message: GraspOutcome) -> None:
        self._outcome = assisted.GraspReport(message.episode, message.held, message.reason)


def round_values(grasp: assisted.Round) -> dict[str, str]:
    return {
        "round": str(grasp.number),
        "object": grasp.object,
        "proposals": str(grasp.proposals),
        "executed": str(grasp.executed),
        "refused": _sentences(grasp.refused),
        "failed": _sentences(grasp.failed),
        "correction_m": _number(grasp.correction),
        "correction_rad": _number(grasp.turn),
        "lifted_m": _number(grasp.lifted),
        "held": "" if grasp.held is None else str(grasp.held).lower(),
        "outcome": grasp.reason,
    }


def _sentences(reasons: tuple[str, ...]) -> str:
    return "; ".join(dict.fromkeys(sentence.rstrip(".") for sentence in reasons))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5f}"
