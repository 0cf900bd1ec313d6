"""The conversation with a headset's page, on a WebSocket that the server of the page has accepted; one headset drives
at a time. The page sends {"secret": its code or key}; the answer is {"key": ..., "ticket": ..., "drives": true}, or
{"refused": a sentence} and the end. Each frame is answered: {"leap": [x, y, z, heading] or null, "note": a sentence,
...scene}; the page sends no more while an answer is missing for a second. {"away": true}, silence and the end of the
page count as unplugged."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from leap_motion.headset.hand_stream import HandFrame, HandStream
from leap_motion.service.access import ConnectionLimits, HeadsetAccess
from leap_motion.service.socket_service import SEND_S, cutter

MAX_MESSAGE_BYTES = 16384  # longest message of a page; two hands take 3000
SECRET_S = 5.0  # a page that has not sent its code by then is gone,
SILENCE_S = 0.3  # a page that was silent for so long is away,
GONE_S = 10.0  # and after this time it is gone
MAX_WAITING, WAITING_OF_ADDRESS = 32, 2  # pages that have not sent their code
REFUSED, BUSY = 1008, 1013  # codes of closing


class Served(Protocol):
    """What becomes of the frames: the Leap service."""

    def offer(self, frame: HandFrame) -> None: ...
    def plug(self, attached: bool) -> None: ...


class Scene(NamedTuple):
    """What the rig says: the box's height above the Leap [m], whether a hand steers, and what the page draws."""

    height: float
    steers: bool
    drawn: dict


class HandsEndpoint:
    """Takes the hands of one headset at a time. `scene` is asked for with each message, `say` gets sentences for the
    person at the terminal, `say_code` the one with the code, which belongs into no log; without it `say` gets that
    too. `driven` is whether a headset drives."""

    def __init__(
        self,
        stream: HandStream,
        served: Served,
        scene: Callable[[], Scene],
        say: Callable[[str], None],
        say_code: Callable[[str], None] | None = None,
    ) -> None:
        self._stream = stream
        self._served = served
        self._scene = scene
        self._say = say
        self._say_code = say_code or say
        self.access = HeadsetAccess()
        self._waiting = ConnectionLimits(MAX_WAITING, WAITING_OF_ADDRESS, newest_first=True)
        self._driver: tuple[str, ServerConnection] | None = None
        self._placed_by = ""  # key of the headset whose box stands in the room
        self._leaving: asyncio.Future | None = None
        self._attached = False
        served.plug(False)
        self._tell_code()

    @property
    def driven(self) -> bool:
        return self._driver is not None

    async def converse(self, connection: ServerConnection, keep: Callable[[], None]) -> None:
        """Serves one connection to its end, which nothing that it sends can prevent. `keep` is called for that of a
        page that may drive: it gives way to no other."""
        try:
            key = await self._greet(connection)
            try:
                if not key:
                    return
                keep()
                if not await self._seat(key, connection):
                    return
                await self._drive(connection)
            finally:
                self._leave(connection)
            await connection.close(REFUSED, "That was no message of the page, or none came.")
        except (ConnectionClosed, asyncio.TimeoutError):
            pass

    async def _greet(self, connection: ServerConnection) -> str | None:
        """Returns the key of a page that may drive; tells the others why they may not."""
        address = connection.remote_address[0]
        place = self._waiting.enter(address, cutter(connection))
        assert place is not None  # none is kept there
        try:
            text = await asyncio.wait_for(connection.recv(), SECRET_S)
        finally:
            self._waiting.leave(place)
        code, now = self.access.code, time.monotonic()
        wait = self.access.wait(address, now)
        key = self.access.admit(_read(text).get("secret"), address, now)
        if self.access.code != code:
            self._tell_code()
        if key is None:
            refused = "That is not the code that stands on the rig's terminal."
            if wait > 0.0:
                refused = f"A wrong code came from this address: try again in {math.ceil(wait)} s."
            else:
                self._say(f"Refused the headset at {address}: it did not send the code.")
            await _send(connection, {"refused": refused})
            await connection.close(REFUSED)
        return key

    def _tell_code(self) -> None:
        self._say_code(self.access.sentence("headset"))

    async def _seat(self, key: str, connection: ServerConnection) -> bool:
        """Gives the page the driver's seat if it is free, or its own from before its connection was lost."""
        before = self._driver
        if before is not None and before[0] != key:
            refused = "Another headset drives the robot; this one can watch."
            await _send(connection, {"refused": refused, "key": key, "ticket": self.access.ticket})
            await connection.close(BUSY)
            return False
        self._driver = (key, connection)
        (self._stream.interrupt if key == self._placed_by else self._stream.restart)()
        self._placed_by = key
        if before is not None:
            self._leaving = asyncio.ensure_future(before[1].close())
        await _send(connection, {"key": key, "ticket": self.access.ticket, "drives": True})
        self._say("A headset drives the robot.")
        return True

    def _leave(self, connection: ServerConnection) -> None:
        if self._driver is None or self._driver[1] is not connection:
            return  # the same page has come back meanwhile
        self._driver = None
        self._away()
        self._say("No headset drives the robot any more.")

    async def _drive(self, connection: ServerConnection) -> None:
        heard = time.monotonic()
        while time.monotonic() - heard < GONE_S:
            try:
                text = await asyncio.wait_for(connection.recv(), SILENCE_S)
            except asyncio.TimeoutError:
                text = None
            if self._driver is None or self._driver[1] is not connection:
                return
            answer = self._answer(text)
            if text is not None:
                heard = time.monotonic()
                self.access.use(self._driver[0], heard)
                if answer is None:
                    return
                await _send(connection, answer)

    def _answer(self, text: str | bytes | None) -> dict | None:
        """Takes a message, or None for silence; returns the answer, None for what is no message of a page."""
        message = {"away": True} if text is None else _read(text)
        scene = self._scene()
        if message.get("away") is True:
            self._away()
        else:
            try:
                frame = self._stream.step(message, time.monotonic(), scene.height, scene.steers)
            except ValueError:
                return None
            self._plug(True)
            if frame is not None:
                self._served.offer(frame)
        placed = self._stream.placement
        return {"leap": placed and [*placed.origin, placed.heading], "note": self._stream.note, **scene.drawn}

    def _away(self) -> None:
        self._plug(False)
        self._stream.interrupt()

    def _plug(self, attached: bool) -> None:
        if attached is not self._attached:
            self._attached = attached
            self._served.plug(attached)


async def _send(connection: ServerConnection, message: dict) -> None:
    """Sends a message; raises asyncio.TimeoutError for a page that does not take it."""
    await asyncio.wait_for(connection.send(json.dumps(message)), SEND_S)


def _read(text: str | bytes) -> dict:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}
