from __future__ import annotations

import socket
from pathlib import Path

import pytest

from simulated import ports


@pytest.mark.real
def test_a_free_port_can_be_opened_and_one_in_use_is_not_returned(monkeypatch):
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        with monkeypatch.context() as patch, socket.socket(socket.AF_INET, kind) as used:
            used.bind(("127.0.0.1", ports.free_port(kind)))
            port = used.getsockname()[1]
            patch.setattr(ports, "FIRST", port)
            patch.setattr(ports, "LAST", port)
            with pytest.raises(OSError):
                ports.free_port(kind)


def test_the_system_gives_none_of_them_away():
    file = Path("/proc/sys/net/ipv4/ip_local_port_range")
    if not file.exists():
        pytest.skip("the range is known on Linux only")
    assert int(file.read_text().split()[0]) > ports.LAST
