"""Every fault of the simulated hand, seen by a plain UDP socket; and that it ends again."""

from __future__ import annotations

import socket
import struct
import threading
from collections import Counter

import numpy as np
import pytest

from rig_simulation.devices.reflex.hand import SimulatedHand
from rig_simulation.devices.reflex.program import HandLink, main, run
from rig_simulation.devices.reflex.wire import GROUP, IDLE, POSITION, STATE_BYTES
from rig_simulation.faults.hand import EFFECTS, HAND_FAULTS, HandWire
from rig_simulation.faults.injection import Faults

SOON_S = 60.0
TIME, ENCODERS, POSITIONS, LOADS = 4, 160, 170, 186
PRESSURES_F2 = 44


class Host:
    """The other end of the cable, without our driver."""

    def __init__(self, port):
        self.address = (GROUP, port)
        self.inbox = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.inbox.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.inbox.bind(self.address)
        membership = socket.inet_aton(GROUP) + socket.inet_aton("127.0.0.1")
        self.inbox.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        self.inbox.settimeout(SOON_S)
        self.outbox = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.outbox.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))

    def packet(self):
        """Returns the next datagram of the hand."""
        while True:
            data = self.inbox.recv(2048)
            if len(data) != 5:  # the host's own mode command
                return data

    def fresh(self):
        """Returns a packet that was sent after this call."""
        self.inbox.setblocking(False)
        try:
            while True:
                self.inbox.recv(2048)
        except BlockingIOError:
            self.inbox.settimeout(SOON_S)
        return self.packet()

    def silent(self, seconds=0.3):
        self.inbox.settimeout(seconds)
        try:
            self.packet()
        except socket.timeout:
            return True
        finally:
            self.inbox.settimeout(SOON_S)
        return False

    def send_mode(self, mode):
        self.outbox.sendto(bytes([1, mode, mode, mode, mode]), self.address)

    def close(self):
        self.inbox.close()
        self.outbox.close()


def values(packet, offset, count, size="H"):
    return struct.unpack_from(f"<{count}{size}", packet, offset)


@pytest.fixture
def link():
    link = HandLink("lo", 0)
    yield link
    link.close()


@pytest.fixture
def hand(link):
    hand, stop = SimulatedHand(4), threading.Event()
    thread = threading.Thread(target=run, args=(hand, link, threading.Lock(), stop))
    thread.start()
    yield hand
    stop.set()
    thread.join(SOON_S)


@pytest.fixture
def host(link, hand):
    host = Host(link.port)
    host.packet()
    yield host
    host.close()


def test_cut(host, hand, link, wait_until):
    link.faults.switch("cut")
    wait_until(host.silent, SOON_S, "silence")
    host.send_mode(POSITION)
    assert host.silent()
    assert hand.state()["mode"] == [IDLE] * 4
    link.faults.switch("cut", on=False)
    assert len(host.packet()) == STATE_BYTES
    host.send_mode(POSITION)
    wait_until(lambda: hand.state()["mode"] == [POSITION] * 4, SOON_S, "the command")


def test_silent(host, hand, link, wait_until):
    link.faults.switch("silent")
    wait_until(host.silent, SOON_S, "silence")
    host.send_mode(POSITION)
    wait_until(lambda: hand.state()["mode"] == [POSITION] * 4, SOON_S, "the command")
    link.faults.switch("silent", on=False)
    assert len(host.packet()) == STATE_BYTES


def test_deaf(host, hand, link, wait_until):
    link.faults.switch("deaf")
    host.send_mode(POSITION)
    for _ in range(10):
        assert len(host.packet()) == STATE_BYTES
    assert hand.state()["modes_received"] == 0
    link.faults.switch("deaf", on=False)
    host.send_mode(POSITION)
    wait_until(lambda: hand.state()["modes_received"] == 1, SOON_S, "the command")


def test_slow(host, hand, link, wait_until):
    link.faults.switch("slow", value=0.5)
    wait_until(lambda: host.silent(0.25), SOON_S, "the wait for the first late packet")

    def age():
        packet = host.fresh()
        return hand.state()["time"] - values(packet, TIME, 1, "I")[0] * 1e-6

    assert age() > 0.45
    link.faults.switch("slow", on=False)
    wait_until(lambda: age() < 0.4, SOON_S, "the end")


def test_garbled(host, link, wait_until):
    link.faults.switch("garbled")
    kinds = set()

    def several():
        packet = host.packet()
        kinds.add((np.sign(len(packet) - STATE_BYTES), packet[0] == 1))
        return {(0, False), (-1, True), (1, True)} <= kinds

    wait_until(several, SOON_S, "garbage of every kind")
    link.faults.switch("garbled", on=False)
    wait_until(lambda: all(len(p := host.packet()) == STATE_BYTES and p[0] == 1 for _ in range(5)), SOON_S, "the end")


def test_reordered(host, link, wait_until):
    def backwards():
        times = [values(host.packet(), TIME, 1, "I")[0] for _ in range(8)]
        return (np.diff(times) < 0).sum() >= 3

    assert not backwards()
    link.faults.switch("reordered")
    wait_until(backwards, SOON_S, "packets in another order")
    link.faults.switch("reordered", on=False)
    wait_until(lambda: not backwards(), SOON_S, "the end")


@pytest.mark.parametrize(("name", "copies"), [("doubled", 2), ("frozen", 5)])
def test_the_same_packet_again(host, link, wait_until, name, copies):
    def again():
        return max(Counter(host.packet() for _ in range(5)).values()) >= copies

    assert not again()
    link.faults.switch(name)
    wait_until(again, SOON_S, "copies")
    link.faults.switch(name, on=False)
    wait_until(lambda: not again(), SOON_S, "the end")


def test_restarted(host, hand, link, wait_until):
    host.send_mode(POSITION)
    wait_until(lambda: hand.state()["mode"] == [POSITION] * 4, SOON_S, "the command")
    link.faults.switch("restarted")
    wait_until(host.silent, SOON_S, "silence")
    before = hand.state()["time"]
    link.faults.switch("restarted", on=False)
    assert values(host.packet(), TIME, 1, "I")[0] * 1e-6 < before, "its clock begins anew"
    assert hand.state()["mode"] == [IDLE] * 4
    assert hand.state()["power_cycles"] == 1


def test_servo_lost(host, link, wait_until):
    link.faults.switch("servo_lost", value=3)
    wait_until(lambda: values(host.packet(), POSITIONS, 4)[2] == 0, SOON_S, "the loss")
    link.faults.switch("servo_lost", value=1)
    wait_until(lambda: values(host.packet(), POSITIONS, 4)[0] == 0, SOON_S, "the loss of another")
    assert values(host.packet(), POSITIONS, 4)[2] > 0
    link.faults.switch("servo_lost", on=False)
    wait_until(lambda: min(values(host.packet(), POSITIONS, 4)) > 0, SOON_S, "the end")


def test_overloaded(host, link, wait_until):
    link.faults.switch("overloaded", value=2)
    wait_until(lambda: values(host.packet(), LOADS, 4)[1] == 1000, SOON_S, "the load")
    link.faults.switch("overloaded", on=False)
    wait_until(lambda: values(host.packet(), LOADS, 4)[1] < 100, SOON_S, "the end")


def test_touch_stuck(host, link, wait_until):
    rest = np.array(values(host.packet(), PRESSURES_F2, 9))
    link.faults.switch("touch_stuck", value=2)
    wait_until(lambda: (np.array(values(host.packet(), PRESSURES_F2, 9)) - rest).min() > 50, SOON_S, "the pressure")
    link.faults.switch("touch_stuck", on=False)
    wait_until(lambda: (np.array(values(host.packet(), PRESSURES_F2, 9)) - rest).max() < 20, SOON_S, "the end")


def test_encoder_stuck(host, hand, link, wait_until):
    def close(ticks):
        goal = [p + s * ticks for p, s in zip(hand.state()["positions"], (1, -1, 1, 0))]
        host.outbox.sendto(b"\2" + struct.pack(">4H", *goal), host.address)
        wait_until(lambda: hand.state()["targets_received"] >= 1, SOON_S, "the target")

    def moved(before):
        return np.abs(np.array(values(host.fresh(), ENCODERS, 3), dtype=int) - before) > 100

    link.faults.switch("encoder_stuck", value=2)
    host.fresh(), host.fresh()
    before = np.array(values(host.fresh(), ENCODERS, 3), dtype=int)
    host.send_mode(POSITION)
    close(300)
    wait_until(lambda: moved(before)[[0, 2]].all(), SOON_S, "the other fingers to close")
    assert not moved(before)[1]
    link.faults.switch("encoder_stuck", on=False)
    wait_until(lambda: moved(before)[1], SOON_S, "the end")


def test_a_share_of_packets_and_commands_is_lost():
    faults = Faults(HAND_FAULTS)
    wire = HandWire(faults)
    faults.switch("silent", value=0.25)
    faults.switch("deaf", value=0.75)
    assert 650 < sum(len(wire.outgoing(b"state", 0.0)) for _ in range(1000)) < 850
    assert 150 < len(wire.incoming([b"command"] * 1000)) < 350


def test_without_faults_everything_passes_unchanged():
    wire = HandWire(Faults(HAND_FAULTS))
    assert wire.outgoing(b"state", 0.0) == [b"state"]
    assert wire.incoming([b"a", b"b"]) == [b"a", b"b"]


def test_fingers_and_motors_are_whole_numbers():
    faults = Faults(HAND_FAULTS)
    for name in EFFECTS.keys() - {"restarted"}:
        with pytest.raises(ValueError):
            faults.switch(name, value=1.5)
        with pytest.raises(ValueError):
            faults.switch(name, value=5)


def test_an_unknown_fault_on_the_command_line_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--fault", "dance"])
    assert "'dance'" in capsys.readouterr().err
