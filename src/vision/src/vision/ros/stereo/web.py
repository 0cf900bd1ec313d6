"""Serves the page and its pictures on one port.

The page asks for a picture by a message on a WebSocket at /pictures, and asks again once it has shown it, so that no
picture waits in a queue. Each answer is one text message, {"picture": true, "tangents": [left, right, up, down],
"deep": ...}, and then the JPEG with both eyes side by side; or {"picture": false} if no new one came for a while.
"""

from __future__ import annotations

import json
import logging
import pathlib
import ssl
import threading
from dataclasses import dataclass

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from common.errors import DeviceError
from vision.node_parameters import WebConfig

SILENCE_S = 0.5
"""Without a new picture for so long the page is told so."""
REQUEST_S = 10.0
"""A page that asks for nothing for so long is gone."""
CLOSE_S = 1.0
MAX_PAGES = 4
LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True)
class Frame:
    """A picture on its way.

    Attributes:
        jpeg: both eyes side by side.
        tangents: tan(angle) of the edges of each eye's picture, to the left, right, up and down.
        deep: whether the eyes' pictures differ by depth.
    """

    jpeg: bytes
    tangents: tuple[float, float, float, float]
    deep: bool


class StereoWeb:
    """A server in threads of its own.

    Args:
        config: where the page is.

    Attributes:
        address: of the page.

    Raises:
        DeviceError: the page, the certificate or the port is not to be had.
    """

    def __init__(self, config: WebConfig) -> None:
        self._frame: Frame | None = None
        self._number = 0
        self._pages: set[ServerConnection] = set()
        self._change = threading.Condition()
        self._local = config.host in LOOPBACK
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        try:
            self._page = pathlib.Path(config.page).read_bytes()
            tls = None
            if config.certificate:
                tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
                tls.load_cert_chain(config.certificate, config.key)
            self._server = serve(
                self._converse,
                config.host,
                config.port,
                process_request=self._meet,
                ssl=tls,
                compression=None,
                close_timeout=CLOSE_S,
            )
        except (OSError, OverflowError) as error:
            raise DeviceError(f"The page cannot be served on {config.host}:{config.port}: {error}.") from error
        port = self._server.socket.getsockname()[1]
        self._scheme = "https" if tls else "http"
        self.address = f"{self._scheme}://{config.host}:{port}/"
        threading.Thread(target=self._server.serve_forever, name="web", daemon=True).start()

    @property
    def watched(self) -> bool:
        """Whether a page shows the pictures."""
        return bool(self._pages)

    def put(self, frame: Frame) -> None:
        """Sends a picture to every page that has shown the one before."""
        with self._change:
            self._frame = frame
            self._number += 1
            self._change.notify_all()

    def close(self) -> None:
        """Ends the server and says so to the pages."""
        self._server.shutdown()
        with self._change:
            pages = list(self._pages)
        for connection in pages:
            connection.close(1001)

    def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answers whatever asks for no WebSocket, and keeps other sites' pages from the camera."""
        host = request.headers.get("Host", "")
        if self._local and host.rpartition(":")[0].strip("[]") not in LOOPBACK:
            return connection.respond(403, "This page is for this computer only.\n")
        if request.path.partition("?")[0] == "/":
            headers = Headers([("Content-Type", "text/html; charset=utf-8"), ("Content-Length", str(len(self._page)))])
            headers["Connection"] = "close"
            headers["Cache-Control"] = "no-store"
            return Response(200, "OK", headers, self._page)
        if request.path != "/pictures":
            return connection.respond(404, "There is nothing here.\n")
        if request.headers.get("Origin", f"{self._scheme}://{host}") != f"{self._scheme}://{host}":
            return connection.respond(403, "These pictures are for their own page only.\n")
        return None

    def _converse(self, connection: ServerConnection) -> None:
        with self._change:
            if len(self._pages) >= MAX_PAGES:
                connection.close(1013, f"{MAX_PAGES} pages look already")
                return
            self._pages.add(connection)
        shown = self._number
        try:
            while True:
                connection.recv(timeout=REQUEST_S)
                number, frame = self._after(shown)
                if number == shown:
                    connection.send(json.dumps({"picture": False}))
                    continue
                shown = number
                connection.send(json.dumps({"picture": True, "tangents": frame.tangents, "deep": frame.deep}))
                connection.send(frame.jpeg)
        except (ConnectionClosed, TimeoutError):
            pass
        finally:
            with self._change:
                self._pages.remove(connection)

    def _after(self, number: int) -> tuple[int, Frame | None]:
        """Returns the newest picture and its number, which is the one given if none came for a while."""
        with self._change:
            self._change.wait_for(lambda: self._number > number, SILENCE_S)
            return self._number, self._frame
