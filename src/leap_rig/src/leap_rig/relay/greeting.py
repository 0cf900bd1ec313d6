"""How a relay and a rig prove to each other that they have the same key, which is not sent, and what follows. Each of
the rig's WebSockets carries one connection of a browser, so that none waits for the packets of another:

message    from   bytes
---------  -----  ----------------------------------------------------------------------------------------------
challenge  relay  MAGIC, the relay's nonce
answer     rig    number of the rig's run, the rig's nonce, HMAC-SHA-256 of MAGIC, "rig", run and both nonces
proof      relay  HMAC-SHA-256 of MAGIC, "relay", run and both nonces
opening    relay  3 bytes that stand for the browser's address, name of the page in ASCII
data       both   what the connection carries, CHUNK bytes at most; no bytes: this direction ends

Nonces are new for each WebSocket, so an answer is good for it alone; and as the two roles have different texts, it
cannot be sent back as the proof."""

from __future__ import annotations

import hashlib
import hmac
import re
from typing import NamedTuple

from common.errors import RigError

MAGIC = b"leap-rig relay 1\n"
NONCE, RUN, MAC, VISITOR = 32, 16, 32, 3  # bytes
CHUNK = 2**14  # bytes
SHORTEST_KEY = 32  # bytes
NAME = re.compile(rb"[a-z][a-z0-9-]{0,30}")


class RelayFault(RigError):
    """What came is not from a relay or rig with our key; the text is one sentence."""


class PageRequest(NamedTuple):
    """A browser asks for a page."""

    visitor: bytes
    page: str


def challenge(relay_nonce: bytes) -> bytes:
    """Returns the relay's first message."""
    return MAGIC + relay_nonce


def answer(key: bytes, message: object, run: bytes, rig_nonce: bytes) -> tuple[bytes, bytes]:
    """Returns the rig's answer to a challenge, and the proof that is then due; raises RelayFault for no challenge."""
    if not isinstance(message, bytes) or len(message) != len(MAGIC) + NONCE or not message.startswith(MAGIC):
        raise RelayFault("What answers there is no relay of this version.")
    nonces = message[len(MAGIC) :] + rig_nonce
    return run + rig_nonce + _mac(key, b"rig", run + nonces), _mac(key, b"relay", run + nonces)


def proof(key: bytes, message: object, relay_nonce: bytes) -> tuple[bytes, bytes]:
    """Returns the run of the rig that sent an answer, and the relay's proof; raises RelayFault for another key."""
    if not isinstance(message, bytes) or len(message) != RUN + NONCE + MAC:
        raise RelayFault("A rig sent no answer to the challenge.")
    run, rig_nonce = message[:RUN], message[RUN : RUN + NONCE]
    if not hmac.compare_digest(message[RUN + NONCE :], _mac(key, b"rig", run + relay_nonce + rig_nonce)):
        raise RelayFault("A rig has another key.")
    return run, _mac(key, b"relay", run + relay_nonce + rig_nonce)


def check_proof(message: object, due: bytes) -> None:
    """Raises RelayFault if the relay's proof is not the one that is due."""
    if not isinstance(message, bytes) or not hmac.compare_digest(message, due):
        raise RelayFault("The relay has another key.")


def opening(visitor: bytes, page: str) -> bytes:
    """Returns the message that asks for a page."""
    return visitor + page.encode("ascii")


def read_opening(message: object) -> PageRequest:
    """Returns what the relay asks for; raises RelayFault for no such message."""
    if not isinstance(message, bytes) or not NAME.fullmatch(message[VISITOR:]):
        raise RelayFault("The relay sent no name of a page.")
    return PageRequest(message[:VISITOR], message[VISITOR:].decode("ascii"))


def local_address(visitor: bytes) -> str:
    """Returns the loopback address that stands for a browser's machine at the page's server, whose limits and waits
    are those of an address."""
    first, second, third = visitor
    return f"127.{128 | first}.{second}.{1 + third % 254}"


def _mac(key: bytes, role: bytes, text: bytes) -> bytes:
    return hmac.new(key, MAGIC + role + b"\n" + text, hashlib.sha256).digest()
