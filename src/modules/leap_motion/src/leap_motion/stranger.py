"""What answers where a device is expected, if that is not the device: in words, by its first bytes. The libraries of
the devices stand alone, so each has a copy of this file, by test: no link, which an sdist loses."""

from __future__ import annotations

SHOWN = 48  # bytes
ECHO, TLS, WEB = "a program that sends back what it gets", "a service with TLS", "a web server"
KINDS = {
    **{begin: ECHO for begin in (b"tftrans", b"get /", b'{"do":', b"\x16\x03\x01")},  # our own words, last by TLS
    **{begin: TLS for begin in (b"\x15\x03", b"\x16\x03")},
    **{begin: WEB for begin in (b"http/", b"<!doctype", b"<html")},
    b"ssh-": "an SSH server",
}
"""What begins like this, in small letters."""


def stranger(address: str, device: str, first: bytes) -> str:
    """Returns, as a part of a sentence, that what answers at the address is not the `device`, what else it seems to
    be, and its `first` bytes."""
    begins = first[:SHOWN].lstrip().lower()
    kind = next((f" but {kind}" for begin, kind in KINDS.items() if begins.startswith(begin)), "")
    shown = repr(first[:SHOWN])[2:-1] + ("…" if len(first) > SHOWN else "")
    return f"what answers at {address} is not {device}{kind}: its first bytes are `{shown}`"
