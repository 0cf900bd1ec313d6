"""Every program of examples/ runs against the simulated devices, in virtual time."""

from __future__ import annotations

import functools
import re
import runpy
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from common import clock
from leap_motion.client import LeapClient
from reflex import ReflexHand

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
DEVICES = {"arm": "sunrise_controller.py", "hand": "reflex_hand.py", "leap": "leapd.py"}
PORT, CONTROL_PORT = "26000", "26001"


@pytest.fixture
def start(virtual_graph, monkeypatch, tmp_path):
    """Starts an example by its number; returns its node."""
    monkeypatch.setenv("HOME", str(tmp_path))
    names = {name: lambda *args, name=name: getattr(clock, name)(*args) for name in ("monotonic", "sleep")}
    monkeypatch.setitem(sys.modules, "time", SimpleNamespace(**{**vars(time), **names}))
    for client in (LeapClient, ReflexHand):  # by default they wait in real time
        monkeypatch.setattr(client, "__init__", functools.partialmethod(client.__init__, runtime=clock))

    def start(number, *arguments):
        (example,) = (path for path in EXAMPLES if path.name.startswith(number))
        words = (str(example), *arguments)
        return virtual_graph.start(example.name, lambda: runpy.run_path(str(example), run_name="__main__"), *words)

    return start


@pytest.mark.ros
@pytest.mark.parametrize(
    ("number", "device", "arguments", "prints"),
    [
        ("01", "arm", (), r"joint 7 at +10\.00 deg\n(.*\n)*joint 7 at +-?0\.0\d deg"),
        ("02", "arm", (), r"flange in the base \[m\]: \[-?0\. +-?0\. +1\.301\]"),
        ("03", "arm", (), r"largest lag: \d\.\d+ deg"),
        ("04", "arm", (), r"the flange is \d\.\d mm from its start"),
        ("05", "hand", (), r"closed \[rad\]: \[2\.\d+(.*\n)open \[rad\]: \[-?0\.0"),
        ("06", "hand", ("--seconds", "0.5"), "touched: nothing"),
        ("07", "leap", ("--frames", "5"), "palm .* m, grab|sends"),
        ("08", None, (), r"0\.0 m forward: joints \[[^\]]*-80[^\]]*\] deg\n.*\n1\.0 m forward: .*out of reach"),
        ("09", None, (), r"position before the camera \[m\]: \[.* 0\.[67]\d* *\]\nangle"),
    ],
)
def test_runs(virtual_graph, start, number, device, arguments, prints):
    from simulated.hand_wire import HandNetwork

    with HandNetwork():
        options = ()
        if device:
            options = ("--port", PORT)
            virtual_graph.run("rig_simulation", DEVICES[device], *options, "--control-port", CONTROL_PORT)
            clock.sleep(0.1)
        example = start(number, *options, *arguments)
        assert example.wait(60.0) == 0, example.log
    assert re.search(prints, example.log), example.log


@pytest.mark.ros
def test_the_subscriber_hears_the_rig(virtual_graph, start):
    import rospy
    from sensor_msgs.msg import JointState

    publisher = rospy.Publisher("joint_states", JointState, queue_size=1, latch=True)
    publisher.publish(JointState(name=["A1"], position=[0.25]))
    example = start("10", "--seconds", "1000")
    clock.sleep(1.0)
    assert "A1 0.250" in example.log and example.poll() is None
    example.send_signal(signal.SIGINT)
    assert example.wait(1.0) == 0


def test_all_are_listed_and_short():
    table = (ROOT / "examples" / "README.md").read_text()
    assert len(EXAMPLES) == 10
    for example in EXAMPLES:
        assert f"]({example.name})" in table
        assert len(example.read_text().splitlines()) <= 36
