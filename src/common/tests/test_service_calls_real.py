"""Service calls by the sockets of real nodes, and what the master knows of them."""

from __future__ import annotations

import socket

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.clock]


@pytest.fixture
def offer():
    import rospy
    from std_srvs.srv import SetBool

    services = []

    def start(name, handler):
        services.append(rospy.Service(name, SetBool, handler))
        return services[-1]

    yield start
    for service in services:
        service.shutdown()


def test_a_service_that_fails_or_is_absent(ros, offer):
    from std_srvs.srv import SetBool, Trigger

    from common.ros.service_calls import ServiceAbsent, ServiceClient, ServiceFailed, call

    def fail(_request):
        raise ValueError("no arm")

    client = ServiceClient("fails", SetBool)
    with pytest.raises(ServiceAbsent):
        client(True, timeout=30.0)
    with pytest.raises(ServiceAbsent):
        call("fails", SetBool, True, timeout=30.0, wait=0.2)
    service = offer("fails", fail)
    client.look_up()
    with pytest.raises(ServiceFailed, match="no arm") as caught:
        client(True, timeout=30.0)
    assert caught.value.sent
    with pytest.raises(ServiceAbsent, match="md5sum"):
        call("fails", Trigger, timeout=30.0)
    service.shutdown()
    with pytest.raises(ServiceAbsent):
        client(True, timeout=30.0)


def test_a_known_service_is_called_without_the_master(ros, offer, monkeypatch, free_port):
    from std_srvs.srv import SetBool, SetBoolResponse

    from common.ros.service_calls import MasterLost, ServiceAbsent, ServiceClient, call

    offer("known", lambda request: SetBoolResponse(request.data, ""))
    client = ServiceClient("known", SetBool)
    client.look_up()
    monkeypatch.setenv("ROS_MASTER_URI", f"http://localhost:{free_port()}")
    assert client(True, timeout=30.0).success
    with pytest.raises(MasterLost):
        client.look_up()
    with pytest.raises(ServiceAbsent):
        call("known", SetBool, True, timeout=30.0)


def test_a_node_that_hangs_never_executes_a_call_that_was_given_up(ros):
    """The handshake is never answered, as by a suspended process; then the node continues."""
    from std_srvs.srv import SetBool

    from common.ros.service_calls import ServiceClient, ServiceFailed

    with socket.create_server(("127.0.0.1", 0)) as node:
        client = ServiceClient("hangs", SetBool)
        client._address = node.getsockname()
        with pytest.raises(ServiceFailed) as caught:
            client(True, timeout=0.5)
        assert not caught.value.sent
        connection, _ = node.accept()
        with connection:
            connection.settimeout(30.0)
            assert b"service=/hangs" in connection.recv(4096)
            header = b"".join(len(f).to_bytes(4, "little") + f for f in (b"md5sum=*", b"type=*"))
            connection.sendall(len(header).to_bytes(4, "little") + header)
            assert connection.recv(4096) == b"", "closed without a request"


def test_listens():
    from common.ros.service_calls import listens

    with socket.create_server(("127.0.0.1", 0)) as server:
        uri = f"http://127.0.0.1:{server.getsockname()[1]}/"
        assert listens(uri)
    assert not listens(uri)


@pytest.mark.parametrize("uri", ["", "http://", "http://127.0.0.1:port/", "nonsense"])
def test_what_is_no_address_does_not_listen(uri):
    from common.ros.service_calls import listens

    assert not listens(uri)
