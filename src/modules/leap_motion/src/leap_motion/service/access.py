"""Who may connect over the network: how many at once, by which name of this computer, and with which code. Not for
several threads."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
import secrets
from collections import Counter
from collections.abc import Iterable
from urllib.parse import urlsplit

FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 300.0  # of an address after its first wrong code, and after many
REMEMBERED_S = 3600.0  # an address that sent no wrong code for so long starts anew
MAX_ADDRESSES = 1000  # that are remembered
CODE_DIGITS = 8  # of a code for a headset
HOST = re.compile(r"[\w.:%\[\]-]+", re.ASCII)
ORIGIN = re.compile(r"https?://([a-z0-9.-]+|\[[0-9a-f:]+\])(:\d+)?", re.ASCII)


class ConnectionLimits:
    """How many connections there may be: `total`, and `per_address` of one machine."""

    def __init__(self, total: int, per_address: int) -> None:
        self._total = total
        self._per_address = per_address
        self._of: Counter[str] = Counter()

    def enter(self, address: str) -> bool:
        """Counts a connection from an address; returns False, and does not count it, if there are too many."""
        machine = _machine(address)
        if sum(self._of.values()) >= self._total or self._of[machine] >= self._per_address:
            return False
        self._of[machine] += 1
        return True

    def leave(self, address: str) -> None:
        machine = _machine(address)
        self._of[machine] -= 1
        if not self._of[machine]:
            del self._of[machine]


class AccessCode:
    """The present `code`. Each wrong one makes its address wait, twice as long as the last one, LONGEST_WAIT_S at
    most; meanwhile nothing from there is compared. Other addresses do not wait. The same wrong code again, as from a
    program that reconnects, is no further guess."""

    def __init__(self, code: str) -> None:
        self.code = code
        self._wrong: dict[str, tuple[int, float, str]] = {}  # how many, until when [s], the last one's hash

    def wait(self, address: str, now: float) -> float:
        """Returns how long an address waits yet [s], 0 if it does not."""
        _, until, _ = self._wrong.get(_machine(address), (0, now, ""))
        return max(0.0, until - now)

    def accepts(self, given: str, address: str, now: float) -> bool:
        """Returns whether `given` is the code and `address` need not wait."""
        if self.wait(address, now) > 0.0:
            return False
        machine = _machine(address)
        count, until, last = self._wrong.pop(machine, (0, now, ""))
        if hmac.compare_digest(given.encode("utf-8", "replace"), self.code.encode()):
            return True
        if now - until > REMEMBERED_S:
            count = 0
        wait, guess = FIRST_WAIT_S, hashlib.sha256(given.encode("utf-8", "replace")).hexdigest()
        if guess != last:
            wait, count = min(FIRST_WAIT_S * 2.0 ** min(count, 30), LONGEST_WAIT_S), count + 1
        if len(self._wrong) >= MAX_ADDRESSES:
            del self._wrong[min(self._wrong, key=lambda each: self._wrong[each][1])]
        self._wrong[machine] = count, now + wait, guess
        return False


class HeadsetAccess:
    """Who may drive the robot over the network: whoever knows the code that stands on the rig's terminal. A code is
    good for one headset, which gets a key for when its connection is lost; the next one needs the next code."""

    def __init__(self) -> None:
        self._keys: set[str] = set()
        self._check = AccessCode(_new_code())

    @property
    def code(self) -> str:
        return self._check.code

    def wait(self, address: str, now: float) -> float:
        """Returns how long no code of an address is compared yet [s]."""
        return self._check.wait(address, now)

    def admit(self, secret: object, address: str, now: float) -> str | None:
        """Returns the key of a page that sent the code, which is void then, or its key; None for one that sent
        neither. A key, which nobody guesses, is good while its address waits."""
        text = secret if isinstance(secret, str) else ""
        for key in self._keys:
            if hmac.compare_digest(text.encode("utf-8", "replace"), key.encode()):
                return key
        if not self._check.accepts(text, address, now):
            return None
        self._check.code = _new_code()
        key = secrets.token_urlsafe(16)
        self._keys.add(key)
        return key


def _new_code() -> str:
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"


def is_loopback(host: str) -> bool:
    """Returns whether only this machine reaches an address, or an address is this machine's."""
    if host == "localhost":
        return True
    address = _ip(host)
    return address is not None and address.is_loopback


def is_own_host(host: str, arrived_at: str, names: Iterable[str] = ()) -> bool:
    """Returns whether the Host of a request names the address that it arrived at, or is one of `names`. Otherwise a
    page of another site has bound its own name to this address, to be taken for ours (DNS rebinding)."""
    name = hostname(f"//{host}") if HOST.fullmatch(host) else ""
    if name and name in {each.lower() for each in names}:
        return True
    if is_loopback(arrived_at):
        return is_loopback(name)
    address = _ip(name)
    return address is not None and address == _ip(arrived_at)


def origin_faults(public: str) -> list[str]:
    """Returns why a page cannot be shown under a public address, in sentences; it may be empty."""
    if not public or ORIGIN.fullmatch(public):
        return []
    return [f"The public address {public!r} is no origin such as https://rig.example.org, without a path."]


def is_host_of(host: str, origin: str) -> bool:
    """Returns whether the Host of a request is that of an origin, which may be empty."""
    return bool(origin) and host == origin.partition("://")[2]


def hostname(url: str) -> str:
    """Returns the host that a URL names, "" if it names none."""
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""


def _ip(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
    return getattr(address, "ipv4_mapped", None) or address


def _machine(address: str) -> str:
    """Returns an address in the one form that stands for its machine."""
    return str(_ip(address) or address)
