"""Service calls by the sockets of real nodes, and what the master knows of them."""

from __future__ import annotations

import socket
import threading
from types import SimpleNamespace

import pytest

pytest.importorskip("rig_msgs.srv")
import rospy
import rospy.impl.tcpros_base as tcpros
from std_srvs.srv import SetBool, SetBoolResponse, Trigger

from common.ros import service_calls
from common.ros.service_calls import MasterLost, ServiceAbsent, ServiceClient, ServiceFailed, call, listens

pytestmark = pytest.mark.ros


@pytest.fixture
def offer():
    services = []

    def start(name, handler):
        services.append(rospy.Service(name, SetBool, handler))
        return services[-1]

    yield start
    for service in services:
        service.shutdown()


@pytest.mark.real
def test_services_of_real_nodes(ros, offer, monkeypatch, free_port):
    """One that is absent, one that fails, and one that is called without the master, as its address is known."""

    def fail(_request):
        raise ValueError("no arm")

    client = ServiceClient("fails", SetBool)
    with pytest.raises(ServiceAbsent):
        client(True, timeout=60.0)
    with pytest.raises(ServiceAbsent):
        call("fails", SetBool, True, timeout=60.0, wait=0.2)
    service = offer("fails", fail)
    client.look_up()
    with pytest.raises(ServiceFailed, match="no arm") as caught:
        client(True, timeout=60.0)
    assert caught.value.sent
    with pytest.raises(ServiceAbsent, match="md5sum"):
        call("fails", Trigger, timeout=60.0)
    service.shutdown()
    with pytest.raises(ServiceAbsent):
        client(True, timeout=60.0)

    offer("known", lambda request: SetBoolResponse(request.data, ""))
    client = ServiceClient("known", SetBool)
    client.look_up()
    monkeypatch.setenv("ROS_MASTER_URI", f"http://localhost:{free_port()}")
    assert client(True, timeout=60.0).success
    with pytest.raises(MasterLost):
        client.look_up()
    with pytest.raises(ServiceAbsent):
        call("known", SetBool, True, timeout=60.0)


@pytest.fixture
def hanging(monkeypatch):
    """A client of a node that accepts connections and says nothing, and that node's socket."""
    monkeypatch.setattr(tcpros, "rospywarn", lambda *_: None)
    monkeypatch.setattr(tcpros, "_is_use_tcp_keepalive", lambda: False)
    monkeypatch.setattr(service_calls, "ask_master", lambda *_: None)
    with socket.create_server(("127.0.0.1", 0)) as node:
        client = service_calls.ServiceClient("hangs", SetBool)
        client._address = node.getsockname()
        yield client, node


def attempts():
    return [thread for thread in threading.enumerate() if thread.name == "hangs"]


@pytest.mark.real
def test_a_node_that_hangs_costs_one_thread_at_most_and_never_executes_what_was_given_up(hanging, monkeypatch):
    """The handshake is not answered, as by a suspended process; then the node continues."""
    client, node = hanging
    uri = f"http://127.0.0.1:{node.getsockname()[1]}/"
    assert listens(uri)
    node.accept()[0].close()
    monkeypatch.setattr(service_calls, "HANDSHAKE_TIMEOUT_S", 60.0)
    for timeout in (0.5, 0.05, 0.05):
        with pytest.raises(ServiceFailed) as caught:
            client(True, timeout=timeout)
        assert not caught.value.sent and type(caught.value) is ServiceFailed
        assert len(attempts()) == 1
    connection, _ = node.accept()
    with connection:
        connection.settimeout(60.0)
        assert b"service=/hangs" in connection.recv(4096)
        header = b"".join(len(f).to_bytes(4, "little") + f for f in (b"md5sum=*", b"type=*"))
        connection.sendall(len(header).to_bytes(4, "little") + header)
        assert connection.recv(4096) == b"", "closed without a request"
    for thread in attempts():
        thread.join(60.0)

    monkeypatch.setattr(service_calls, "HANDSHAKE_TIMEOUT_S", 0.1)
    with pytest.raises(ServiceFailed, match="did not answer the handshake within 0.1 s") as caught:
        client(True, timeout=60.0)
    assert type(caught.value) is ServiceFailed
    for thread in attempts():
        thread.join(60.0)
    assert not attempts()
    node.close()
    assert not listens(uri)


@pytest.mark.real
def test_a_call_that_is_given_up_after_the_request_ends(monkeypatch):
    here, there = socket.socketpair()
    sent, response = threading.Event(), service_calls._Attempt.response
    client = service_calls.ServiceClient("hangs", SetBool)
    client._address = "nowhere", 0

    def send(proxy, _):
        sent.set()
        return proxy.transport.socket.recv(1)

    def response_once_sent(attempt, timeout):
        sent.wait(60.0)
        return response(attempt, timeout)

    monkeypatch.setattr(service_calls, "_connection", lambda *_: SimpleNamespace(socket=here, close=here.close))
    monkeypatch.setattr(service_calls.rospy.ServiceProxy, "call", send)
    monkeypatch.setattr(service_calls._Attempt, "response", response_once_sent)
    with here, there:
        with pytest.raises(service_calls.ServiceFailed) as caught:
            client(True, timeout=0.01)
        assert caught.value.sent
        for thread in attempts():
            thread.join(60.0)
        assert not attempts()


@pytest.mark.parametrize("uri", ["", "http://", "http://127.0.0.1:port/", "nonsense"])
def test_what_is_no_address_does_not_listen(uri):
    assert not listens(uri)
