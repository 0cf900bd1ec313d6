"""Every program of examples/ runs against the simulated devices."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.clock

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SIMULATORS = ROOT / "src" / "modules" / "rig_simulation" / "scripts"
DEVICES = {
    "arm": ("sunrise_controller.py", "127.0.0.1:"),
    "hand": ("reflex_hand.py", "UDP port "),
    "leap": ("leapd.py", "127.0.0.1:"),
}
PATIENT = """
import functools, runpy, sys
from kst import KstTiming
from reflex import HandSettings
for kind, waits in ((KstTiming, {"reply": 20.0, "servo_reply": 20.0}), (HandSettings, {"silence_time": 5.0})):
    kind.__init__ = functools.partialmethod(kind.__init__, **waits)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
"""Runs an example whose devices may take long to answer: this machine may be busy."""


@pytest.fixture(scope="module")
def port_of(tmp_path_factory):
    """Starts each simulated device at its first use, once; returns its port."""
    running: dict[str, tuple[subprocess.Popen, str]] = {}

    def port(device: str) -> str:
        if device not in running:
            program, before_port = DEVICES[device]
            command = [sys.executable, str(SIMULATORS / program), "--port", "0", "--control-port", "0"]
            process = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, text=True)
            ready = process.stdout.readline()
            running[device] = process, re.search(before_port + r"(\d+), control port", ready)[1]
        return running[device][1]

    yield port
    for process, _ in running.values():
        process.terminate()
        process.communicate(timeout=120.0)


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}


def run(number: str, home: Path, *arguments: str) -> str:
    (example,) = (path for path in EXAMPLES if path.name.startswith(number))
    done = subprocess.run(
        [sys.executable, "-c", PATIENT, str(example), *arguments],
        env={**environment(), "HOME": str(home)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


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
def test_runs(port_of, tmp_path, number, device, arguments, prints):
    options = ("--port", port_of(device)) if device else ()
    output = run(number, tmp_path, *options, *arguments)
    assert re.search(prints, output), output


@pytest.mark.ros
def test_the_subscriber_hears_the_rig(ros, processes, wait_until):
    import rospy
    from sensor_msgs.msg import JointState

    publisher = rospy.Publisher("joint_states", JointState, queue_size=1, latch=True)
    publisher.publish(JointState(name=["A1"], position=[0.25]))
    (example,) = (path for path in EXAMPLES if path.name.startswith("10"))
    process = processes.start(sys.executable, str(example), "--seconds", "1000")
    wait_until(lambda: "A1 0.250" in process.log_path.read_text(), 20.0, "the joints")
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(10.0) == 0


def test_all_are_listed_and_short():
    table = (ROOT / "examples" / "README.md").read_text()
    assert len(EXAMPLES) == 10
    for example in EXAMPLES:
        assert f"]({example.name})" in table
        assert len(example.read_text().splitlines()) <= 36
