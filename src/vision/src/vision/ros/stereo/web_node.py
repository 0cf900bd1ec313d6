"""The node stereo_web: serves the headset view as a page for headsets and phones, with its images on the same port. The
page requests an image by a message on a WebSocket at /pictures, and the next one once it has shown it, so that no image
waits in a queue. Each answer is one text message, {"picture": true, "tangents": [left, right, up, down], "deep": ...},
and then the JPEG with both eyes side by side; or {"picture": false} if no new image arrived for a while. Both have the
rows of the operator's view beside it, if there are any: "rows": [{name, text, tone, kind, labels, values}, ...]. The
node subscribes to camera and view only while a page is open. With ~web/hands a headset's page also sends the person's
hands, on a WebSocket at /hands (leap_motion.headset.transport).
"""

from __future__ import annotations

import contextlib
import json
import logging
import pathlib
import socket
import ssl
from collections.abc import Callable
from dataclasses import asdict, dataclass

import cv2
import numpy as np
import rospkg
import rospy
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from common import clock
from common.errors import DeviceError
from common.operator_rows import OLD_ROWS_S, rows_of
from common.ros.diagnostics import Diagnostics
from common.ros.on_demand import OnDemand
from common.ros.params import private_config
from leap_motion.headset.transport import MAX_MESSAGE_BYTES
from rig_msgs.msg import OperatorView
from vision.ros.stereo.certificate import own_certificate
from vision.ros.stereo.eye_images import ShownView, StereoImageSource
from vision.ros.stereo.headset_hands import HeadsetHands
from vision.stereo.view import StereoViewConfig, WebConfig

REFRESH_S = 0.2
SILENCE_S = 0.5  # the page is notified after this time without a new image
REQUEST_S = 10.0  # a page without a request for this time is gone
CLOSE_S = 1.0
MAX_PAGES = 4
LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True)
class StereoFrame:
    """An image for the page."""

    jpeg: bytes  # both eyes side by side
    tangents: tuple[float, float, float, float]  # tan(angle) to the edges: left, right, up, down
    deep: bool  # whether the eye images differ by depth


class StereoWeb:
    """A server in threads of its own; `address` is its page's. `converse` serves /hands, if there is to be that.

    Raises DeviceError without page, certificate or port.
    """

    def __init__(self, config: WebConfig, converse: Callable[[ServerConnection], None] | None = None) -> None:
        self._hands = converse
        self._frame: StereoFrame | None = None
        self._number = 0
        self._view: tuple[list[dict], float] = [], 0.0  # rows and when they came [s]
        self._pages: set[ServerConnection] = set()
        self._others: set[ServerConnection] = set()
        self._change = clock.Condition()
        self._local = config.host in LOOPBACK
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        try:
            self._page = pathlib.Path(config.page).read_bytes()
            tls = None
            files = config.certificate, config.key
            if converse and not config.certificate:  # a browser gives hands to a secure page only
                files = own_certificate(pathlib.Path(rospkg.get_ros_home()) / "leap_rig" / "headset")
            if files[0]:
                tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
                tls.load_cert_chain(*files)
            options = {"process_request": self._answer, "ssl": tls, "compression": None, "close_timeout": CLOSE_S}
            options["max_size"] = MAX_MESSAGE_BYTES
            self._server = serve(self._converse, config.host, config.port, **options)
        except (OSError, OverflowError) as error:
            fault = f"Cannot serve the page on {config.host}:{config.port}: {error}."
            raise DeviceError(f"{fault} Check page and certificate, or choose another port.") from error
        port = self._server.socket.getsockname()[1]
        self._scheme = "https" if tls else "http"
        self.address = f"{self._scheme}://{_reachable(config.host)}:{port}/"
        clock.Thread(target=self._server.serve_forever, name="web", daemon=True).start()

    @property
    def watched(self) -> bool:
        """Whether a page is open."""
        return bool(self._pages)

    def put(self, frame: StereoFrame) -> None:
        """Sends an image to every page that has shown the previous one."""
        with self._change:
            self._frame = frame
            self._number += 1
            self._change.notify_all()

    def put_view(self, message: OperatorView) -> None:
        """Sends the rows of the operator's view with the next answers."""
        rows = [{**asdict(row), "tone": row.tone.value} for row in rows_of(message.rows)]
        self._view = rows, clock.monotonic()

    def _more(self) -> dict[str, object]:
        rows, at = self._view
        more: dict[str, object] = {"hands": True} if self._hands else {}
        return {**more, "rows": rows} if rows and clock.monotonic() - at <= OLD_ROWS_S else more

    def close(self) -> None:
        """Stops the server and closes the pages' connections."""
        self._server.shutdown()
        with self._change:
            open_ones = [*self._pages, *self._others]
        for connection in open_ones:
            connection.close(1001)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answers requests without a WebSocket, and refuses the pages of other sites."""
        host = request.headers.get("Host", "")
        if self._local and host.rpartition(":")[0].strip("[]") not in LOOPBACK:
            return connection.respond(403, "This page is for this computer only.\n")
        if request.path.partition("?")[0] == "/":
            headers = Headers([("Content-Type", "text/html; charset=utf-8"), ("Content-Length", str(len(self._page)))])
            headers["Connection"] = "close"
            headers["Cache-Control"] = "no-store"
            return Response(200, "OK", headers, self._page)
        if request.path not in (("/pictures", "/hands") if self._hands else ("/pictures",)):
            return connection.respond(404, "Not found.\n")
        if request.headers.get("Origin", f"{self._scheme}://{host}") != f"{self._scheme}://{host}":
            return connection.respond(403, "This is for its own page only.\n")
        return None

    def _converse(self, connection: ServerConnection) -> None:
        if self._hands and connection.request.path == "/hands":
            with self._change:
                self._others.add(connection)
            try:
                self._hands(connection)
            finally:
                with self._change:
                    self._others.discard(connection)
            return
        with self._change:
            if len(self._pages) >= MAX_PAGES:
                connection.close(1013, f"{MAX_PAGES} pages are open already")
                return
            self._pages.add(connection)
        shown = self._number
        try:
            while True:
                connection.recv(timeout=REQUEST_S)
                number, frame = self._after(shown)
                if number == shown:
                    connection.send(json.dumps({"picture": False, **self._more()}))
                    continue
                shown = number
                about = {"picture": True, "tangents": frame.tangents, "deep": frame.deep, **self._more()}
                connection.send(json.dumps(about))
                connection.send(frame.jpeg)
        except (ConnectionClosed, TimeoutError):
            pass
        finally:
            with self._change:
                self._pages.remove(connection)

    def _after(self, number: int) -> tuple[int, StereoFrame | None]:
        """Returns the newest image and its number, which is the given one if none arrived for SILENCE_S."""
        with self._change:
            self._change.wait_for(lambda: self._number > number, SILENCE_S)
            return self._number, self._frame


def _reachable(host: str) -> str:
    """Returns the address at which other machines find this one, for a host that stands for all addresses."""
    if host == "0.0.0.0":
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))  # sends nothing, but chooses the interface
            return probe.getsockname()[0]
    return host


def main() -> None:
    """Runs the node with its private parameters."""
    cv2.setNumThreads(1)  # images this small take more processor time when shared
    config = private_config(StereoViewConfig, "view")
    settings = private_config(WebConfig, "web")
    hands = HeadsetHands(settings) if settings.hands else None
    web = StereoWeb(settings, hands and hands.converse)
    (rospy.logwarn if hands else rospy.loginfo)("The view is at %s", web.address)
    images = StereoImageSource(config)
    view = OnDemand(lambda: [rospy.Subscriber("operator_view/rows", OperatorView, web.put_view, queue_size=1)])
    Diagnostics("stereo_web", images.diagnose)
    try:
        while not rospy.is_shutdown():
            images.subscribe(web.watched)
            view(web.watched)
            if hands:
                hands.watch()
            shown = images.wait(REFRESH_S)
            if shown is not None and shown.new and web.watched:
                web.put(_frame(shown, config.jpeg_quality))
    finally:
        web.close()
        if hands:
            hands.close()


def _frame(shown: ShownView, quality: int) -> StereoFrame:
    image = np.hstack((shown.eyes.left, shown.eyes.right))
    _, jpeg = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return StereoFrame(jpeg.tobytes(), shown.view.tangents, shown.eyes.deep)
