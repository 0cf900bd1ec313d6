"""The control panel connected to a controller: what a click asks for, and what is seen whatever the controller does."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest
from controller_rig import PTP, REAL_TIME, set_params

from common import clock

pytest.importorskip("rig_msgs.srv")
import fake_controller
import rosgraph
import rospy
from std_srvs.srv import SetBool, Trigger

import kuka_msgs.srv
from kuka_control.gui.panel import ControlPanel
from kuka_control.ros import emergency, panel_link, panel_process
from kuka_control.ros.panel_link import PanelLink, linked_panels
from rig_msgs.msg import KukaStatus, OperatorRow, OperatorView

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")
pytestmark = pytest.mark.ros

PERIOD_S = 0.05
"""Of a controller's status, and of what the panel shows."""
PROGRAM_PERIOD_S = 0.1
"""Of the program's look whether it is to end."""
LATE_S = 0.01
"""What connections and messages may take."""


@pytest.fixture
def failures(monkeypatch):
    """Exceptions that end a thread or come out of a slot; there must be none."""
    caught = []
    monkeypatch.setattr(threading, "excepthook", lambda args: caught.append(args.exc_value))
    monkeypatch.setattr(sys, "excepthook", lambda kind, value, trace: caught.append(value))
    yield caught
    assert caught == []


@pytest.fixture
def timers(monkeypatch):
    """The timers of the links that run, in virtual time: all are due whenever somebody looks."""
    running = []

    class Timer:
        def __init__(self, parent=None):
            self.timeout = SimpleNamespace(connect=lambda slot: setattr(self, "slot", slot))
            self.period_ms = 1000.0 * (PROGRAM_PERIOD_S if parent is None else PERIOD_S)

        def start(self, period_ms):
            assert period_ms == self.period_ms
            running.append(self)

        def stop(self):
            running.remove(self)

    monkeypatch.setattr(panel_link, "QTimer", Timer)
    return running


@pytest.fixture
def panel(ros, application, failures, timers):
    widget = ControlPanel()
    widget.link = PanelLink(widget)
    widget.show()
    yield widget
    widget.link.close()
    widget.close()


@pytest.fixture
def see(ros, application, timers):
    """Waits until something is seen, while Qt works; returns how long that took [s]."""

    def wait(condition, what, seconds=5.0):
        def look():
            for timer in list(timers):
                timer.slot()
            application.processEvents()
            return condition()

        begun = clock.monotonic()
        ros.wait_until(look, seconds, what, poll=PERIOD_S)
        return clock.monotonic() - begun

    return wait


@pytest.fixture
def start(ros, monkeypatch):
    """Starts the fake controller; what the panel learns of processes and does to them is done to these."""
    started = {}
    monkeypatch.setattr(emergency, "_is_controller", lambda pid: pid in started)
    monkeypatch.setattr(emergency, "_start_of", lambda pid: 0 if started[pid].poll() is None else None)
    monkeypatch.setattr(os, "kill", lambda pid, number: started[pid].send_signal(number))

    def run(*args):
        pid = 10**7 + len(started)
        started[pid] = ros.start("fake_controller.py", fake_controller.main, "", "--pid", str(pid), *args)
        return started[pid]

    return run


@pytest.fixture
def controller(start, panel, see):
    process = start()
    see(lambda: panel.control.isEnabled(), "the controller")
    return process


def is_after(constant, elapsed):
    """Whether something came when it should, as far as the panel's period lets a test see."""
    return constant - LATE_S <= elapsed <= constant + 2 * PERIOD_S + LATE_S


def click(button):
    from python_qt_binding.QtCore import Qt
    from python_qt_binding.QtTest import QTest

    QTest.mouseClick(button, Qt.LeftButton)


def call(name, kind, *values):
    rospy.wait_for_service(f"kuka/{name}", 5.0)
    return rospy.ServiceProxy(f"kuka/{name}", getattr(kuka_msgs.srv, kind))(*values)


def now_scale():
    return rospy.wait_for_message("kuka/status", KukaStatus, 5.0).scaling_factor


@pytest.mark.parametrize("name", ["control", "gripper"])
def test_a_toggle_is_green_when_the_controller_says_so(panel, controller, see, name):
    button = getattr(panel, name)
    controller.send_signal(signal.SIGUSR1)
    silence = see(lambda: not button.isEnabled(), "the silence of the controller")
    assert is_after(1.5, silence + PERIOD_S)  # since the last status
    controller.send_signal(signal.SIGUSR1)
    see(button.isEnabled, "the controller again")

    controller.send_signal(signal.SIGUSR1)  # the request is carried out, but no status says so
    click(button)
    see(lambda: "is on" in panel.answer.full, "the answer")
    assert not button.isChecked()
    controller.send_signal(signal.SIGUSR1)
    see(button.isChecked, "green")
    click(button)
    see(lambda: not button.isChecked(), "grey")
    see(lambda: "is off" in panel.answer.full, "the answer, which may come after the status")


def test_double_clicks_and_quick_changes_are_harmless(panel, controller, see):
    for _ in range(2):
        click(panel.control)
    see(panel.control.isChecked, "control in green")
    for on in (False, True, False, True, False):
        panel.control_requested.emit(on)
    see(lambda: not panel.control.isChecked() and not panel.link.controller._running, "the last request")
    for _ in range(5):
        assert call("exit_app", "exitApp").success and not panel.control.isChecked()


def test_the_slider_stays_where_the_keys_put_it(panel, start, see):
    from python_qt_binding.QtCore import Qt
    from python_qt_binding.QtTest import QTest

    start("--delay", "0.3")
    see(panel.scaling.isEnabled, "the controller")
    for steps in range(1, 6):
        QTest.keyClick(panel.scaling, Qt.Key_Left)
        assert panel.scaling.value() == 100 - steps
        see(lambda: True, "Qt's events")
    seen = set()
    see(lambda: seen.add(panel.scaling.value()) or abs(now_scale() - 0.95) < 1e-6, "the scaling factor")
    see(lambda: "0.95" in panel.answer.full, "the answer")
    assert seen == {95} and panel.scaling_label.text() == "Scaling Factor: 0.95"
    click(panel.reset)
    see(lambda: panel.scaling.value() == 100 and abs(now_scale() - 1.0) < 1e-6, "the default")


def test_a_policy_and_episodes_are_asked_for_where_somebody_offers_them(panel, controller, see):
    asked = []

    def offer(name, kind):
        answer = (True, f"{name} answers.")
        return rospy.Service(name, kind, lambda request: asked.append((name, getattr(request, "data", None))) or answer)

    services = [offer("leap_kuka/run_policy", SetBool), offer("episodes/begin", Trigger)]
    see(lambda: panel.marks["begin"].isVisible(), "the episodes")
    assert not panel.policy.isVisible(), "an absolute engagement"
    rospy.set_param("leap/engagement", "relative")
    see(lambda: panel.policy.isVisible(), "the policy")
    for button, name in (
        (panel.policy, "run_policy"),
        (panel.no_policy, "run_policy"),
        (panel.marks["begin"], "begin"),
    ):
        panel.show_answer("")
        click(button)
        see(lambda name=name: f"{name} answers." in panel.answer.full, "the answer")
    assert asked == [("leap_kuka/run_policy", True), ("leap_kuka/run_policy", False), ("episodes/begin", None)]
    for service in services:
        service.shutdown()
    see(lambda: not panel.training.isVisible(), "nobody offers them")
    assert panel.control.isEnabled()


def test_a_refusal_is_shown(panel, controller, see):
    click(panel.exit)
    see(lambda: "goes to the zero position" in panel.answer.full, "the answer")
    click(panel.control)
    see(lambda: "Control stays off: the controller is shutting down." in panel.answer.full, "the refusal")
    assert panel.answer.property("tone") == "warning" and not panel.control.isChecked()


def test_a_controller_that_comes_goes_and_comes_again(panel, start, see):
    see(lambda: panel.status.full == "Waiting for the controller of the arm.", "the sentence")
    assert not panel.control.isEnabled() and panel.emergency.isEnabled()
    first = start()
    see(panel.control.isEnabled, "the controller")
    click(panel.control)
    see(panel.control.isChecked, "green")
    first.send_signal(signal.SIGKILL)
    see(lambda: "has exited" in panel.status.full, "the sentence")
    assert not panel.control.isChecked() and not panel.control.isEnabled() and panel.emergency.isEnabled()
    start()
    see(panel.control.isEnabled, "the second controller")
    assert not panel.control.isChecked()
    click(panel.gripper)
    see(panel.gripper.isChecked, "green")
    assert "is on" in panel.answer.full


def test_without_a_master_it_says_so_until_one_answers(ros, application, timers, failures, see, start):
    start()
    ros.master_answers, panel = False, ControlPanel()
    link = PanelLink(panel)
    said = see(lambda: panel.status.full == f"Waiting for the ROS master at {rosgraph.get_master_uri()}.", "it")
    assert said <= PERIOD_S
    clock.sleep(5.0)
    assert not link.controller._subscribers
    ros.master_answers = True
    assert see(panel.control.isEnabled, "the controller") <= 2 * PERIOD_S + LATE_S
    ros.master_answers = False
    assert see(lambda: "does not answer; this controller still does" in panel.status.full, "it") <= 1.0 + PERIOD_S
    click(panel.control)
    see(panel.control.isChecked, "green")
    link.close()


def test_at_a_master_that_was_started_anew_it_subscribes_again_once_no_controller_is_heard(ros, panel, controller, see):
    before = list(panel.link.controller._subscribers)
    ros.here.is_known = False
    see(lambda: clock.sleep(3.0) or True, "three looks at the master")
    assert panel.link.controller._subscribers == before
    controller.send_signal(signal.SIGUSR1)
    see(lambda: panel.link.controller._subscribers not in ([], before), "new subscriptions")
    ros.here.is_known = True
    controller.send_signal(signal.SIGUSR1)
    see(panel.control.isEnabled, "the controller again")


def test_a_hanging_controller_never_does_later_what_was_given_up(panel, controller, see):
    controller.send_signal(signal.SIGSTOP)
    click(panel.control)
    silence = see(lambda: "it hangs" in panel.status.full, "the sentence")
    assert is_after(1.5, silence + PERIOD_S)  # since the last status
    assert not panel.control.isEnabled() and panel.status.property("tone") == "fault"
    given_up = see(lambda: "nothing was requested" in panel.answer.full, "the end of the request")
    assert is_after(3.0, silence + given_up)
    controller.send_signal(signal.SIGCONT)
    see(panel.control.isEnabled, "the controller again")
    assert call("gripper_control", "setGripperControl", True).success
    see(panel.gripper.isChecked, "the gripper")
    assert not panel.control.isChecked()


def test_emergency_stop_asks_a_controller_whose_loop_hangs(panel, controller, see):
    controller.send_signal(signal.SIGUSR1)
    see(lambda: "silent" in panel.status.full, "the silence")
    click(panel.emergency)
    assert is_after(0.05, see(lambda: controller.poll() is not None, "the end of the process"))
    assert controller.returncode == 2
    see(lambda: "the controller has exited" in panel.answer.full, "the sentence")


def test_emergency_stop_again_and_again(panel, controller, see):
    for _ in range(5):
        click(panel.emergency)
    see(lambda: controller.poll() is not None, "the end of the process")
    see(lambda: panel.answer.full != "", "the sentence")
    click(panel.emergency)
    see(lambda: not panel.link.controller._running, "the second sentence")
    assert "Emergency Stop" in panel.answer.full


def test_emergency_stop_on_another_machine_is_a_call_alone(panel, start, see, suspend):
    process = start("--host", "far-away")
    see(panel.control.isEnabled, "the controller")
    process.send_signal(signal.SIGSTOP)
    click(panel.emergency)
    assert is_after(0.5, see(lambda: "on far-away did not confirm it" in panel.answer.full, "the sentence"))
    assert process.poll() is None and "smartPad" in panel.answer.full
    process.send_signal(signal.SIGCONT)
    see(panel.control.isEnabled, "the controller again")
    click(panel.emergency)
    see(lambda: process.poll() is not None, "the end of the process")
    assert process.returncode == 2
    see(lambda: "at once" in panel.answer.full, "the sentence")


@pytest.mark.parametrize("asked", [(False, True), (True,)], ids=["behind another", "on its way"])
def test_what_waited_before_an_emergency_stop_is_not_asked_after_it(panel, start, see, asked):
    process = start("--host", "far-away")
    see(panel.control.isEnabled, "the controller")
    process.send_signal(signal.SIGSTOP)
    for on in asked:
        panel.control_requested.emit(on)
    click(panel.emergency)
    see(lambda: "on far-away did not confirm it" in panel.answer.full, "the sentence")
    process.send_signal(signal.SIGCONT)
    see(lambda: not panel.link.controller._running, "the end of the calls")
    assert call("gripper_control", "setGripperControl", True).success
    see(panel.gripper.isChecked, "the gripper")
    assert not panel.control.isChecked()


def test_emergency_stop_without_a_controller_says_so(panel, see):
    click(panel.emergency)
    see(lambda: "there is no controller to stop" in panel.answer.full, "the sentence")


def test_qt_never_waits_for_a_service(panel, start, see, application):
    start("--delay", "2")
    see(panel.scaling.isEnabled, "the controller")
    click(panel.reset)
    before = panel.link.controller._answers.qsize()
    application.processEvents()
    assert panel.link.controller._running == {"kuka/scaling_factor"} and before == 0
    see(lambda: "scaling factor is 1" in panel.answer.full, "the answer")


def test_a_controller_that_hung_before_the_panel_came_is_said_to_be_unheard(
    ros, application, failures, timers, see, start
):
    process = start()
    clock.sleep(1.0)
    process.send_signal(signal.SIGSTOP)
    panel = ControlPanel()
    link = PanelLink(panel)
    silence = see(lambda: "has not been heard" in panel.status.full, "the sentence")
    assert is_after(1.5, silence) and panel.status.property("tone") == "fault" and not panel.control.isEnabled()
    click(panel.emergency)
    see(lambda: "did not confirm it" in panel.answer.full, "the sentence")
    assert "smartPad" in panel.answer.full
    process.send_signal(signal.SIGCONT)
    see(panel.control.isEnabled, "the controller")
    link.close()


def test_what_reaches_a_controller_after_the_emergency_stop_changes_nothing(panel, controller):
    assert call("exit_app_emergency", "exitAppEmergency").success
    answer = call("kuka_control", "setKukaControl", True)
    assert not answer.success and "exits at once" in answer.message


def test_a_panel_may_go_while_a_call_runs(ros, application, failures, timers, start, see):
    start("--delay", "1")
    panel = ControlPanel()
    link = PanelLink(panel)
    see(panel.scaling.isEnabled, "the controller")
    click(panel.reset)
    names = {"kuka/scaling_factor", "watch"}
    mine = [t for t in threading.enumerate() if isinstance(t, clock.Thread) and t.name in names]
    assert {thread.name for thread in mine} == names
    link.close()
    panel.deleteLater()
    del panel, link
    gc.collect()
    see(lambda: not any(thread.is_alive() for thread in mine), "the end of the threads")
    assert not timers


def test_the_panel_shows_what_the_operator_sees_and_that_nobody_says_it_any_more(panel, see):
    rows = OperatorView(rows=[OperatorRow("Hand", "waiting", "good", "ticks", ["flat"], [1.0])])
    publisher = rospy.Publisher("operator_view/rows", OperatorView, queue_size=1)
    said = panel.operator.accessibleDescription
    see(lambda: publisher.publish(rows) or "flat yes" in said(), "the rows")
    assert is_after(1.5, see(lambda: "no news" in said(), "the silence") + PERIOD_S)


@pytest.fixture
def program(ros, application, failures, see, monkeypatch, capsys):
    """Runs the program; `during` is called while its window is there. Returns its exit code, and what it said."""

    def run(*arguments, during=None):
        class Application:
            over = False

            def __init__(self, _argv):
                pass

            def quit(self):
                self.over = True

            def exec_(self):
                (panel,) = (window for window in application.topLevelWidgets() if isinstance(window, ControlPanel))
                assert panel.isVisible() and bool(panel.windowFlags() & Qt.WindowStaysOnTopHint) == (
                    "--on-top" in arguments
                )
                during(panel)
                see(lambda: self.over, "the end")
                return 0

        from python_qt_binding.QtCore import Qt

        monkeypatch.setattr(panel_link, "QApplication", Application)
        ros.here.argv = ["gui.py", *arguments]
        with pytest.raises(SystemExit) as end:
            panel_link.main()
        said = "".join(capsys.readouterr())
        return (1, end.value.code) if isinstance(end.value.code, str) else (end.value.code, said)

    return run


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("master", ["there", "never there", "ended", "hanging"])
def test_interrupted_it_ends_well(ros, program, see, monkeypatch, master, number):
    def signal_shutdown(reason, shut_down=rospy.signal_shutdown):  # which asks the master
        while ros.master_hangs:
            clock.sleep(0.1)
        shut_down(reason)

    def leave(code):
        raise SystemExit(code)

    monkeypatch.setattr(rospy, "signal_shutdown", signal_shutdown)
    monkeypatch.setattr(os, "_exit", leave)
    ros.master_answers = master != "never there"
    begun = []

    def during(panel):
        lost = "Waiting for the ROS master" if master == "never there" else "Waiting for the controller"
        see(lambda: panel.status.full.startswith(lost), "the window")
        clock.sleep(1.0)
        ros.master_answers, ros.master_hangs = master == "there", master == "hanging"
        ros.here.handlers[number](number, None)
        begun.append(clock.monotonic())

    assert program("--on-top", during=during) == (0, "")
    assert clock.monotonic() - begun[0] == pytest.approx(2.0 if master == "hanging" else 0.0, abs=PROGRAM_PERIOD_S)
    ros.master_hangs = False


def test_it_ends_with_its_node(ros, program):
    assert program(during=lambda _: rospy.signal_shutdown("another panel")) == (0, "")


@pytest.mark.parametrize(("display", "said"), [("", "neither DISPLAY nor"), (":98765", "the screen :98765 (DISPLAY)")])
@pytest.mark.parametrize(("option", "code"), [("--if-possible", 0), ("--on-top", 1)])
def test_a_screen_that_is_not_there_is_one_sentence_and_beside_a_controller_no_fault(
    program, monkeypatch, display, said, option, code
):
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.setenv("QT_QPA_PLATFORM", "")
    ended, text = program(option)
    assert ended == code and said in text and len(text.splitlines()) == 1


def test_a_second_panel_is_not_opened_beside_the_first(ros, program, monkeypatch):
    ros.start("first", lambda: (rospy.init_node("kuka_panel"), rospy.spin()))
    clock.sleep(0.1)
    code, text = program("--if-possible")
    assert code == 0 and "open already" in text


@pytest.fixture
def beside(ros, monkeypatch):
    """Starts a controller that has neither parameters nor a robot, on a screen or without one; the commands that it
    starts, and what becomes of these, are in `commands` and `ends`.
    """

    def start(program, *arguments, display=":0"):
        def popen(command, **_):
            start.commands.append(" ".join(command))
            return SimpleNamespace(terminate=lambda: start.ends.append("terminated"), wait=start.ends.append)

        stand_in = SimpleNamespace(Popen=popen, DEVNULL=None, TimeoutExpired=subprocess.TimeoutExpired)
        monkeypatch.setattr(panel_process, "subprocess", stand_in)
        monkeypatch.setenv("DISPLAY", display)
        node = ros.run("kuka_control", program, *arguments)
        clock.sleep(1.0)
        return node

    start.commands, start.ends = [], []
    return start


@pytest.mark.parametrize("program", [REAL_TIME, PTP])
def test_the_panel_comes_and_goes_with_each_controller(beside, program):
    controller = beside(program)
    assert beside.commands == ["rosrun kuka_control gui.py --on-top --if-possible"] and not beside.ends
    controller.send_signal(signal.SIGINT)
    assert controller.wait(1.0) == 0 and beside.ends == ["terminated", 3.0]


def test_the_panel_stays_after_a_fault_of_its_controller(beside):
    controller = beside(REAL_TIME)
    set_params(REAL_TIME, robot="none")
    assert controller.wait(5.0) == 1 and beside.commands and not beside.ends
    assert rospy.get_param("kuka/robot") == "none"


@pytest.mark.parametrize(
    ("argument", "display", "said"), [("gui:=false", ":0", ""), ("gui:=true", "", "there is no screen")]
)
def test_a_controller_runs_without_the_panel(beside, argument, display, said):
    controller = beside(REAL_TIME, argument, display=display)
    assert controller.poll() is None and not beside.commands and said in controller.log


def test_a_request_for_the_control_panel_that_is_no_truth_value_is_refused(beside):
    controller = beside(PTP, "gui:=perhaps")
    assert controller.wait(1.0) == 1 and "gui:=perhaps" in controller.log


@pytest.fixture
def window(ros, application, failures, timers):
    """The window of two arms, with its links."""
    widget, links = linked_panels(["left", "right"])
    widget.show()
    yield widget
    for link in links:
        link.close()
    widget.close()


@pytest.fixture
def both(start, window, see):
    """A controller in each namespace."""
    processes = {arm: start(f"__ns:=/{arm}") for arm in window.panels}
    see(lambda: all(panel.control.isEnabled() for panel in window.panels.values()), "both controllers")
    return processes


def test_each_arm_of_two_has_its_own_switches(window, both, see):
    left, right = window.panels.values()
    click(right.control)
    see(right.control.isChecked, "control of the right arm")
    click(left.gripper)
    see(left.gripper.isChecked, "the left gripper")
    assert not left.control.isChecked() and not right.gripper.isChecked()
    assert [process.poll() for process in both.values()] == [None, None]


def press_emergency(window):
    click(window.emergency)


def press_escape_in(number):
    def press(window):
        from python_qt_binding.QtCore import Qt
        from python_qt_binding.QtTest import QTest

        QTest.keyClick(
            window.emergency if number is None else list(window.panels.values())[number].control, Qt.Key_Escape
        )

    return press


@pytest.mark.parametrize(
    "press", [press_emergency, press_escape_in(None), press_escape_in(0), press_escape_in(1)],
    ids=["button", "Esc", "Esc in the left panel", "Esc in the right panel"],
)  # fmt: skip
def test_one_emergency_stop_ends_both_controllers_even_one_that_hangs(window, both, see, press):
    window.activateWindow()
    both["left"].send_signal(signal.SIGSTOP)
    press(window)
    assert is_after(0.5, see(lambda: not any(p.poll() is None for p in both.values()), "the end of both controllers"))
    see(lambda: all("Emergency Stop" in panel.answer.full for panel in window.panels.values()), "both answers")
    assert not any(panel.emergency.isVisible() for panel in window.panels.values()) and window.emergency.isVisible()
