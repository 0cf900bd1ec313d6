"""What comes in is sorted: by sender, kind, age and the hand's own clock."""

import pytest

from reflex.link import PacketArrival, PacketFilter
from rig_simulation.devices.reflex.hand import SimulatedHand

HAND, OTHER = ("10.99.99.99", 11333), ("10.0.0.2", 40000)
BODY = SimulatedHand().packet()[8:]


def packet(seconds: float) -> bytes:
    return b"\1\0\0\0" + (round(seconds * 1e6) % 2**32).to_bytes(4, "little") + BODY


@pytest.fixture
def link():
    link = PacketFilter(silence_time=0.5)
    assert link.sort(packet(10.0), HAND, 100.0)[0] is PacketArrival.FIRST
    return link


def test_is_not_alive_before_the_first_packet():
    link = PacketFilter(0.5)
    assert not link.heard() and not link.alive(0.0) and link.age(0.0) == float("inf")


@pytest.mark.parametrize(
    ("device", "host", "arrival"),
    [
        (10.025, 100.025, PacketArrival.NEXT),
        (10.3, 100.3, PacketArrival.NEXT),
        (10.025, 100.4, PacketArrival.NEXT),
        (10.025, 103.0, PacketArrival.NEXT),
        (9.7, 100.025, PacketArrival.RESTARTED),
        (10.0, 100.001, PacketArrival.DROPPED),
        (9.975, 100.01, PacketArrival.DROPPED),
        (0.1, 100.4, PacketArrival.RESTARTED),
        (0.1, 105.0, PacketArrival.RESTARTED),
        (500.0, 100.1, PacketArrival.RESTARTED),
    ],
)
def test_device_time_tells_a_pause_from_a_restart(link, device, host, arrival):
    assert link.sort(packet(device), HAND, host)[0] is arrival


@pytest.mark.parametrize(
    ("device", "host", "arrival"),
    [
        (12.0, 102.0, PacketArrival.RESUMED),
        (10.7 + 2**32 / 1e6, 100.7 + 2**32 / 1e6, PacketArrival.RESUMED),
        (3610.0, 3701.0, PacketArrival.RESUMED),
        (10.1, 101.0, PacketArrival.RESTARTED),
        (9.99, 100.7, PacketArrival.RESTARTED),
        (0.1, 105.0, PacketArrival.RESTARTED),
        (500.0, 105.0, PacketArrival.RESTARTED),
    ],
)
def test_after_a_silence_the_clocks_must_agree(link, device, host, arrival):
    assert not link.watch(100.4)
    assert link.watch(100.6) and not link.watch(100.65)
    assert link.sort(packet(device), HAND, host)[0] is arrival
    assert not link.watch(host + 0.1) and link.watch(host + 0.6)


def test_the_clock_of_the_hand_wraps():
    link = PacketFilter(0.5)
    wrap = 2**32 / 1e6
    link.sort(packet(wrap - 0.01), HAND, 100.0)
    assert link.sort(packet(wrap + 0.015), HAND, 100.025)[0] is PacketArrival.NEXT
    assert link.counts.lost == 0


def test_a_clock_that_stands_still_is_no_silence(link):
    assert link.sort(packet(10.0), HAND, 100.025)[0] is PacketArrival.NEXT


def test_lost_and_late_packets_are_counted(link):
    link.sort(packet(10.1), HAND, 100.1)
    assert (link.counts.lost, link.counts.late) == (3, 0)
    link.sort(packet(10.125), HAND, 100.2)
    assert (link.counts.lost, link.counts.late) == (3, 1)


def test_a_second_hand_is_dropped_while_the_first_is_there(link):
    arrival, _, why = link.sort(packet(3.0), OTHER, 100.1)
    assert arrival is PacketArrival.DROPPED and "second hand (10.0.0.2:40000)" in why
    assert link.sort(packet(3.0), OTHER, 101.0)[0] is PacketArrival.RESTARTED


def test_another_host_and_garbage_are_named(link):
    assert "sends commands" in link.sort(bytes.fromhex("0102020202"), OTHER, 100.1)[2]
    assert "3 bytes" not in link.sort(b"GET", OTHER, 100.1)[2] and link.counts.malformed == 1
    assert "202 bytes" in link.sort(packet(10.0)[:-1], HAND, 100.1)[2]
    assert link.counts.packets == 1


def test_silence_begins_after_its_time(link):
    assert link.alive(100.5) and not link.alive(100.51)
