"""The control panel as a program of its own."""

from __future__ import annotations

import signal
import sys

import rospy
from python_qt_binding.QtWidgets import QApplication

from kuka_control.gui.panel import ControlPanel
from kuka_control.ros.panel_link import PanelLink


def main() -> None:
    """Shows the panel until its window is closed, ROS shuts down, or the program is interrupted."""
    rospy.init_node("kuka_panel", disable_signals=True)
    application = QApplication(rospy.myargv())
    panel = ControlPanel()
    link = PanelLink(panel)
    panel.resize(520, 340)
    panel.show()
    # Qt's loop returns to Python at every refresh of the panel, so signals are seen.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: application.quit())
    rospy.on_shutdown(application.quit)
    code = application.exec_()
    link.close()
    rospy.signal_shutdown("the panel was closed")
    sys.exit(code)
