"""Who may drive the robot over the network: whoever knows the code that stands on the rig's terminal.

A code is good for one headset, which gets a key for when its connection is lost; the next headset needs the next code.
"""

from __future__ import annotations

import hmac
import secrets

from leap_motion.service.access import AccessCode

DIGITS = 8


class Access:
    """The present code, and the keys of those who were admitted. Wrong codes make their address wait."""

    def __init__(self) -> None:
        self._keys: set[str] = set()
        self._check = AccessCode(_new())

    @property
    def code(self) -> str:
        return self._check.code

    def wait(self, address: str, now: float) -> float:
        """Returns how long no code of an address is compared yet [s]."""
        return self._check.wait(address, now)

    def admit(self, secret: object, address: str, now: float) -> str | None:
        """Returns the key of a page that sent the code or its key; None for one that sent neither.

        Who is admitted by the code makes it void: `code` is then another one. A key, which nobody guesses, is good
        while its address waits.
        """
        text = secret if isinstance(secret, str) else ""
        for key in self._keys:
            if hmac.compare_digest(text.encode("utf-8", "replace"), key.encode()):
                return key
        if not self._check.accepts(text, address, now):
            return None
        self._check.code = _new()
        key = secrets.token_urlsafe(16)
        self._keys.add(key)
        return key


def _new() -> str:
    return f"{secrets.randbelow(10**DIGITS):0{DIGITS}d}"
