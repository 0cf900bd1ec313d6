"""The WebSocket of the service: several clients, served as each requests; a slow client does not delay the others."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from common.errors import DeviceError
from rig_simulation.control_port import ControlPort, Handler, listen
from rig_simulation.devices.leap import wire
from rig_simulation.faults.injection import Faults
from rig_simulation.faults.leap import LEAP_FAULTS, FrameStream
from rig_simulation.operator.sources import Playback

LATE_S = 0.05  # later frames are dropped: the clock does not wait for a busy machine
LONGEST_LAG_S = 0.5  # a lag beyond this is dropped: frames then come at a low rate; else none would be in time
CLOSE_TIMEOUT_S = 0.5
LONGEST_SLEEP_S = 0.2
GATED_FROM_VERSION = 4
POLL_S = 0.02
RESET_ON_CLOSE = struct.pack("ii", 1, 0)


class _Client:
    """One connection: its requests, and its newest pending frames, without faults a single one."""

    def __init__(self, connection: ServerConnection, version: int, lenient: bool) -> None:
        self.connection, self.version = connection, version
        self.wants = {"background": lenient or version < GATED_FROM_VERSION, "focused": False}
        self.events: list[str] = []
        self.frames: list[str] = []
        self.wake = asyncio.Event()

    def hear(self, message: str | bytes) -> None:
        """Handles a message of the client; ignores unknown ones."""
        try:
            request = json.loads(message)
        except ValueError:
            return
        for key, value in request.items() if isinstance(request, dict) else ():
            if key in self.wants:
                self.wants[key] = value is True

    def offer(self, frames: list[str]) -> int:
        """Replaces the pending frames; returns how many frames that lost."""
        if not frames or not any(self.wants.values()):
            return 0
        lost, self.frames = len(self.frames), frames
        self.wake.set()
        return lost

    def notify(self, event: dict | None) -> None:
        if event is not None:
            self.events.append(wire.text(event))
            self.wake.set()


class LeapService:
    """Plays frames to all clients; port 0 takes any free one, see the attributes.

    Raises DeviceError if a port is taken.
    """

    def __init__(
        self,
        playback: Playback,
        host: str,
        port: int,
        control_port: int,
        fields: str = "2.x",  # field set, which the header announces
        lenient: bool = False,  # serve clients without a request, as the bridge for current services does
        requests: Mapping[str, Handler] | None = None,  # further ones of the control port
    ) -> None:
        self._playback, self._fields, self._lenient = playback, fields, lenient
        self._clients: set[_Client] = set()
        self._sent = self._lost = 0
        self.faults = Faults(LEAP_FAULTS)
        self._stream = FrameStream(self.faults)
        self._loop = asyncio.new_event_loop()
        self._stopping = False
        self._socket = listen(host, port, "the Leap service")
        self.host, self.port = self._socket.getsockname()[:2]
        handlers: dict[str, Handler] = {
            **(requests or {}),
            "state": self._state,
            "play": lambda: self._do(self._playback.play),
            "pause": lambda: self._do(self._playback.pause),
            "plug": lambda: self._plug(True),
            "unplug": lambda: self._plug(False),
            **self.faults.requests,
        }
        self._control = ControlPort(handlers, host, control_port)
        self.control_port = self._control.port
        logging.getLogger("websockets").setLevel(logging.CRITICAL)

    def run(self) -> None:
        """Serves until `stop` is called."""
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            # Running requests wait for the loop.
            self._loop.run_until_complete(self._loop.run_in_executor(None, self._control.close))
            self._loop.close()

    def stop(self) -> None:
        """Makes `run` return soon; may be called from a signal handler or another thread."""
        self._stopping = True

    async def _serve(self) -> None:
        while not self._stopping:
            async with serve(
                self._converse,
                sock=self._socket,
                process_request=self._meet,
                compression=None,
                close_timeout=CLOSE_TIMEOUT_S,
                ping_interval=None,
            ):
                await self._play_frames()
            while not self._stopping and not self._started_again():
                await asyncio.sleep(POLL_S)

    async def _play_frames(self) -> None:
        start = time.monotonic()
        while not self._stopping and not self.faults.is_on("restarted"):
            self._follow_faults()
            played = self._playback.next()
            due = start + played.time
            behind = time.monotonic() - due
            late = LATE_S < behind < LONGEST_LAG_S
            start += behind if behind >= LONGEST_LAG_S else 0.0
            await self._sleep_until(due)
            if self._attached and not late:
                frames = self._stream.pass_on(played.text, due)
                for client in self._clients:
                    self._lost += client.offer(frames)

    @property
    def _attached(self) -> bool:
        return not self.faults.is_on("unplugged")

    def _started_again(self) -> bool:
        if self.faults.is_on("restarted"):
            return False
        try:
            self._socket = listen(self.host, self.port, "the Leap service")
        except DeviceError:  # another program may have taken the port for a moment
            return False
        self._playback.restart()
        return True

    def _follow_faults(self) -> None:
        changes = self.faults.changes()
        for client in self._clients:
            if "unplugged" in changes:
                client.notify(wire.device_event(client.version, self._attached, self._attached))
            if changes.get("cut") is not None:
                _reset(client.connection)
            if "half_open" in changes:
                transport = client.connection.transport
                transport.resume_reading() if changes["half_open"] is None else transport.pause_reading()

    async def _meet(self, connection: ServerConnection, _: Request) -> Response | None:
        await self._while_half_open()
        if self.faults.is_on("cut"):
            _reset(connection)
        return None

    async def _while_half_open(self) -> None:
        while self.faults.is_on("half_open") and not self._stopping:
            await asyncio.sleep(POLL_S)

    async def _sleep_until(self, due: float) -> None:
        left = due - time.monotonic()
        if left <= 0.0:
            await asyncio.sleep(0)  # the clients have their turn also where frames are late
        while not self._stopping and left > 0.0:
            await asyncio.sleep(min(left, LONGEST_SLEEP_S))
            left = due - time.monotonic()

    async def _converse(self, connection: ServerConnection) -> None:
        assert connection.request is not None  # the handshake is over
        version = wire.version_of(connection.request.path)
        if version is None:
            await connection.close(1001)
            return
        client = _Client(connection, version, self._lenient)
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
            client.notify(wire.device_event(client.version, self._attached, self._attached))
            while True:
                await client.wake.wait()
                client.wake.clear()
                await self._while_half_open()
                while client.events:
                    await connection.send(client.events.pop(0))
                frames, client.frames = client.frames, []
                for frame in frames:
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

    def _plug(self, attached: bool) -> None:
        self.faults.switch("unplugged", not attached)

    def _do(self, action: Callable[[], None]) -> None:
        """Runs an action in the thread of the loop, which owns clients and playback, and waits for it."""

        async def act() -> None:
            action()

        asyncio.run_coroutine_threadsafe(act(), self._loop).result(5.0)


def _reset(connection: ServerConnection) -> None:
    connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
    connection.transport.abort()
