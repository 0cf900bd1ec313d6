"""The scenario assisted_grasp on the running rig: the operator works with the proposals of the network.

It uses the topics and services of the nodes ggcnn and grasp_execution, and reports each grasp on
`simulation/scenario` with the values of `round_values`.
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
from rig_simulation.ros.scenario import AT_HOME, FOLLOWING, PERIOD_S, ProgressReport, RigObserver

FRESH_S = 2.0
"""Proposals of an older image are ignored."""
SERVICE_TIMEOUT_S = 10.0
HOLD_S = 2.0
NETWORK_START_S = 180.0
"""On a busy machine, the libraries of the network take more than a minute to load."""


class GraspTopics:
    """The topics of the two nodes of grasping."""

    def __init__(self) -> None:
        self._grasps: GraspList | None = None
        self.execution: dict[str, str] = {}
        self.outcome: GraspReport | None = None
        rospy.Subscriber("ggcnn/out/grasps", GraspList, self._take_grasps, queue_size=1)
        rospy.Subscriber("grasping/state", DiagnosticStatus, self._take_execution, queue_size=10)
        rospy.Subscriber("grasping/outcome", GraspOutcome, self._take_outcome, queue_size=10)

    @property
    def received(self) -> bool:
        """Whether the network has published anything yet."""
        return self._grasps is not None

    def best(self) -> tuple[ProposedGrasp | None, str]:
        """Returns the best reachable grasp of a fresh image, or None and the reason."""
        grasps = self._grasps
        if grasps is None:
            return None, "no list of grasps has arrived yet"
        age = (rospy.Time.now() - grasps.header.stamp).to_sec()
        if age > FRESH_S:
            return None, f"the newest image is {age:.1f} s old"
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
    """Executes proposed grasps, and corrects them by hand.

    Args:
        name: of the scenario.
        rounds: number of grasps.
        leapd: control port of the simulated Leap service, which must run guided.
        world: control port of the simulated world.

    Raises:
        RigError: the arm is not upright.
    """

    def __init__(self, name: str, rounds: int, leapd: ControlClient, world: ControlClient) -> None:
        self._leapd = leapd
        self._rig, self._report, self._proposals = RigObserver(name, world), ProgressReport(name), GraspTopics()
        self._operator = AssistedGrasp(OperatorHabits(rounds), Plan(hold=HOLD_S), self._rig.center_line)
        self._streams = False
        rospy.Subscriber("leap_kuka/stream", DiagnosticStatus, self._take_stream, queue_size=10)

    def run(self) -> None:
        """Runs until the scenario is over or ROS shuts down, then takes the hand away.

        Raises:
            DeviceError: the world or the Leap service does not answer.
        """
        self._wait_for_network()
        while not rospy.is_shutdown():
            time.sleep(PERIOD_S)
            if self._rig.grip is None:
                continue
            result = self._operator.step(self._scene(), time.monotonic())
            self._do(result)
            self._report.publish(result.step, result.failure, **round_values(result.round))
            if result.over:
                break
        self._leapd.ask(HIDE)

    def _wait_for_network(self) -> None:
        """Waits for the first list of grasps; without one, the operator reports why it gives up."""
        deadline = time.monotonic() + NETWORK_START_S
        while not rospy.is_shutdown() and not self._proposals.received and time.monotonic() < deadline:
            self._report.publish("network starts")
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
                self._operator.answer(success, message, time.monotonic())

    def _call(self, name: str) -> tuple[bool, str]:
        try:
            answer = call(f"grasping/{name}", Trigger, timeout=SERVICE_TIMEOUT_S, wait=SERVICE_TIMEOUT_S)
        except ServiceFailed as error:
            return False, str(error)
        return answer.success, answer.message

    def _scene(self) -> AssistedView:
        rig, execution = self._rig, self._proposals.execution
        fingers = heading(rig.R)
        objects = {}
        for name, seen in rig.objects().items():
            turn = turn_to(rig.shapes[name], rotation_from_quaternion(seen["quaternion"]), fingers)
            objects[name] = ObservedObject(seen["top"], seen["clearance"], turn)
        proposal, complaint = self._proposals.best()
        return AssistedView(
            grip=rig.grip,
            heading=fingers,
            following=self._streams and rig.mode == FOLLOWING,
            at_home=rig.mode == AT_HOME,
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
    """Returns the published values of a grasp."""
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
    """Returns each different sentence once."""
    return "; ".join(dict.fromkeys(sentence.rstrip(".") for sentence in reasons))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5f}"


def _proposal(grasp: Grasp) -> ProposedGrasp:
    return ProposedGrasp(grasp.id, array(grasp.pose_base.pose.position))
