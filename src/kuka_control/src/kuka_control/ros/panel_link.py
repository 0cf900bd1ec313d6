"""The control panel as a program: connects its window to the controllers (controller_link)."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence

import rospy
from python_qt_binding.QtCore import QObject, Qt, QTimer
from python_qt_binding.QtGui import QGuiApplication
from python_qt_binding.QtWidgets import QApplication

from common import clock
from common.errors import RigError
from common.ros.master import check_surroundings
from common.ros.node import end_closed_servers, hide_closed_connections
from common.screen import TITLE_PX, check_screen, panel_area
from kuka_control.gui.panel import ArmsPanel, ControlPanel
from kuka_control.ros import panel_process
from kuka_control.ros.controller_link import ControllerLink

REFRESH_MS = 50
SHUTDOWN_S = 2.0  # how long saying goodbye to the ROS master may take


class PanelLink(QObject):
    """Shows in a panel what the link `controller` knows, and carries the operator's requests to it; none of them waits
    in Qt's thread, where this is made. `arm`: namespace of one of several arms; empty: this program's own."""

    def __init__(self, panel: ControlPanel, arm: str = "") -> None:
        super().__init__(panel)
        self._panel = panel
        self.controller = ControllerLink(arm)
        panel.control_requested.connect(self.controller.ask_control)
        panel.pause_requested.connect(self.controller.ask_pause)
        panel.guide_requested.connect(self.controller.ask_guide)
        panel.gripper_requested.connect(self.controller.ask_gripper)
        panel.policy_requested.connect(self.controller.ask_policy)
        panel.mark_requested.connect(self.controller.ask_mark)
        panel.scaling_requested.connect(self.controller.ask_scaling)
        panel.exit_requested.connect(self.controller.ask_exit)
        panel.emergency_requested.connect(self.ask_emergency)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._refresh)
        self._timer.start(REFRESH_MS)
        self._refresh()

    def close(self) -> None:
        """Stops listening; running threads stop after their time-outs and no longer touch the panel."""
        self._timer.stop()
        self.controller.close()

    def ask_emergency(self) -> None:
        """Stops the controller at once, beside Qt's thread."""
        self.controller.ask_emergency()

    def _refresh(self) -> None:
        update = self.controller.refresh()
        for answer in update.answers:
            self._panel.show_answer(*answer)
        self._panel.show_rows(update.rows)
        self._panel.show_state(update.state)


def main() -> None:
    """Shows the panel until its window is closed, ROS shuts down, or the program is interrupted."""
    parser = argparse.ArgumentParser(description="The control panel of the arm and the gripper.")
    parser.add_argument("--on-top", action="store_true", help="keep the window above all others")
    parser.add_argument(
        "--if-possible", action="store_true",
        help="if there is no screen, or the control panel is open already, say so and exit without an error",
    )  # fmt: skip
    parser.add_argument(
        "--arms", nargs="+", default=[], metavar="NAMESPACE",
        help="several arms in one window, with one Emergency Stop for all",
    )  # fmt: skip
    arguments = parser.parse_args(rospy.myargv()[1:])
    if arguments.if_possible:
        reason = panel_process.why_not()
        if reason:
            print(reason)
            sys.exit(0)
    try:
        check_screen("The control panel")
        check_surroundings()
    except RigError as error:
        sys.exit(str(error))
    sys.exit(_show(arguments.on_top, arguments.arms))


def linked_panels(arms: Sequence[str]) -> tuple[ControlPanel | ArmsPanel, list[PanelLink]]:
    """Returns the window for these namespaces, or for this program's own without any, and its links. Whatever asks
    for the Emergency Stop in it stops the controllers of all its arms, each beside the others."""
    if not arms:
        panel = ControlPanel()
        return panel, [PanelLink(panel)]
    window = ArmsPanel(arms)
    links = [PanelLink(panel, arm) for arm, panel in window.panels.items()]
    for link in links:
        window.emergency_requested.connect(link.ask_emergency)
    return window, links


def _show(on_top: bool, arms: Sequence[str]) -> int:
    application = QApplication(sys.argv[:1])
    interrupted = clock.Event()  # Qt forgets quit() before exec_()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: interrupted.set())
    # Beside Qt, because it waits for the ROS master.
    clock.Thread(target=_join_ros, name="join", daemon=True).start()
    panel, links = linked_panels(arms)
    panel.setWindowFlag(Qt.WindowStaysOnTopHint, on_top)
    left, top, width, height = panel_area(*QGuiApplication.primaryScreen().availableGeometry().getRect())
    panel.resize(width, height)
    panel.move(left, top - TITLE_PX)  # of the frame, not of what is in it
    panel.show()
    end = QTimer()
    # Its time-outs also give Python the chance to see signals.
    end.timeout.connect(lambda: application.quit() if interrupted.is_set() or rospy.is_shutdown() else None)
    end.start(100)
    code = application.exec_()
    end.stop()
    for link in links:
        link.close()
    # A master that hangs must not keep the program.
    goodbye = clock.Thread(target=rospy.signal_shutdown, args=("the panel was closed",), daemon=True)
    goodbye.start()
    goodbye.join(SHUTDOWN_S)
    if goodbye.is_alive():
        os._exit(code)
    return code


def _join_ros() -> None:
    end_closed_servers()
    hide_closed_connections()
    try:
        rospy.init_node(panel_process.NODE, disable_signals=True)
    except rospy.exceptions.ROSInitException:
        return  # the panel was closed before there was a master
