"""Connects the control panel to the controller: status in, service calls out, none of them in Qt's thread. rospy's
thread, one that watches the master and one per request leave what they know in attributes and a queue; a timer in Qt's
thread shows it."""

from __future__ import annotations

import argparse
import os
import signal
import socket
import sys
from collections.abc import Sequence
from dataclasses import replace
from time import strftime

import rosgraph
import rospy
from python_qt_binding.QtCore import QObject, Qt, QTimer
from python_qt_binding.QtWidgets import QApplication

from common import clock
from common.errors import RigError
from common.operator_rows import OLD_ROWS_S, SILENT, Row, rows_of
from common.ros.master import check_surroundings
from common.ros.node import end_closed_servers, hide_closed_connections
from common.ros.service_calls import MasterLost, ServiceClient, ServiceFailed, ask_master
from common.screen import check_screen
from kuka_control.gui.panel import ArmsPanel, ControlPanel
from kuka_control.gui.panel_state import ABSENT_S, ControllerStatus, PanelContext, PanelState, Tone, panel_state
from kuka_control.ros import emergency, panel_process
from kuka_control.ros.emergency import ControllerProcess
from kuka_msgs.srv import exitApp, exitAppEmergency, setGripperControl, setKukaControl, setScalingFactor
from rig_msgs.msg import KukaStatus, OperatorView

REFRESH_MS = 50
CALL_TIMEOUT_S = 3.0
SETTLE_S = 1.0  # how long the slider waits for a status with the scaling factor that was accepted
CONTROL, GRIPPER = "kuka/kuka_control", "kuka/gripper_control"
SCALING, EXIT = "kuka/scaling_factor", "kuka/exit_app"
KINDS = {CONTROL: setKukaControl, GRIPPER: setGripperControl, SCALING: setScalingFactor, EXIT: exitApp,
         emergency.SERVICE: exitAppEmergency}  # fmt: skip
SHUTDOWN_S = 2.0  # how long saying goodbye to the ROS master may take


class PanelLink(QObject):
    """Feeds the panel with kuka/status and operator_view/rows, and carries the operator's requests to the services.
    Made in Qt's thread. `arm`: namespace of one of several arms; empty: this program's own."""

    def __init__(self, panel: ControlPanel, arm: str = "") -> None:
        super().__init__(panel)
        self._panel, self._of = panel, f"{arm}/" if arm else ""
        self._status: ControllerStatus | None = None
        self._process: ControllerProcess | None = None
        self._master_lost = False
        self._services = {name: ServiceClient(self._of + name, kind) for name, kind in KINDS.items()}
        self._answers: clock.SimpleQueue[tuple[str, bool, str]] = clock.SimpleQueue()
        self._running: set[str] = set()
        self._next: dict[str, tuple] = {}
        self._asked_scaling: tuple[float, float] | None = None
        panel.control_requested.connect(lambda on: self._ask(CONTROL, on))
        panel.gripper_requested.connect(lambda on: self._ask(GRIPPER, on))
        panel.scaling_requested.connect(self._ask_scaling)
        panel.exit_requested.connect(lambda: self._ask(EXIT))
        panel.emergency_requested.connect(self.ask_emergency)
        self._closed = self._subscribing = False
        self._subscribers: list[rospy.Subscriber] = []
        self._view: tuple[tuple[Row, ...], float] = SILENT, clock.monotonic()
        self._wake = clock.Event()
        clock.Thread(target=self._watch, name="watch", daemon=True).start()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._refresh)
        self._timer.start(REFRESH_MS)
        self._refresh()

    def close(self) -> None:
        """Stops listening; running threads stop after their time-outs and no longer touch the panel."""
        self._timer.stop()
        self._closed = True
        self._wake.set()

    def _refresh(self) -> None:
        while not self._answers.empty():
            self._show_answer(*self._answers.get())
        status = self._status
        runs = None if self._process is None else emergency.runs(self._process)
        context = PanelContext(rosgraph.get_master_uri(), self._master_lost, runs)
        rows, at = self._view
        self._panel.show_rows(rows if clock.monotonic() - at <= OLD_ROWS_S else SILENT)
        self._panel.show_state(self._with_asked_scaling(panel_state(status, clock.monotonic(), context)))

    def _with_asked_scaling(self, state: PanelState) -> PanelState:
        """Shows the scaling factor that was asked for until the controller has taken or refused it."""
        if self._asked_scaling is None:
            return state
        factor, until = self._asked_scaling
        if clock.monotonic() > until or abs(state.scaling_factor - factor) < 1e-3 or not state.present:
            self._asked_scaling = None
            return state
        return replace(state, scaling_factor=factor)

    def _show_answer(self, name: str, accepted: bool, sentence: str) -> None:
        self._running.discard(name)
        if name in self._next:
            self._ask(name, *self._next.pop(name))
            return  # the answer to the newest request counts
        if name == SCALING and not accepted:
            self._asked_scaling = None
        text = f"{strftime('%H:%M:%S')}  {sentence}"
        self._panel.show_answer(text, Tone.NORMAL if accepted else Tone.WARNING)

    def _ask_scaling(self, factor: float) -> None:
        self._asked_scaling = factor, clock.monotonic() + CALL_TIMEOUT_S + SETTLE_S
        self._ask(SCALING, factor)

    def _ask(self, name: str, *request) -> None:
        """Calls a service, one call at a time so that requests stay in order; of those that wait, the newest counts."""
        if name in self._running:
            self._next[name] = request
            return
        self._running.add(name)
        clock.Thread(target=self._call, args=(name, request), name=name, daemon=True).start()

    def _call(self, name: str, request) -> None:
        try:
            answer = self._services[name](*request, timeout=CALL_TIMEOUT_S)
            self._answers.put((name, answer.success, answer.message))
        except ServiceFailed as error:
            self._answers.put((name, False, f"Not confirmed: {error}."))

    def ask_emergency(self) -> None:
        """Stops the controller at once, beside Qt's thread; once while that runs."""
        if emergency.SERVICE not in self._running:
            self._running.add(emergency.SERVICE)
            clock.Thread(target=self._stop, name="emergency", daemon=True).start()

    def _stop(self) -> None:
        status = self._status
        ended, sentence = emergency.stop(
            self._services[emergency.SERVICE], self._process, status.host if status else ""
        )
        self._answers.put((emergency.SERVICE, ended, sentence))

    def _watch(self) -> None:
        """Subscribes once there is a node to do it, keeps addresses, and subscribes anew at a master that forgot us."""
        watch_s = 1.0
        while not (self._master_answers() and rospy.core.is_initialized()):
            if self._closed:
                return
            clock.sleep(REFRESH_MS * 1e-3)
        self._subscribe()
        while not self._closed:
            self._wake.clear()
            try:
                for service in self._services.values():
                    service.look_up()
                forgotten = ask_master("lookupNode", rospy.get_name()) is None
                self._master_lost = False
            except MasterLost:
                self._master_lost, forgotten = True, False
            # A connection that still brings a status is kept: the new master does not know its other end.
            if forgotten and not self._hears() and not self._subscribing:
                self._subscribe()
            self._wake.wait(0.0 if self._closed else watch_s)
        self._unsubscribe()

    def _unsubscribe(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _master_answers(self) -> bool:
        """Asks, because rospy counts a node without topics as initialized, and waits with its first topic for ever."""
        try:
            ask_master("getPid")
        except MasterLost:
            self._master_lost = True
            return False
        self._master_lost = False
        return True

    def _hears(self) -> bool:
        status = self._status
        return status is not None and clock.monotonic() - status.received < ABSENT_S

    def _subscribe(self) -> None:
        """Subscribes anew in a thread of its own, as rospy waits for a master that hangs."""
        self._subscribing = True

        def subscribe() -> None:
            try:
                self._unsubscribe()
                self._subscribers = [
                    rospy.Subscriber(f"{self._of}kuka/status", KukaStatus, self._take, queue_size=1),
                    rospy.Subscriber(f"{self._of}operator_view/rows", OperatorView, self._take_view, queue_size=1),
                ]
            finally:
                self._subscribing = False

        clock.Thread(target=subscribe, name="subscribe", daemon=True).start()

    def _take_view(self, message: OperatorView) -> None:
        self._view = rows_of(message.rows), clock.monotonic()

    def _take(self, message: KukaStatus) -> None:
        process = emergency.find(message.pid) if message.host == socket.gethostname() else None
        known = self._process
        if process is not None or known is None or known.pid != message.pid:  # else it has just exited
            self._process = process
        previous = self._status
        m = message
        self._status = ControllerStatus(
            *(clock.monotonic(), m.control_on, m.gripper_on, m.scaling_factor, m.mode, m.reason),
            *(tuple(m.limited_by), m.host, m.pid),
        )
        if previous is None or (previous.host, previous.pid) != (message.host, message.pid):
            self._wake.set()  # another controller has other addresses


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
    panel.resize(560 * max(1, len(arms)), 780)
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
