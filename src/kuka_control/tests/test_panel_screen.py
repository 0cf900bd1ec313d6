"""The program gui.py on a screen of its own, clicked at the widgets' positions, its colours read from the screen."""

from __future__ import annotations

import mmap
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(
        not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="the packages xvfb and xdotool are not installed"
    ),
]

PARAMETERS = Path(__file__).parents[1] / "config" / "kuka_params_rt.yaml"
FAKE = str(Path(__file__).with_name("fake_controller.py"))
TITLE = "Leap Rig: control"
LONG_S = 30.0
"""Longest wait; the machine may be busy."""
HOME_S = 60.0
ASK_S = 0.2
"""Between two questions of xdotool, each of which starts a program."""

GREEN, GREY, LOCKED, RED = (0x2E, 0x9E, 0x44), (0xE4, 0xE7, 0xEB), (0xF1, 0xF3, 0xF5), (0xC6, 0x28, 0x28)
NORMAL, WARNING, FAULT = (0xFF, 0xFF, 0xFF), (0xFF, 0xF3, 0xD6), (0xFD, 0xE3, 0xE3)


class Screen:
    """A virtual screen, with the panel in its upper left corner."""

    def __init__(self, folder, number, wait_until):
        self.display = f":{number}"
        self._wait_until = wait_until
        self._twin = None
        with open(folder / "Xvfb_screen0", "rb") as file:
            self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    def xdotool(self, *command):
        done = subprocess.run(
            ["xdotool", *map(str, command)],
            env={**os.environ, "DISPLAY": self.display},
            capture_output=True, text=True, timeout=LONG_S,
        )  # fmt: skip
        return done.stdout

    def wait_for_panel(self):
        """Waits for the window and makes a hidden twin of the panel, which knows where the widgets are."""
        from kuka_control.gui.panel import ControlPanel

        shown = ("search", "--onlyvisible", "--name", TITLE)
        self.window = self._wait_until(lambda: self.xdotool(*shown).split(), LONG_S, "the window", ASK_S)[0]
        self._twin = ControlPanel()
        self._twin.show()
        self._follow_window()
        self.wait_for("emergency", RED)

    def _follow_window(self):
        """Puts the twin where the window is now: Qt may still move and resize one that is already seen."""
        place = dict(re.findall(r"(\w+)=(-?\d+)", self.xdotool("getwindowgeometry", "--shell", self.window)))
        if place:  # the window may just have gone
            self.origin = int(place["X"]), int(place["Y"])
            self._twin.resize(int(place["WIDTH"]), int(place["HEIGHT"]))

    def place(self, name):
        """Returns a point near the upper left corner of a widget, where its background is [px]."""
        from python_qt_binding.QtCore import QPoint

        point = getattr(self._twin, name).mapTo(self._twin, QPoint(10, 10))
        return self.origin[0] + point.x(), self.origin[1] + point.y()

    def click(self, name):
        self.xdotool("mousemove", *self.place(name), "click", 1, "mousemove", 799, 799)

    def key(self, name):
        self.xdotool("windowfocus", "--sync", self.window, "key", name)

    def colour(self, name):
        """Returns the colour of a widget as it is on the screen (XWDFile.h: 25 numbers, the colour map, the pixels)."""
        header = struct.unpack(">25I", self._memory[:100])
        start, bits, line = header[0] + 12 * header[19], header[11], header[12]
        x, y = self.place(name)
        blue, green, red = self._memory[start + y * line + x * bits // 8 :][:3]
        return red, green, blue

    def wait_for(self, name, *colours):
        followed = 0.0

        def seen():
            nonlocal followed
            if self.colour(name) in colours:
                return True
            if time.monotonic() > followed + ASK_S:
                self._follow_window()
                followed = time.monotonic()
            return False

        try:
            self._wait_until(seen, LONG_S, f"{name} in one of {colours}")
        except pytest.fail.Exception as failure:
            pytest.fail(f"{failure.msg}; it is {self.colour(name)} at {self.place(name)}")


@pytest.fixture
def screen(application, processes, tmp_path, wait_until):
    size = ("-screen", "0", "800x800x24", "-fbdir", str(tmp_path))
    server = processes.start("Xvfb", "-displayfd", "1", *size, "-noreset", "-nolisten", "tcp")
    number = wait_until(lambda: re.search(r"^(\d+)$", server.log_path.read_text(), re.M), LONG_S, "the screen")
    return Screen(tmp_path, number[1], wait_until)


class Panel:
    """The program, started as `rosrun` does."""

    def __init__(self, process, wait_until):
        self.process, self._wait_until = process, wait_until

    @property
    def log(self):
        return self.process.log_path.read_text()

    def wait_until_known(self):
        """Waits until the ROS master has the node."""
        import rosgraph

        self._wait_until(lambda: "/kuka_panel" in str(rosgraph.Master("/test").getSystemState()), LONG_S, "the node")

    def wait_for_end(self):
        self._wait_until(lambda: self.process.poll() is not None, LONG_S, "the end of the panel")
        assert "Traceback" not in self.log, self.log
        return self.process.returncode


@pytest.fixture
def panel(screen, processes, wait_until):
    """Starts the program on the screen, at the given ROS master or at the tests' own."""
    started = []

    def start(uri=None, *args):
        env = {"DISPLAY": screen.display, "QT_QPA_PLATFORM": "xcb", **({"ROS_MASTER_URI": uri} if uri else {})}
        started.append(Panel(processes.start("rosrun", "kuka_control", "gui.py", *args, env=env), wait_until))
        screen.wait_for_panel()
        return started[-1]

    yield start
    for one in started:
        assert "Traceback" not in one.log, one.log


@pytest.fixture
def fake(processes):
    def start(uri=None, *args):
        return processes.start(sys.executable, FAKE, *args, env={"ROS_MASTER_URI": uri} if uri else None)

    return start


@pytest.fixture
def core(processes, free_port, wait_until):
    """Starts a ROS master of the test's own, which may be ended; `start` starts it on the same port again."""

    class Core:
        port = free_port()
        uri = f"http://localhost:{port}"

        def start(self):
            self.process = processes.start("rosmaster", "--core", "-p", str(self.port))
            wait_until(self.answers, LONG_S, "the ROS master")

        def answers(self):
            import xmlrpc.client

            try:
                _, _, self.pid = xmlrpc.client.ServerProxy(self.uri).getPid("/test")
            except OSError:
                return False
            return True

        def end(self):
            processes.end(self.process)
            wait_until(lambda: not self.answers(), LONG_S, "the end of the ROS master")

    return Core()


def ended(wait_until, process):
    wait_until(lambda: process.poll() is not None, LONG_S, "the end of the process")
    return process.returncode


def test_a_person_clicks(ros, screen, panel, fake, wait_until, suspend):
    shown = panel()
    screen.wait_for("control", LOCKED)
    controller = fake()
    screen.wait_for("control", GREY)
    assert screen.colour("gripper") == GREY
    for name, other in (("control", "gripper"), ("gripper", "control")):
        screen.click(name)
        screen.wait_for(name, GREEN)
        assert screen.colour(other) == GREY
        screen.click(name)
        screen.wait_for(name, GREY)
    screen.click("control")
    screen.wait_for("reset", LOCKED)
    suspend(controller.pid)
    screen.wait_for("status", FAULT)
    screen.wait_for("control", LOCKED)
    screen.click("emergency")
    assert ended(wait_until, controller) == -signal.SIGKILL
    screen.wait_for("status", WARNING)
    fake()
    screen.wait_for("control", GREY)
    screen.click("control")
    screen.wait_for("control", GREEN)
    assert shown.process.poll() is None


@pytest.mark.parametrize("key", ["Escape", "space"])
def test_a_key_stops(ros, screen, panel, fake, wait_until, key):
    panel()

    def exits():
        """Whether a controller exits by itself; one that a busy machine keeps from it for half a second is killed."""
        controller = fake()
        screen.wait_for("control", GREY)
        screen.click("control")  # leaves the focus on Emergency Stop
        screen.wait_for("control", GREEN)
        screen.key(key)
        code = ended(wait_until, controller)
        assert code in (2, -signal.SIGKILL)
        return code == 2

    wait_until(exits, LONG_S, "a controller that exits by itself")


def test_the_panel_of_the_real_controller(ros, screen, panel, wait_until, suspend):
    import rospy
    from std_msgs.msg import String

    from kuka_msgs.srv import setGripperControl

    ready = r"listening on 127\.0\.0\.1:(\d+)"
    robot = ros.run("rig_simulation", "sunrise_controller.py", "--port", "0", "--control-port", "0")
    port = wait_until(lambda: re.search(ready, robot.log_path.read_text()), LONG_S, "the simulated robot")[1]
    rospy.set_param("kuka", {**yaml.safe_load(PARAMETERS.read_text()), "ip": "127.0.0.1", "port": int(port)})
    modes = ros.record("kuka/mode", String)
    shown = panel()
    controller = ros.run("kuka_control", "real_time_controller.py")
    wait_until(lambda: modes and modes[-1].data == "home", HOME_S, "the arm at home")
    screen.wait_for("control", GREY)
    screen.click("control")
    screen.wait_for("control", GREEN)
    assert rospy.ServiceProxy("kuka/gripper_control", setGripperControl)(True).success
    screen.wait_for("gripper", GREEN)
    screen.click("control")
    screen.wait_for("control", GREY)
    screen.click("exit")
    wait_until(lambda: controller.poll() is not None, HOME_S, "the end of the controller")
    assert controller.returncode == 0
    screen.wait_for("control", LOCKED)
    again = ros.run("kuka_control", "real_time_controller.py")
    screen.wait_for("control", GREY)
    suspend(again.pid)
    screen.click("emergency")
    assert ended(wait_until, again) == -signal.SIGKILL
    screen.wait_for("control", LOCKED)
    assert shown.process.poll() is None


def test_the_master_ends_and_comes_again(screen, panel, fake, core, wait_until):
    core.start()
    panel(core.uri)
    controller = fake(core.uri)
    screen.wait_for("control", GREY)
    core.end()
    screen.wait_for("status", WARNING)
    screen.click("control")
    screen.wait_for("control", GREEN)
    screen.click("emergency")
    assert ended(wait_until, controller) == 2
    screen.wait_for("control", LOCKED)
    core.start()
    fake(core.uri)
    screen.wait_for("control", GREY)
    screen.click("gripper")
    screen.wait_for("gripper", GREEN)


def test_it_waits_for_the_master(screen, panel, fake, core):
    panel(core.uri)
    screen.wait_for("status", WARNING)
    screen.click("emergency")
    core.start()
    screen.wait_for("status", NORMAL)
    fake(core.uri)
    screen.wait_for("control", GREY)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("master", ["there", "never there", "ended", "hanging"])
def test_interrupted_it_ends_well(screen, panel, core, master, number):
    if master != "never there":
        core.start()
    shown = panel(core.uri)
    screen.wait_for("status", WARNING if master == "never there" else NORMAL)
    if master == "ended":
        core.end()
        screen.wait_for("status", WARNING)
    elif master == "hanging":
        os.kill(core.pid, signal.SIGSTOP)
        screen.wait_for("status", WARNING)
    try:
        shown.process.send_signal(number)
        assert shown.wait_for_end() == 0
    finally:
        if master == "hanging":
            os.kill(core.pid, signal.SIGCONT)


def test_its_window_is_closed(ros, screen, panel):
    shown = panel()
    ask_to_close(screen.display, int(screen.window))
    assert shown.wait_for_end() == 0


def test_without_a_screen_it_says_so(ros, processes, wait_until):
    env = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "QT_QPA_PLATFORM")}
    done = subprocess.run(
        ["rosrun", "kuka_control", "gui.py"], env=env, capture_output=True, text=True, timeout=60.0
    )  # fmt: skip
    assert done.returncode == 1
    assert "neither DISPLAY nor WAYLAND_DISPLAY is set" in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(("display", "said"), [("", "neither DISPLAY nor"), (":98765", "the screen :98765 (DISPLAY)")])
@pytest.mark.parametrize(("option", "code"), [("--if-possible", 0), ("--on-top", 1)])
def test_a_screen_that_is_not_there_is_one_sentence_and_beside_a_controller_no_fault(
    ros, processes, display, said, option, code
):
    environment = {"DISPLAY": display, "QT_QPA_PLATFORM": ""}
    process = processes.start("rosrun", "kuka_control", "gui.py", option, env=environment)
    assert process.wait(LONG_S) == code
    text = process.log_path.read_text()
    assert said in text and len(text.splitlines()) == 1


def test_a_second_panel_is_not_opened_beside_the_first(ros, screen, panel, processes):
    shown = panel()
    shown.wait_until_known()
    second = processes.start("rosrun", "kuka_control", "gui.py", "--if-possible", env={"DISPLAY": screen.display})
    assert second.wait(LONG_S) == 0 and "open already" in second.log_path.read_text()
    assert shown.process.poll() is None


@pytest.fixture
def beside(processes, wait_until):
    """Starts a controller that has neither parameters nor a robot, and waits until it says so."""

    def start(program, *arguments, display=""):
        environment = {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb" if display else "offscreen"}
        controller = processes.start("rosrun", "kuka_control", program, *arguments, env=environment)
        wait_until(lambda: "kuka" in controller.log_path.read_text(), LONG_S, "the controller's first sentence")
        return controller

    return start


def children(process):
    return Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()


@pytest.mark.parametrize("program", ["real_time_controller.py", "ptp_controller.py"])
def test_the_panel_comes_and_goes_with_each_controller(ros, screen, beside, processes, wait_until, program):
    controller = beside(program, display=screen.display)
    screen.wait_for_panel()
    assert len(children(controller)) == 1
    assert processes.end(controller) == 0
    there = ("search", "--onlyvisible", "--name", TITLE)
    wait_until(lambda: not screen.xdotool(*there), LONG_S, "the window to close", ASK_S)


def test_the_panel_stays_after_a_fault_of_its_controller(ros, screen, beside):
    import rospy

    controller = beside("real_time_controller.py", display=screen.display)
    screen.wait_for_panel()
    rospy.set_param("kuka", {**yaml.safe_load(PARAMETERS.read_text()), "robot": "none"})
    assert controller.wait(LONG_S) == 1
    screen.wait_for("emergency", RED)


def test_without_the_panel_a_controller_starts_nothing(ros, screen, beside):
    assert children(beside("real_time_controller.py", "gui:=false", display=screen.display)) == []


def test_without_a_screen_a_controller_says_so_and_runs(ros, beside, wait_until):
    controller = beside("real_time_controller.py")
    wait_until(lambda: "there is no screen" in controller.log_path.read_text(), LONG_S, "the sentence")
    assert controller.poll() is None and children(controller) == []


def test_a_request_for_the_control_panel_that_is_no_truth_value_is_refused(ros, beside):
    controller = beside("ptp_controller.py", "gui:=perhaps")
    assert controller.wait(LONG_S) == 1 and "gui:=perhaps" in controller.log_path.read_text()


def ask_to_close(display, window):
    """Sends what a window manager sends when its close button is clicked (ICCCM 4.2.8.1)."""
    from ctypes import CDLL, Structure, Union, byref, c_char_p, c_int, c_long, c_ulong, c_void_p

    class ClientMessage(Structure):
        _fields_ = (
            ("type", c_int), ("serial", c_ulong), ("send_event", c_int), ("display", c_void_p), ("window", c_ulong),
            ("message_type", c_ulong), ("format", c_int), ("data", c_long * 5),
        )  # fmt: skip

    class Event(Union):
        _fields_ = (("client", ClientMessage), ("pad", c_long * 24))

    x11 = CDLL("libX11.so.6")
    x11.XOpenDisplay.restype, x11.XOpenDisplay.argtypes = c_void_p, [c_char_p]
    x11.XInternAtom.restype, x11.XInternAtom.argtypes = c_ulong, [c_void_p, c_char_p, c_int]
    x11.XSendEvent.argtypes = [c_void_p, c_ulong, c_int, c_long, c_void_p]
    x11.XCloseDisplay.argtypes = [c_void_p]
    connection = x11.XOpenDisplay(display.encode())
    event = Event()
    event.client.type, event.client.window, event.client.format = 33, window, 32
    event.client.message_type = x11.XInternAtom(connection, b"WM_PROTOCOLS", 0)
    event.client.data[0] = x11.XInternAtom(connection, b"WM_DELETE_WINDOW", 0)
    x11.XSendEvent(connection, window, 0, 0, byref(event))
    x11.XCloseDisplay(connection)
