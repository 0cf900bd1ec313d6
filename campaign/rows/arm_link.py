"""Rows 1 to 15: the link to the arm."""

from __future__ import annotations

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
