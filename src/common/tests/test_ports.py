from __future__ import annotations

import socket
from pathlib import Path

import pytest

from common import ports

pytestmark = pytest.mark.real

KINDS = [socket.SOCK_STREAM, socket.SOCK_DGRAM]


@pytest.mark.parametrize("kind", KINDS)
def test_the_port_can_be_opened(kind):
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", ports.free_port(kind)))


def test_the_system_gives_none_of_them_away():
    file = Path("/proc/sys/net/ipv4/ip_local_port_range")
    if not file.exists():
        pytest.skip("the range is known on Linux only")
    assert int(file.read_text().split()[0]) > ports.LAST


@pytest.mark.parametrize("kind", KINDS)
def test_a_port_in_use_is_not_returned(monkeypatch, kind):
    with socket.socket(socket.AF_INET, kind) as used:
        used.bind(("127.0.0.1", ports.free_port(kind)))
        port = used.getsockname()[1]
        monkeypatch.setattr(ports, "FIRST", port)
        monkeypatch.setattr(ports, "LAST", port)
        with pytest.raises(OSError):
            ports.free_port(kind)
