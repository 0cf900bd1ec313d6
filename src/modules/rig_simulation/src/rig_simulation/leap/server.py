"""The service's WebSocket: several clients, each served when it asked to be, none of them able to slow the others."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from rig_simulation.control_port import ControlPort, listen
from rig_simulation.leap import wire
from rig_simulation.leap.playback import Playback

LATE_S = 0.05
"""Frames that are later than this are not sent: the clock does not wait for a busy machine."""

CLOSE_TIMEOUT_S = 0.5
LONGEST_SLEEP_S = 0.2
GATED_FROM_VERSION = 4


class _Client:
    """One connection: what it asked for, and the newest frame that waits for it."""

    def __init__(self, version: int, lenient: bool) -> None:
        self.version = version
        self.wants = {"background": lenient or version < GATED_FROM_VERSION, "focused": False}
        self.events: list[str] = []
        self.frame: str | None = None
        self.wake = asyncio.Event()

    def hear(self, message: str | bytes) -> None:
        """Takes a message of the client; what it does not know it leaves aside."""
        try:
            request = json.loads(message)
        except ValueError:
            return
        for key, value in request.items() if isinstance(request, dict) else ():
            if key in self.wants:
                self.wants[key] = value is True

    def offer(self, frame: str) -> bool:
        """Leaves a frame for sending in place of one that still waits; returns whether one was lost so."""
        if not any(self.wants.values()):
            return False
        lost, self.frame = self.frame is not None, frame
        self.wake.set()
        return lost

    def tell(self, event: dict | None) -> None:
        """Leaves an event for sending."""
        if event is not None:
            self.events.append(wire.text(event))
            self.wake.set()


class LeapService:
    """Plays frames to whoever connects.

    Args:
        playback: where the frames come from.
        host: loopback address to listen on.
        port: 0 takes any free port.
        control_port: where tests see and do what a client cannot; 0 takes any free port.
        fields: field set, which decides what the header says.
        lenient: serve clients that asked for nothing, as the bridge for current services does.
        calls: further requests of the control port.

    Raises:
        DeviceError: a port is not to be had.
    """

    def __init__(
        self,
        playback: Playback,
        host: str,
        port: int,
        control_port: int,
        fields: str = "2.x",
        lenient: bool = False,
        calls: Mapping[str, Callable] = MappingProxyType({}),
    ) -> None:
        self._playback, self._fields, self._lenient = playback, fields, lenient
        self._clients: set[_Client] = set()
        self._sent = self._lost = 0
        self._attached = True
        self._loop = asyncio.new_event_loop()
        self._stopping = False
        self._socket = listen(host, port, "the Leap service", backlog=16)
        self.host, self.port = self._socket.getsockname()[:2]
        handlers = {**calls, "state": self._state, "play": self._play, "pause": self._pause}
        handlers.update({"plug": lambda: self._plug(True), "unplug": lambda: self._plug(False)})
        self._control = ControlPort(handlers, host, control_port)
        self.control_port = self._control.port
        logging.getLogger("websockets").setLevel(logging.CRITICAL)

    def run(self) -> None:
        """Serves until `stop` is called."""
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._control.close()
            self._loop.close()

    def stop(self) -> None:
        """Ends `run` within a moment; may be called from a signal handler or another thread."""
        self._stopping = True

    async def _serve(self) -> None:
        options = {"compression": None, "close_timeout": CLOSE_TIMEOUT_S, "ping_interval": None}
        async with serve(self._converse, sock=self._socket, **options):
            start = time.monotonic()
            while not self._stopping:
                played = self._playback.next()
                due = start + played.time
                late = time.monotonic() - due > LATE_S
                await self._sleep_until(due)
                if self._attached and not late:
                    for client in self._clients:
                        self._lost += client.offer(played.text)

    async def _sleep_until(self, due: float) -> None:
        await asyncio.sleep(0)
        while not self._stopping and time.monotonic() < due:
            await asyncio.sleep(min(due - time.monotonic(), LONGEST_SLEEP_S))

    async def _converse(self, connection: ServerConnection) -> None:
        version = wire.version_of(connection.request.path)
        if version is None:
            await connection.close(1001)
            return
        client = _Client(version, self._lenient)
        sender = asyncio.ensure_future(self._send(connection, client))
        self._clients.add(client)
        try:
            async for message in connection:
                client.hear(message)
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(client)
            sender.cancel()

    async def _send(self, connection: ServerConnection, client: _Client) -> None:
        with contextlib.suppress(ConnectionClosed):
            await connection.send(wire.text(wire.header(client.version, self._fields)))
            client.tell(wire.device_event(client.version, self._attached, self._attached))
            while True:
                await client.wake.wait()
                client.wake.clear()
                while client.events:
                    await connection.send(client.events.pop(0))
                frame, client.frame = client.frame, None
                if frame is not None:
                    await connection.send(frame)
                    self._sent += 1

    def _state(self) -> dict[str, Any]:
        return {
            "playing": self._playback.playing,
            "attached": self._attached,
            "position": self._playback.position,
            "clients": len(self._clients),
            "frames_sent": self._sent,
            "frames_lost": self._lost,
        }

    def _play(self) -> None:
        self._do(self._playback.play)

    def _pause(self) -> None:
        self._do(self._playback.pause)

    def _plug(self, attached: bool) -> None:
        def plug() -> None:
            self._attached = attached
            for client in self._clients:
                client.tell(wire.device_event(client.version, attached, attached))

        self._do(plug)

    def _do(self, action: Callable[[], None]) -> None:
        """Does something in the thread of the loop, which owns clients and playback, and waits for it."""

        async def act() -> None:
            action()

        asyncio.run_coroutine_threadsafe(act(), self._loop).result(5.0)
