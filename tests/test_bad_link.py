"""The laws of a bad link: order, delay, loss, repetition, rate; and real TCP over it, where devices may be made."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from campaign.network.link import CONDITIONS, Link, Way, direction, exchanged
from campaign.network.wire import ROOT, in_own_network

times = st.floats(0.0, 0.2)
fractions = st.floats(0.0, 1.0)


@st.composite
def links(draw, **fixed):
    delay = draw(times)
    free = {"delay": delay, "jitter": draw(st.floats(0.0, delay)), "loss": draw(fractions)}
    return Link(**{**free, "duplicated": draw(fractions), "reordered": draw(fractions), **fixed})


@st.composite
def traffic(draw):
    """Packets, all different, and the pauses before them."""
    pauses = draw(st.lists(st.floats(0.0, 0.05), min_size=1, max_size=60))
    return [(pause, bytes([k]) * draw(st.integers(1, 1500))) for k, pause in enumerate(pauses)]


def passed(packets, *changes, seed=1):
    """Sends packets while the link changes; returns (sent at, arrived at, packet), packets as they arrive."""
    way, now, sent, arrived = Way(seed), 0.0, {}, []
    after = len(packets) // len(changes) + 1
    for k, (pause, packet) in enumerate(packets):
        way.link = changes[k // after]
        now += pause
        while way.due() <= now:
            due = way.due()
            arrived += [(sent[packet], due, packet) for packet in way.take(due)]
        sent[packet] = now
        way.put(packet, now)
    while way.due() < math.inf:
        due = way.due()
        arrived += [(sent[packet], due, packet) for packet in way.take(due)]
    return arrived


@given(traffic(), st.lists(links(reordered=0.0, duplicated=0.0), min_size=1, max_size=3))
def test_without_reordering_the_order_is_kept_and_no_packet_changes(packets, changes):
    arrived = [packet for _, _, packet in passed(packets, *changes)]
    rest = iter([packet for _, packet in packets])
    assert all(packet in rest for packet in arrived), "a part of what was sent, in its order"


@given(traffic(), links(loss=0.0))
def test_every_packet_arrives_within_its_delay(packets, link):
    arrived = passed(packets, link)
    assert {packet for _, _, packet in arrived} == {packet for _, packet in packets}
    for sent, at, _ in arrived:
        most = link.delay + link.jitter
        assert 0.0 <= at - sent <= most + 1e-9
        assert link.reordered or at - sent >= link.delay - link.jitter - 1e-9


@given(links(reordered=0.0, loss=0.0, duplicated=0.0), st.integers(0, 1000))
def test_jitter_is_even_over_its_range(link, seed):
    arrived = passed([(1.0, k.to_bytes(2, "big")) for k in range(400)], link, seed=seed)
    shares = sorted((at - sent - link.delay) / max(link.jitter, 1e-3) for sent, at, _ in arrived)
    if link.jitter > 1e-3:
        for k, share in enumerate(shares):  # Kolmogorov and Smirnov; exceeded by chance once in 10^9
            assert abs((share + 1.0) / 2.0 - k / 400) < 0.17


@given(links(reordered=0.0, jitter=0.0), st.integers(0, 1000))
def test_losses_and_repetitions_come_as_often_as_stated(link, seed):
    count = 2000
    arrived = passed([(0.001, k.to_bytes(2, "big")) for k in range(count)], link, seed=seed)
    different = len({packet for _, _, packet in arrived})

    def is_likely(n, fraction, of):
        return abs(n - fraction * of) <= 5.0 * math.sqrt(fraction * (1.0 - fraction) * of) + 6.0

    assert is_likely(different, 1.0 - link.loss, count)
    assert is_likely(len(arrived) - different, link.duplicated, different)


@given(traffic(), st.floats(1e4, 1e7), st.integers(1500, 50_000))
def test_a_rate_is_kept_and_nothing_waits_longer_than_the_queue_holds(packets, rate, queue):
    arrived = passed(packets, Link(rate=rate, queue=queue))
    assert arrived, "an empty queue takes any packet"
    for k, (_, begin, _) in enumerate(arrived):
        later = sum(len(packet) for _, at, packet in arrived[k + 1 :] if at <= begin + 0.1)
        assert 8 * later <= rate * 0.1 + 8 * 1e-6
    assert max(at - sent for sent, at, _ in arrived) <= 8.0 * queue / rate + 1e-9


@given(traffic(), times)
def test_a_link_that_is_held_passes_everything_on_afterwards_in_order(packets, delay):
    way, now = Way(1), 0.0
    way.link = Link(delay=delay, held=True)
    for pause, packet in packets:
        now += pause
        way.put(packet, now)
        assert way.due() == math.inf and not way.take(now + 10.0)
    way.link = Link(delay=delay)
    assert way.take(now + delay) == [packet for _, packet in packets]


@given(st.floats(-1.0, 2.0), st.sampled_from(["loss", "reordered", "duplicated"]))
def test_fractions_are_between_0_and_1(fraction, name):
    assume(not 0.0 <= fraction <= 1.0)
    with pytest.raises(ValueError):
        Link(**{name: fraction})


@pytest.mark.parametrize(
    "fields", [{"jitter": 0.1}, {"delay": -0.1}, {"delay": math.nan}, {"rate": 0.0}, {"queue": 0.0}]
)
def test_a_link_that_cannot_be_is_refused(fields):
    with pytest.raises(ValueError):
        Link(**fields)


def test_the_conditions_last_longer_than_a_cell():
    for name, condition in CONDITIONS.items():
        assert sum(seconds for seconds, _ in condition.phases) >= 60.0, name


def header_sum(packet):
    """Returns the one's complement sum over the header, and over the addresses and all behind them: what TCP sums."""

    def fold(data):
        data += bytes(len(data) % 2)
        total = sum(int.from_bytes(data[k : k + 2], "big") for k in range(0, len(data), 2))
        return total % 0xFFFF

    return fold(packet[: 4 * (packet[0] & 0x0F)]), fold(packet[12:])


@given(st.integers(5, 15), st.binary(min_size=60, max_size=1500), st.sampled_from([6, 17, 1]))
def test_a_packet_comes_back_with_its_sums_its_content_and_in_its_direction(words, data, protocol):
    packet = bytes([0x40 | words]) + data[:8] + bytes([protocol]) + data[9:] + bytes(4)
    back = exchanged(packet)
    assert header_sum(back) == header_sum(packet)
    assert exchanged(back) == packet and back[20:] == packet[20:] and back[:12] == packet[:12]
    assert direction(back) == direction(packet)
    h = 4 * words
    answer = packet[:h] + packet[h + 2 : h + 4] + packet[h : h + 2] + packet[h + 4 :]
    if protocol != 1 and packet[h : h + 2] != packet[h + 2 : h + 4]:
        assert {direction(packet), direction(answer)} == {0, 1}


@pytest.mark.parametrize("packet", [b"", b"\x45", bytes([0x60]) + bytes(40)])
def test_what_is_not_ipv4_does_not_pass(packet):
    assert direction(packet) is None


CONVERSATION = """
import socket, threading
from campaign.network.link import Link
from campaign.network.wire import Wire
sent = bytes(range(250)) * 400
for name in ("arm", "ros"):
    with Wire(name) as wire, socket.create_server((wire.near, 0)) as server:
        wire.set(Link(delay=0.002, jitter=0.002, loss=0.02, reordered=0.1, duplicated=0.1))
        def echo():
            with server.accept()[0] as peer:
                while data := peer.recv(65536):
                    peer.sendall(data)
        threading.Thread(target=echo, daemon=True).start()
        with socket.create_connection((wire.far, server.getsockname()[1]), 20.0) as client:
            threading.Thread(target=client.sendall, args=(sent,), daemon=True).start()
            came = b""
            while len(came) < len(sent):
                came += client.recv(65536)
        counts = wire.set(Link())
        assert came == sent and counts["lost"] > 0 and counts["packets"] > 140, counts
print("whole")
"""


@pytest.mark.real
def test_tcp_gets_everything_through_a_bad_link():
    command = in_own_network([sys.executable, "-c", "from campaign.network.wire import Wire; Wire('arm').close()"])
    if subprocess.run(command, cwd=ROOT, capture_output=True, timeout=240.0).returncode:
        pytest.skip("this machine lets nobody make a network device")
    command = in_own_network([sys.executable, "-c", CONVERSATION])
    assert subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240.0).stdout == "whole\n"
