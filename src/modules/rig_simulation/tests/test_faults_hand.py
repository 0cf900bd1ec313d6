"""Every fault of the simulated hand, seen by a plain host on its wire; and that it ends again."""

from __future__ import annotations

import struct
from collections import Counter

import numpy as np
import pytest

from common import clock
from rig_simulation.devices.reflex.hand import PERIOD_S
from rig_simulation.devices.reflex.wire import IDLE, POSITION, STATE_BYTES
from rig_simulation.faults.hand import EFFECTS, HAND_FAULTS, HandWire
from rig_simulation.faults.injection import Faults
from simulated import hand_wire
from simulated.clock import virtual_time

CYCLE_S = PERIOD_S + hand_wire.DELAY_S
"""After this time the hand has noticed a fault or a command, and its packet is there."""
TIME, ENCODERS, POSITIONS = 4, 160, 170
PRESSURES_F2 = 44


class Host:
    """The other end of the cable, without our driver."""

    def __init__(self, wire):
        self._transport = wire.connect("lo", 11333)

    def packet(self):
        """Returns the next packet of the hand."""
        return self._transport.receive(3.0 * PERIOD_S)[0]

    def silent(self, seconds=1.0):
        clock.sleep(seconds)
        return self._transport.receive(0.0) is None

    def fresh(self, offset, count, size="H"):
        """Returns values of a packet that was sent after this call."""
        while self._transport.receive(0.0) is not None:
            pass
        return values(self.packet(), offset, count, size)

    def send(self, data):
        self._transport.send(data)
        clock.sleep(CYCLE_S)

    def send_mode(self, mode):
        self.send(bytes([1, mode, mode, mode, mode]))


def values(packet, offset, count, size="H"):
    return struct.unpack_from(f"<{count}{size}", packet, offset)


@pytest.fixture
def wire():
    with virtual_time(), hand_wire.HandWire(seed=4) as wire:
        yield wire


@pytest.fixture
def hand(wire):
    return wire.hand


@pytest.fixture
def host(wire):
    return Host(wire)


@pytest.fixture
def fault(wire, host):
    """Switches a fault, waits until the hand has noticed, and forgets what came before."""

    def fault(name, **fields):
        wire.faults.switch(name, **fields)
        clock.sleep(CYCLE_S)
        while host._transport.receive(0.0) is not None:
            pass

    return fault


def test_cut(host, hand, fault):
    fault("cut")
    host.send_mode(POSITION)
    assert host.silent()
    assert hand.state()["mode"] == [IDLE] * 4
    fault("cut", on=False)
    assert len(host.packet()) == STATE_BYTES
    host.send_mode(POSITION)
    assert hand.state()["mode"] == [POSITION] * 4


def test_silent(host, hand, fault):
    fault("silent")
    host.send_mode(POSITION)
    assert hand.state()["mode"] == [POSITION] * 4
    assert host.silent()
    fault("silent", on=False)
    assert len(host.packet()) == STATE_BYTES


def test_slow(host, hand, fault):
    def age():
        seen = host.fresh(TIME, 1, "I")[0]
        return hand.state()["time"] - 1e-6 * seen

    fault("slow", value=0.51)
    assert host.silent(0.5 - 2 * PERIOD_S)
    clock.sleep(1.0)
    assert age() == pytest.approx(21 * PERIOD_S, abs=1e-5)
    fault("slow", on=False)
    clock.sleep(0.5)
    assert age() == pytest.approx(0.0, abs=1e-5)


def test_garbled(host, fault):
    def kind():
        packet = host.packet()
        return np.sign(len(packet) - STATE_BYTES), packet[0] == 1

    fault("garbled")
    assert {kind() for _ in range(50)} == {(0, False), (-1, True), (1, True)}
    fault("garbled", on=False)
    assert {kind() for _ in range(5)} == {(0, True)}


def test_reordered(host, fault):
    def steps():
        times = [values(host.packet(), TIME, 1, "I")[0] for _ in range(9)]
        return (np.diff(times) / (1e6 * PERIOD_S)).round().tolist()

    assert steps() == [1] * 8
    fault("reordered")
    assert steps() in ([-1, 3] * 4, [3, -1] * 4)
    fault("reordered", on=False)
    host.packet()
    assert steps() == [1] * 8


@pytest.mark.parametrize(("name", "copies"), [("doubled", 2), ("frozen", 10)])
def test_the_same_packet_again(host, fault, name, copies):
    def counts():
        return set(Counter(host.packet() for _ in range(10)).values())

    assert counts() == {1}
    fault(name)
    assert counts() == {copies}
    fault(name, on=False)
    assert counts() == {1}


def test_restarted(host, hand, fault):
    host.send_mode(POSITION)
    assert hand.state()["mode"] == [POSITION] * 4
    fault("restarted")
    assert host.silent()
    fault("restarted", on=False)
    assert host.fresh(TIME, 1, "I")[0] * 1e-6 == pytest.approx(PERIOD_S, abs=1e-5), "its clock begins anew"
    assert hand.state()["mode"] == [IDLE] * 4
    assert hand.state()["power_cycles"] == 1


def test_servo_lost(host, fault):
    fault("servo_lost", value=3)
    assert [position > 0 for position in host.fresh(POSITIONS, 4)] == [True, True, False, True]
    fault("servo_lost", value=1)
    assert [position > 0 for position in host.fresh(POSITIONS, 4)] == [False, True, True, True]
    fault("servo_lost", on=False)
    assert min(host.fresh(POSITIONS, 4)) > 0


def test_touch_stuck(host, fault):
    rest = np.array(host.fresh(PRESSURES_F2, 9))
    fault("touch_stuck", value=2)
    assert (np.array(host.fresh(PRESSURES_F2, 9)) - rest).min() > 50
    fault("touch_stuck", on=False)
    assert (np.array(host.fresh(PRESSURES_F2, 9)) - rest).max() < 20


def test_encoder_stuck(host, hand, fault):
    def moved():
        return np.abs(np.array(host.fresh(ENCODERS, 3), dtype=int) - before) > 100

    fault("encoder_stuck", value=2)
    before = np.array(host.fresh(ENCODERS, 3), dtype=int)
    host.send_mode(POSITION)
    goal = [p + s * 300 for p, s in zip(hand.state()["positions"], (1, -1, 1, 0))]
    host.send(b"\2" + struct.pack(">4H", *goal))
    clock.sleep(1.0)
    assert moved().tolist() == [True, False, True]
    fault("encoder_stuck", on=False)
    assert moved().tolist() == [True, True, True]


def test_a_share_of_packets_and_commands_is_lost():
    faults = Faults(HAND_FAULTS)
    wire = HandWire(faults)
    faults.switch("silent", value=0.25)
    faults.switch("deaf", value=0.75)
    assert 650 < sum(len(wire.outgoing(b"state", 0.0)) for _ in range(1000)) < 850
    assert 150 < len(wire.incoming([b"command"] * 1000)) < 350


def test_fingers_and_motors_are_whole_numbers():
    faults = Faults(HAND_FAULTS)
    for name in EFFECTS.keys() - {"restarted"}:
        with pytest.raises(ValueError):
            faults.switch(name, value=1.5)
        with pytest.raises(ValueError):
            faults.switch(name, value=5)
