"""Rows 67 to 69: the robot hand, while arm and fingers follow a hand."""

from __future__ import annotations

from std_srvs.srv import Empty

from campaign.rows.limits import stays_in_servo
from campaign.trial import row

INDEX, MIDDLE = 0, 1
HELD_RAD = 0.08  # a finger that is held creeps by the slack of its tendon and the load's filter


def angles(trial) -> list[float]:
    """Returns the true angles of index, middle, thumb and spread [rad]."""
    return trial.rig.robot_hand.ask("state")["angles"]


def grips(trial, curl: float) -> None:
    """Lets arm and robot hand follow a hand whose fingers are bent by so much, until the robot's are bent, too."""
    rig = trial.rig
    trial.follow(sway=False)
    assert rig.gripper(True).success
    bends(trial, curl)
    rig.wait(lambda: min(angles(trial)[:3]) > 0.2, "the fingers to close", 10.0)
    rig.watch(0.5)


def bends(trial, curl: float) -> None:
    """Bends the operator's fingers, and waits until the frames of it are through."""
    rig = trial.rig
    rig.hand.glide(0.5, curl=curl)
    rig.wait(lambda: rig.hand.still, "the hand to stand still")
    rig.see(20)
    rig.watch(0.7)


def opens(trial) -> None:
    """The operator opens the hand: all fingers of the robot hand must follow."""
    bends(trial, 0.0)
    trial.rig.wait(lambda: max(angles(trial)[:3]) < 0.15, "the fingers to open", 10.0)


@row(67, "Hand (gripper) unplugged", "", named_by="state of the robot hand is unknown", hazards=(17,))
def unplugged(trial):
    rig = trial.rig
    grips(trial, 0.4)
    rig.hand.sway(1.0, right=0.06)
    before = angles(trial)
    trial.fault("hand", "cut")
    trial.says("state of the robot hand is unknown")
    trial.says("The hand is silent")
    bends(trial, 0.7)
    after = angles(trial)
    trial.check("the fingers stand", max(abs(a - b) for a, b in zip(before, after)) < HELD_RAD, (before, after))
    start = rig.arm.now.time
    rig.hand.sway(1.0, right=0.06)
    rig.watch(1.5)
    trial.check("the arm follows on", rig.arm.way(start) > 0.02, rig.arm.way(start))
    trial.mend("hand", "cut")
    rig.wait(lambda: min(angles(trial)[:3]) > min(before[:3]) + 0.2, "the fingers to follow again", 10.0)
    opens(trial)
    stays_in_servo(trial)


@row(68, "Hand motor overload / hot", "", named_by="Motor f1 is overloaded",
     dangerous="fingers that keep closing crush what they hold, or a person's fingers", hazards=(17,))  # fmt: skip
def overloaded(trial):
    rig = trial.rig
    grips(trial, 0.4)
    before = angles(trial)
    trial.fault("hand", "overloaded", value=1)
    trial.says("Motor f1 is overloaded")
    rig.wait(lambda: angles(trial)[INDEX] < before[INDEX] - 0.03, "the index to be loosened")
    loosened = angles(trial)
    bends(trial, 0.8)
    after = angles(trial)
    trial.check("the index does not close further", after[INDEX] < loosened[INDEX] + HELD_RAD, (loosened, after))
    trial.check("the others close", after[MIDDLE] > before[MIDDLE] + 0.2, (before, after))
    opens(trial)
    trial.mend("hand", "overloaded")
    rig.watch(1.0)
    bends(trial, 0.5)
    rig.wait(lambda: angles(trial)[INDEX] > 0.2, "the index to close again", 10.0)
    stays_in_servo(trial)


@row(69, "Tactile sensor stuck / drift", "", named_by="index is not closed further", hazards=(17,))
def taxel_stuck(trial):
    rig = trial.rig
    grips(trial, 0.4)
    before = angles(trial)
    trial.fault("hand", "touch_stuck", value=1)
    trial.says("index is not closed further")
    bends(trial, 0.8)
    after = angles(trial)
    trial.check("the index does not close further", after[INDEX] < before[INDEX] + HELD_RAD, (before, after))
    trial.check("the others close", after[MIDDLE] > before[MIDDLE] + 0.2, (before, after))
    opens(trial)
    # The operator has the taxels zeroed: what they say now counts as nothing.
    rig.call("reflex_takktile/calibrate_tactile", Empty)
    trial.says("index may close again")
    bends(trial, 0.5)
    rig.wait(lambda: angles(trial)[INDEX] > before[INDEX] - 0.1, "the index to close again", 10.0)
    trial.mend("hand", "touch_stuck")
    rig.call("reflex_takktile/calibrate_tactile", Empty)
    stays_in_servo(trial)
