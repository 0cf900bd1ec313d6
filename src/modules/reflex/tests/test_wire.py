"""Driver and simulated hand on the real sockets of the loopback interface."""

import socket
import threading

import pytest

from common import clock
from common.errors import DeviceError
from reflex.codec import GROUP, STATE_BYTES, decode_state, encode_mode, encode_target
from reflex.errors import WireFault
from reflex.transport import HandTransport, interface_address
from rig_simulation.devices.reflex import program
from rig_simulation.devices.reflex.hand import SimulatedHand
from rig_simulation.devices.reflex.wire import POSITION

LONG_S = 60.0


@pytest.mark.real
def test_packets_and_commands_arrive_whole_and_own_ones_do_not_come_back():
    link, hand, stop = program.HandLink("lo", 0), SimulatedHand(), threading.Event()
    transport, other = HandTransport("lo", link.port), HandTransport("lo", link.port)
    assert [transport.send(encode_target((1, 2, 3, 4))) or transport.receive(0.05) for _ in range(3)] == [None] * 3
    assert other.receive(LONG_S)[0] == encode_target((1, 2, 3, 4)), "another host hears them"
    cycle = threading.Thread(target=program.run, args=(hand, link, threading.Lock(), stop), daemon=True)
    transport.send(encode_mode(POSITION))
    assert transport.receive(0.05) is None
    cycle.start()
    times = []
    while hand.modes_received == 0 or len(times) < 5:
        data, _ = transport.receive(LONG_S)
        times.append(decode_state(data).device_time)
    assert times == sorted(set(times)) and hand.state()["mode"] == [POSITION] * 4
    stop.set()
    cycle.join(LONG_S)
    for each in (transport, other, link, transport):
        each.close()


@pytest.mark.real
def test_a_port_in_use_and_a_second_hand_are_one_sentence(monkeypatch, free_port):
    port = free_port(socket.SOCK_DGRAM)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
        selfish.bind(("", port))
        with pytest.raises(WireFault, match=f"Cannot use the multicast group {GROUP}:{port} on lo"):
            HandTransport("lo", port)
        with pytest.raises(DeviceError, match=f"Cannot use {GROUP}:{port} on lo"):
            program.HandLink("lo", port)
    first, waits, sleep = program.HandLink("lo", 0), [], clock.sleep

    def send_meanwhile(seconds):
        waits.append(seconds)
        first.send(bytes(STATE_BYTES))
        sleep(seconds)

    monkeypatch.setattr(clock, "sleep", send_meanwhile)
    with pytest.raises(DeviceError, match=f"Another hand already sends on port {first.port} of lo"):
        program.HandLink("lo", first.port)
    assert waits == [0.15]
    first.close()


@pytest.mark.real
def test_only_the_named_interface_is_heard(free_port):
    others = [name for _, name in socket.if_nameindex() if name != "lo" and _has_address(name)]
    if not others:
        pytest.skip("this machine has no second interface with an IPv4 address")
    port = free_port(socket.SOCK_DGRAM)
    here, there = HandTransport("lo", port), HandTransport(others[0], port)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    sender.sendto(b"simulated", (GROUP, port))
    assert here.receive(LONG_S)[0] == b"simulated"
    assert there.receive(0.1) is None
    for s in (here, there, sender):
        s.close()


def _has_address(name: str) -> bool:
    try:
        return bool(interface_address(name))
    except WireFault:
        return False


def test_an_absent_interface_is_one_sentence_with_those_there_are():
    with pytest.raises(WireFault, match=r"'eth77' does not exist; interfaces with an IPv4 address: .*lo"):
        HandTransport("eth77", 11333)
