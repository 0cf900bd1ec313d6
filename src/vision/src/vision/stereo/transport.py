"""Images for pages, on a WebSocket that the server of a page has accepted. The page requests an image by a message, and
the next one once it has shown it, so that no image waits in a queue. Each answer is one text message, {"picture": true,
...what there is to know of it}, and then the JPEG; or {"picture": false} if no new image arrived for a while."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from leap_motion.service.access import ConnectionLimits
from leap_motion.service.socket_service import SEND_S


class Picture(NamedTuple):
    """An image for a page."""

    about: Mapping[str, Any]
    jpeg: bytes


class PictureStream:
    """Sends the newest image to each page that asks, in the server's event loop; `more` returns what each answer has
    beside the image."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, more: Callable[[], Mapping[str, Any]], max_pages: int, of_address: int
    ) -> None:
        self._loop, self._more = loop, more
        self._limits = ConnectionLimits(max_pages, of_address)
        self._picture: Picture | None = None
        self._number = self._pages = 0
        self._next = loop.create_future()  # done when the next image is there

    @property
    def watched(self) -> bool:
        return self._pages > 0

    def take(self, picture: Picture) -> None:
        """Takes a new image, in the loop."""
        self._picture = picture
        self._number += 1
        self._next.set_result(None)
        self._next = self._loop.create_future()

    async def converse(self, connection: ServerConnection) -> None:
        """Serves a page to its end."""
        address = connection.remote_address[0]
        if not self._limits.enter(address):
            await connection.close(1013, "too many pages are open already")
            return
        self._pages += 1
        with contextlib.suppress(ConnectionClosed, asyncio.TimeoutError):
            try:
                await self._show(connection)
            finally:
                self._pages -= 1
                self._limits.leave(address)

    async def _show(self, page: ServerConnection) -> None:
        silence_s = 0.5  # the page is notified after this time without a new image
        request_s = 10.0  # a page without a request for this time is gone
        shown = self._number
        while True:
            await asyncio.wait_for(page.recv(), request_s)
            if self._number == shown:
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(asyncio.shield(self._next), silence_s)
            picture = self._picture
            if picture is None or self._number == shown:
                await asyncio.wait_for(page.send(json.dumps({"picture": False, **self._more()})), SEND_S)
                continue
            shown = self._number
            about = {"picture": True, **picture.about, **self._more()}
            await asyncio.wait_for(page.send(json.dumps(about)), SEND_S)
            await asyncio.wait_for(page.send(picture.jpeg), SEND_S)
