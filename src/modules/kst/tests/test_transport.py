"""The socket: framing, and every way in which a link ends, on wires; options and a reset by a real one."""

import contextlib
import socket
import struct
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from common import clock
from kst.codec import ReplyKind
from kst.errors import ConnectionLost, NoServer
from kst.transport import LEAP_RIG, TOOLBOX, KstTransport
from simulated.wires import DELAY_S

RESET = (socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


@contextlib.contextmanager
def connected(listener):
    """A transport and the other end of its connection."""
    transport = KstTransport.connect(*listener.getsockname(), 5.0)
    peer, _ = listener.accept()
    yield transport, peer
    peer.close()
    transport.close()


@pytest.fixture
def link(wires):
    """A transport and the other end of its connection, on wires."""
    with connected(wires.serve(("127.0.0.1", 0))) as link:
        yield link


@pytest.fixture
def real_link():
    """A transport and the other end of its connection, on real sockets."""
    with socket.create_server(("127.0.0.1", 0)) as listener, connected(listener) as link:
        yield link


def soon(seconds=10.0):
    return clock.monotonic() + seconds


def test_a_reply_in_pieces_and_two_in_one(link, takes):
    transport, peer = link
    peer.sendall(b"do")
    with takes(0.05):
        assert transport.receive(soon(0.05)) is None
    peer.sendall(b"ne\nnak\n")
    assert transport.receive(soon()).kind is ReplyKind.DONE
    assert transport.receive(soon()).kind is ReplyKind.NAK
    assert transport.waiting() == []


def test_what_waits_is_taken_without_waiting(link):
    transport, peer = link
    peer.sendall(b"1\n\n")
    assert transport.waiting() == []
    clock.sleep(DELAY_S)
    assert transport.waiting()[0].kind is ReplyKind.PIN


@pytest.mark.parametrize("reset", [False, True])
def test_the_last_words_before_an_end_are_heard(link, reset):
    ends(*link, reset)


@pytest.mark.real
@pytest.mark.parametrize("reset", [False, True])
def test_on_a_real_socket_packets_leave_at_once_dead_peers_are_noticed_and_ends_too(real_link, reset):
    option = real_link[0]._socket.getsockopt
    assert option(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    assert option(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    assert 0 < option(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) <= 5000
    assert option(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) <= 5
    ends(*real_link, reset)


def ends(transport, peer, reset):
    peer.sendall(b"done\n")
    assert transport.receive(soon(60.0)).kind is ReplyKind.DONE
    if reset:
        peer.setsockopt(*RESET)
    peer.close()
    with pytest.raises(ConnectionLost):
        transport.receive(soon(60.0))
    assert transport.ended_by_peer
    with pytest.raises(ConnectionLost):
        transport.send("end", 1.0)


def test_a_peer_that_takes_nothing_does_not_block(link, takes):
    transport, peer = link
    peer.incoming.room = 4000
    for _ in range(3):
        transport.send("x" * 1000, 0.5)
    clock.Timer(0.2, peer.recv, [4000]).start()
    with takes(0.2):
        transport.send("x" * 2000, 0.5)
    transport.send("x" * 2000, 0.5)
    with takes(0.5), pytest.raises(ConnectionLost):
        transport.send("x" * 2000, 0.5)


def test_abort_wakes_a_waiting_call(link, takes):
    transport, peer = link
    clock.Timer(0.1, transport.abort).start()
    with takes(0.1), pytest.raises(ConnectionLost):
        transport.receive(soon(30.0))
    assert peer.recv(10) == b""
    with takes(0.0), pytest.raises(ConnectionLost):
        transport.pause(30.0)


def test_use_after_close(link):
    transport, _ = link
    transport.close()
    transport.abort()
    for use in (transport.waiting, lambda: transport.receive(soon()), lambda: transport.send("end", 1.0)):
        with pytest.raises(ConnectionLost):
            use()


def test_a_host_without_an_address(monkeypatch):
    def unknown(*_):
        raise socket.gaierror("Name or service not known")

    monkeypatch.setattr(socket, "create_connection", unknown)
    with pytest.raises(NoServer) as caught:
        KstTransport.connect("no such host", 30001, 5.0)
    assert caught.value.address == "no such host:30001"


@pytest.mark.parametrize(
    ("program", "absent"),
    [
        (
            TOOLBOX,
            "no toolbox server at .*: start MatlabToolboxServer on the smartPad .it waits 60 s for a client. and",
        ),
        (LEAP_RIG, "no robot application at .*: start LeapRigServer on the smartPad and check cable and address"),
    ],
)
def test_what_is_to_be_started_is_named(monkeypatch, program, absent):
    monkeypatch.setattr(socket, "create_connection", Mock(side_effect=ConnectionRefusedError("Connection refused")))
    with pytest.raises(NoServer, match=absent):
        KstTransport.connect("127.0.0.1", 30001, 5.0, program)


def test_a_connection_that_met_only_itself_is_no_server(monkeypatch):
    closed = []
    here = lambda: ("127.0.0.1", 30001)  # noqa: E731
    itself = SimpleNamespace(getsockname=here, getpeername=here, close=lambda: closed.append(True))
    monkeypatch.setattr(socket, "create_connection", lambda *_: itself)
    with pytest.raises(NoServer):
        KstTransport.connect("127.0.0.1", 30001, 5.0)
    assert closed
