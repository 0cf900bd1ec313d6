"""The simulated operator: waits for the arm, enables the controls, and holds a hand above the Leap. It waits until the
controller runs and the arm is at home, enables gripper and arm control, and starts the hand of the simulated Leap
service. With a scenario it then steers the hand by its observations."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import rospy

from common import clock
from common.errors import DeviceError, RigError
from common.ros.params import private_config
from common.ros.service_calls import ServiceClient, ServiceFailed
from common.ros.simulated_devices import announce
from kuka_msgs.msg import jointPositions
from kuka_msgs.srv import setGripperControl, setKukaControl
from rig_msgs.msg import KukaStatus
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import (
    ASSISTED_GRASP,
    BY_CLUTCH,
    EPISODES,
    HAND_OVER,
    LOOPBACK,
    POLICY,
    TWO_CUPS,
    TWO_HANDS,
    WALL,
    OperatorConfig,
)
from rig_simulation.ros.hand_over import HandOverScenario
from rig_simulation.ros.rounds import EpisodesScenario, PolicyScenario
from rig_simulation.ros.scenarios import AssistedScenario, ClutchScenario, PickScenario, WallScenario

NAME = "operator"
REMIND_S = ANSWER_TIMEOUT_S = 10.0
AT_HOME = np.radians(1.0)


class Operator:
    """Performs the steps one by one, each with the same time-out."""

    def __init__(self, config: OperatorConfig) -> None:
        self._config = config
        self._leapd = ControlClient(LOOPBACK, config.leapd_port)
        self._arms = [f"{arm}/" for arm in config.arms] or [""]
        self._joints: dict[str, np.ndarray] = {}
        self._why = ""

    def run(self) -> None:
        """Starts the rig and the scenario, then spins until ROS shuts down; raises RigError if a step timed out."""
        for arm in self._arms:
            self._start(arm)
        if self._config.leapd_port:
            self._wait(self._leapd_plays, "the simulated Leap service plays")
            rospy.loginfo("A hand enters the view of the Leap.")
        name, world = self._config.scenario, ControlClient(LOOPBACK, self._config.world_port)
        if name == ASSISTED_GRASP:
            AssistedScenario(name, self._config.rounds, self._leapd, world).run()
        elif name == WALL:
            WallScenario(name, self._leapd, world).run()
        elif name in (BY_CLUTCH, TWO_HANDS):
            ClutchScenario(name, name == TWO_HANDS, self._leapd, world).run()
        elif name == TWO_CUPS:
            self._pick_with_all(name)
        elif name == EPISODES:
            EpisodesScenario(self._config.rounds, self._config.seed, self._leapd, world).run()
        elif name == POLICY:
            PolicyScenario(self._config.rounds, self._config.seed, self._config.takes_over, self._leapd, world).run()
        elif name == HAND_OVER:
            HandOverScenario(name, self._leapd, world, self._config.arms).run()
        elif name:
            PickScenario(name, "cup", self._leapd, world).run()
        rospy.spin()

    def _pick_with_all(self, name: str) -> None:
        """Picks up with each hand the cup before its arm, all at the same time."""
        scenarios = [
            PickScenario(
                name,
                f"{arm}_cup",
                ControlClient(LOOPBACK, self._config.leapd_port),
                ControlClient(LOOPBACK, self._config.world_port),
                arm,
            )
            for arm in self._config.arms
        ]
        failures: list[BaseException] = []

        def run(scenario: PickScenario) -> None:
            try:
                scenario.run()
            except BaseException as error:
                failures.append(error)

        arms = zip(self._config.arms, scenarios)
        threads = [clock.Thread(target=run, args=(scenario,), name=f"{arm}{name}") for arm, scenario in arms]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if failures:
            raise failures[0]

    def _start(self, arm: str) -> None:
        """Waits until an arm is at home, and switches its controls on; `arm`: its namespace with a slash, or empty.
        leap_kuka, too, hears from the status that control is on, and follows only a hand that comes in afterwards."""
        of = f" {arm[:-1]}" if arm else ""
        topic, take = f"{arm}kuka/joint_positions", partial(self._take_joints, arm)
        joints = rospy.Subscriber(topic, jointPositions, take, queue_size=1)
        param = f"{arm}kuka/joints_home"
        self._wait(lambda: rospy.has_param(param), f"the controller{of} has computed the home position")
        home = np.asarray(rospy.get_param(param), dtype=float)
        self._wait(
            lambda: arm in self._joints and np.abs(self._joints[arm] - home).max() < AT_HOME, f"the arm{of} is at home"
        )
        if len(self._arms) > 1:
            joints.unregister()  # of two arms they would cost a small machine more than the rest of this node
        if self._config.auto_start:
            self._switch(f"{arm}kuka/gripper_control", setGripperControl)
            self._switch(f"{arm}kuka/kuka_control", setKukaControl)
            on = clock.Event()
            status = rospy.Subscriber(
                f"{arm}kuka/status", KukaStatus, lambda message: on.set() if message.control_on else None, queue_size=1
            )
            self._wait(on.is_set, f"the status{of} says that control is on")
            status.unregister()

    def _take_joints(self, arm: str, message: jointPositions) -> None:
        self._joints[arm] = np.array([getattr(message, f"joint_{i}") for i in range(1, 8)])

    def _switch(self, name: str, service_type: type) -> None:
        client = ServiceClient(name, service_type)

        def switched() -> bool:
            try:
                answer = client(True, timeout=ANSWER_TIMEOUT_S)
            except ServiceFailed as error:
                self._why = f": {error}"
                return False
            self._why = f": {answer.message}"
            return answer.success

        self._wait(switched, f"the service {name} switches on")
        rospy.loginfo("%s is on%s", rospy.resolve_name(name), self._why)

    def _leapd_plays(self) -> bool:
        try:
            self._leapd.ask("play")
        except DeviceError as error:
            self._why = f": {error}"
            return False
        return True

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        """Waits for a condition; raises RigError after the time-out, and ROSInterruptException when ROS shuts down."""
        poll_s = 0.1
        start = clock.monotonic()
        remind = start + 1.0
        self._why = ""
        while not condition():
            now = clock.monotonic()
            if rospy.is_shutdown():
                raise rospy.ROSInterruptException(f"shut down while waiting until {what}")
            if now - start > self._config.time_out:
                raise RigError(f"Timed out after {self._config.time_out:g} s, waiting until {what}{self._why}")
            if now > remind:
                rospy.loginfo("Waiting until %s%s", what, self._why)
                remind = now + REMIND_S
            clock.sleep(poll_s)


def main() -> None:
    config = private_config(OperatorConfig)
    announce()
    Operator(config).run()
