"""The rig's side of a relay: WebSockets to it, of which some always wait for a browser. Nothing at the lab listens for
them, and the relay reaches no port but those of the pages."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import functools
import logging
import secrets
import ssl
from collections.abc import Callable, Mapping
from typing import NamedTuple

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from leap_rig.relay import greeting
from leap_rig.relay.greeting import CHUNK, NONCE, RUN, RelayFault
from leap_rig.relay.transport import Passage, end_tasks, within

SPARE = 8  # WebSockets that wait; a page takes six at once
MAX_SOCKETS = 128
FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 30.0  # before the next try, after the first that failed and after many
SOUND_S = 5.0  # a WebSocket that waited for so long was none that failed
OPEN_S = 10.0  # for each step of the way to the relay
PING_S = 5.0  # a relay that answers no ping for so long is gone


class PagePort(NamedTuple):
    """The port of a page on this machine, and whether it has a certificate."""

    port: int
    tls: bool = False


class RelayClient:
    """Connects to the relay at `url`, ws:// or wss://, until it is cancelled. `say` gets sentences for the terminal."""

    def __init__(self, url: str, key: bytes, pages: Mapping[str, PagePort], say: Callable[[str], None]) -> None:
        self._url, self._key, self._pages, self._say = url, key, dict(pages), say
        self._run = secrets.token_bytes(RUN)
        self._links: set[asyncio.Future[None]] = set()
        self._spare, self._failed, self._next_try = 0, 0, 0.0
        self._said = ""

    async def run(self) -> None:
        """Keeps WebSockets waiting at the relay."""
        loop, longest_s = asyncio.get_running_loop(), 1.0
        self._changed = asyncio.Event()
        try:
            while True:
                self._changed.clear()
                pause = self._next_try - loop.time()
                while pause <= 0.0 and self._spare < (1 if self._failed else SPARE) and len(self._links) < MAX_SOCKETS:
                    self._spare += 1
                    link = asyncio.ensure_future(self._link())
                    self._links.add(link)
                    link.add_done_callback(self._links.discard)
                with contextlib.suppress(asyncio.TimeoutError):
                    await within(pause if 0.0 < pause < longest_s else longest_s, self._changed.wait())
        finally:
            await end_tasks(self._links)

    async def _link(self) -> None:
        """Serves one WebSocket to its end."""
        loop, began, spare = asyncio.get_running_loop(), 0.0, True
        logger = logging.getLogger(__name__)
        logger.setLevel(logging.CRITICAL)
        try:
            async with connect(
                self._url, compression=None, max_size=CHUNK, write_limit=CHUNK, open_timeout=OPEN_S,
                ping_interval=PING_S, ping_timeout=PING_S, close_timeout=OPEN_S, logger=logger,
            ) as socket:  # fmt: skip
                await within(OPEN_S, self._greet(socket))
                began = loop.time()
                self._tell("The relay is reached.")
                self._succeed()
                asked = greeting.read_opening(await socket.recv())
                self._spare, spare = self._spare - 1, False
                self._changed.set()
                await self._converse(asked, socket)
        except RelayFault as fault:
            self._tell(f"{fault} Trying again.")
        except ConnectionClosed as closed:
            reason = closed.rcvd.reason if closed.rcvd else ""
            if spare:
                self._tell(f"The relay ended the connection{reason and ': ' + reason}. Trying again.")
        except (OSError, InvalidHandshake, asyncio.TimeoutError) as error:
            self._tell(f"The relay at {self._url} is not reached: {str(error) or 'it does not answer'}. Trying again.")
        finally:
            if spare:
                self._spare -= 1
                if not began or loop.time() - began < SOUND_S:
                    self._fail(loop.time())
            self._changed.set()

    def _succeed(self) -> None:
        """Lets the rest of the WebSockets follow the first one."""
        self._failed = 0
        self._changed.set()

    def _fail(self, now: float) -> None:
        """Lets more time pass before the next try; those that failed together count once."""
        if now >= self._next_try:
            self._next_try = now + min(FIRST_WAIT_S * 2.0 ** min(self._failed, 10), LONGEST_WAIT_S)
            self._failed += 1

    async def _greet(self, socket: ClientConnection) -> None:
        answer, due = greeting.answer(self._key, await socket.recv(), self._run, secrets.token_bytes(NONCE))
        await socket.send(answer)
        greeting.check_proof(await socket.recv(), due)

    async def _converse(self, asked: greeting.PageRequest, socket: ClientConnection) -> None:
        target = self._pages.get(asked.page)
        if target is None:
            self._tell(f"The relay asks for the page {asked.page!r}, which this rig does not serve.")
            return
        try:
            reader, writer = await within(OPEN_S, _open(target, greeting.local_address(asked.visitor)))
        except (OSError, asyncio.TimeoutError) as error:
            self._tell(f"The page {asked.page!r} on port {target.port} is not reached: {error}.")
            return
        await Passage(reader, writer, socket).run(closed_by_other=True)

    def _tell(self, sentence: str) -> None:
        if sentence != self._said:
            self._said = sentence
            self._say(sentence)


async def _open(target: PagePort, address: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connects to a page on this machine, whose certificate nobody else vouches for, from a loopback address."""
    tls = None
    if target.tls:
        tls = ssl.create_default_context()
        tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    open_from = functools.partial(asyncio.open_connection, "127.0.0.1", target.port, limit=CHUNK, ssl=tls)
    try:
        return await open_from(local_addr=(address, 0))
    except OSError as error:
        if error.errno != errno.EADDRNOTAVAIL:  # where loopback is one address alone
            raise
    return await open_from()
