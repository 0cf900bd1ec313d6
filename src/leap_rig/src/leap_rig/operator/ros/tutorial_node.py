"""The node tutorial: watches the rig's topics and leads a visitor, in a window or on the terminal. Publishes
`leap_rig/tutorial` (diagnostic_msgs/DiagnosticStatus, latched): its message is a sentence, its values are scenario,
step, ticked and failure, as those of simulation/scenario. It commands nothing."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from common import clock
from common.config import choice, flag
from common.frames import BASE, FLANGE_MEASURED
from common.limits import known_limits
from common.robot_hand import HAND, hand_state
from common.ros.conversions import pose_from_transform
from common.ros.params import private_config
from common.ros.raw_tf import TransformSearch
from common.screen import no_screen
from common.teleop_record import teleop_record
from leap_kuka.config import NONE
from leap_rig.operator.tutorial import (
    DONE,
    ArmRecord,
    FingersRecord,
    FlangeRecord,
    Record,
    Tutorial,
    TutorialView,
)
from leap_rig.operator.tutorial_texts import ENGLISH, GERMAN, TEXTS, language_of
from reflex_msgs.msg import Hand
from rig_msgs.msg import KukaStatus, TeleopState

PERIOD_S = 0.1
CLOSED_RAD = np.radians(100.0)  # of a finger of the closed robot hand: the least of leap_hand.yaml


@dataclass(frozen=True)
class TutorialConfig:
    """The private parameters of the node."""

    language: str = choice("", ENGLISH, GERMAN, doc="of the texts; empty: as LANG says", absent="")
    window: bool = flag(doc="open a window; false, or without a screen: the terminal", absent=True)


class TutorialNode:
    """Feeds the tutorial and shows its views."""

    def __init__(self, config: TutorialConfig, clutch: bool) -> None:
        self.texts = TEXTS[language_of(config.language, os.environ.get("LANG", ""))]
        self._tutorial, self._lock = Tutorial(clutch), clock.Lock()
        self._find_flange, self._flange_at = TransformSearch(BASE, FLANGE_MEASURED), 0.0
        self._shown: TutorialView | None = None
        self._publisher = rospy.Publisher("leap_rig/tutorial", DiagnosticStatus, queue_size=10, latch=True)
        for topic, kind, callback in (
            ("leap_kuka/state", TeleopState, self._on_state),
            ("kuka/status", KukaStatus, self._on_status),
            (HAND.state, Hand, self._on_hand),
            ("/tf", rospy.AnyMsg, self._on_transforms),
        ):
            rospy.Subscriber(topic, kind, callback, queue_size=10)

    def view(self) -> TutorialView:
        """Returns the present view, after publishing and logging what is new in it."""
        with self._lock:
            view = self._tutorial.view(clock.monotonic())
        before, self._shown = self._shown, view
        for name in view.steps[before.ticked if before else 0 : view.ticked]:
            self._tell(view, f"✔ {self.texts[f'name_{name}']}")
        if before is None or before.step != view.step:
            self._tell(view, self.texts[f"do_{view.step}"])
        elif view.hint and view.hint != before.hint:
            self._tell(view, self.texts[f"hint_{view.hint}"])
        return view

    def _tell(self, view: TutorialView, sentence: str) -> None:
        rospy.loginfo("%s", sentence)
        ticked = " ".join(view.steps[: view.ticked])
        values = {"scenario": "tutorial", "step": view.step, "failure": "", "ticked": ticked}
        status = DiagnosticStatus(name="tutorial", message=sentence)
        status.values = [KeyValue(key, value) for key, value in values.items()]
        self._publisher.publish(status)

    def _take(self, record: Record) -> None:
        with self._lock:
            self._tutorial.take(record, clock.monotonic())

    def _on_state(self, message: TeleopState) -> None:
        self._take(teleop_record(message))

    def _on_status(self, message: KukaStatus) -> None:
        self._take(ArmRecord(message.mode, message.control_on, message.gripper_on, known_limits(message.limited_by)))

    def _on_hand(self, message: Hand) -> None:
        angles = hand_state(message).angles[: len(HAND.fingers)]
        self._take(FingersRecord(float(np.mean(angles)) / CLOSED_RAD))

    def _on_transforms(self, message: rospy.AnyMsg) -> None:
        """Reads ten poses of the flange a second, of the many transforms."""
        now = clock.monotonic()
        flange = self._find_flange(message) if now - self._flange_at >= PERIOD_S else None
        if flange is not None:
            self._flange_at = now
            self._take(FlangeRecord(pose_from_transform(flange.message.transform)))


def main() -> None:
    """Runs the node until ROS shuts down or its window is closed."""
    config = private_config(TutorialConfig)
    node = TutorialNode(config, rospy.get_param("leap/clutch", NONE) != NONE)
    fault = no_screen() if config.window else ""
    if config.window and not fault:
        _show(node)
        return
    if fault:
        rospy.logwarn("The tutorial has no window: %s.", fault)
    while not rospy.is_shutdown() and node.view().step != DONE:
        clock.sleep(PERIOD_S)
    rospy.spin()


def _show(node: TutorialNode) -> None:
    from python_qt_binding.QtCore import QTimer
    from python_qt_binding.QtWidgets import QApplication

    from leap_rig.operator.tutorial_window import TutorialWindow

    application = QApplication([])
    window, timer = TutorialWindow(node.texts), QTimer()
    screen = application.primaryScreen().availableGeometry()
    window.move(screen.left(), screen.bottom() - window.height())

    def refresh() -> None:
        if rospy.is_shutdown():
            application.quit()
        else:
            window.show_view(node.view())

    refresh()
    timer.timeout.connect(refresh)
    timer.start(round(1e3 * PERIOD_S))
    window.show()
    application.exec_()
    timer.stop()
