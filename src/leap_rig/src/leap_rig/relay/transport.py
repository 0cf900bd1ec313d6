"""Passes a browser's connection through a WebSocket."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterable
from typing import Any, TypeVar

from websockets.asyncio.connection import Connection

from leap_rig.relay.greeting import CHUNK, RelayFault

TAKE_S = 10.0  # who takes no bytes for so long is gone
LINGER_S = 5.0  # how long one direction may be silent after the other has ended
CLOSED_S = 60.0  # how long the other side may take to close the WebSocket
T = TypeVar("T")


class Passage:
    """A browser's connection, or that to a page, and the WebSocket through which it passes."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, socket: Connection) -> None:
        self._reader, self._writer, self._socket = reader, writer, socket
        self._passed = 0  # bytes, both ways

    async def run(self, closed_by_other: bool = False) -> None:
        """Passes bytes on, both ways, until one of the two is gone or does not take them; then ends both. What has
        come by a WebSocket and waits is lost when it closes, so the side that receives more closes it."""
        self._writer.transport.set_write_buffer_limits(CHUNK)
        ways = [asyncio.ensure_future(self._send()), asyncio.ensure_future(self._receive())]
        try:
            done, left = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            before = -1
            while left and self._passed != before and not any(way.exception() for way in done):
                before = self._passed
                done, left = await asyncio.wait(left, timeout=LINGER_S)
            if closed_by_other and not left and not any(way.exception() for way in ways):
                await within(CLOSED_S, self._socket.wait_closed())
        finally:
            await end_tasks(ways)
            await end(self._writer)
            await self._socket.close()

    async def _send(self) -> None:
        data = b"begins"
        while data:
            data = await self._reader.read(CHUNK)
            await within(TAKE_S, self._socket.send(data))
            self._passed += len(data)

    async def _receive(self) -> None:
        while data := await self._socket.recv():
            if not isinstance(data, bytes):
                raise RelayFault("The other side sent text, which is no part of a connection.")
            self._writer.write(data)
            await within(TAKE_S, self._writer.drain())
            self._passed += len(data)
        if self._writer.can_write_eof():
            self._writer.write_eof()


async def within(seconds: float, action: Awaitable[T]) -> T:
    """As asyncio.wait_for, which before Python 3.12 may swallow that its task is cancelled."""
    task = asyncio.ensure_future(action)
    try:
        done, _ = await asyncio.wait((task,), timeout=seconds)
    finally:
        task.cancel()
    if not done:
        raise asyncio.TimeoutError
    return task.result()


async def end_tasks(tasks: Iterable[asyncio.Future[Any]]) -> None:
    """Cancels tasks and waits for them."""
    tasks = list(tasks)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def end(writer: asyncio.StreamWriter) -> None:
    """Ends a connection once it has sent what waits, or does not."""
    writer.close()
    try:
        await within(LINGER_S, writer.wait_closed())
    except asyncio.TimeoutError:
        writer.transport.abort()
    except OSError:  # and ssl.SSLError: it is gone
        pass
