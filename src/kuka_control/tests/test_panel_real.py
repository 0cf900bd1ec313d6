"""The control panel and processes as they are: which of them Emergency Stop ends, and a master that nobody hears."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path

import pytest

pytest.importorskip("rig_msgs.srv")

from kuka_control.gui.panel import ControlPanel
from kuka_control.ros.panel_link import PanelLink

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")
pytestmark = [pytest.mark.ros, pytest.mark.real]

FAKE = str(Path(__file__).with_name("fake_controller.py"))


@pytest.fixture
def link(ros, application):
    panel = ControlPanel()
    made = PanelLink(panel)
    made.panel = panel
    yield made
    made.close()
    panel.close()
    for thread in threading.enumerate():  # its watch must not outlive the graph
        if thread.name == "watch":
            thread.join(20.0)


@pytest.fixture
def see(application, wait_until):
    """Waits until something is seen, while Qt works."""
    return lambda condition, what: wait_until(lambda: (application.processEvents(), condition())[1], 20.0, what)


def test_emergency_stop_ends_a_controller_that_hangs_and_no_other_process(link, processes, see, suspend):
    other = processes.start("sleep", "600")
    liar = processes.start(sys.executable, FAKE, "--pid", str(other.pid))
    see(link.panel.control.isEnabled, "the controller")
    suspend(liar.pid)
    link.panel.emergency.click()
    see(lambda: "did not confirm it" in link.panel.answer.full, "the sentence")
    assert other.poll() is None and liar.poll() is None
    liar.kill()
    see(lambda: not link.panel.control.isEnabled(), "the silence")
    controller = processes.start(sys.executable, FAKE)
    see(link.panel.control.isEnabled, "the controller")
    suspend(controller.pid)
    link.panel.emergency.click()
    see(lambda: controller.poll() is not None, "the end of the process")
    assert controller.returncode == -signal.SIGKILL
    see(lambda: "hung and its process was ended" in link.panel.answer.full, "the sentence")
