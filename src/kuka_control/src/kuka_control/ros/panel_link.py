"""Connects the control panel to the controller: status in, service calls out, none of them in the GUI's thread."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time

import rospy
from python_qt_binding.QtCore import QObject, QTimer, Signal

from kuka_control.gui.panel import ControlPanel
from kuka_control.gui.panel_state import ControllerStatus, panel_state
from kuka_msgs.srv import exitApp, exitAppEmergency, setGripperControl, setKukaControl, setScalingFactor
from rig_msgs.msg import KukaStatus

REFRESH_MS = 100
CALL_TIMEOUT_S = 3.0
EMERGENCY_TIMEOUT_S = 0.5


class PanelLink(QObject):
    """Feeds the panel with kuka/status and carries the person's requests to the services."""

    answered = Signal(str)

    def __init__(self, panel: ControlPanel) -> None:
        super().__init__(panel)
        self._panel = panel
        self._status: ControllerStatus | None = None
        self._pending: set[str] = set()
        panel.control_requested.connect(lambda on: self._ask("kuka/kuka_control", setKukaControl, on))
        panel.gripper_requested.connect(lambda on: self._ask("kuka/gripper_control", setGripperControl, on))
        panel.scaling_requested.connect(lambda factor: self._ask("kuka/scaling_factor", setScalingFactor, factor))
        panel.exit_requested.connect(lambda: self._ask("kuka/exit_app", exitApp))
        panel.emergency_requested.connect(self._emergency)
        self.answered.connect(panel.show_answer)
        self._subscriber = rospy.Subscriber("kuka/status", KukaStatus, self._take, queue_size=1)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._refresh)
        self._timer.start(REFRESH_MS)
        self._refresh()

    def close(self) -> None:
        """Stops listening."""
        self._timer.stop()
        self._subscriber.unregister()

    def _take(self, message: KukaStatus) -> None:
        self._status = ControllerStatus(
            time.monotonic(),
            message.control_on,
            message.gripper_on,
            message.scaling_factor,
            message.mode,
            message.reason,
            tuple(message.limited_by),
            message.host,
            message.pid,
        )

    def _refresh(self) -> None:
        self._panel.show_state(panel_state(self._status, time.monotonic()))

    def _ask(self, name: str, kind, *request) -> None:
        if name in self._pending:
            self.answered.emit(f"{name} has not answered yet.")
            return
        self._pending.add(name)
        threading.Thread(target=self._call, args=(name, kind, request), daemon=True).start()

    def _call(self, name: str, kind, request) -> None:
        try:
            rospy.wait_for_service(name, CALL_TIMEOUT_S)
            self.answered.emit(rospy.ServiceProxy(name, kind)(*request).message)
        except (rospy.ROSException, rospy.ServiceException) as error:
            self.answered.emit(f"{name} did not answer: {error}")
        finally:
            self._pending.discard(name)

    def _emergency(self) -> None:
        """Asks the controller to end at once, and ends its process if it does not within half a second."""
        status = self._status
        threading.Thread(target=self._call_emergency, daemon=True).start()
        if status is not None:
            QTimer.singleShot(round(EMERGENCY_TIMEOUT_S * 1e3), lambda: self._kill(status))

    def _call_emergency(self) -> None:
        try:
            rospy.ServiceProxy("kuka/exit_app_emergency", exitAppEmergency)()
        except (rospy.ROSException, rospy.ServiceException) as error:
            # The controller may end before its answer is out, which is what was asked for.
            self.answered.emit(f"Emergency stop: {error}")

    def _kill(self, status: ControllerStatus) -> None:
        if status.host != socket.gethostname() or status.pid <= 0:
            self.answered.emit(f"Emergency stop asked for; the controller runs on {status.host}, watch the arm.")
            return
        try:
            os.kill(status.pid, signal.SIGKILL)
            self.answered.emit("Emergency stop: the controller hung and its process was ended.")
        except ProcessLookupError:
            self.answered.emit("Emergency stop: the controller has ended.")
        except PermissionError:
            self.answered.emit(f"Emergency stop: process {status.pid} belongs to another user, end it by hand.")
