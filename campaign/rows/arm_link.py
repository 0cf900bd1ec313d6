"""Rows 1 to 15: the link to the arm."""

from __future__ import annotations

import numpy as np

from campaign.judge import Limits
from campaign.trial import row

ROBOT_BRAKES = Limits.of_the_drives()


@row(1, "Arm TCP reset by peer", "DL", within=1.5, named_by="out of reach|connection", operator=True,
     limits=ROBOT_BRAKES, dangerous="the commonest end of a link, in the middle of a motion")  # fmt: skip
def reset(trial):
    trial.follow()
    trial.fault("arm", "cut", duration=1.5)
    trial.says("connected again", 15.0)
    trial.stays_away(2.0)
    trial.recovers()


@row(2, "Arm half-open TCP (cable out, no FIN)", "HD", within=1.5, named_by="not answered for", operator=True,
     dangerous="no end of file says that the link is gone")  # fmt: skip
def half_open(trial):
    trial.follow()
    trial.fault("arm", "half_open", duration=3.0)
    trial.says("connected again|answers again", 15.0)
    trial.stays_away(1.0)
    trial.recovers()


@row(8, "Controller in protective stop", "DL", within=0.8, named_by="safety stop", operator=True, limits=ROBOT_BRAKES,
     dangerous="a person is touched")  # fmt: skip
def protective_stop(trial):
    trial.follow()
    trial.begins()
    # At joint 1, where the weight of the hand makes no torque.
    trial.rig.arm.ask("set_external_torque", value=[-25.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    trial.says("safety stop", 5.0)
    trial.rig.wait(lambda: trial.rig.arm.now.speed == 0.0, "the arm to stand")
    trial.rig.arm.ask("set_external_torque", value=[0.0] * 7)
    trial.rig.arm.ask("release")
    trial.stays_away(2.0)
    trial.recovers()


def wrong_joints(trial, offset: float, stays: float) -> None:
    """Shifts the measured joints [rad]; the arm is to stop, to say so, and to stay within `stays` [rad]."""
    arm, before = trial.rig.arm, len(trial.rig.said)
    since = arm.now.time
    trial.fault("arm", "shifted", value=offset)
    trial.rig.wait_for_mode("stopped")
    trial.rig.watch(0.7)
    said = [text for _, who, text in trial.rig.said[before:] if who == "kuka/status" and "not believed" in text]
    trial.check(f"the joint is named, at {offset} rad", said and "joint" in said[0], said[:1])
    trial.check(f"the arm moves by less than {stays} rad, at {offset} rad", arm.way(since) < stays, arm.way(since))


@row(16, "Measured joints far from commanded", "DL", within=1.2, named_by="joint . is at .* deg", operator=True,
     limits=ROBOT_BRAKES, dangerous="goals made from wrongly measured joints make the arm jump")  # fmt: skip
def shifted(trial):
    rig = trial.rig
    trial.follow()
    wrong_joints(trial, 0.5, 0.15)  # while it moves, which it may end
    trial.stays_away(1.0)
    trial.mend("arm", "shifted")
    trial.recovers()
    for offset in (-0.1, 0.02):
        wrong_joints(trial, offset, 0.02)  # while it stands in servo mode
        trial.mend("arm", "shifted")
        trial.recovers()
    rig.hand.hide()
    rig.wait_for_mode("home")
    rig.modes.clear()
    rig.hand.show(right=0.1)
    rig.wait_for_modes("pick_up")
    trial.fault("arm", "shifted", value=0.1)
    rig.wait_for_mode("stopped", "servo")
    trial.check("no stream begins after a pick-up with wrong joints", rig.mode == "stopped", rig.modes)
    rig.hand.hide()
    # They are still wrong when control goes on: a planned motion home, and nothing else.
    rig.wait(lambda: rig.control(False).success and rig.control(True).success, "control to go on", 20.0)
    rig.modes.clear()
    rig.wait_for_modes("homing", "stopped")
    trial.check("no stream begins where control goes on with wrong joints", "servo" not in rig.modes, rig.modes)
    trial.mend("arm", "shifted")
    trial.recovers()


@row(17, "Measured joints frozen while commanded moves", "DL", within=1.2, named_by="stands still although",
     operator=True, limits=ROBOT_BRAKES,
     dangerous="the arm moves on unseen, and a goal at the frozen joints would pull it back")  # fmt: skip
def frozen(trial):
    rig = trial.rig
    trial.follow()
    since, at = rig.arm.now.time, rig.arm.now.q
    trial.fault("arm", "frozen")
    rig.wait_for_mode("stopped")
    trial.stays_away(1.0)
    away = [np.max(np.abs(sample.q - at)) for sample in rig.arm.since(since)]
    trial.check("the arm does not go back to where its joints are frozen", away[-1] > max(away) - 0.02, away[-1])
    trial.mend("arm", "frozen")
    trial.recovers()
