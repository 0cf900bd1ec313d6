"""The socket: options, framing on a real stream, and every way in which a link ends."""

import socket
import threading
import time

import pytest

from kst.codec import ReplyKind
from kst.errors import ConnectionLost, NoServer
from kst.transport import KstTransport

pytestmark = pytest.mark.clock


@pytest.fixture
def link():
    """A transport and the other end of its connection."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        transport = KstTransport.connect("127.0.0.1", listener.getsockname()[1], 5.0)
        peer, _ = listener.accept()
    peer.settimeout(10.0)
    with peer:
        yield transport, peer
    transport.close()


def soon(seconds=10.0):
    return time.monotonic() + seconds


def test_small_packets_leave_at_once_and_dead_peers_are_noticed(link):
    option = link[0]._socket.getsockopt
    assert option(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    assert option(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    assert 0 < option(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) <= 5000
    assert option(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) <= 5


def test_a_reply_in_pieces_and_two_in_one(link):
    transport, peer = link
    peer.sendall(b"do")
    assert transport.receive(soon(0.05)) is None
    peer.sendall(b"ne\nnak\n")
    assert transport.receive(soon()).kind is ReplyKind.DONE
    assert transport.receive(soon()).kind is ReplyKind.NAK
    assert transport.waiting() == []


def test_what_waits_is_taken_without_waiting(link, wait_until):
    transport, peer = link
    assert transport.waiting() == []
    peer.sendall(b"1\n\n")
    assert wait_until(transport.waiting, 10.0, "the reply")[0].kind is ReplyKind.PIN


@pytest.mark.parametrize("reset", [False, True])
def test_the_last_words_before_an_end_are_heard(link, reset, server_end):
    transport, peer = link
    peer.sendall(b"done\n")
    assert transport.receive(soon()).kind is ReplyKind.DONE
    server_end(peer, reset)
    with pytest.raises(ConnectionLost):
        transport.receive(soon())
    assert transport.ended_by_peer
    with pytest.raises(ConnectionLost):
        transport.send("end", 1.0)


@pytest.fixture
def server_end():
    def end(peer, reset):
        if reset:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        peer.close()

    return end


def test_a_peer_that_takes_nothing_does_not_block(link):
    transport, _ = link
    with pytest.raises(ConnectionLost):
        for _ in range(100_000):
            transport.send("x" * 1000, 0.1)


def test_abort_wakes_a_waiting_call(link):
    transport, peer = link
    threading.Timer(0.1, transport.abort).start()
    with pytest.raises(ConnectionLost):
        transport.receive(soon(30.0))
    assert peer.recv(10) == b""
    with pytest.raises(ConnectionLost):
        transport.pause(30.0)


def test_use_after_close(link):
    transport, _ = link
    transport.close()
    transport.abort()
    for use in (transport.waiting, lambda: transport.receive(soon()), lambda: transport.send("end", 1.0)):
        with pytest.raises(ConnectionLost):
            use()


@pytest.mark.parametrize("host", ["127.0.0.1", "no such host.invalid"])
def test_nobody_there(host, free_port):
    port = free_port()
    with pytest.raises(NoServer) as caught:
        KstTransport.connect(host, port, 5.0)
    assert caught.value.address == f"{host}:{port}"


def test_a_connection_that_met_only_itself_is_no_server(monkeypatch):
    def create_connection(*_):
        itself = socket.socket()
        itself.bind(("127.0.0.1", 0))
        itself.connect(itself.getsockname())
        return itself

    monkeypatch.setattr(socket, "create_connection", create_connection)
    with pytest.raises(NoServer):
        KstTransport.connect("127.0.0.1", 30001, 5.0)
