"""A node that hangs costs a client one thread and one socket at most, however often it is asked."""

from __future__ import annotations

import socket
import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")
from std_srvs.srv import SetBool

from common.ros import service_calls
from common.ros.service_calls import ServiceClient, ServiceFailed

pytestmark = [pytest.mark.ros, pytest.mark.clock]


@pytest.fixture
def client(monkeypatch):
    """A client of a node that accepts connections and says nothing."""
    import rospy.impl.tcpros_base as tcpros

    monkeypatch.setattr(tcpros, "rospywarn", lambda *_: None)
    monkeypatch.setattr(tcpros, "_is_use_tcp_keepalive", lambda: False)
    monkeypatch.setattr(service_calls, "ask_master", lambda *_: None)
    with socket.create_server(("127.0.0.1", 0)) as node:
        made = ServiceClient("hangs", SetBool)
        made._address = node.getsockname()
        yield made


def attempts():
    return [thread for thread in threading.enumerate() if thread.name == "hangs"]


def test_no_second_call_while_the_first_waits_for_the_handshake(client, monkeypatch):
    monkeypatch.setattr(service_calls, "HANDSHAKE_TIMEOUT_S", 60.0)
    for _ in range(5):
        with pytest.raises(ServiceFailed) as caught:
            client(True, timeout=0.05)
        assert not caught.value.sent and type(caught.value) is ServiceFailed
        assert len(attempts()) == 1


def test_the_handshake_is_given_up_and_is_no_absence(client, monkeypatch):
    monkeypatch.setattr(service_calls, "HANDSHAKE_TIMEOUT_S", 0.1)
    with pytest.raises(ServiceFailed, match="did not answer the handshake within 0.1 s") as caught:
        client(True, timeout=20.0)
    assert type(caught.value) is ServiceFailed
    for thread in attempts():
        thread.join(20.0)
    assert not attempts()


def test_a_call_that_is_given_up_after_the_request_ends(client, monkeypatch):
    here, there = socket.socketpair()
    sent, response = threading.Event(), service_calls._Attempt.response

    def connection(proxy, address):
        return SimpleNamespace(socket=here, close=here.close)

    def send(proxy, _):
        sent.set()
        return proxy.transport.socket.recv(1)

    def response_once_sent(attempt, timeout):
        sent.wait(30.0)
        return response(attempt, timeout)

    monkeypatch.setattr(service_calls, "_connection", connection)
    monkeypatch.setattr(service_calls.rospy.ServiceProxy, "call", send)
    monkeypatch.setattr(service_calls._Attempt, "response", response_once_sent)
    with here, there:
        with pytest.raises(ServiceFailed) as caught:
            client(True, timeout=0.2)
        assert caught.value.sent
        end = time.monotonic() + 20.0
        while attempts() and time.monotonic() < end:
            time.sleep(0.01)
        assert not attempts()
