"""Messages to bytes."""

from __future__ import annotations

import io

import genpy


def bytes_of(message: genpy.Message) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()
