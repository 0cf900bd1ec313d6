"""Which nodes of the graph really run: the master still knows those that were killed."""

from __future__ import annotations

import socket
from urllib.parse import urlparse

ANSWER_S = 3.0
"""Longest wait for an answer [s]."""


def listens(uri: str) -> bool:
    """Returns whether somebody listens at an address such as the master tells of a node, `http://host:port/`."""
    try:
        address = urlparse(uri)
        with socket.create_connection((address.hostname, address.port), ANSWER_S):
            return True
    except (OSError, TypeError, ValueError):  # nobody there, no address, no port
        return False
