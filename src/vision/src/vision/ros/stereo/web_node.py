"""The node stereo_web: serves the headset view as a page for headsets and phones, with its images on the same port. The
page requests an image by a message on a WebSocket at /pictures, and the next one once it has shown it, so that no image
waits in a queue. Each answer is one text message, {"picture": true, "tangents": [left, right, up, down], "deep": ...},
and then the JPEG with both eyes side by side; or {"picture": false} if no new image arrived for a while. Both have the
rows of the operator's view beside it, if there are any: "rows": [{name, text, tone, kind, labels, values}, ...]. The
node subscribes to camera and view only while a page is open. With ~web/hands a headset's page also sends the person's
hands, on a WebSocket at /hands (leap_motion.headset.transport)."""

from __future__ import annotations

import asyncio
import contextlib
import json
import pathlib
import socket
import ssl
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass

import cv2
import numpy as np
import rospkg
import rospy
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from common import clock
from common.errors import DeviceError
from common.operator_rows import OLD_ROWS_S, rows_of
from common.ros.diagnostics import Diagnostics
from common.ros.on_demand import OnDemand
from common.ros.params import private_config
from leap_motion.headset.transport import MAX_MESSAGE_BYTES
from leap_motion.service.access import ConnectionLimits, is_loopback, is_own_host
from leap_motion.service.certificate import Certificate, CertificateError, own_certificate
from leap_motion.service.socket_service import SEND_S, SocketService, listen, own_names
from rig_msgs.msg import OperatorView
from vision.ros.stereo.eye_images import ShownView, StereoImageSource
from vision.ros.stereo.headset_hands import HeadsetHands
from vision.stereo.view import StereoViewConfig, WebConfig


@dataclass(frozen=True)
class StereoFrame:
    """An image for the page."""

    jpeg: bytes  # both eyes side by side
    tangents: tuple[float, float, float, float]  # tan(angle) to the edges: left, right, up, down
    deep: bool  # whether the eye images differ by depth


class StereoWeb(SocketService):
    """A server in a thread of its own; `address` is its page's, `fingerprint` its certificate's. `converse` serves
    /hands, if there is to be that. Raises DeviceError without page, certificate or port."""

    max_message_bytes = MAX_MESSAGE_BYTES
    write_limit = 1  # an image that waits would be late

    def __init__(
        self, config: WebConfig, converse: Callable[[ServerConnection], Awaitable[None]] | None = None
    ) -> None:
        max_pages = 6
        pages_of_address = 3
        super().__init__()
        self._hands = converse
        self._frame: StereoFrame | None = None
        self._number = 0
        self._next = self._loop.create_future()  # done when the next image is there
        self._view: tuple[list[dict], float] = [], 0.0  # rows and when they came [s]
        self._pages: list[ServerConnection] = []
        self._limits = ConnectionLimits(max_pages, pages_of_address)
        self._names = () if is_loopback(config.host) else (*own_names(), config.name)
        self.fingerprint = ""
        try:
            self._page = pathlib.Path(config.page).read_bytes()
            tls = self._tls(config)
            listener = listen(config.host, config.port)
        except (CertificateError, OSError, OverflowError) as error:
            fault = f"Cannot serve the page on {config.host}:{config.port}: {error}"
            raise DeviceError(f"{fault.rstrip('.')}. Check page and certificate, or choose another port.") from error
        self._open(listener, tls)
        self._scheme = "https" if tls else "http"
        self.address = f"{self._scheme}://{_reachable(config.host)}:{listener.getsockname()[1]}/"
        self._thread = clock.Thread(target=self.run, name="web", daemon=True)
        self._thread.start()

    def _tls(self, config: WebConfig) -> ssl.SSLContext | None:
        if config.certificate:
            certificate = Certificate(config.certificate, config.key)
        elif self._hands:  # a browser gives hands to a secure page only
            certificate = own_certificate(pathlib.Path(rospkg.get_ros_home()) / "leap_rig" / "headset")
        else:
            return None
        self.fingerprint = certificate.fingerprint()
        return certificate.server()

    @property
    def watched(self) -> bool:
        return bool(self._pages)

    def put(self, frame: StereoFrame) -> None:
        """Sends an image to every page that has shown the previous one."""
        self._soon(self._take, frame)

    def put_view(self, message: OperatorView) -> None:
        """Sends the rows of the operator's view with the next answers."""
        rows = [{**asdict(row), "tone": row.tone.value} for row in rows_of(message.rows)]
        self._view = rows, clock.monotonic()

    def close(self) -> None:
        """Stops the server and closes the pages' connections."""
        close_s = 2.0
        self.stop()
        self._thread.join(close_s)

    def _take(self, frame: StereoFrame) -> None:
        self._frame = frame
        self._number += 1
        self._next.set_result(None)
        self._next = self._loop.create_future()

    def _more(self) -> dict[str, object]:
        rows, at = self._view
        more: dict[str, object] = {"hands": True} if self._hands else {}
        return {**more, "rows": rows} if rows and clock.monotonic() - at <= OLD_ROWS_S else more

    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answers requests without a WebSocket, and refuses the pages of other sites."""
        host = request.headers.get("Host", "")
        if not is_own_host(host, connection.local_address[0], self._names):
            return connection.respond(403, "Ask for this page by the address that the rig shows.\n")
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

    async def _converse(self, connection: ServerConnection) -> None:
        if self._hands and connection.request.path == "/hands":
            await self._hands(connection)
            return
        address = connection.remote_address[0]
        if not self._limits.enter(address):
            await connection.close(1013, "too many pages are open already")
            return
        self._pages.append(connection)
        with contextlib.suppress(ConnectionClosed, asyncio.TimeoutError):
            try:
                await self._show(connection)
            finally:
                self._pages.remove(connection)
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
            frame = self._frame
            if frame is None or self._number == shown:
                await asyncio.wait_for(page.send(json.dumps({"picture": False, **self._more()})), SEND_S)
                continue
            shown = self._number
            about = {"picture": True, "tangents": frame.tangents, "deep": frame.deep, **self._more()}
            await asyncio.wait_for(page.send(json.dumps(about)), SEND_S)
            await asyncio.wait_for(page.send(frame.jpeg), SEND_S)


def _reachable(host: str) -> str:
    """Returns the address at which other machines find this one, for a host that stands for all addresses."""
    if host == "0.0.0.0":
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))  # sends nothing, but chooses the interface
            return probe.getsockname()[0]
    return host


def main() -> None:
    refresh_s = 0.2
    cv2.setNumThreads(1)  # images this small take more processor time when shared
    config = private_config(StereoViewConfig, "view")
    settings = private_config(WebConfig, "web")
    hands = HeadsetHands(settings) if settings.hands else None
    web = StereoWeb(settings, hands and hands.converse)
    (rospy.logwarn if hands else rospy.loginfo)("The view is at %s", web.address)
    if web.fingerprint:
        rospy.loginfo("The fingerprint (SHA-256) of its certificate is %s", web.fingerprint)
    images = StereoImageSource(config)
    view = OnDemand(lambda: [rospy.Subscriber("operator_view/rows", OperatorView, web.put_view, queue_size=1)])
    Diagnostics("stereo_web", images.diagnose)
    try:
        while not rospy.is_shutdown():
            images.subscribe(web.watched)
            view(web.watched)
            if hands:
                hands.watch()
            shown = images.wait(refresh_s)
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
