"""The simulated service: plays frames to its clients, with faults and a control port."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Callable, Mapping
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from common import clock
from common.errors import DeviceError
from leap_motion.service.certificate import Certificate
from leap_motion.service.server import LeapService
from leap_motion.service.socket_service import LONGEST_SLEEP_S
from rig_simulation.control_port import ControlPort, Handler, listen, require_loopback
from rig_simulation.faults.injection import Faults
from rig_simulation.faults.leap import LEAP_FAULTS, FrameStream
from rig_simulation.operator.sources import Playback

POLL_S = 0.02
RESET_ON_CLOSE = struct.pack("ii", 1, 0)
PURPOSE = "the Leap service"
VERSION = "2.3.1+simulated"


class SimulatedLeapService(LeapService):
    """Plays frames to all clients; port 0 takes any free one, see the attributes. Raises DeviceError if a port is
    taken."""

    def __init__(
        self,
        playback: Playback,
        host: str,
        port: int,
        control_port: int,
        service: str = "2.3",
        requests: Mapping[str, Handler] | None = None,  # further ones of the control port
    ) -> None:
        require_loopback(host, PURPOSE)
        super().__init__(host, port, service, VERSION, simulated=True)
        self._playback = playback
        self.faults = Faults(LEAP_FAULTS)
        self._stream = FrameStream(self.faults)
        handlers: dict[str, Handler] = {
            **(requests or {}),
            "state": self._state,
            "play": lambda: self._do(self._playback.play),
            "pause": lambda: self._do(self._playback.pause),
            "plug": lambda: self.plug(True),
            "unplug": lambda: self.plug(False),
            **self.faults.requests,
        }
        self._control = ControlPort(handlers, host, control_port)
        self.control_port = self._control.port

    def plug(self, attached: bool) -> None:
        self.faults.switch("unplugged", not attached)

    def _listen(self, host: str, port: int, certificate: Certificate | None = None) -> tuple[str, int]:
        listener = listen(host, port, PURPOSE)
        self._doors.clear()  # of before a restart
        self._open(listener)
        return listener.getsockname()[:2]

    async def _serve(self) -> None:
        try:
            while not self._stopping:
                async with self._serving():
                    await self._play_frames()
                while not self._stopping and not self._started_again():
                    await asyncio.sleep(POLL_S)
        finally:  # running requests wait for the loop
            await self._loop.run_in_executor(None, self._control.close)

    async def _play_frames(self) -> None:
        late_s = 0.05  # later frames are dropped: the clock does not wait for a busy machine
        # a lag beyond this is dropped: frames then come at a low rate; else none would be in time
        longest_lag_s = 0.5
        start = clock.monotonic()
        while not self._stopping and not self.faults.is_on("restarted"):
            self._follow_faults()
            played = self._playback.next()
            due = start + played.time
            behind = clock.monotonic() - due
            late = late_s < behind < longest_lag_s
            start += behind if behind >= longest_lag_s else 0.0
            await self._sleep_until(due)
            if self._attached and not late:
                self._hand_out(tuple(self._stream.pass_on(played.text, due)))

    def _started_again(self) -> bool:
        if self.faults.is_on("restarted"):
            return False
        try:
            self._listen(self.host, self.port)
        except DeviceError:  # another program may have taken the port for a moment
            return False
        self._playback.restart()
        return True

    def _follow_faults(self) -> None:
        changes = self.faults.changes()
        if "unplugged" in changes:
            self._set_attached(changes["unplugged"] is None)
        for client in self._clients:
            if changes.get("cut") is not None:
                _reset(client.connection)
            if "half_open" in changes:
                transport = client.connection.transport
                transport.resume_reading() if changes["half_open"] is None else transport.pause_reading()

    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        await self._while_held()
        if self.faults.is_on("cut"):
            _reset(connection)
        return await super()._meet(connection, request)

    async def _while_held(self) -> None:
        while self.faults.is_on("half_open") and not self._stopping:
            await asyncio.sleep(POLL_S)

    async def _sleep_until(self, due: float) -> None:
        left = due - clock.monotonic()
        if left <= 0.0:
            await asyncio.sleep(0)  # the clients have their turn also where frames are late
        while not self._stopping and left > 0.0:
            await asyncio.sleep(min(left, LONGEST_SLEEP_S))
            left = due - clock.monotonic()

    def _state(self) -> dict[str, Any]:
        return {
            "playing": self._playback.playing,
            "attached": not self.faults.is_on("unplugged"),
            "position": self._playback.position,
            "clients": self.clients,
            "frames_sent": self.sent,
            "frames_lost": self.lost,
            "mode": self.mode,
        }

    def _do(self, action: Callable[[], None]) -> None:
        """Runs an action in the thread of the loop, which owns clients and playback, and waits for it."""

        async def act() -> None:
            action()

        asyncio.run_coroutine_threadsafe(act(), self._loop).result(5.0)


def _reset(connection: ServerConnection) -> None:
    connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
    connection.transport.abort()
