"""TCP in virtual time: who waits is woken by whatever ends the wait, and a killed program says nothing more."""

from __future__ import annotations

import math

import pytest

import kst.transport
from common import clock
from simulated.wires import virtual_wires


@pytest.fixture
def pair():
    """A connection in virtual time: its wires, the near and the far end."""
    with virtual_wires() as wires:
        listener = kst.transport.socket.socket()
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        near = kst.transport.socket.create_connection(listener.getsockname(), 1.0)
        far, _ = listener.accept()
        yield wires, near, far


def test_the_end_of_a_stall_wakes_a_reader(pair):
    wires, near, far = pair
    heard = []

    def read():
        heard.append((far.recv(10), clock.monotonic()))

    wires.connections[-1].up.stalls = [(clock.monotonic(), math.inf)]
    near.send(b"late")
    clock.Thread(target=read, daemon=True).start()
    clock.sleep(1.0)
    assert not heard
    wires.connections[-1].up.stalls = []
    clock.sleep(0.01)
    assert heard == [(b"late", pytest.approx(clock.monotonic() - 0.01, abs=1e-3))]


def test_room_wakes_a_writer(pair):
    wires, near, _ = pair
    near.settimeout(None)
    wires.connections[-1].up.room = 3
    assert near.send(b"123456") == 3
    sent = []
    clock.Thread(target=lambda: sent.append(near.send(b"456")), daemon=True).start()
    clock.sleep(1.0)
    assert not sent
    wires.connections[-1].up.room = math.inf
    clock.sleep(0.01)
    assert sent == [3]


@pytest.mark.parametrize("seed", range(20))
def test_all_who_wait_at_a_socket_are_woken(seed):
    with virtual_wires(seed):
        listener = kst.transport.socket.socket()
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        taken = []
        for _ in range(3):
            clock.Thread(target=lambda: taken.append(listener.accept()), daemon=True).start()
        clock.sleep(0.1)
        ends = [kst.transport.socket.create_connection(listener.getsockname(), 1.0) for _ in range(3)]
        clock.sleep(0.1)
        assert len(taken) == len(ends)
