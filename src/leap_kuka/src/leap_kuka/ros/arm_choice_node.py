"""The node arm_choice: the service leap_kuka/choose_arm in, or tracking frames; leap_kuka/chosen_arm out, latched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import rospy
from std_msgs.msg import String

from common import clock
from common.config import names
from common.errors import ConfigError
from common.ros.node import run
from common.ros.params import private_config, wait_for_config
from leap_kuka.arm_choice import ArmChoice, meaning
from leap_kuka.config import NONE, OPERATOR_INPUT, LeapConfig
from leap_motion.frames import TrackingFrame
from leap_motion.ros.tracking import ReceivedPalms, Subscribe, subscribe
from rig_msgs.srv import ChooseArm, ChooseArmRequest

CHOSEN_ARM = "leap_kuka/chosen_arm"


@dataclass(frozen=True)
class ArmChoiceConfig:
    """Private parameters of the node arm_choice."""

    arms: tuple[str, ...] = names(doc="namespaces of the arms, such as [left, right]")


class ArmChoiceNode:
    """Publishes each change of the choice."""

    def __init__(self, choice: ArmChoice, subscribe: Subscribe) -> None:
        self._choice = choice
        self._lock = clock.Lock()
        self._publisher = rospy.Publisher(CHOSEN_ARM, String, queue_size=10, latch=True, tcp_nodelay=True)
        self._publish()
        rospy.Service("leap_kuka/choose_arm", ChooseArm, self._on_request)
        subscribe(self._on_frame, ReceivedPalms)

    def _on_frame(self, frame: TrackingFrame, _stamp: rospy.Time) -> None:
        with self._lock:
            if self._choice.see(frame.hands):
                self._publish()

    def _on_request(self, request: ChooseArmRequest) -> tuple[bool, str]:
        with self._lock:
            answer = self._choice.request(request.arm)
            if answer.success:
                self._publish()
            else:
                rospy.logwarn(answer.sentence)
        return answer.success, answer.sentence

    def _publish(self) -> None:
        self._publisher.publish(String(self._choice.chosen))
        rospy.loginfo(meaning(self._choice.chosen))


def arm_choice(arms: Sequence[str]) -> ArmChoice | None:
    """Waits for the parameters of these arms, and returns their choice; None if leap/arm_choice is none. Raises
    ConfigError if they do not agree."""
    configs = {arm: wait_for_config(LeapConfig, f"{arm}/leap", others=(OPERATOR_INPUT,)) for arm in arms}
    ways = {arm: config.arm_choice for arm, config in configs.items()}
    (how, *others) = set(ways.values())
    if others:
        listed = ", ".join(f"{arm}/leap/arm_choice {way}" for arm, way in ways.items())
        raise ConfigError([f"The arms must choose in the same way, but there are {listed}."])
    if how == NONE:
        return None
    return ArmChoice(how, {arm: config.box_offset for arm, config in configs.items()})


def start(choice: ArmChoice, subscribe: Subscribe = subscribe) -> None:
    ArmChoiceNode(choice, subscribe)
    while not rospy.is_shutdown():
        clock.sleep(0.5)


def _run() -> None:
    choice = arm_choice(private_config(ArmChoiceConfig).arms)
    if choice is None:
        raise ConfigError(["leap/arm_choice is none, but the node arm_choice needs service or region."])
    start(choice)


def main() -> None:
    run("arm_choice", _run)
