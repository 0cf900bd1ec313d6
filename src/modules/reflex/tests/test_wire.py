"""Driver and simulated hand on the real sockets of the loopback interface, without ROS."""

import socket
import time

import numpy as np
import pytest

from reflex.codec import GROUP, STATE_BYTES, decode_state, encode_mode, encode_target
from reflex.errors import WireFault
from reflex.hand import HandLogic
from reflex.transport import HandTransport, interface_address

pytestmark = pytest.mark.clock


class Host:
    """The driver's loop."""

    def __init__(self, settings, calibration, port) -> None:
        self.transport = HandTransport("lo", port)
        self.hand = HandLogic(settings, *calibration, calibrated=False)
        self.notes = []
        self.reading = None
        self.act(self.hand.start())

    def act(self, result):
        for packet in result.send:
            self.transport.send(packet)
        self.notes += [note.text for note in result.notes]
        self.reading = result.reading or self.reading
        return result

    def until(self, condition, timeout=60.0):
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, (self.notes, self.hand.state(time.monotonic()))
            datagram = self.transport.receive(0.005)
            if datagram:
                self.act(self.hand.receive(*datagram, time.monotonic()))
            self.act(self.hand.tick(time.monotonic()))


@pytest.fixture
def host(make_settings, shipped):
    hosts = []

    def make(port, **changes):
        hosts.append(Host(make_settings(**changes), shipped, port))
        return hosts[-1]

    yield make
    for one in hosts:
        one.transport.close()


def test_calibrates_commands_and_lets_go(simulated_hand, host):
    _, port, control = simulated_hand("--seed", "4")
    h = host(port, silence_time=5.0, calibration_max_time=60.0)
    h.until(lambda: h.reading)
    h.act(h.hand.calibrate_fingers(time.monotonic()))
    h.act(h.hand.calibrate_tactile(time.monotonic()))
    h.until(lambda: h.hand.calibration_outcome == "succeeded" and "The tactile sensors are zeroed." in h.notes)
    h.act(h.hand.command((2.0, 2.0, 1.8, 0.4), time.monotonic()))
    h.until(lambda: np.allclose(h.reading.joint_angles, (2.0, 2.0, 1.8, 0.4), atol=0.01))
    assert min(control.ask("state")["angles"][:3]) > 1.5
    control.ask("press", finger=2, cell=3, value=60)
    h.until(lambda: h.reading.contact[2][3])
    assert np.array(h.reading.contact).sum() == 1
    h.act(h.hand.stop())
    h.until(lambda: control.ask("state")["torque"] == [False] * 4)
    counters = h.hand.link.counts
    assert counters.packets > 20
    assert (counters.repeated, counters.malformed, counters.other_hands, counters.other_hosts) == (0, 0, 0, 0)


def test_survives_garbage_and_names_a_second_host(simulated_hand, host):
    _, port, control = simulated_hand()
    h = host(port)
    h.until(lambda: h.reading)
    other = HandTransport("lo", port)
    for data in (b"", b"\1", bytes(STATE_BYTES), b"\1" + bytes(4000), encode_mode(2)):
        other.send(data)
    other.close()
    h.until(lambda: h.hand.link.counts.malformed >= 4 and h.hand.link.counts.other_hosts == 1)
    packets = h.hand.link.counts.packets
    h.until(lambda: h.hand.link.counts.packets > packets + 3)
    assert control.ask("state")["targets_received"] > 0


def test_the_hand_may_come_and_go(simulated_hand, processes, host):
    process, port, _ = simulated_hand()
    h = host(port)
    h.until(lambda: h.reading)
    assert processes.end(process) == 0
    h.until(lambda: any("silent" in note for note in h.notes))
    _, _, control = simulated_hand(port=port)
    h.until(lambda: any("switched off and on" in note for note in h.notes))
    h.until(lambda: control.ask("state")["torque"] == [True] * 4)


def test_own_packets_do_not_come_back(free_port):
    transport = HandTransport("lo", free_port(socket.SOCK_DGRAM))
    transport.send(encode_target((1, 2, 3, 4)))
    assert [transport.receive(0.05) for _ in range(3)] == [None] * 3
    transport.close()
    transport.close()


def test_only_the_named_interface_is_heard(free_port):
    others = [name for _, name in socket.if_nameindex() if name != "lo" and _has_address(name)]
    if not others:
        pytest.skip("this machine has no second interface with an IPv4 address")
    port = free_port(socket.SOCK_DGRAM)
    here, there = HandTransport("lo", port), HandTransport(others[0], port)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    sender.sendto(b"simulated", (GROUP, port))
    assert here.receive(60.0)[0] == b"simulated"
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


def test_a_port_in_use_is_one_sentence(free_port):
    port = free_port(socket.SOCK_DGRAM)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
        selfish.bind(("", port))
        with pytest.raises(WireFault, match=f"Cannot use the multicast group {GROUP}:{port} on lo"):
            HandTransport("lo", port)


def test_the_simulated_hand_sends_whole_packets(simulated_hand):
    _, port, _ = simulated_hand()
    transport = HandTransport("lo", port)
    datagrams = [transport.receive(60.0) for _ in range(5)]
    transport.close()
    times = [decode_state(data).device_time for data, _ in datagrams]
    assert times == sorted(set(times))
