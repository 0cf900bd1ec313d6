"""A headset's page from afar, `python -m campaign.network.headset LEAP_URL PAGE_URL CODE`: it takes the hands that a
simulated Leap service shows, and sends them as the page does, to a relay's port of that page. The person stands at the
origin of the room and looks along -z. It ends with SIGTERM."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import ssl
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidHandshake, WebSocketException

from leap_motion.headset.placement import FROM_XR

HEAD = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]
ANSWER_S, AGAIN_S = 1.0, 1.0  # as the page's ANSWER_MS and AGAIN_MS
JOINTS = ("carpPosition", "mcpPosition", "pipPosition", "dipPosition", "btipPosition")


def xr_points(frame: dict[str, Any], side: str) -> np.ndarray | None:
    """Returns the joints of a hand in a frame of the Leap service, shape (25, 3) [m]; None if it shows no such hand."""
    for hand in frame["hands"]:
        if hand["type"] == side:
            fingers = sorted((p for p in frame["pointables"] if p["handId"] == hand["id"]), key=lambda p: p["type"])
            points = np.empty((25, 3))
            points[0] = hand["wrist"]
            points[FROM_XR] = [[finger[joint] for joint in JOINTS] for finger in fingers]
            return 1e-3 * points
    return None


class HeadsetPage:
    """The page's side of the conversation (leap_motion.headset.transport); `on_drive` is called when it drives."""

    def __init__(self, secret: str) -> None:
        self.on_drive: Callable[[], None] = lambda: None
        self._secret = secret
        self._socket: Any = None
        self._sent: list[float] = []
        self._origin: list[float] | None = None

    async def hold(self, url: str) -> None:
        """Connects, again and again."""
        tls = None
        if url.startswith("wss:"):
            tls = ssl.create_default_context()
            tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
        while True:
            with contextlib.suppress(OSError, WebSocketException, InvalidHandshake, asyncio.TimeoutError):
                async with connect(url, ssl=tls, compression=None, ping_interval=None) as socket:
                    await socket.send(json.dumps({"secret": self._secret}))
                    await self._hear(socket)
            self._socket = None
            await asyncio.sleep(AGAIN_S)

    async def _hear(self, socket: Any) -> None:
        async for text in socket:
            said = json.loads(text)
            self._secret = said.get("key", self._secret)
            if said.get("drives"):
                self._socket, self._sent = socket, []
                self.on_drive()
            elif "leap" in said:
                self._sent = self._sent[1:]
                self._origin = said["leap"] and said["leap"][:3]

    async def show(self, frame: dict[str, Any], now: float) -> None:
        """Sends a frame's right hand."""
        if self._socket is None or (self._sent and now - self._sent[0] >= ANSWER_S):
            return
        self._sent.append(now)
        points = xr_points(frame, "right") if self._origin else None
        right = None if points is None else np.round(points + self._origin, 5).ravel().tolist()
        with contextlib.suppress(WebSocketException):
            await self._socket.send(
                json.dumps({"t": 1e3 * now, "place": 1, "head": HEAD, "left": None, "right": right})
            )


async def play(leap: str, page: HeadsetPage, url: str) -> None:
    """Sends the hands of a Leap service until it ends."""
    held = asyncio.ensure_future(page.hold(url))
    try:
        async with connect(leap, compression=None, max_queue=1, ping_interval=None) as service:
            await service.send('{"background": true}')
            async for text in service:
                frame = json.loads(text)
                if "hands" in frame:
                    await page.show(frame, asyncio.get_running_loop().time())
    finally:
        held.cancel()
        await asyncio.gather(held, return_exceptions=True)


async def main(leap: str, url: str, code: str) -> None:
    """The program."""
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, asyncio.current_task().cancel)
    page = HeadsetPage(code)
    page.on_drive = lambda: print("drives", flush=True)
    await play(leap, page, url)


if __name__ == "__main__":
    with contextlib.suppress(asyncio.CancelledError):
        asyncio.run(main(*sys.argv[1:4]))
