"""Who listens and who does not."""

import socket

import pytest

pytest.importorskip("rospy")


def test_listens():
    from common.ros.nodes import listens

    with socket.create_server(("127.0.0.1", 0)) as server:
        uri = f"http://127.0.0.1:{server.getsockname()[1]}/"
        assert listens(uri)
    assert not listens(uri)


@pytest.mark.parametrize("uri", ["", "http://", "http://127.0.0.1:port/", "nonsense"])
def test_what_is_no_address_does_not_listen(uri):
    from common.ros.nodes import listens

    assert not listens(uri)
