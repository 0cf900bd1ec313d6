"""The client of the hand on the loopback interface, with the simulated hand as a program of its own."""

import math
import socket
import threading
import time

import numpy as np
import pytest
import yaml

from common.config import parse
from reflex import CommandRefused, HandSettings, HandSilent, HandStatus, ReflexHand, WireFault
from reflex.calibration_files import CalibrationFiles
from reflex.ros.parameters import ReflexDriverConfig

pytestmark = pytest.mark.clock


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "reflex hand"]


PATIENT = HandSettings(silence_time=5.0, calibration_max_time=60.0)
"""Hand and client may get no processor for seconds."""


@pytest.fixture
def hand_of(tmp_path):
    """Makes a client whose calibration is kept in a folder of the test."""
    return lambda port, **options: ReflexHand("lo", port, files=CalibrationFiles(str(tmp_path / "hand")), **options)


def test_calibrates_closes_feels_and_lets_go(simulated_hand, hand_of, wait_until):
    _, port, control = simulated_hand("--seed", "4")
    readings, notes = [], []
    with hand_of(port, settings=PATIENT, on_reading=readings.append, on_note=notes.append) as hand:
        with pytest.raises(CommandRefused) as caught:
            hand.close()
        assert "calibrate" in caught.value.reason and not hand.calibrated
        hand.calibrate_fingers()
        hand.calibrate_tactile()
        assert hand.calibrated and hand.status is HandStatus.READY
        hand.close()
        np.testing.assert_allclose(hand.state.joint_angles[:3], 2.5, atol=0.02)
        assert min(control.ask("state")["angles"][:3]) > 2.0
        hand.open()
        hand.move((1.0, 2.0, 1.5, 0.4))
        np.testing.assert_allclose(hand.state.joint_angles, (1.0, 2.0, 1.5, 0.4), atol=0.02)
        wait_until(lambda: any("tactile_calibrate" in note.text for note in notes), 10.0, "the saved offsets")
        control.ask("press", finger=2, cell=3, value=60)
        wait_until(lambda: hand.state.contact[2][3], 10.0, "the touch")
        hand.set_speed((1.0, 1.0, 1.0, 1.0))
        wait_until(lambda: control.ask("state")["speed_settings"] == [118, 1142, 118, 1149], 10.0, "the speed")
        for bad in (lambda: hand.command((math.nan, 0, 0, 0)), lambda: hand.set_speed((math.inf,) * 4)):
            with pytest.raises(CommandRefused):
                bad()
        assert hand.diagnosis()[2]["interface"] == "lo"
    assert len(readings) > 20 and not threads()
    wait_until(lambda: control.ask("state")["torque"] == [False] * 4, 10.0, "torque off")
    with hand_of(port, hold_at_exit=True) as again:
        assert again.calibrated
        wait_until(lambda: control.ask("state")["torque"] == [True] * 4, 10.0, "torque on")
    again.disconnect()
    time.sleep(0.2)  # in which the hand would have read the last packet
    assert control.ask("state")["torque"] == [True] * 4
    for use in (lambda: again.command((0.0,) * 4), again.connect, lambda: again.wait_for_packet(0.1)):
        with pytest.raises(CommandRefused):
            use()


def test_a_callback_may_close_the_connection_on_a_fault_of_the_wire(hand_of, free_port, monkeypatch):
    def fail(data):
        raise WireFault("the interface is down")

    notes = []
    hand = hand_of(free_port(socket.SOCK_DGRAM), on_note=lambda note: (notes.append(note), hand.disconnect()))
    hand.connect()
    monkeypatch.setattr(hand._transport, "send", fail)
    caller = threading.Thread(target=hand.disable_torque, daemon=True)
    caller.start()
    caller.join(30.0)
    assert not caller.is_alive() and not hand.listening
    assert [note.level for note in notes] == ["error"]


def test_a_failed_calibration_is_a_refusal(simulated_hand, hand_of):
    _, port, control = simulated_hand()
    with hand_of(port, settings=PATIENT) as hand:
        control.ask("stick_encoder", finger=0, on=True)
        with pytest.raises(CommandRefused) as caught:
            hand.calibrate_fingers()
        assert "f1" in caught.value.reason and not hand.calibrated


def test_a_silent_hand_is_an_error_and_comes_back(simulated_hand, hand_of, wait_until):
    _, port, control = simulated_hand()
    with hand_of(port) as hand:
        control.ask("set_silent", on=True)
        wait_until(lambda: hand.status is HandStatus.SILENT, 10.0, "the silence")
        for use in (lambda: hand.state, hand.close, lambda: hand.wait_for_packet(0.1)):
            with pytest.raises(HandSilent) as caught:
                use()
            assert caught.value.interface == "lo" and 0.1 <= caught.value.seconds < math.inf
        control.ask("set_silent", on=False)
        hand.wait_for_packet(30.0)


def test_no_hand_and_no_interface(hand_of, free_port):
    hand = hand_of(free_port(socket.SOCK_DGRAM))
    hand.connect()
    with pytest.raises(HandSilent) as caught:
        _ = hand.state
    assert caught.value.seconds < 60.0
    with pytest.raises(HandSilent):
        hand.wait_for_packet(0.1)
    hand.disconnect()
    assert not threads()
    with pytest.raises(WireFault):
        ReflexHand("eth77")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_fault_in_a_callback_lets_the_hand_go(simulated_hand, hand_of, wait_until):
    _, port, control = simulated_hand()
    hand = hand_of(port, on_reading=lambda reading: 1 / 0)
    hand.connect()
    wait_until(lambda: not hand.listening, 10.0, "the end of the thread")
    wait_until(lambda: control.ask("state")["torque"] == [False] * 4, 10.0, "torque off")
    hand.disconnect()


def test_the_drivers_parameters_have_the_clients_defaults(shipped_parameters):
    values = {**shipped_parameters, "network_interface": "lo", "port": 1, "calibration_folder": "x"}
    assert parse(ReflexDriverConfig, values).settings() == HandSettings()


@pytest.fixture
def shipped_parameters(config_folder):
    return yaml.safe_load((config_folder / "reflex_takktile.yaml").read_text())
