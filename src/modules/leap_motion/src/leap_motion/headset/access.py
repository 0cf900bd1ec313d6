"""Who may drive the robot over the network: whoever knows the code that stands on the rig's terminal.

A code is good for one headset, which gets a key for when its connection is lost; the next headset needs the next code.
"""

from __future__ import annotations

import hmac
import secrets

from leap_motion.service.server import AccessCode

DIGITS = 6


class Access:
    """The present `code`, and the keys of those who were admitted. After some wrong codes in a row none is right."""

    def __init__(self) -> None:
        self._keys: set[str] = set()
        self._renew()

    def admit(self, secret: object) -> str | None:
        """Returns the key of a page that sent the code or its key; None for one that sent neither.

        Who is admitted by the code makes it void: `code` is then another one.
        """
        text = secret if isinstance(secret, str) else ""
        for key in self._keys:
            if hmac.compare_digest(text.encode("utf-8", "replace"), key.encode()):
                return key
        if not self._check.accepts(text):
            return None
        self._renew()
        key = secrets.token_urlsafe(16)
        self._keys.add(key)
        return key

    def _renew(self) -> None:
        self.code = f"{secrets.randbelow(10**DIGITS):0{DIGITS}d}"
        self._check = AccessCode(self.code)
