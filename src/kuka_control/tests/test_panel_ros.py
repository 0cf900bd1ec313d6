"""The control panel connected to a controller: what a click asks for, and what is seen whatever the controller does."""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")
pytestmark = pytest.mark.ros

FAKE = str(Path(__file__).with_name("fake_controller.py"))
LONG_S = 20.0
"""Longest wait; the machine may be busy."""


@pytest.fixture
def failures(monkeypatch):
    """Exceptions that end a thread or come out of a slot; there must be none."""
    caught = []
    monkeypatch.setattr(threading, "excepthook", lambda args: caught.append(args.exc_value))
    monkeypatch.setattr(sys, "excepthook", lambda kind, value, trace: caught.append(value))
    yield caught
    assert caught == []


@pytest.fixture
def panel(ros, application, failures):
    from kuka_control.gui.panel import ControlPanel
    from kuka_control.ros.panel_link import PanelLink

    widget = ControlPanel()
    widget.link = PanelLink(widget)
    widget.show()
    yield widget
    close(widget.link)
    widget.close()


def close(*links):
    """Closes the links; their threads unsubscribe at their end, which must not be later than that of the graph."""
    for link in links:
        link.close()
    for thread in threading.enumerate():
        if thread.name == "watch":
            thread.join(LONG_S)


@pytest.fixture
def see(application, wait_until):
    """Waits until something is seen, while Qt works."""

    def wait(condition, what):
        def look():
            application.processEvents()
            return condition()

        return wait_until(look, LONG_S, what)

    return wait


@pytest.fixture
def start(processes):
    """Starts the fake controller."""
    return lambda *args: processes.start(sys.executable, FAKE, *args)


@pytest.fixture
def controller(start, panel, see):
    process = start()
    see(lambda: panel.control.isEnabled(), "the controller")
    return process


@pytest.fixture
def patience(monkeypatch):
    """Gives a controller that does not hang more than half a second to exit, which a busy machine may take."""
    from kuka_control.ros import emergency

    return lambda: monkeypatch.setattr(emergency, "PATIENCE_S", LONG_S)


def click(button):
    from python_qt_binding.QtCore import Qt
    from python_qt_binding.QtTest import QTest

    QTest.mouseClick(button, Qt.LeftButton)


def call(name, kind, *values):
    import rospy

    import kuka_msgs.srv

    rospy.wait_for_service(f"kuka/{name}", LONG_S)
    return rospy.ServiceProxy(f"kuka/{name}", getattr(kuka_msgs.srv, kind))(*values)


def now_scale():
    import rospy

    from rig_msgs.msg import KukaStatus

    return rospy.wait_for_message("kuka/status", KukaStatus, LONG_S).scaling_factor


@pytest.mark.parametrize("name", ["control", "gripper"])
def test_a_toggle_is_green_when_the_controller_says_so(panel, controller, see, name):
    button = getattr(panel, name)
    controller.send_signal(signal.SIGUSR1)
    see(lambda: not button.isEnabled(), "the silence of the controller")
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


def test_a_call_made_elsewhere_turns_the_toggles_green(panel, controller, see):
    assert call("kuka_control", "setKukaControl", True).success
    see(panel.control.isChecked, "control in green")
    assert call("gripper_control", "setGripperControl", True).success
    see(panel.gripper.isChecked, "gripper in green")
    assert panel.answer.full == ""


def test_double_clicks_and_quick_changes_are_harmless(panel, controller, see):
    for _ in range(2):
        click(panel.control)
    see(panel.control.isChecked, "control in green")
    for on in (False, True, False, True, False):
        panel.control_requested.emit(on)
    see(lambda: not panel.control.isChecked() and not panel.link._running, "the last request")
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


def test_the_scaling_factor_is_locked_while_control_is_on(panel, controller, see):
    click(panel.control)
    see(lambda: not panel.scaling.isEnabled(), "the lock")
    panel.scaling_requested.emit(0.3)  # as if it was asked for just before
    see(lambda: "stays 1: it cannot change while control is on" in panel.answer.full, "the refusal")
    see(lambda: panel.scaling.value() == 100, "the slider where it was")
    assert panel.answer.property("tone") == "warning"


def test_a_factor_set_by_the_service_is_shown_exactly(panel, controller, see):
    see(panel.scaling.isEnabled, "the controller")
    assert call("scaling_factor", "setScalingFactor", 0.3337).success
    see(lambda: panel.scaling_label.text() == "Scaling Factor: 0.3337", "the factor")


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
    first.kill()
    see(lambda: "has exited" in panel.status.full, "the sentence")
    assert not panel.control.isChecked() and not panel.control.isEnabled() and panel.emergency.isEnabled()
    start()
    see(panel.control.isEnabled, "the second controller")
    assert not panel.control.isChecked()
    click(panel.gripper)
    see(panel.gripper.isChecked, "green")
    assert "is on" in panel.answer.full


def test_without_a_master_it_says_so_while_rospy_waits_for_one(ros, application, failures, see, monkeypatch, free_port):
    import rospy

    from kuka_control.gui.panel import ControlPanel
    from kuka_control.ros.panel_link import PanelLink

    uri = f"http://localhost:{free_port()}"
    panel = ControlPanel()
    with monkeypatch.context() as elsewhere:
        elsewhere.setenv("ROS_MASTER_URI", uri)
        with rospy.topics.get_topic_manager().lock:  # as rospy's first topic does
            link = PanelLink(panel)
            see(lambda: panel.status.full == f"Waiting for the ROS master at {uri}.", "the sentence")
        close(link)


def test_a_hanging_controller_never_does_later_what_was_given_up(panel, controller, see, suspend):
    suspend(controller.pid)
    click(panel.control)
    see(lambda: "it hangs" in panel.status.full, "the sentence")
    assert not panel.control.isEnabled() and panel.status.property("tone") == "fault"
    see(lambda: "nothing was requested" in panel.answer.full, "the end of the request")
    controller.send_signal(signal.SIGCONT)
    see(panel.control.isEnabled, "the controller again")
    assert call("gripper_control", "setGripperControl", True).success
    see(panel.gripper.isChecked, "the gripper")
    assert not panel.control.isChecked()


def test_emergency_stop_ends_a_controller_that_hangs(panel, controller, see, suspend):
    suspend(controller.pid)
    click(panel.emergency)
    see(lambda: controller.poll() is not None, "the end of the process")
    assert controller.returncode == -signal.SIGKILL
    see(lambda: "hung and its process was ended" in panel.answer.full, "the sentence")
    see(lambda: "has exited" in panel.status.full and not panel.control.isEnabled(), "the end")


def test_emergency_stop_asks_a_controller_whose_loop_hangs(panel, controller, see, patience):
    patience()
    controller.send_signal(signal.SIGUSR1)
    see(lambda: "silent" in panel.status.full, "the silence")
    click(panel.emergency)
    see(lambda: controller.poll() is not None, "the end of the process")
    assert controller.returncode == 2
    see(lambda: "the controller has exited" in panel.answer.full, "the sentence")


def test_emergency_stop_again_and_again(panel, controller, see):
    for _ in range(5):
        click(panel.emergency)
    see(lambda: controller.poll() is not None, "the end of the process")
    see(lambda: panel.answer.full != "", "the sentence")
    click(panel.emergency)
    see(lambda: not panel.link._running, "the second sentence")
    assert "Emergency Stop" in panel.answer.full


def test_emergency_stop_on_another_machine_is_a_call_alone(panel, start, see, suspend, patience):
    process = start("--host", "far-away")
    see(panel.control.isEnabled, "the controller")
    suspend(process.pid)
    click(panel.emergency)
    see(lambda: "on far-away did not confirm it" in panel.answer.full, "the sentence")
    assert process.poll() is None and "smartPad" in panel.answer.full
    process.send_signal(signal.SIGCONT)
    see(panel.control.isEnabled, "the controller again")
    patience()
    click(panel.emergency)
    see(lambda: process.poll() is not None, "the end of the process")
    assert process.returncode == 2
    see(lambda: "at once" in panel.answer.full, "the sentence")


def test_emergency_stop_never_ends_a_process_that_is_no_controller(panel, processes, start, see, suspend):
    other = processes.start("sleep", "60")
    process = start("--pid", str(other.pid))
    see(panel.control.isEnabled, "the controller")
    suspend(process.pid)
    click(panel.emergency)
    see(lambda: "did not confirm it" in panel.answer.full, "the sentence")
    assert other.poll() is None and process.poll() is None


def test_emergency_stop_without_a_controller_says_so(panel, see):
    click(panel.emergency)
    see(lambda: "there is no controller to stop" in panel.answer.full, "the sentence")


def test_qt_never_waits_for_a_service(panel, start, see, application):
    start("--delay", "2")
    see(panel.scaling.isEnabled, "the controller")
    click(panel.reset)
    before = panel.link._answers.qsize()
    application.processEvents()
    assert panel.link._running == {"kuka/scaling_factor"} and before == 0
    see(lambda: "scaling factor is 1" in panel.answer.full, "the answer")


def test_a_panel_may_go_while_a_call_runs(ros, application, failures, start, see):
    from kuka_control.gui.panel import ControlPanel
    from kuka_control.ros.panel_link import PanelLink

    start("--delay", "1")
    panel = ControlPanel()
    link = PanelLink(panel)
    see(panel.scaling.isEnabled, "the controller")
    click(panel.reset)
    names = {"kuka/scaling_factor", "watch"}
    mine = [thread for thread in threading.enumerate() if thread.name in names]
    link.close()
    panel.deleteLater()
    del panel, link
    gc.collect()
    see(lambda: not any(thread.is_alive() for thread in mine), "the end of the threads")
    time.sleep(0.1)


def test_the_panel_shows_what_the_operator_sees_and_that_nobody_says_it_any_more(panel, see):
    import rospy

    from rig_msgs.msg import OperatorRow, OperatorView

    rows = OperatorView(rows=[OperatorRow("Hand", "waiting", "good", "ticks", ["flat"], [1.0])])
    publisher = rospy.Publisher("operator_view/rows", OperatorView, queue_size=1)
    said = panel.operator.accessibleDescription
    see(lambda: publisher.publish(rows) or "flat yes" in said(), "the rows")
    see(lambda: "no news" in said(), "the silence")


@pytest.fixture
def window(ros, application, failures):
    """The window of two arms, with its links."""
    from kuka_control.ros.panel_link import linked_panels

    widget, links = linked_panels(["left", "right"])
    widget.show()
    yield widget
    close(*links)
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
def test_one_emergency_stop_ends_both_controllers_even_one_that_hangs(window, both, see, press, suspend):
    window.activateWindow()
    suspend(both["left"].pid)
    press(window)
    see(lambda: all(process.poll() is not None for process in both.values()), "the end of both controllers")
    see(lambda: all("Emergency Stop" in panel.answer.full for panel in window.panels.values()), "both answers")
    assert not any(panel.emergency.isVisible() for panel in window.panels.values()) and window.emergency.isVisible()
