"""The client of the hand in virtual time, with the simulated hand on its wire."""

import math

import numpy as np
import pytest
import yaml

from common import clock
from common.config import parse
from reflex import CommandRefused, HandSettings, HandSilent, HandStatus, ReflexHand
from reflex.calibration_files import CalibrationFiles
from reflex.link import PacketCounts
from reflex.ros.parameters import ReflexDriverConfig
from simulated.clock import virtual_time
from simulated.hand_wire import HandWire

PACKET_S, SILENCE_S, REOPEN_S, LOOP_S = 0.025, 0.5, 2.0, 0.01
"""Between two packets; of the client: until silence, and until the sockets are opened anew; what both take at most."""


@pytest.fixture
def wire():
    with virtual_time(), HandWire(seed=4) as wire:
        yield wire


@pytest.fixture
def hand_of(wire, tmp_path):
    """Makes a client whose calibration is kept in a folder of the test."""

    def make(port=11333, **options):
        return ReflexHand("lo", port, files=CalibrationFiles(str(tmp_path / "hand")), runtime=clock, **options)

    return make


def test_calibrates_closes_feels_and_lets_go(wire, hand_of):
    readings, notes = [], []
    with hand_of(on_reading=readings.append, on_note=notes.append) as hand:
        with pytest.raises(CommandRefused) as caught:
            hand.close()
        assert "calibrate" in caught.value.reason and not hand.calibrated
        hand.calibrate_fingers()
        hand.calibrate_tactile()
        assert hand.calibrated and hand.status is HandStatus.READY
        began = clock.monotonic()
        hand.close()
        assert clock.monotonic() - began < 1.2, "2.5 rad at 3 rad/s, and four packets at rest"
        np.testing.assert_allclose(hand.state.joint_angles[:3], 2.5, atol=0.02)
        assert min(wire.hand.state()["angles"][:3]) > 2.0
        hand.open()
        hand.move((1.0, 2.0, 1.5, 0.4))
        np.testing.assert_allclose(hand.state.joint_angles, (1.0, 2.0, 1.5, 0.4), atol=0.02)
        assert any("tactile_calibrate" in note.text for note in notes)
        wire.hand.press(finger=2, cell=3, value=60)
        clock.sleep(PACKET_S + LOOP_S)
        assert hand.state.contact[2][3]
        hand.set_speed((1.0, 1.0, 1.0, 1.0))
        clock.sleep(PACKET_S + LOOP_S)
        assert wire.hand.state()["speed_settings"] == [118, 1142, 118, 1149]
        for bad in (lambda: hand.command((math.nan, 0, 0, 0)), lambda: hand.set_speed((math.inf,) * 4)):
            with pytest.raises(CommandRefused):
                bad()
        assert hand.diagnosis()[2]["interface"] == "lo"
    assert len(readings) > 20 and not hand.listening
    assert hand._logic.link.counts == PacketCounts(packets=len(readings))
    clock.sleep(PACKET_S + LOOP_S)
    assert wire.hand.state()["torque"] == [False] * 4
    with hand_of(hold_at_exit=True) as again:
        assert again.calibrated
        clock.sleep(0.2)  # in which the speeds are set
        assert wire.hand.state()["torque"] == [True] * 4
    again.disconnect()
    clock.sleep(1.0)
    assert wire.hand.state()["torque"] == [True] * 4
    for use in (lambda: again.command((0.0,) * 4), again.connect, lambda: again.wait_for_packet(0.1)):
        with pytest.raises(CommandRefused):
            use()


def test_a_callback_may_close_the_connection_on_a_fault_of_the_wire(wire, hand_of):
    notes = []
    hand = hand_of(on_note=lambda note: (notes.append(note), hand.disconnect()))
    hand.connect()
    wire.broken = "the interface is down"
    caller = clock.Thread(target=hand.disable_torque, daemon=True)
    caller.start()
    caller.join(1.0)
    assert not caller.is_alive() and not hand.listening
    assert [note.level for note in notes] == ["error"]


def test_a_fault_of_the_wire_is_said_once_and_ends(wire, hand_of):
    notes = []
    with hand_of(on_note=notes.append) as hand:
        wire.broken = "the interface is down"
        for _ in range(3):
            hand.disable_torque()
        assert [note.text for note in notes if note.level == "error"] == ["Cannot send to lo: the interface is down."]
        clock.sleep(1.0)
        assert hand.status is HandStatus.SILENT and "the interface is down" in hand.diagnosis()[1]
        wire.broken = ""
        hand.wait_for_packet(PACKET_S + LOOP_S)
        hand.disable_torque()
        assert "the interface is down" not in hand.diagnosis()[1]


def test_a_failed_calibration_is_a_refusal(wire, hand_of):
    with hand_of() as hand:
        wire.hand.stick_encoder(finger=0, on=True)
        with pytest.raises(CommandRefused) as caught:
            hand.calibrate_fingers()
        assert "f1" in caught.value.reason and not hand.calibrated


def test_a_silent_hand_is_an_error_and_comes_back(wire, hand_of):
    at, notes = [], []
    with hand_of(on_reading=lambda _: at.append(clock.monotonic()), on_note=notes.append) as hand:
        wire.hand.set_silent(True)
        clock.sleep(0.1)
        clock.sleep(at[-1] + SILENCE_S - 1e-6 - clock.monotonic())
        assert hand.status is not HandStatus.SILENT and hand.state is not None
        clock.sleep(2e-6)
        assert hand.status is HandStatus.SILENT
        for use in (lambda: hand.state, hand.close, lambda: hand.wait_for_packet(0.1)):
            with pytest.raises(HandSilent) as caught:
                use()
            assert caught.value.interface == "lo" and 0.1 <= caught.value.seconds <= SILENCE_S + 0.1
        reminders = lambda: len([note for note in notes if "is it on and its cable in" in note.text])  # noqa: E731
        for opening, before, after in ((1, 0, 1), (3, 1, 1), (4, 1, 2)):  # of the sockets
            clock.sleep(at[-1] + opening * REOPEN_S - LOOP_S - clock.monotonic())
            assert reminders() == before
            clock.sleep(5 * LOOP_S)
            assert reminders() == after
        wire.hand.set_silent(False)
        hand.wait_for_packet(PACKET_S + LOOP_S)


def test_a_hand_that_hears_no_commands_is_not_moved(wire, hand_of):
    with hand_of() as hand:
        hand.calibrate_fingers()
        clock.sleep(1.0)
        wire.faults.switch("deaf")
        began, before = clock.monotonic(), hand.state.joint_angles
        hand.move((2.0, 2.0, 2.0, 0.0))
        assert clock.monotonic() - began < 0.2, "it returns as the motors stand still"
        np.testing.assert_allclose(hand.state.joint_angles, before, atol=0.02)


def test_no_hand(hand_of):
    """Reported in https://github.com/RightHandRobotics/reflex-ros-pkg/issues/43: the hand is not heard. Tried: no
    packets.
    """
    hand = hand_of(port=11334)
    hand.connect()
    clock.sleep(0.3)
    with pytest.raises(HandSilent) as caught:
        _ = hand.state
    assert caught.value.seconds == pytest.approx(0.3)
    began = clock.monotonic()
    with pytest.raises(HandSilent):
        hand.wait_for_packet(0.1)
    assert clock.monotonic() - began == pytest.approx(0.1, abs=LOOP_S)
    hand.disconnect()
    assert not hand.listening


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_fault_in_a_callback_lets_the_hand_go(wire, hand_of):
    hand = hand_of(on_reading=lambda reading: 1 / 0)
    hand.connect()
    clock.sleep(2 * PACKET_S + 2 * LOOP_S)
    assert not hand.listening and wire.hand.state()["torque"] == [False] * 4
    hand.disconnect()


def test_the_drivers_parameters_have_the_clients_defaults(config_folder):
    shipped = yaml.safe_load((config_folder / "reflex_takktile.yaml").read_text())
    values = {**shipped, "network_interface": "lo", "port": 1, "calibration_folder": "x"}
    assert parse(ReflexDriverConfig, values).settings() == HandSettings()


def test_a_speed_that_is_not_set_is_given_up_after_two_seconds(wire, hand_of, monkeypatch):
    with hand_of() as hand:
        monkeypatch.setattr(ReflexHand, "status", HandStatus.CHANGING_SPEED)
        began = clock.monotonic()
        with pytest.raises(CommandRefused, match="within 2 s"):
            hand.set_speed((1.0, 1.0, 1.0, 1.0))
        assert clock.monotonic() - began == pytest.approx(2.0, abs=LOOP_S)
        monkeypatch.undo()
