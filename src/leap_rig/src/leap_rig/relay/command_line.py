"""The program relay.py, which needs no ROS: `serve` on a computer that browsers reach, `connect` on the rig."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import signal
import stat
import sys
from collections.abc import Sequence
from urllib.parse import urlsplit

from common.command_line import CommandLine, whole
from common.errors import RigError
from leap_motion.service.access import is_loopback
from leap_rig.relay.client import PagePort, RelayClient
from leap_rig.relay.greeting import NAME, SHORTEST_KEY
from leap_rig.relay.server import Relay

PORT = 8480
NAME_OF = "relay"


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program; an error of the user ends it with one sentence and exit code 1."""
    parser = CommandLine(NAME_OF, __doc__.splitlines()[0])
    programs = parser.add_subparsers(dest="program", required=True, parser_class=argparse.ArgumentParser)
    serve = programs.add_parser("serve", help="be the relay, behind a TLS proxy")
    serve.add_argument("--host", default="127.0.0.1", help="address to listen on")
    serve.add_argument("--forwarded", action="store_true", help="a proxy names the browser in X-Forwarded-For, last")
    serve.add_argument("--port", type=whole(0, 65535), default=PORT, help="port for the rig, at /rig")
    connect = programs.add_parser("connect", help="let the relay reach pages of this rig")
    connect.add_argument("url", help="address of the relay, such as wss://rig.example.org/rig")
    for each, what in ((serve, "NAME=PORT for browsers"), (connect, "NAME=PORT here, NAME=tls:PORT if it is https")):
        each.add_argument("--key", required=True, help="file with the key, for its owner alone (mode 600)")
        each.add_argument("--page", action="append", required=True, help=f"a page, {what}; may be repeated")
    options = parser.parse_args(arguments)
    try:
        key, pages = read_key(options.key), dict(_page(text) for text in options.page)
        if options.program == "serve":
            _converse(options, key, pages)
        else:
            _connect(options.url, key, pages)
    except RigError as error:
        parser.error(str(error))


def read_key(path: str) -> bytes:
    """Returns the key in a file; raises RigError for a file that others may read, or that holds none."""
    longest = 1024
    try:
        # Opening a pipe would wait for its writer.
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            about = os.fstat(file.fileno())
            key = file.read(longest + 1) if stat.S_ISREG(about.st_mode) else b""
    except OSError as error:
        raise RigError(f"The key {path} cannot be read: {error.strerror}. Make one: openssl rand -hex 32.") from error
    if not stat.S_ISREG(about.st_mode):
        raise RigError(f"The key {path} is no regular file. Make one: openssl rand -hex 32.")
    if stat.S_IMODE(about.st_mode) & 0o077 or about.st_uid != os.getuid():
        raise RigError(f"Others may read the key {path}, so it was not used. Make a new one, and chmod 600 it.")
    if len(key) > longest or len(key.strip()) < SHORTEST_KEY:
        has = f"{len(key.strip())} characters" if len(key) <= longest else f"more than {longest} characters"
        raise RigError(f"The key {path} has {has}; {SHORTEST_KEY} to {longest} are due.")
    return key.strip()


def _page(text: str) -> tuple[str, PagePort]:
    name, _, port = text.partition("=")
    number = port[len("tls:") :] if port.startswith("tls:") else port
    if not NAME.fullmatch(name.encode("utf-8", "replace")) or not number.isdecimal() or int(number) > 65535:
        raise RigError(f"{text!r} is no page: a name in small letters and a port are due, such as cockpit=8470.")
    return name, PagePort(int(number), port != number)


def _converse(options: argparse.Namespace, key: bytes, pages: dict[str, PagePort]) -> None:
    if options.forwarded and not is_loopback(options.host):
        raise RigError(f"Whoever reaches {options.host} could name any browser: --forwarded needs --host 127.0.0.1.")
    ports = {name: target.port for name, target in pages.items()}
    try:
        relay = Relay(key, ports, _say, host=options.host, port=options.port, forwarded=options.forwarded)
    except (OSError, OverflowError) as error:
        raise RigError(f"Cannot listen on {options.host}: {error}. Choose other ports.") from error
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: relay.stop())
    shown = ", ".join(f"{name} on {port}" for name, port in relay.pages.items())
    _say(f"The relay listens for a rig on {options.host}:{relay.port}, for browsers: {shown}.")
    relay.run()


def _connect(url: str, key: bytes, pages: dict[str, PagePort]) -> None:
    try:
        parts = urlsplit(url)
        sound = parts.scheme in ("ws", "wss") and parts.hostname and (parts.port is None or parts.port > 0)
    except ValueError:
        sound = False
    if not sound:
        raise RigError(f"{url!r} is no address of a relay, such as wss://rig.example.org/rig.")
    if parts.scheme == "ws" and not is_loopback(parts.hostname or ""):
        raise RigError(f"{url!r} is not encrypted: whoever sits on the way could command the rig. Use wss://.")
    with contextlib.suppress(asyncio.CancelledError):
        asyncio.run(_until_signal(RelayClient(url, key, pages, _say)))


async def _until_signal(client: RelayClient) -> None:
    task = asyncio.ensure_future(client.run())
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    await task


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)
