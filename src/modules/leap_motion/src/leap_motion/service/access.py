"""Who may connect over the network: how many at once, by which name of this computer, and with which code. Not for
several threads."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import math
import re
import secrets
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from urllib.parse import urlsplit

FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 300.0  # of an address after its first wrong code, and after many
REMEMBERED_S = 3600.0  # an address that sent no wrong code for so long starts anew
MAX_ADDRESSES = 1000  # that are remembered
CODE_DIGITS = 8  # of a code for a headset
MAX_GUESSES = 20  # wrong codes from all addresses, before there is a new one
CODE_S = 60.0  # so long at least a code stays
KEY_S = 12 * 3600.0  # a key expires after so long without use
MAX_KEYS = 32
HOST = re.compile(r"[\w.:%\[\]-]+", re.ASCII)
ORIGIN = re.compile(r"https?://([a-z0-9.-]+|\[[0-9a-f:]+\])(:\d+)?", re.ASCII)


@dataclass(eq=False)
class Place:
    """One of the places for connections: of which machine, how its connection is ended, since when [s], and whether it
    is kept."""

    machine: str
    end: Callable[[], None]
    since: float
    kept: bool = False


class ConnectionLimits:
    """How many connections there may be: `total`, and `per_address` of one machine, but for those that are kept. A kept
    one takes the place of the oldest other one if there is no room, and gives way to none. `newest_first`: any new one
    takes the place of the oldest that is not kept, of its own machine if that has too many. But each has `grace_s`, in
    which it gives way only to those from a machine that had a kept one: so a flood is refused, which costs little, and
    among it somebody may still come in and send the code."""

    def __init__(self, total: int, per_address: int, newest_first: bool = False, grace_s: float = 0.0) -> None:
        self._total, self._per_address, self._newest_first = total, per_address, newest_first
        self._grace_s = grace_s
        self._places: list[Place] = []  # the oldest first
        self._known: list[str] = []  # machines that had a kept place, the last one last

    def enter(self, address: str, end: Callable[[], None], kept: bool = False, now: float = 0.0) -> Place | None:
        """Returns the place of a new connection, None if there is no room. `end` ends it if it has to give way."""
        machine = _machine(address)
        others = [place for place in self._places if not place.kept]
        of_machine = [place for place in others if place.machine == machine]
        full = len(self._places) >= self._total
        if not kept and len(of_machine) >= self._per_address:
            full, others = True, of_machine
        if full:
            if machine not in self._known and not kept:
                others = [place for place in others if now - place.since >= self._grace_s]
            if not others or not (kept or self._newest_first):
                return None
            self.leave(others[0])
            others[0].end()
        place = Place(machine, end, now, kept)
        self._places.append(place)
        return place

    def leave(self, place: Place) -> None:
        """Makes room again, once a connection has ended; also of one that gave way."""
        if place in self._places:
            self._places.remove(place)
        if place.kept:
            known = [machine for machine in self._known if machine != place.machine]
            self._known = [*known[1 - MAX_KEYS :], place.machine]


class VisitLimits:
    """How many visits there may be in each `period_s`: `total`, and `per_address` of one machine."""

    def __init__(self, total: int, per_address: int, period_s: float = 1.0) -> None:
        self._total, self._per_address, self._period_s = total, per_address, period_s
        self._period = 0
        self._of: Counter[str] = Counter()

    def admit(self, address: str, now: float) -> bool:
        """Counts a visit at `now` [s]; returns False, and does not, if there were too many in this period."""
        machine, before, self._period = _machine(address), self._period, int(now / self._period_s)
        if self._period != before:
            self._of.clear()
        if self._of[machine] >= self._per_address or sum(self._of.values()) >= self._total:
            return False
        self._of[machine] += 1
        return True


class AccessCode:
    """The present `code`, and the `former` one, if it is good yet. Each wrong one makes its address wait, twice as long
    as the last one, LONGEST_WAIT_S at most; meanwhile nothing from there is compared. Other addresses do not wait. The
    same wrong code again, as from a program that reconnects, is no further guess. `guesses`: how many there were, from
    all addresses."""

    def __init__(self, code: str) -> None:
        self.code, self.former, self.guesses = code, "", 0
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
        for code in filter(None, (self.code, self.former)):
            if hmac.compare_digest(given.encode("utf-8", "replace"), code.encode()):
                return True
        if now - until > REMEMBERED_S:
            count = 0
        wait, guess = FIRST_WAIT_S, hashlib.sha256(given.encode("utf-8", "replace")).hexdigest()
        if guess != last:
            wait, count = min(FIRST_WAIT_S * 2.0 ** min(count, 30), LONGEST_WAIT_S), count + 1
            self.guesses += 1
        if len(self._wrong) >= MAX_ADDRESSES:
            del self._wrong[min(self._wrong, key=lambda each: self._wrong[each][1])]
        self._wrong[machine] = count, now + wait, guess
        return False


class HeadsetAccess:
    """Who may drive the robot over the network: whoever knows the code that stands on the rig's terminal. A code is
    good for one headset, which gets a key for when its connection is lost; the next one needs the next code. After
    MAX_GUESSES wrong codes there is a new one, too, but none within CODE_S of the last, which is good until the one
    after: somebody may be typing it.

    `ticket`, for pages with a key, admits to nothing: a connection to an address that ends with it has a kept place.
    There is a new one after the end of the last key."""

    def __init__(self) -> None:
        self._keys: dict[str, float] = {}  # when each was used [s]
        self._check, self._since, self._guessed = AccessCode(_new_code()), -math.inf, 0
        self.ticket = secrets.token_urlsafe(16)

    @property
    def code(self) -> str:
        return self._check.code

    def sentence(self, whose: str) -> str:
        """Returns the sentence for the terminal that has the code, for the next `whose`."""
        sentence = f"he code for the next {whose} is {self.code}."
        return f"There were {self._guessed} wrong codes, so t{sentence}" if self._guessed else f"T{sentence}"

    def has_ticket(self, path: str) -> bool:
        """Returns whether the address of a request ends with the ticket."""
        return hmac.compare_digest(path[-len(self.ticket) :].encode("utf-8", "replace"), self.ticket.encode())

    def wait(self, address: str, now: float) -> float:
        """Returns how long no code of an address is compared yet [s]."""
        return self._check.wait(address, now)

    def admit(self, secret: object, address: str, now: float) -> str | None:
        """Returns the key of a page that sent the code, which is void then, or its key; None for one that sent
        neither. A key, which nobody guesses, is good while its address waits."""
        text = secret if isinstance(secret, str) else ""
        had, self._keys = self._keys, {key: used for key, used in self._keys.items() if now - used < KEY_S}
        if had and not self._keys:
            self.ticket = secrets.token_urlsafe(16)
        for key in self._keys:
            if hmac.compare_digest(text.encode("utf-8", "replace"), key.encode()):
                self._keys[key] = now
                return key
        if not self._check.accepts(text, address, now):
            if self._check.guesses >= MAX_GUESSES and now - self._since >= CODE_S:
                self._renew(self._check.guesses, now)
            return None
        self._renew(0, now)
        if len(self._keys) >= MAX_KEYS:
            del self._keys[min(self._keys, key=self._keys.__getitem__)]
        key = secrets.token_urlsafe(16)
        self._keys[key] = now
        return key

    def use(self, key: str, now: float) -> None:
        """Notes that a page with a key is there."""
        if key in self._keys:
            self._keys[key] = now

    def _renew(self, guessed: int, now: float) -> None:
        self._check.former = self._check.code if guessed else ""
        self._check.code, self._check.guesses = _new_code(), 0
        self._since, self._guessed = now, guessed


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
    """Returns an address in the one form that stands for its machine: of IPv6 its network, as a machine may have any
    address there, but for those on the same link."""
    ip = _ip(address)
    if ip is None or ip.version == 4 or ip.is_link_local or ip.is_loopback:
        return str(ip or address)
    return str(ipaddress.IPv6Network((int(ip), 64), strict=False))
