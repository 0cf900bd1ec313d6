"""Rows 54 to 56: engaging."""

from __future__ import annotations

import contextlib
import signal

import numpy as np
import rospy
from std_msgs.msg import Header

from campaign.judge import Limits
from campaign.rig import TELEOP
from campaign.trial import row
from rig_msgs.msg import OperatorInput

PLANNED = Limits(joint_speed=0.3, tool_speed=0.45)
"""A planned motion runs at a quarter of the full joint speeds, and the hands here are slow."""


@row(54, "Axis convention or scale file wrong", "R", within=3.0, named_by="axes are mirrored|millimetres", still=True,
     argued="axes-of-the-tracker.md",
     dangerous="an arm that moves to the wrong side, or ten times as far", hazards=(10,))  # fmt: skip
def wrong_axes(trial):
    rig = trial.rig
    trial.check("control is on", rig.control(True).success)
    trial.fault("leap", "mirrored")
    rig.hand.show(right=0.02)
    trial.says("axes are mirrored", 10.0)
    rig.watch(2.0)
    for factor in (0.1, 25.4, 3.0):
        said = len(rig.said)
        rig.leap.ask("fault", name="scaled", value=factor)
        rig.leap.ask("fault", name="mirrored", on=False)
        rig.hand.show(right=0.02)
        rig.wait(lambda said=said: any("not millimetres" in text for _, _, text in rig.said[said:]), "the reason", 10.0)
        rig.watch(1.0)
    trial.check("no stream began", not rig.desired and {state for state, _ in rig.stream} == {"waiting"})
    trial.operator()
    rig.hand.hide()
    trial.mend("leap", "scaled")
    rig.bring_hand(right=0.02)
    rig.wait_for_modes("servo")


@row(
    55,
    "Engage while hand moves fast",
    "R",
    within=6.0,
    named_by="moves too fast for a start",
    still=True,
    hazards=(21,),
)
def fast_hand(trial):
    rig = trial.rig
    trial.check("control is on", rig.control(True).success)
    rig.hand.show(right=0.18)
    rig.wait(lambda: rig.hand.still, "the hand beside the box")
    trial.begins()
    rig.hand.sway(0.5, right=-0.18)  # it turns outside of the box, and is faster than 0.3 m/s within
    trial.says("moves too fast for a start", 8.0)
    rig.watch(4.0)
    trial.check("no stream began", not rig.desired and {state for state, _ in rig.stream} == {"waiting"})
    trial.operator()
    rig.hand.glide(1.5, right=0.0)
    rig.wait(lambda: rig.stream_state == "running", "the hand to be followed once it is slow")


@row(56, "Engage with target far away", "", limits=PLANNED, hazards=(1,))
def far_target(trial):
    rig = trial.rig
    home = rig.arm.now.T_base_tool[:3, 3]
    corners = ({"right": 0.09, "up": 0.09, "back": 0.05}, {"right": -0.09, "up": -0.09, "back": -0.05})
    trial.begins()
    trial.check("control is on", rig.control(True).success)
    for corner in corners:
        rig.modes.clear()
        rig.bring_hand(**corner)
        rig.wait_for_modes("pick_up", "servo")
        rig.settle()
        far = float(np.linalg.norm(rig.arm.now.T_base_tool[:3, 3] - home))
        trial.check("the arm went far by a planned motion", far > 0.1, f"{far:.3f} m")
        rig.hand.hide()
        rig.wait_for_modes("returning", "home")
    with relative_engagement(trial) as pedal:
        since = rig.arm.now.time
        rig.modes.clear()
        rig.bring_hand(**corners[0])
        rig.wait_for_modes("servo")
        rig.settle()
        # The hand comes to rest while it is followed already.
        trial.check("relative: the tool stays where it is", _way(rig, since) < 0.05, f"{_way(rig, since):.3f} m")
        pedal.clutch = True
        rig.wait(lambda: rig.stream_state == "waiting", "the clutch")
        since = rig.arm.now.time
        rig.hand.glide(0.8, **corners[1])
        rig.wait(lambda: rig.hand.still, "the hand on the other side")
        rig.see(20)
        pedal.clutch = False
        rig.wait(lambda: rig.stream_state == "running", "the hand to be followed again")
        rig.settle()
        trial.check("clutch: the tool stays where it is", _way(rig, since) < 0.005, f"{_way(rig, since):.3f} m")
        rig.hand.glide(3.0, up=0.0)
        rig.settle()
        trial.check("and follows from there", 0.06 < _way(rig, since) < 0.12, f"{_way(rig, since):.3f} m")


def _way(rig, since):
    positions = np.array([sample.T_base_tool[:3, 3] for sample in rig.arm.since(since)])
    return float(np.max(np.linalg.norm(positions - positions[0], axis=1)))


class Pedal:
    """The pedal of the clutch, which reports all the time."""

    def __init__(self):
        self.clutch = False
        self._publisher = rospy.Publisher("leap_kuka/operator_input", OperatorInput, queue_size=1, tcp_nodelay=True)
        self._timer = rospy.Timer(rospy.Duration(0.05), self._report)

    def end(self):
        self._timer.shutdown()
        self._timer.join()
        self._publisher.unregister()

    def _report(self, _):
        now = Header(stamp=rospy.Time.now())
        self._publisher.publish(OperatorInput(header=now, enabled=True, clutch=self.clutch, source="pedal"))


@contextlib.contextmanager
def relative_engagement(trial):
    """Restarts leap_kuka with relative engagement and a pedal as its clutch; afterwards as it was."""
    values = {"engagement": "relative", "hold_time": 30.0, "clutch": "device"}
    before = {key: rospy.get_param(f"leap/{key}") for key in values}
    trial.killed.add(f"/{TELEOP}")
    _restart(trial.rig, values)
    pedal = Pedal()
    try:
        yield pedal
    finally:
        pedal.end()
        trial.rig.hand.hide()
        _restart(trial.rig, before)


def _restart(rig, values):
    rig.signal(TELEOP, signal.SIGINT)
    rig.exit_code(TELEOP)
    for key, value in values.items():
        rospy.set_param(f"leap/{key}", value)
    rig.stream_state = ""
    rig.start(TELEOP)
    rig.wait(lambda: rig.stream_state == "waiting", "the node to start again", 20.0)
