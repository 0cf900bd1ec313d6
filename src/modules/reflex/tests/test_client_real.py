"""The client of the hand on the loopback interface, with the simulated hand as a program of its own."""

import socket
import threading

import pytest

from reflex import HandSettings, HandSilent, HandStatus, ReflexHand, WireFault
from reflex.calibration_files import CalibrationFiles

pytestmark = pytest.mark.clock

PATIENT = HandSettings(silence_time=60.0, calibration_max_time=60.0)
"""Hand and client may get no processor for seconds."""


@pytest.fixture
def hand_of(tmp_path):
    """Makes a client whose calibration is kept in a folder of the test."""
    return lambda port, **options: ReflexHand("lo", port, files=CalibrationFiles(str(tmp_path / "hand")), **options)


def test_calibrates_closes_and_lets_go(simulated_hand, hand_of, wait_until):
    _, port, control = simulated_hand("--seed", "4")
    with hand_of(port, settings=PATIENT) as hand:
        hand.calibrate_fingers()
        assert hand.calibrated and hand.status is HandStatus.READY
        hand.command((2.5, 2.5, 2.5, 0.0))
        wait_until(lambda: min(control.ask("state")["angles"][:3]) > 2.0, 10.0, "the closed hand")
    wait_until(lambda: control.ask("state")["torque"] == [False] * 4, 10.0, "torque off")
    assert not [thread for thread in threading.enumerate() if thread.name == "reflex hand"]


def test_no_hand_and_no_interface(hand_of, free_port):
    hand = hand_of(free_port(socket.SOCK_DGRAM))
    hand.connect()
    with pytest.raises(HandSilent):
        hand.wait_for_packet(0.1)
    hand.disconnect()
    with pytest.raises(WireFault):
        ReflexHand("eth77")
