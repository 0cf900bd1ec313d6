"""The control panel as a program of its own."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading

import rospy
from python_qt_binding.QtCore import Qt, QTimer
from python_qt_binding.QtWidgets import QApplication

from kuka_control.gui.panel import ControlPanel
from kuka_control.ros.panel_link import PanelLink

SHUTDOWN_S = 2.0
"""How long saying goodbye to the ROS master may take."""


def main() -> None:
    """Shows the panel until its window is closed, ROS shuts down, or the program is interrupted."""
    parser = argparse.ArgumentParser(description="The control panel of the arm and the gripper.")
    parser.add_argument("--on-top", action="store_true", help="keep the window above all others")
    arguments = parser.parse_args(rospy.myargv()[1:])
    if not any(name in os.environ for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")):
        sys.exit("The control panel needs a screen: neither DISPLAY nor WAYLAND_DISPLAY is set.")
    sys.exit(_show(arguments.on_top))


def _show(on_top: bool) -> int:
    application = QApplication(sys.argv[:1])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: application.quit())
    # Beside Qt, because it waits for the ROS master.
    threading.Thread(target=_join_ros, name="join", daemon=True).start()
    panel = ControlPanel()
    panel.setWindowFlag(Qt.WindowStaysOnTopHint, on_top)
    link = PanelLink(panel)
    panel.resize(560, 460)
    panel.show()
    end = QTimer()
    # Its time-outs also give Python the chance to see signals.
    end.timeout.connect(lambda: application.quit() if rospy.is_shutdown() else None)
    end.start(100)
    code = application.exec_()
    end.stop()
    link.close()
    # A master that hangs must not keep the program.
    goodbye = threading.Thread(target=rospy.signal_shutdown, args=("the panel was closed",), daemon=True)
    goodbye.start()
    goodbye.join(SHUTDOWN_S)
    if goodbye.is_alive():
        os._exit(code)
    return code


def _join_ros() -> None:
    try:
        rospy.init_node("kuka_panel", disable_signals=True)
    except rospy.exceptions.ROSInitException:
        return  # the panel was closed before there was a master
