"""The cockpit's server: the page at /, the 3-D scene in a frame of it, whose WebSocket is passed on to viser, the state
as JSON on /state, images on /pictures, and commands on /control, which need the code. What a page sends anywhere but on
/control moves nothing. A page with the code gets a ticket, with which it keeps its places where many others watch."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gzip
import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import websockets.asyncio.client as client
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from common import clock
from leap_motion.service.access import ConnectionLimits, Place, VisitLimits
from leap_motion.service.certificate import Certificate
from leap_motion.service.socket_service import PAGE_CONNECTIONS, SEND_S, PageService, cutter, page_response
from leap_rig.cockpit.control import CockpitControl, CockpitPage, HeldSwitches
from leap_rig.cockpit.messages import (
    BEAT,
    GIVE,
    SECRET,
    STOP,
    TAKE,
    PageCommand,
    PageMessageFault,
    read_command,
    state_text,
)
from vision.stereo.transport import AUTO, Picture, PictureStream

KEYS = b"""<script>
document.body.tabIndex = 0;
addEventListener("keydown", event => {
  if (event.key === "Escape" && !event.repeat) parent.postMessage("stop", "*");
});
</script>"""
"""The scene's frame is sandboxed, so that the browser draws it in a process of its own: the stop never waits for it.
The key Tab comes to its body, where viser takes the arrow keys."""
SCENE_HEADERS = ("Content-Encoding", "gzip"), ("Content-Security-Policy", "frame-ancestors 'self'")
MAX_RATE = 50  # messages of a page on /control in a second; a page sends 10
STOP_TEXT = '{"do":"stop"}'  # as the page sends it
SECRET_S = 30.0  # a page without the code may keep its connection for it so long
GONE_S = 5.0  # a page with the code that was silent for so long is gone
BUSY, REFUSED = 1013, 1008  # codes of closing
MAX_PAGES, PAGES_OF_ADDRESS = 8, 4
OPENINGS_S = 10.0  # in which each of these pages may load the scene once: it is large, and costs the server its time


class ScenePage(NamedTuple):
    """The scene's page, and host and port of its WebSocket on this machine."""

    html: bytes
    address: tuple[str, int]


class CockpitServer(PageService):
    """Serves in a thread of its own. `obey` gets what a page that may has commanded, `stop` is the Emergency Stop; both
    are called in that thread, and return at once. `tell_code` gets the sentence with the code, which belongs into no
    log. `script` is the page's for images, of `cameras` on the `way` of PictureStream. Raises as PageService does."""

    max_message_bytes = 65536
    write_limit = 1  # what waits would be late

    def __init__(
        self,
        page: Path,
        scene: ScenePage,
        arms: Sequence[str],
        obey: Callable[[PageCommand], None],
        stop: Callable[[], None],
        tell_code: Callable[[str], None],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        name: str = "",
        certificate: Certificate | None = None,
        script: bytes = b"",
        cameras: Sequence[str] = ("camera",),
        way: str = AUTO,
        public: str = "",
    ) -> None:
        jpeg_quality = 80
        self.scene_path = f"/scene/{secrets.token_urlsafe(16)}"  # a sandboxed frame has no origin to be checked
        self._page, self._scene_html, self._script = page.read_bytes(), gzip.compress(scene.html + KEYS), script
        super().__init__(host, port, name, certificate, public)
        self._scene, self._obey, self._stop, self._tell_code = scene, obey, stop, tell_code
        self.control, self._lock = CockpitControl(tuple(arms)), clock.Lock()
        self._state = "{}"
        self._news = self._loop.create_future()
        self._limits = {
            "/control": ConnectionLimits(PAGE_CONNECTIONS, PAGES_OF_ADDRESS, newest_first=True),
            **{path: ConnectionLimits(MAX_PAGES, PAGES_OF_ADDRESS) for path in ("/state", self.scene_path)},
        }
        self._openings = VisitLimits(2 * MAX_PAGES, 2 * PAGES_OF_ADDRESS, OPENINGS_S)  # page and WebSocket
        self._open_pages = self._open_scenes = self._number = 0
        self.pictures = PictureStream(self._loop, dict, MAX_PAGES, PAGES_OF_ADDRESS, jpeg_quality, way, cameras)
        self._say_code()
        self._thread = clock.Thread(target=self.run, name="cockpit", daemon=True)
        self._thread.start()

    @property
    def watched(self) -> bool:
        """Whether a page is open."""
        return self._open_pages > 0

    @property
    def scene_watched(self) -> bool:
        """Whether a page shows the scene."""
        return self._open_scenes > 0

    @property
    def live(self) -> bool:
        """Whether a page has control, has focus, and is heard."""
        with self._lock:
            return self.control.live(clock.monotonic())

    def put_state(self, state: Mapping[str, Any]) -> None:
        """Sends the state to all pages; what one has not taken yet is replaced."""
        self._soon(self._take_state, state_text({**state, "controller": self._controller(), "scene": self.scene_path}))

    def put_picture(self, camera: str, picture: Picture) -> None:
        self._soon(self.pictures.take, camera, picture)

    def held(self) -> Mapping[str, HeldSwitches]:
        """Returns what is pressed of each arm now."""
        with self._lock:
            self.control.watch(clock.monotonic())
            return {arm: replace(switches) for arm, switches in self.control.switches.items()}

    def close(self) -> None:
        """Stops the server and closes the pages' connections."""
        close_s = 2.0
        self.stop()
        self._thread.join(close_s)

    def _controller(self) -> dict[str, Any] | None:
        controller = self.control.controller
        if controller is None:
            return None
        return {"name": controller.page.name, "for": clock.monotonic() - controller.since}

    def _take_state(self, text: str) -> None:
        self._state = text
        self._news.set_result(None)
        self._news = self._loop.create_future()

    def _say_code(self) -> None:
        self._tell_code(self.control.access.sentence("page of the cockpit"))

    def _subprotocol(self, connection: ServerConnection, offered: Sequence[Subprotocol]) -> Subprotocol | None:
        return offered[0] if offered and self._path(connection) == self.scene_path else None

    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        pages = {
            "/": lambda: page_response(self._page, ("Content-Security-Policy", "frame-ancestors 'none'")),
            "/pictures.js": lambda: page_response(self._script, kind="text/javascript"),
        }
        scenes = (self.scene_path, f"{self.scene_path}/{self.control.access.ticket}")
        for scene in scenes:
            pages[scene] = lambda: page_response(self._scene_html, *SCENE_HEADERS)
        answer = self._answer(connection, request, pages, ("/state", "/control", "/pictures", *scenes), scenes)
        if request.path.partition("?")[0] != self.scene_path or (answer is not None and answer.status_code != 200):
            return answer
        if self._openings.admit(connection.remote_address[0], clock.monotonic()):
            return answer
        refused = connection.respond(429, "Too many pages open the scene; this one tries again.\n")
        refused.headers["Refresh"] = f"{OPENINGS_S:g}"
        return refused

    async def _converse(self, connection: ServerConnection) -> None:
        path = self._path(connection)
        whole = connection.request.path if connection.request else ""
        # The ticket stands in addresses, so perhaps in the log of a proxy: where the stop comes from, only a key keeps.
        kept = path != "/control" and self.control.access.has_ticket(whole)
        keep = functools.partial(self._keep, connection) if kept else None
        if path == "/pictures":
            await self.pictures.converse(connection, keep)
            return
        place = self._limits[path].enter(connection.remote_address[0], cutter(connection), kept)
        if place is None:
            await connection.close(BUSY, "too many pages are open already")
            return
        if keep is not None:
            keep()
        try:
            with contextlib.suppress(ConnectionClosed, asyncio.TimeoutError):
                if path == "/control":
                    await self._take_commands(connection, place)
                else:
                    await (self._show_state if path == "/state" else self._pass_scene)(connection)
        finally:
            self._limits[path].leave(place)

    def _path(self, connection: ServerConnection) -> str:
        path = connection.request.path.partition("?")[0] if connection.request else ""
        return self.scene_path if path.startswith(self.scene_path) else path

    async def _show_state(self, connection: ServerConnection) -> None:
        self._open_pages += 1
        reader = asyncio.ensure_future(_drain(connection))
        try:
            while True:
                news = self._news
                await asyncio.wait_for(connection.send(self._state), SEND_S)
                await asyncio.wait((news, reader), return_when=asyncio.FIRST_COMPLETED)
                if reader.done():
                    return
        finally:
            self._open_pages -= 1
            reader.cancel()

    async def _pass_scene(self, connection: ServerConnection) -> None:
        host, port = self._scene.address
        subprotocols = [connection.subprotocol] if connection.subprotocol else None
        self._open_scenes += 1
        try:
            async with client.connect(
                f"ws://{host}:{port}/", subprotocols=subprotocols, compression=None, max_size=None, write_limit=1
            ) as scene:
                ways = [asyncio.ensure_future(_pass(*way)) for way in ((connection, scene), (scene, connection))]
                try:
                    await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    for way in ways:
                        way.cancel()
                    await asyncio.gather(*ways, return_exceptions=True)
        except (OSError, InvalidHandshake):
            await connection.close(BUSY, "the scene does not answer")
        finally:
            self._open_scenes -= 1

    async def _take_commands(self, connection: ServerConnection, place: Place) -> None:
        address = connection.remote_address[0]
        self._number += 1
        page = CockpitPage(f"Page {self._number} at {address}")
        self._open_pages += 1
        second, count = 0, 0
        try:
            while True:
                text = await asyncio.wait_for(connection.recv(), GONE_S if page.key else SECRET_S)
                before, second = second, int(clock.monotonic())
                count = count + 1 if second == before else 1
                if count > MAX_RATE and not page.key:
                    await connection.close(REFUSED, "too many messages")
                    return
                if count > MAX_RATE and text != STOP_TEXT:  # after a pause of the page or of the connection
                    continue
                with self._lock:
                    answer = self._answer_command(page, text, address)
                if page.key and not place.kept:
                    place.kept = True
                    self._keep(connection)
                if answer:
                    await asyncio.wait_for(connection.send(json.dumps(answer)), SEND_S)
        finally:
            self._open_pages -= 1
            with self._lock:
                self.control.give(page)

    def _answer_command(self, page: CockpitPage, text: str | bytes, address: str) -> dict[str, Any] | None:
        control, now = self.control, clock.monotonic()
        control.access.use(page.key, now)
        try:
            command = read_command(text, control.arms)
        except PageMessageFault as fault:
            return {"refused": str(fault)}
        if command.name == SECRET:
            code = control.access.code
            refused = control.admit(page, command.value, address, now)
            if control.access.code != code:
                self._say_code()
            if refused:
                return {"refused": refused, "code": False}
            return {"key": page.key, "name": page.name, "ticket": control.access.ticket}
        if command.name == BEAT:
            focused, held = command.value
            control.beat(page, focused, held, now, now - command.heard)
            return {"heard": now}
        if command.name == STOP:
            if not page.key:
                return {"refused": "Only a page that has sent the code can do that."}
            self._stop()
            return {"done": "The Emergency Stop was sent."}
        if command.name == TAKE:
            refused = control.take(page, now)
            return {"refused": refused} if refused else {"control": True}
        if command.name == GIVE:
            control.give(page)
            return {"control": False}
        refused = control.refusal(page, now, now - command.heard)
        if refused:
            return {"refused": refused}
        self._obey(command)
        return None


async def _drain(connection: ServerConnection) -> None:
    """Reads what nobody wants until the connection ends."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            await connection.recv()


async def _pass(source: Any, sink: Any) -> None:
    with contextlib.suppress(ConnectionClosed):
        while True:
            await sink.send(await source.recv())
