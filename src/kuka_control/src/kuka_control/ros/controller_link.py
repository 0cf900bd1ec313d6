"""The link of a control panel to the controller of one arm, whatever draws the panel: status in, service calls out.
rospy's thread, one that watches the master and one per request leave what they know in attributes and a queue;
`refresh` returns what a panel shows, and is called from one thread alone."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable
from dataclasses import replace
from time import strftime
from typing import NamedTuple

import rosgraph
import rospy
from std_srvs.srv import SetBool, Trigger

from common import clock
from common.episode_marks import BEGIN, MARKS
from common.operator_rows import OLD_ROWS_S, SILENT, Row, rows_of
from common.ros.service_calls import MasterLost, ServiceClient, ServiceFailed, ask_master, master_answers
from kuka_control.gui.panel_state import ABSENT_S, ControllerStatus, PanelContext, PanelState, Tone, panel_state
from kuka_control.ros import emergency
from kuka_control.ros.emergency import ControllerProcess
from kuka_msgs.srv import exitApp, exitAppEmergency, setGripperControl, setKukaControl, setScalingFactor
from rig_msgs.msg import KukaStatus, OperatorView

POLL_S = 0.05
CALL_TIMEOUT_S = 3.0
SETTLE_S = 1.0  # how long the slider waits for a status with the scaling factor that was accepted
CONTROL, GRIPPER = "kuka/kuka_control", "kuka/gripper_control"
SCALING, EXIT, PAUSE, GUIDE = "kuka/scaling_factor", "kuka/exit_app", "kuka/pause", "kuka/guide"
POLICY, ENGAGEMENT, RELATIVE = "leap_kuka/run_policy", "leap/engagement", "relative"
KINDS = {
    **dict.fromkeys((CONTROL, PAUSE, GUIDE), setKukaControl),
    GRIPPER: setGripperControl,
    SCALING: setScalingFactor,
    EXIT: exitApp,
    emergency.SERVICE: exitAppEmergency,
}
"""The controller's services; others may be there."""
OTHERS = {POLICY: SetBool, **{f"episodes/{mark}": Trigger for mark in MARKS}}


class PanelAnswer(NamedTuple):
    """What became of a request."""

    text: str  # when, and a sentence
    tone: Tone


class PanelUpdate(NamedTuple):
    """What a panel shows now; `status_age`: of the controller's last status [s], None before the first."""

    rows: tuple[Row, ...]
    state: PanelState
    answers: tuple[PanelAnswer, ...]  # new since the last one
    status_age: float | None


class ControllerLink:
    """Hears kuka/status and operator_view/rows, and carries the operator's requests to the services. `arm`: namespace
    of one of several arms; empty: this program's own. `rows`: whether somebody sees the operator's view at once."""

    def __init__(self, arm: str = "", rows: bool = True) -> None:
        self._of = f"{arm}/" if arm else ""
        self._rows, self._rows_wanted, self._lock = None, rows, clock.Lock()
        self._status: ControllerStatus | None = None
        self._process: ControllerProcess | None = None
        self._master_lost = False
        self._policy = self._episodes = False  # whether these services are there
        self._known_since = math.inf  # when the master named a controller
        self._services = {n: ServiceClient(self._of + n, kind) for n, kind in (*KINDS.items(), *OTHERS.items())}
        self._answers: clock.SimpleQueue[tuple[str, bool, str]] = clock.SimpleQueue()
        self._running: set[str] = set()
        self._next: dict[str, tuple[tuple, int]] = {}  # requests that wait, and how many stops were asked for before
        self._stops = 0
        self._asked_scaling: tuple[float, float] | None = None
        self._closed = self._subscribing = False
        self._subscribers: list[rospy.Subscriber] = []
        self._view: tuple[tuple[Row, ...], float] = SILENT, clock.monotonic()
        self._wake = clock.Event()
        clock.Thread(target=self._watch, name="watch", daemon=True).start()

    def close(self) -> None:
        """Stops listening; running threads stop after their time-outs."""
        self._closed = True
        self._wake.set()

    def refresh(self) -> PanelUpdate:
        """Returns what the panel shows now; carries out requests that waited for an answer."""
        answers = []
        while not self._answers.empty():
            answers += self._taken(*self._answers.get())
        status, now = self._status, clock.monotonic()
        runs = None if self._process is None else emergency.runs(self._process)
        unheard = now - self._known_since > ABSENT_S
        context = PanelContext(rosgraph.get_master_uri(), self._master_lost, runs, unheard)
        rows, at = self._view
        state = self._with_asked_scaling(panel_state(status, now, context))
        state = replace(state, policy=self._policy, episodes=self._episodes)
        age = None if status is None else now - status.received
        return PanelUpdate(rows if now - at <= OLD_ROWS_S else SILENT, state, tuple(answers), age)

    def _with_asked_scaling(self, state: PanelState) -> PanelState:
        """Shows the scaling factor that was asked for until the controller has taken or refused it."""
        if self._asked_scaling is None:
            return state
        factor, until = self._asked_scaling
        if clock.monotonic() > until or abs(state.scaling_factor - factor) < 1e-3 or not state.present:
            self._asked_scaling = None
            return state
        return replace(state, scaling_factor=factor)

    def _taken(self, name: str, accepted: bool, sentence: str) -> list[PanelAnswer]:
        self._running.discard(name)
        following = self._next.pop(name, None)  # a stop beside this thread may empty it
        if following is not None:
            self._start(name, *following)
            return []  # the answer to the newest request counts
        if name == SCALING and not accepted:
            self._asked_scaling = None
        return [PanelAnswer(f"{strftime('%H:%M:%S')}  {sentence}", Tone.NORMAL if accepted else Tone.WARNING)]

    def ask_control(self, on: bool) -> None:
        self._ask(CONTROL, on)

    def ask_gripper(self, on: bool) -> None:
        self._ask(GRIPPER, on)

    def ask_pause(self, on: bool) -> None:
        self._ask(PAUSE, on)

    def ask_guide(self, on: bool) -> None:
        self._ask(GUIDE, on)

    def ask_policy(self, on: bool) -> None:
        self._ask(POLICY, on)

    def ask_mark(self, mark: str) -> None:
        self._ask(f"episodes/{mark}")

    def ask_exit(self) -> None:
        self._ask(EXIT)

    def ask_scaling(self, factor: float) -> None:
        self._asked_scaling = factor, clock.monotonic() + CALL_TIMEOUT_S + SETTLE_S
        self._ask(SCALING, factor)

    def _ask(self, name: str, *request) -> None:
        """Calls a service, one call at a time so that requests stay in order; of those that wait, the newest counts."""
        if name in self._running:
            self._next[name] = request, self._stops
        else:
            self._start(name, request, self._stops)

    def _start(self, name: str, request: tuple, stops: int) -> None:
        self._running.add(name)
        clock.Thread(target=self._call, args=(name, request, stops), name=name, daemon=True).start()

    def _call(self, name: str, request: tuple, stops: int) -> None:
        try:
            wanted = lambda: self._stops == stops  # noqa: E731
            answer = self._services[name](*request, timeout=CALL_TIMEOUT_S, wanted=wanted)
            self._answers.put((name, answer.success, answer.message))
        except ServiceFailed as error:
            self._answers.put((name, False, f"Not confirmed: {error}."))

    def ask_emergency(self) -> None:
        """Stops the controller at once, in a thread of its own; once while that runs. What was asked before and has
        not reached the controller is taken back."""
        self._stops += 1
        self._next.clear()
        if emergency.SERVICE not in self._running:
            self._running.add(emergency.SERVICE)
            clock.Thread(target=self._stop, name="emergency", daemon=True).start()

    def _stop(self) -> None:
        status = self._status
        ended, sentence = emergency.stop(
            *(self._services[emergency.SERVICE], self._process, status.host if status else ""),
            stops=status is not None and status.stops,
        )
        self._running.discard(emergency.SERVICE)
        self._answers.put((emergency.SERVICE, ended, sentence))

    def _watch(self) -> None:
        """Subscribes once there is a node to do it, keeps addresses, and subscribes anew at a master that forgot us."""
        watch_s = 1.0
        while True:
            self._master_lost = not master_answers()  # rospy counts a node without topics as initialized
            if not self._master_lost and rospy.core.is_initialized():
                break
            if self._closed:
                return
            clock.sleep(POLL_S)
        self._beside(self._subscribe)
        while not self._closed:
            self._wake.clear()
            try:
                known = [self._services[name].look_up() for name in KINDS]
                self._policy = self._services[POLICY].look_up() and self._parameter(ENGAGEMENT) == RELATIVE
                self._episodes = self._services[f"episodes/{BEGIN}"].look_up()
                self._known_since = min(self._known_since, clock.monotonic()) if any(known) else math.inf
                forgotten = ask_master("lookupNode", rospy.get_name()) is None
                self._master_lost = False
            except MasterLost:
                self._master_lost, forgotten = True, False
            # A connection that still brings a status is kept: the new master does not know its other end.
            if not (self._master_lost or self._subscribing):
                if forgotten and not self._hears():
                    self._beside(self._subscribe)
                elif self._rows_wanted is (self._rows is None):
                    self._beside(self._follow_rows)
            self._wake.wait(0.0 if self._closed else watch_s)
        self._unsubscribe()

    def _parameter(self, name: str) -> object:
        return ask_master("getParam", rospy.resolve_name(self._of + name))

    def watch_rows(self, on: bool) -> None:
        """Whether somebody sees the operator's view now, which is made for those who look."""
        self._rows_wanted = on
        self._wake.set()

    def _follow_rows(self) -> None:
        with self._lock:
            if self._rows_wanted and self._rows is None and self._subscribers:
                self._rows = rospy.Subscriber(
                    f"{self._of}operator_view/rows", OperatorView, self._take_view, queue_size=1
                )
            elif not self._rows_wanted and self._rows is not None:
                self._rows.unregister()
                self._rows = None

    def _unsubscribe(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            rows, self._rows = self._rows, None
        if rows is not None:
            rows.unregister()

    def _hears(self) -> bool:
        status = self._status
        return status is not None and clock.monotonic() - status.received < ABSENT_S

    def _beside(self, job: Callable[[], None]) -> None:
        """Subscribes in a thread of its own, one at a time, as rospy waits for a master that hangs."""
        self._subscribing = True

        def subscribe() -> None:
            try:
                job()
            finally:
                self._subscribing = False

        clock.Thread(target=subscribe, name="subscribe", daemon=True).start()

    def _subscribe(self) -> None:
        self._unsubscribe()
        self._subscribers = [rospy.Subscriber(f"{self._of}kuka/status", KukaStatus, self._take, queue_size=1)]
        self._follow_rows()

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
            *(tuple(m.limited_by), m.host, m.pid, tuple(m.robot_abilities), m.paused, m.guided),
        )
        if previous is None or (previous.host, previous.pid) != (message.host, message.pid):
            self._wake.set()  # another controller has other addresses
