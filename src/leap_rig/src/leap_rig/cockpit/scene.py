"""The 3-D scene of the cockpit: a server of viser, which draws in the browser what RViz draws on a screen."""

from __future__ import annotations

from pathlib import Path

import rich
import viser

LOOPBACK = "127.0.0.1"


class SceneServer:
    """The scene and its server, on a free port of this machine alone: who lets a page from elsewhere see it passes
    `page` and the WebSocket on. Nothing that a page sends there has an effect but on its own view."""

    def __init__(self) -> None:
        rich.get_console().quiet = True  # viser prints its address, which is of no use to anybody
        self._server = viser.ViserServer(host=LOOPBACK, port=0, verbose=False)
        # Of what a page may send, its camera alone is taken: viser would else build a tunnel to a server on the
        # internet for whoever asks, or keep a file of any size.
        self._server._websock_server._incoming_handlers.clear()

    @property
    def port(self) -> int:
        return self._server.get_port()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, where both the page and, at the path /, its WebSocket are."""
        return LOOPBACK, self.port

    @property
    def page(self) -> Path:
        """The one file of the page; it needs no other."""
        return Path(viser.__file__).parent / "client" / "build" / "index.html"

    @property
    def viewers(self) -> int:
        """How many pages show the scene."""
        return len(self._server.get_clients())

    def close(self) -> None:
        self._server.stop()
