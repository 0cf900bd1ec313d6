"""Hands made by hand, for the tests of leap_kuka."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from common.config import parse
from common.rotations import rotation_from_zyx
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.virtual_leap import R_LEAP_REFERENCE
from leap_motion.frames import TrackedHand, TrackingFrame

sys.path.append(str(Path(__file__).parent))
LEAP = {
    "z_clearance": 0.15,
    "box_dimensions": np.array([0.2, 0.2, 0.2]),
    "box_offset": 0.0,
    "hand": "any",
    "buffer_size": 10,
    "filter": "mean",
    "start_tol_pitch": 20.0,
    "start_tol_roll": 20.0,
    "run_tol_yaw": 25.0,
    "run_tol_pitch": 25.0,
    "run_tol_roll": 25.0,
    "min_confidence": 0.05,
    "engagement": "absolute",
    "hold_time": 0.0,
    "enabling": "none",
    "clutch": "none",
    "arm_choice": "none",
}
ARM = {
    "center_line": np.array([1.0, -1.0, 0.0]),
    "z_lower_limit": 0.2,
    "tool_length": 0.106,
    "ws_center": np.array([0.42, -0.42, 0.4]),
}
BOX_HEIGHT = 0.35


@pytest.fixture(scope="session")
def leap():
    """Makes the parameters of the package, with what differs from the defaults."""
    return lambda **changes: LeapConfig(**{**LEAP, **changes})


@pytest.fixture(scope="session")
def arm():
    """Makes the arm's parameters, with what differs from the defaults."""
    return lambda **changes: parse(ArmPlacement, {**ARM, **changes}, "kuka/")


@pytest.fixture(scope="session")
def sample():
    """Makes a hand from its angles against the reference hand [deg]; by default level in the middle of the box."""

    def make(
        yaw=0.0, pitch=0.0, roll=0.0, position=(0.0, BOX_HEIGHT, 0.0), id=12, is_left=False, confidence=1.0, **more
    ):
        R = R_LEAP_REFERENCE @ rotation_from_zyx(*np.radians([yaw, pitch, roll]))
        return TrackedHand(id, is_left, position, R[:, 0], R[:, 2], confidence, **more)

    return make


@pytest.fixture(scope="session")
def player():
    """Feeds hands to a ArmTeleop as frames of a tracker at 100 Hz."""

    class Player:
        def __init__(self, teleop):
            self.teleop = teleop
            self.number = 0
            self.now = 50.0

        def step(self, *hands, dt=0.01):
            self.number += 1
            self.now += dt
            return self.teleop.step(TrackingFrame(self.number, 0.0, hands), self.now)

        def steps(self, count, *hands):
            return [self.step(*hands) for _ in range(count)]

        def come_in(self, hand, *others):
            """The hand comes from in front of the box and stays for a second; returns the results."""
            way = [0.3] * 3 + np.arange(0.3, 0.0, -0.015).tolist() + [0.0] * 100
            hands = [dataclasses.replace(hand, palm=np.add(hand.palm, (0.0, 0.0, back))) for back in way]
            return [self.step(hand, *others) for hand in hands]

    return Player
