"""Cuts what arrives into lines as the server's line reader does."""

from __future__ import annotations

import re

MAX_LINE_BYTES = 65536
_END = re.compile(rb"\r\n|[\n\r]|\xc2\x85|\xe2\x80[\xa8\xa9]")


class JavaLineSplitter:
    """Collects bytes; lines end with LF, CR LF, a lone CR, NEL, LS or PS."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Returns the lines that the new bytes complete; empty ones are left out, since they mean nothing.

        Raises:
            ValueError: a line is longer than MAX_LINE_BYTES.
        """
        *lines, self._rest = _END.split(self._rest + data)
        if len(self._rest) > MAX_LINE_BYTES:
            raise ValueError(f"a line is longer than {MAX_LINE_BYTES} bytes")
        return [line.decode("utf-8", "replace") for line in lines if line]
