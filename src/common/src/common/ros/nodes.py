"""Which nodes of the graph run: the master still lists those that were killed."""

from __future__ import annotations

import socket
from urllib.parse import urlparse

ANSWER_S = 3.0
"""Longest wait for an answer [s]."""


def listens(uri: str) -> bool:
    """Returns whether somebody listens at a node's address, `http://host:port/`."""
    try:
        address = urlparse(uri)
        with socket.create_connection((address.hostname, address.port), ANSWER_S):
            return True
    except (OSError, TypeError, ValueError):  # no listener, no address, no port
        return False
