"""What the two processes of the bridge send each other: frames of a length, the number of a channel, and bytes."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

from common.errors import RigError

HEADER = struct.Struct("<IH")
MAX_BODY = 2**25  # bytes: more than any image
READ_BYTES = 2**16


class BridgeFault(RigError):
    """What came is no frame, or ended within one; the text is one sentence."""


def packed(channel: int, body: bytes) -> bytes:
    """Returns a frame; raises BridgeFault if it would be too large."""
    if len(body) > MAX_BODY:
        raise BridgeFault(f"A message of {len(body)} bytes is larger than {MAX_BODY}, so it is not passed on.")
    return HEADER.pack(len(body), channel) + body


def frames(receive: Callable[[int], bytes]) -> Iterator[tuple[int, bytes]]:
    """Yields channel and body of each frame until `receive`, which returns at most so many bytes, returns none. Raises
    BridgeFault."""
    waiting = bytearray()
    while data := receive(READ_BYTES):
        waiting += data
        while len(waiting) >= HEADER.size:
            length, channel = HEADER.unpack_from(waiting)
            if length > MAX_BODY:
                raise BridgeFault(f"A frame claims {length} bytes, more than {MAX_BODY}: the other side is not ours.")
            end = HEADER.size + length
            if len(waiting) < end:
                break
            body = bytes(waiting[HEADER.size : end])
            del waiting[:end]
            yield channel, body
    if waiting:
        raise BridgeFault(f"The other side ended within a frame, after {len(waiting)} bytes of it.")
