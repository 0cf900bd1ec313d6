"""Leap services and their clients in virtual time."""

import pytest


@pytest.fixture
def wires():
    """Sockets in memory, in virtual time."""
    from simulated.wires import virtual_wires

    with virtual_wires() as wires:
        yield wires
