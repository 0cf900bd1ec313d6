"""Client against a WebSocket server of another implementation on a free port of loopback."""

import contextlib
import json
import threading

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

from leap_motion import client as client_module
from leap_motion import transport
from leap_motion.client import LeapClient, LeapLink

pytestmark = pytest.mark.clock

LONG_S = 60.0
WAITS = ((transport, "OPEN_TIMEOUT_S"), (client_module, "HEADER_TIMEOUT_S"), (client_module, "PING_S"))
"""Waits of the client: service and client may get no processor for long, which is no fault of the service."""
HEADER = '{"version":6,"serviceVersion":"2.3.1+33747"}'
POLICIES = ['{"background":true}', '{"optimizeHMD":false}', '{"focused":true}']


def frame(number):
    return json.dumps({"id": number, "timestamp": number * 8650, "hands": [], "pointables": []})


@pytest.fixture
def start(monkeypatch):
    """Starts a service that runs the function for each connection, and a client of it; both end with the test."""
    for module, name in WAITS:
        monkeypatch.setattr(module, name, LONG_S)
    ends = []

    def start(talk):
        def handle(connection):
            with contextlib.suppress(ConnectionClosed):
                talk(connection)

        server = serve(handle, "127.0.0.1", 0)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        client = LeapClient(port=server.socket.getsockname()[1])
        ends.extend([client.close, server.shutdown])
        return client

    yield start
    for end in ends:
        end()


def test_requests_policies_frames_and_the_next_connection(start, wait_until):
    heard = []

    def talk(connection):
        heard.append(connection.request.path)
        connection.send(HEADER)
        heard.extend(connection.recv(LONG_S) for _ in range(3))
        connection.send(frame(1 if len(heard) == 4 else 2))
        connection.close(1001)

    client = start(talk)
    wait_until(lambda: (got := client.next_frame(0.2)) and got.frame.id == 2, 10.0, "the second connection")
    assert heard[:8] == ["/v6.json", *POLICIES] * 2 and client.status.service == "2.3.1+33747"


def test_close_with_unread_messages_ends(start, wait_until):
    def floods(connection):
        connection.send(HEADER)
        for number in range(10**9):
            connection.send(frame(number))

    client = start(floods)
    wait_until(lambda: client.counts.received > 100, 10.0, "a flood")
    client.close()
    assert client.status.link is LeapLink.CLOSED
