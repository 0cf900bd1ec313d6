"""Rows 43 to 50: the tracker and the hand over it; leap_kuka is as shipped, because its limits are on trial."""

from __future__ import annotations

import signal

import numpy as np

from campaign.rig import DRIVER
from campaign.trial import row

LEFT = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
"""The horizontal direction to the left of the centre line as shipped."""
TOOL_SPEED = 0.65  # limit of the stream as shipped [m/s]
FULL_SPEED_HZ = 60.0  # down to this frame rate it holds
DRIVES = 1.1  # what drives that lag unevenly add to the speed of the tool


def follow_up_and_down(trial):
    """Lets the arm follow a hand that moves up and down on the left of the box."""
    trial.rig.follow(right=-0.05)
    trial.rig.hand.sway(0.8, up=0.07)
    trial.rig.wait(lambda: trial.rig.arm.now.tool_speed > 0.08, "the arm to move")


def tools(trial, since):
    """Returns where the tool was since a time of the arm's clock [m], shape (n, 3)."""
    return np.array([sample.T_base_tool[:3, 3] for sample in trial.rig.arm.since(since)])


def way(positions, direction=None):
    """Returns how far the tool was, at most, from where it was first, along a direction or at all [m]."""
    steps = positions - positions[0]
    return float(np.max(np.linalg.norm(steps, axis=1) if direction is None else np.abs(steps @ direction)))


def fastest(trial, since):
    """Returns the largest speed of the tool since a time of the arm's clock [m/s]."""
    return max([step[15] for step in list(trial.rig.arm.steps) if step[0] >= since], default=0.0)


@row(43, "Tracker service not running", "R", within=10.0, named_by="No Leap service answers", still=True,
     variant="tracker")  # fmt: skip
def not_running(trial):
    rig = trial.rig
    trial.killed.add(f"/{DRIVER}")
    rig.signal(DRIVER, signal.SIGINT)
    rig.exit_code(DRIVER)
    trial.fault("leap", "restarted")
    rig.start(DRIVER)
    trial.check("control goes on without a tracker", rig.control(True).success)
    rig.hand.show()
    trial.says("No Leap service answers", 15.0)
    trial.stays_away(2.0)
    trial.check("no stream runs", rig.stream_state == "waiting" and not rig.desired)
    trial.check("the operator reads why", any("no tracking frames come in" in why for _, why in rig.stream))
    trial.operator()
    trial.mend("leap", "restarted")
    seen = rig.listen_to_hands()
    rig.wait(lambda: seen, "the driver to find the service by itself", 5.0)
    rig.bring_hand(right=-0.04)
    rig.wait_for_modes("servo")


@row(44, "Tracker unplugged while tracking", "D", within=1.6, named_by="unplugged|no tracking frames", operator=True,
     variant="tracker", dangerous="nobody sees any more what the hand does")  # fmt: skip
def unplugged(trial):
    trial.follow()
    trial.fault("leap", "unplugged", duration=2.5)
    trial.stands(0.5)
    trial.says("unplugged|no tracking frames")
    trial.stays_away(4.0)
    trial.recovers()


@row(45, "Hand leaves the volume", "D", within=1.6, named_by="was lost", operator=True, variant="tracker",
     dangerous="the commonest end of a stream, in any motion")  # fmt: skip
def hand_leaves(trial):
    trial.follow()
    trial.fault("leap", "hand_lost", duration=2.0)
    trial.stands(0.5)
    trial.says("was lost")
    trial.stays_away(3.5)
    trial.recovers()


@row(46, "Hand re-appears with a new id elsewhere", "D", within=1.6, named_by="was lost", operator=True,
     variant="tracker", dangerous="an arm that goes to where the new hand is")  # fmt: skip
def hand_elsewhere(trial):
    follow_up_and_down(trial)
    since = trial.rig.arm.now.time
    trial.fault("leap", "hand_moved", value=100.0, duration=2.5)
    trial.stands(0.5)
    sideways = way(tools(trial, since), LEFT)
    trial.check("the arm does not go to the new place", sideways < 0.005, f"{sideways:.3f} m towards it")
    trial.says("out of the box and back in")
    trial.stays_away(4.0)
    trial.recovers()


@row(47, "Left/right hand swapped", "D", within=1.6, named_by="was lost", operator=True, variant="tracker")
def swapped(trial):
    follow_up_and_down(trial)
    since = trial.rig.arm.now.time
    trial.fault("leap", "hand_swapped", duration=2.5)
    trial.stands(0.5)
    sideways = way(tools(trial, since), LEFT)
    trial.check("the arm does not follow the other side", sideways < 0.005, f"{sideways:.3f} m sideways")
    trial.says("left hand .*out of the box and back in")
    trial.stays_away(4.0)
    trial.recovers()


@row(48, "Second hand or another person appears", "D", within=1.6, named_by="was lost", operator=True,
     variant="tracker", dangerous="an arm that follows a person who does not expect it")  # fmt: skip
def another_person(trial):
    rig = trial.rig
    follow_up_and_down(trial)
    since, desired = rig.arm.now.time, len(rig.desired)
    # Another person's hand, also a right one: nearer to the tracker, listed first, and moving to and fro.
    rig.hand.join(0.6, {"right": 0.09}, right=0.04, up=-0.08)
    rig.watch(2.5)
    sideways = way(tools(trial, since), LEFT)
    trial.check("the arm follows the first hand alone", rig.mode == "servo" and sideways < 0.005, f"{sideways:.3f} m")
    heights = np.array(rig.desired[desired:])[:, 2, 3]
    trial.check("and goes on to follow it", np.ptp(heights) > 0.05, f"{np.ptp(heights):.3f} m up and down")
    trial.begins()
    rig.hand.leave()
    trial.stands(0.6)
    trial.says("out of the box and back in")
    trial.stays_away(3.0)
    trial.recovers()


@row(50, "Tracker frozen: same frame repeated", "D", within=1.6, named_by="came twice|repeats frame|no tracking frames",
     operator=True, variant="tracker")  # fmt: skip
def frozen(trial):
    trial.follow()
    trial.fault("leap", "frozen", duration=2.5)
    trial.stands(0.5)
    trial.stays_away(4.0)
    trial.recovers()
