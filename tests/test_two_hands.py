"""Both hands over one Leap at the frame rate of two arms: each steers the arm and the robot hand of its side."""

from __future__ import annotations

import numpy as np
import pytest

from golden.chain import PureChain, Run, World
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import BothHands, Playback, ScriptedOperator

RATE, SECONDS = 60.0, 26.0  # frames per second as two_simulated_arms.launch sets them
BESIDE_M = {"left": -0.16, "right": 0.16}


@pytest.fixture(scope="module")
def frames():
    """Times of receipt [s] and texts of some visits of both hands."""
    script = Script(figure="circle", laps=1, speed=250.0, away=1.0)
    left, right = (
        ScriptedOperator(script, side, centre=(1e3 * x, 350.0, 0.0), frame_rate=RATE) for side, x in BESIDE_M.items()
    )
    playback = Playback(BothHands((left, right), frame_rate=RATE), 3, frame_rate=RATE)
    played = [playback.next() for _ in range(round(RATE * SECONDS))]
    return tuple((0.3 + frame.time, frame.text) for frame in played)


@pytest.mark.parametrize("side", BESIDE_M)
def test_each_arm_follows_its_hand_loses_it_and_follows_the_next_one(frames, side):
    settings = {"kuka": {"center_line": [1, 0, 0]}, "leap": {"hand": side, "box_offset": BESIDE_M[side]}}
    trace = PureChain(World(Run("two hands", frames, settings=settings))).run()
    said = [event.split(" ", 1)[1] for event in trace.events]
    followed = f"leap_kuka: running: {side} hand # is followed"
    lost = f"leap_kuka: waiting: no {side} hand is seen"
    assert followed in said and lost in said and followed in said[said.index(lost) :]
    other = "right" if side == "left" else "left"
    assert not any(f"{other} hand" in event for event in said)
    goals, hands = np.array(trace.goals), np.array(trace.hands)
    assert np.nanmax(np.ptp(goals[np.isfinite(goals[:, 0])], axis=0)) > 0.1, "the arm moved in servo mode [rad]"
    assert (np.nanmax(hands, axis=0) - np.nanmin(hands, axis=0))[:3].min() > 1.0, "each finger closed [rad]"
