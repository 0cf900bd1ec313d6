"""Images of cameras for pages, on a WebSocket that the server of a page has accepted: the newest one at each stage.

A page asks for an image by a message, and for the next one once it has decoded it, so that no image waits in a queue.
The message may be JSON: {"t": the page's time [ms], "video": whether its video runs}. The answer is one text message,
{"picture": true, ...what there is to know of it}, and then the JPEG; or {"picture": false} if no new image came for a
while. A page whose video runs gets the text alone, and seldom. With "t", an answer has "t" again, the server's time
"now" and how long it "waited" for an image [ms], from which the page knows the server's time and so the image's age:
"taken" is when the image was taken, "came" when it arrived, by the same clock.

Where "video" is true in an answer, the page may send {"offer": SDP} and gets {"answer": SDP}; see webrtc.py."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from common import clock
from leap_motion.service.access import ConnectionLimits, is_loopback
from leap_motion.service.socket_service import SEND_S, cutter
from vision.stereo import webrtc

JPEG, WEBRTC, AUTO = "jpeg", "webrtc", "auto"


class Picture(NamedTuple):
    """An image for a page."""

    image: np.ndarray  # RGB, shape (height, width, 3), uint8
    taken: float  # when it was taken [s], by clock.monotonic
    came: float  # when it arrived here [s]
    about: Mapping[str, Any]


class NewestPicture:
    """The newest image of one camera, in the server's event loop; `pages` counts who looks."""

    def __init__(self, loop: asyncio.AbstractEventLoop, quality: int) -> None:
        self._loop, self._quality = loop, quality
        self.picture: Picture | None = None
        self.number = self.pages = 0
        self._next = loop.create_future()  # done when the next image is there
        self._jpeg: asyncio.Future[bytes] | None = None

    def take(self, picture: Picture) -> None:
        self.picture, self._jpeg = picture, None
        self.number += 1
        self._next.set_result(None)
        self._next = self._loop.create_future()

    async def after(self, number: int) -> None:
        """Returns once there is an image after that of the number."""
        while self.number == number:
            await asyncio.shield(self._next)

    def jpeg(self) -> asyncio.Future[bytes]:
        """The newest image as JPEG, which is made once, for the first page that wants it."""
        if self._jpeg is None and self.picture is not None:
            self._jpeg = asyncio.ensure_future(
                self._loop.run_in_executor(None, encoded, self.picture.image, self._quality)
            )
        assert self._jpeg is not None
        return self._jpeg


class PictureStream:
    """Sends the newest image to each page that asks, in the server's event loop; `more` returns what each answer has
    beside the image. `cameras`: their names, of which a page gives one as ?camera=NAME, otherwise it is the first.
    `way`: JPEG, WEBRTC, or AUTO, which is JPEG to this machine and video elsewhere if this rig has what it needs."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        more: Callable[[], Mapping[str, Any]],
        max_pages: int,
        of_address: int,
        quality: int,
        way: str = AUTO,
        cameras: Sequence[str] = ("camera",),
    ) -> None:
        self._more, self._way, self._videos = more, way, 0
        self._newest = {camera: NewestPicture(loop, quality) for camera in cameras}
        self._limits = {camera: ConnectionLimits(max_pages, of_address) for camera in cameras}

    def watched(self, camera: str) -> bool:
        return self._newest[camera].pages > 0

    def take(self, camera: str, picture: Picture) -> None:
        """Takes a new image, in the loop."""
        self._newest[camera].take(picture)

    async def converse(self, connection: ServerConnection, keep: Callable[[], None] | None = None) -> None:
        """Serves a page to its end. `keep`: its place is kept, and this keeps its connection."""
        asked = parse_qs(urlsplit(connection.request.path if connection.request else "").query)
        camera = asked.get("camera", [next(iter(self._newest))])[0]
        if camera not in self._newest:
            await connection.close(1008, "there is no such camera")
            return
        newest, limits = self._newest[camera], self._limits[camera]
        place = limits.enter(connection.remote_address[0], cutter(connection), keep is not None)
        if place is None:
            await connection.close(1013, "too many pages are open already")
            return
        if keep is not None:
            keep()
        newest.pages += 1
        with contextlib.suppress(ConnectionClosed, asyncio.TimeoutError):
            async with contextlib.AsyncExitStack() as stack:
                try:
                    await self._show(connection, newest, stack)
                finally:
                    newest.pages -= 1
                    limits.leave(place)

    def _may_have_video(self, address: str) -> bool:
        wanted = self._way == WEBRTC or (self._way == AUTO and not is_loopback(address))
        return wanted and self._videos < webrtc.MAX_VIDEOS and not webrtc.missing()

    async def _show(self, page: ServerConnection, newest: NewestPicture, stack: contextlib.AsyncExitStack) -> None:
        silence_s = 0.5  # the page is notified after this time without a new image
        request_s = 10.0  # a page without a request for this time is gone
        text_s = 0.2  # between answers to a page whose video runs
        shown, offered = newest.number, False

        async def send(message: str | bytes) -> None:
            await asyncio.wait_for(page.send(message), SEND_S)

        while True:
            asked = _read(await asyncio.wait_for(page.recv(), request_s))
            heard = clock.monotonic()
            if "offer" in asked:
                answer = None
                if not offered and self._may_have_video(page.remote_address[0]):
                    offered = True
                    self._videos += 1
                    stack.callback(self._end_video)
                    answer = await webrtc.answered(str(asked["offer"]), newest, page, stack)
                await send(json.dumps({"answer": answer}))
                continue
            if asked.get("video") is True:
                await asyncio.sleep(text_s)
            elif newest.number == shown:
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(newest.after(shown), silence_s)
            picture, about, jpeg = newest.picture, dict(self._more()), None
            new = picture is not None and newest.number != shown
            if picture is not None and new:
                shown = newest.number
                if asked.get("video") is not True:
                    jpeg = await asyncio.shield(newest.jpeg())
                about = {**picture.about, "taken": 1e3 * picture.taken, "came": 1e3 * picture.came, **about}
            if not offered and self._may_have_video(page.remote_address[0]):
                about["video"] = True
            if "t" in asked:
                now = clock.monotonic()
                about.update(t=asked["t"], now=1e3 * now, waited=1e3 * (now - heard))
            await send(json.dumps({"picture": new, **about}))
            if jpeg is not None:
                await send(jpeg)

    def _end_video(self) -> None:
        self._videos -= 1


def encoded(image: np.ndarray, quality: int) -> bytes:
    """Returns an RGB image as JPEG."""
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(jpeg)


def _read(text: str | bytes) -> dict[str, Any]:
    """Returns what a page asks for; nothing of what is not well-formed."""
    try:
        asked = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    if not isinstance(asked, dict) or not isinstance(asked.get("t", 0.0), (int, float)):
        return {}
    return asked
