"""The scenario assisted_grasp on the running rig: the person works with the proposals of the network.

Meets the nodes ggcnn and grasp_execution on their topics and services. What each grasp came to is told on
`simulation/scenario`, in the values that `round_values` names.
"""

from __future__ import annotations

import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from common.ros.conversions import array
from common.ros.service_calls import ServiceFailed, call
from common.rotations import rotation_from_quaternion
from grasp_msgs.msg import Grasp, GraspList, GraspOutcome
from rig_simulation.control_port import ControlClient
from rig_simulation.operator.alignment import heading, turn_to
from rig_simulation.operator.assisted_grasp import (
    EXECUTE,
    HIDE,
    IDLE,
    SHOW,
    AssistedGrasp,
    AssistedStep,
    AssistedView,
    GraspReport,
    ObservedObject,
    OperatorHabits,
    ProposedGrasp,
    Round,
)
from rig_simulation.operator.pick_and_place import Plan
from rig_simulation.ros.scenario import AT_HOME, FOLLOWING, PERIOD_S, Eyes, Story

FRESH_S = 2.0
"""Proposals in an older picture are not looked at."""
SERVICE_TIMEOUT_S = 10.0
HOLD_S = 2.0
NETWORK_START_S = 180.0
"""Where other programs want the processor, the network's libraries take a minute and more to load."""


class GraspTopics:
    """What the two nodes of grasping say."""

    def __init__(self) -> None:
        self._grasps: GraspList | None = None
        self.execution: dict[str, str] = {}
        self.outcome: GraspReport | None = None
        rospy.Subscriber("ggcnn/out/grasps", GraspList, self._take_grasps, queue_size=1)
        rospy.Subscriber("grasping/state", DiagnosticStatus, self._take_execution, queue_size=10)
        rospy.Subscriber("grasping/outcome", GraspOutcome, self._take_outcome, queue_size=10)

    @property
    def came(self) -> bool:
        """Whether the network has said anything yet."""
        return self._grasps is not None

    def best(self) -> tuple[ProposedGrasp | None, str]:
        """Returns the best grasp in a fresh picture that the arm reaches, and if there is none, why."""
        grasps = self._grasps
        if grasps is None:
            return None, "no list of grasps came yet"
        age = (rospy.Time.now() - grasps.header.stamp).to_sec()
        if age > FRESH_S:
            return None, f"the newest picture is {age:.1f} s old"
        for grasp in grasps.grasps:
            if grasp.reachable and grasp.pose_base.header.frame_id:
                return _proposal(grasp), ""
        return None, grasps.grasps[0].reason if grasps.grasps else grasps.reason

    def _take_grasps(self, message: GraspList) -> None:
        self._grasps = message

    def _take_execution(self, message: DiagnosticStatus) -> None:
        self.execution = {value.key: value.value for value in message.values}

    def _take_outcome(self, message: GraspOutcome) -> None:
        self.outcome = GraspReport(message.episode, message.held, message.reason)


class AssistedScenario:
    """Lets proposed grasps be executed, and corrects them by hand.

    Args:
        name: of the scenario.
        rounds: how many grasps there are to be.
        leapd: control port of the simulated Leap service, which must run guided.
        world: control port of the simulated world.

    Raises:
        RigError: the rig or its world is not what the scenario needs.
    """

    def __init__(self, name: str, rounds: int, leapd: ControlClient, world: ControlClient) -> None:
        self._leapd = leapd
        self._eyes, self._story, self._proposals = Eyes(name, world), Story(name), GraspTopics()
        self._person = AssistedGrasp(OperatorHabits(rounds), Plan(hold=HOLD_S), self._eyes.center_line)
        self._streams = False
        rospy.Subscriber("leap_kuka/stream", DiagnosticStatus, self._take_stream, queue_size=10)

    def run(self) -> None:
        """Works until the scenario is over or ROS shuts down, then takes the hand away.

        Raises:
            DeviceError: the world or the Leap service does not answer.
        """
        self._wait_for_network()
        while not rospy.is_shutdown():
            time.sleep(PERIOD_S)
            if self._eyes.grip is None:
                continue
            result = self._person.step(self._scene(), time.monotonic())
            self._do(result)
            self._story.tell(result.step, result.failure, **round_values(result.round))
            if result.over:
                break
        self._leapd.ask(HIDE)

    def _wait_for_network(self) -> None:
        """Waits for the first list of grasps; without one the person looks in vain, and says so."""
        deadline = time.monotonic() + NETWORK_START_S
        while not rospy.is_shutdown() and not self._proposals.came and time.monotonic() < deadline:
            self._story.tell("network starts")
            time.sleep(PERIOD_S)

    def _do(self, result: AssistedStep) -> None:
        if result.move is not None:
            self._leapd.ask("reach", **result.move.fields)
        if result.request in (SHOW, HIDE):
            self._leapd.ask(result.request)
        elif result.request:
            success, message = self._call(result.request)
            rospy.loginfo("grasping/%s: %s", result.request, message)
            if result.request == EXECUTE:
                self._person.answer(success, message, time.monotonic())

    def _call(self, name: str) -> tuple[bool, str]:
        try:
            answer = call(f"grasping/{name}", Trigger, timeout=SERVICE_TIMEOUT_S, wait=SERVICE_TIMEOUT_S)
        except ServiceFailed as error:
            return False, str(error)
        return answer.success, answer.message

    def _scene(self) -> AssistedView:
        eyes, execution = self._eyes, self._proposals.execution
        fingers = heading(eyes.R)
        objects = {}
        for name, seen in eyes.objects().items():
            turn = turn_to(eyes.shapes[name], rotation_from_quaternion(seen["quaternion"]), fingers)
            objects[name] = ObservedObject(seen["top"], seen["clearance"], turn)
        proposal, complaint = self._proposals.best()
        return AssistedView(
            grip=eyes.grip,
            heading=fingers,
            following=self._streams and eyes.mode == FOLLOWING,
            at_home=eyes.mode == AT_HOME,
            objects=objects,
            proposal=proposal,
            complaint=complaint,
            execution=execution.get("state", IDLE),
            reason=execution.get("reason", ""),
            outcome=self._proposals.outcome,
        )

    def _take_stream(self, message: DiagnosticStatus) -> None:
        self._streams = message.level == DiagnosticStatus.OK


def round_values(grasp: Round) -> dict[str, str]:
    """Returns what is told of a grasp: its number, the object, what was proposed, refused, corrected, and achieved."""
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


def _sentences(told: tuple[str, ...]) -> str:
    """Returns each different sentence once."""
    return "; ".join(dict.fromkeys(sentence.rstrip(".") for sentence in told))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5f}"


def _proposal(grasp: Grasp) -> ProposedGrasp:
    return ProposedGrasp(grasp.id, array(grasp.pose_base.pose.position))
