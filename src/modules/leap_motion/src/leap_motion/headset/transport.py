"""The conversation with a headset's page, on a WebSocket that the server of the page has accepted.

The page first sends {"secret": its code or key}; the answer is {"key": ..., "drives": true}, or {"refused": a sentence}
and the end. One headset drives at a time. Then the page sends a message for each frame of the headset (`hand_stream`),
and each is answered: {"leap": [x, y, z, heading] or null, "note": a sentence, ...scene}. The page sends no more while
several answers are missing, so nothing waits in a queue. {"away": true} says that nobody looks: headset taken off,
page without focus. Then, and when the page falls silent or is gone, the tracker counts as unplugged.
"""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection

from leap_motion.headset.access import Access
from leap_motion.headset.hand_stream import HandFrame, HandStream

MAX_MESSAGE_BYTES = 16384  # longest message of a page; two hands take 3000
SECRET_S = 5.0  # a page that has not sent its code by then is gone,
SILENCE_S = 0.3  # a page that was silent for so long is away,
GONE_S = 10.0  # and after this time it is gone
SEND_S = 2.0  # nor is a page there that takes no answers
MAX_WAITING = 8  # pages that have not sent their code
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
    person at the terminal, `say_code` the one with the code, which belongs into no log; without it `say` gets that too.
    `driven` is whether a headset drives.
    """

    def __init__(
        self,
        stream: HandStream,
        served: Served,
        scene: Callable[[], Scene],
        say: Callable[[str], None],
        say_code: Callable[[str], None] | None = None,
    ) -> None:
        self._stream, self._served, self._scene, self._say = stream, served, scene, say
        self._say_code = say_code or say
        self._access = Access()
        self._lock = threading.Lock()
        self._driver: tuple[str, ServerConnection] | None = None
        self._placed_by = ""  # key of the headset whose box stands in the room
        self._waiting = 0
        self._attached = False
        served.plug(False)
        self._tell_code()

    @property
    def driven(self) -> bool:
        return self._driver is not None

    def converse(self, connection: ServerConnection) -> None:
        """Serves one connection to its end, which nothing that it sends can prevent."""
        connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", int(SEND_S), 0))
        try:
            key = self._greet(connection)
            try:
                if not key or not self._seated(key, connection):
                    return
                self._drive(connection)
            finally:
                self._leave(connection)
            connection.close(REFUSED, "That was no message of the page, or none came.")
        except (ConnectionClosed, TimeoutError, OSError):
            pass

    def _greet(self, connection: ServerConnection) -> str | None:
        """Returns the key of a page that may drive; tells the others why they may not."""
        with self._lock:
            self._waiting += 1
            full = self._waiting > MAX_WAITING
        try:
            text = "" if full else connection.recv(timeout=SECRET_S)
        finally:
            with self._lock:
                self._waiting -= 1
        if full:
            connection.close(BUSY, "Too many pages ask for the robot.")
            return None
        secret = _read(text).get("secret")
        with self._lock:
            code = self._access.code
            key = self._access.admit(secret)
            used = self._access.code != code
        if used:
            self._tell_code()
        if key is None:
            self._say(f"Refused the headset at {connection.remote_address[0]}: it did not send the code.")
            refused = "That is not the code that stands on the rig's terminal, or too many wrong ones came before."
            connection.send(json.dumps({"refused": refused}))
            connection.close(REFUSED)
        return key

    def _tell_code(self) -> None:
        self._say_code(f"The code for the next headset is {self._access.code}.")

    def _seated(self, key: str, connection: ServerConnection) -> bool:
        """Gives the page the driver's seat if it is free, or its own from before its connection was lost."""
        with self._lock:
            before = self._driver
            free = before is None or before[0] == key
            if free:
                self._driver = (key, connection)
                (self._stream.interrupt if key == self._placed_by else self._stream.restart)()
                self._placed_by = key
        if not free:
            refused = "Another headset drives the robot; this one can watch."
            connection.send(json.dumps({"refused": refused, "key": key}))
            connection.close(BUSY)
            return False
        if before is not None:
            threading.Thread(target=before[1].close, daemon=True).start()
        connection.send(json.dumps({"key": key, "drives": True}))
        self._say("A headset drives the robot.")
        return True

    def _leave(self, connection: ServerConnection) -> None:
        with self._lock:
            if self._driver is None or self._driver[1] is not connection:
                return  # the same page has come back meanwhile
            self._driver = None
            self._away()
        self._say("No headset drives the robot any more.")

    def _drive(self, connection: ServerConnection) -> None:
        heard = time.monotonic()
        while time.monotonic() - heard < GONE_S:
            try:
                text = connection.recv(timeout=SILENCE_S)
            except TimeoutError:
                text = None
            with self._lock:
                if self._driver is None or self._driver[1] is not connection:
                    return
                answer = self._answer(text)
            if text is not None:
                heard = time.monotonic()
                if answer is None:
                    return
                connection.send(json.dumps(answer))

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


def _read(text: str | bytes) -> dict:
    """Returns the message in a text, an empty one if the text holds none."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}
