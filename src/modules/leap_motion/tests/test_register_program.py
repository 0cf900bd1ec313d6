"""The program register_tracker before the simulated service, whose tracker is tilted and moved."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("rospy")
from common import clock
from common.poses import pose
from common.rotations import rotation_about, rotation_angle
from leap_motion.registration import FINGER_M, SHEET, tilt_deg
from leap_motion.ros import register_program
from leap_motion.ros.registrations import load, registration_file
from rig_simulation.operator.guided import GuidedOperator
from rig_simulation.operator.hand_model import HandModel
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator

pytest.importorskip("rig_msgs.srv")
import rospy

from leap_motion.msg import Human
from simulated.leap_wire import LeapWire

pytestmark = pytest.mark.ros

STANDS = (30.0, 12.0, -20.0, 10.0, -15.0, 5.0)  # mm and deg about x, y, z
SHOWN_S = 0.2  # from the hand's move to the key
PORT = 6437
TIP = 1e-3 * HandModel().place(ScriptedOperator(Script(), centre=(0.0, 0.0, 0.0)).pose(np.zeros(7))).tips[1]


def stands(unit=1.0):
    """The pose of the tracker, shape (4, 4); `unit`: of its position [mm]."""
    pitch, yaw, roll = np.radians(STANDS[3:])
    R = rotation_about(1, yaw) @ rotation_about(0, pitch) @ rotation_about(2, roll)
    return pose(R, unit * np.array(STANDS[:3]))


@pytest.fixture
def ros(virtual_graph, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    return virtual_graph


@pytest.fixture
def leapd(ros):
    """A guided hand on the desk before a service whose tracker stands at STANDS."""
    hand = GuidedOperator(ScriptedOperator(Script(), centre=(0.0, 0.0, 0.0), T_desk_leap=stands()))
    with LeapWire() as wire:
        wire.play(Playback(hand), PORT)
        yield hand


class Person:
    """Obeys the program: touches the point that it names. `errors`: by point [m]."""

    def __init__(self, hand, height=0.2, **errors):
        self._hand, self._height, self._errors, self.asked = hand, height, errors, []

    def __call__(self, question):
        self.asked.append(question)
        name = next((name for name in SHEET if name in question), None)
        if name is not None:
            x, z = SHEET[name]
            right, up, back = (
                np.array([x, self._height + FINGER_M, z]) - TIP + self._errors.get(name.replace(" ", "_"), 0)
            )
            self._hand.show(right=right, up=up, back=back)
            if len(self.asked) == 1:  # the first time in a hurry
                self._hand.reach(right=right + 0.25, up=up, back=back, seconds=2.5)
            clock.sleep(SHOWN_S)
        return ""


def test_a_tilted_tracker_is_registered(leapd, capsys):
    person = Person(leapd)
    assert register_program.main(["desk"], person) == 0
    out = capsys.readouterr().out
    touched = [name for question in person.asked for name in SHEET if name in question]
    first, *others = SHEET
    assert "The finger moved by" in out and touched == [first, first, *others]
    assert "Start the rig with registration:=desk" in out
    found = load("desk", clock.time())
    T = stands(1e-3)
    assert found.serial.startswith("LP") and f"Tracker {found.serial}" in out
    assert np.degrees(rotation_angle(found.T_desk_leap[:3, :3].T @ T[:3, :3])) < 3.0
    middle = np.array([0.0, 0.2, 0.0, 1.0])
    assert_allclose(found.T_desk_leap @ np.linalg.inv(T) @ middle, middle, atol=5e-3)
    level = ["desk", "--level"]
    assert register_program.main(level, Person(leapd)) == 1  # "" is no yes
    assert "Cancelled" in capsys.readouterr().err
    assert register_program.main([*level, "--force"], Person(leapd)) == 0
    assert tilt_deg(load("desk", clock.time()).T_desk_leap) == pytest.approx(tilt_deg(T), abs=2.0)


class Client:
    """Gives a frame each 0.1 s, after one that waits."""

    number = 0

    def next_frame(self, timeout):
        if self.number:
            clock.sleep(min(timeout, 0.1))
        self.number += 1
        return SimpleNamespace(frame=self.number)


def test_the_frame_from_before_the_key_does_not_count(ros):
    assert register_program._frames(Client()) == list(range(2, 12))


@pytest.mark.parametrize(
    ("options", "errors", "sentence"),
    [
        ((), {"far_left": np.array([0.0, 0.05, 0.0])}, "off by"),
        (("--points", "enlarged.yaml"), {}, "farther apart than stated"),
    ],
)
def test_points_that_do_not_fit_store_nothing(leapd, capsys, tmp_path, monkeypatch, options, errors, sentence):
    monkeypatch.chdir(tmp_path)
    lines = [f"{name}: [{0.9 * x}, 0.2, {0.9 * z}]" for name, (x, z) in SHEET.items()]
    Path("enlarged.yaml").write_text("\n".join(lines))
    assert register_program.main(["desk", *options], Person(leapd, **errors)) == 1
    err = capsys.readouterr().err
    assert sentence in err and "Nothing was stored" in err
    assert not registration_file("desk").exists()


def test_a_running_rig_is_not_steered_by_the_hand_that_is_shown(ros, capsys):
    rospy.Publisher("leap_motion/leap_device", Human, queue_size=1)
    assert register_program.main(["desk"], str) == 1
    assert "stop it, then register" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["desk", "--points", "list.yaml"], "not a mapping"),
        (["desk", "--points", "mm.yaml"], "each in [-2, 2] m"),
        (["desk", "--points", "line.yaml"], "on one line"),
        (["desk", "--height", "0.2"], "--height is 0.2 mm, but must be between 20 and 600 mm"),
        (["desk", "--host", "10.0.0.5"], "set trust_network"),
        (["desk"], "No Leap service answers"),
    ],
)
def test_what_cannot_be_done_is_said_before_anybody_is_asked(ros, capsys, monkeypatch, tmp_path, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    Path("list.yaml").write_text("- [0, 0, 0]")
    Path("mm.yaml").write_text("a: [100, 200, 70]\nb: [0, 0.2, 0]\nc: [0.1, .nan, 0]")
    Path("line.yaml").write_text("a: [0, 0, 0]\nb: [0.1, 0, 0]\nc: [0.2, 0, 0]")
    began = clock.monotonic()
    assert register_program.main(arguments, ask=None) == 1
    assert sentence in capsys.readouterr().err
    waited = 10.0 if "No Leap" in sentence else 0.0
    assert waited <= clock.monotonic() - began <= waited + 0.5


def test_an_interrupt_stores_nothing(leapd, capsys):
    def interrupted(_):
        raise KeyboardInterrupt

    assert register_program.main(["desk"], interrupted) == register_program.INTERRUPTED
    assert not registration_file("desk").exists()
