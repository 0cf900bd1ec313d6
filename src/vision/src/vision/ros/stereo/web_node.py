"""The node stereo_web: serves the headset view as a page for headsets and phones, with its images on the same port,
both eyes side by side, on a WebSocket at /pictures (vision.stereo.transport). An answer has {"tangents": [left, right,
up, down], "deep": ...} of its image, and the rows of the operator's view, if there are any: "rows": [{name, text, tone,
kind, labels, values}, ...]. The node subscribes to camera and view only while a page is open. With ~web/hands a
headset's page also sends the person's hands, on a WebSocket at /hands (leap_motion.headset.transport)."""

from __future__ import annotations

import functools
import pathlib
from dataclasses import asdict

import cv2
import numpy as np
import rospkg
import rospy
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from common import clock
from common.errors import DeviceError
from common.operator_rows import OLD_ROWS_S, rows_of
from common.ros.diagnostics import Diagnostics
from common.ros.node import repeat
from common.ros.on_demand import OnDemand
from common.ros.params import private_config
from leap_motion.headset.transport import MAX_MESSAGE_BYTES, HandsEndpoint
from leap_motion.service.access import is_loopback
from leap_motion.service.certificate import Certificate, CertificateError, own_certificate
from leap_motion.service.socket_service import PageService, page_response
from rig_msgs.msg import OperatorView
from vision.ros.stereo.eye_images import ShownView, StereoImageSource
from vision.ros.stereo.headset_hands import HeadsetHands
from vision.stereo import webrtc
from vision.stereo.transport import JPEG, Picture, PictureStream
from vision.stereo.view import StereoViewConfig, WebConfig

CAMERA = "camera"


class StereoWeb(PageService):
    """A server in a thread of its own; `address` is its page's, `fingerprint` its certificate's. `hands` serves
    /hands, if there is to be that. Raises DeviceError without page, certificate or port."""

    max_message_bytes = MAX_MESSAGE_BYTES
    write_limit = 1  # an image that waits would be late

    def __init__(
        self,
        config: WebConfig,
        hands: HandsEndpoint | None = None,
        jpeg_quality: int = 80,
    ) -> None:
        max_pages = 6
        pages_of_address = 3
        self._hands, self._only_view = hands, config.only_view
        self._view: tuple[list[dict], float] = [], 0.0  # rows and when they came [s]
        try:
            page = pathlib.Path(config.page)
            self._page, self._script = page.read_bytes(), page.with_name("pictures.js").read_bytes()
            super().__init__(config.host, config.port, config.name, self._certificate(config), config.public)
        except (CertificateError, OSError, OverflowError) as error:
            fault = f"Cannot serve the page on {config.host}:{config.port}: {error}"
            raise DeviceError(f"{fault.rstrip('.')}. Check page and certificate, or choose another port.") from error
        self._pictures = PictureStream(
            self._loop, self._more, max_pages, pages_of_address, jpeg_quality, config.video, (CAMERA,)
        )
        self._thread = clock.Thread(target=self.run, name="web", daemon=True)
        self._thread.start()

    def _certificate(self, config: WebConfig) -> Certificate | None:
        if config.certificate:
            return Certificate(config.certificate, config.key)
        if self._hands:  # a browser gives hands to a secure page only
            return own_certificate(pathlib.Path(rospkg.get_ros_home()) / "leap_rig" / "headset")
        return None

    @property
    def watched(self) -> bool:
        return self._pictures.watched(CAMERA)

    def put(self, picture: Picture) -> None:
        """Sends an image to every page that has shown the previous one."""
        self._soon(self._pictures.take, CAMERA, picture)

    def put_view(self, message: OperatorView) -> None:
        """Sends the rows of the operator's view with the next answers."""
        rows = [{**asdict(row), "tone": row.tone.value} for row in rows_of(message.rows)]
        self._view = rows, clock.monotonic()

    def close(self) -> None:
        """Stops the server and closes the pages' connections."""
        close_s = 2.0
        self.stop()
        self._thread.join(close_s)

    def _more(self) -> dict[str, object]:
        rows, at = self._view
        more: dict[str, object] = {"hands": True} if self._hands else {}
        if self._only_view:
            more["only_view"] = True
        return {**more, "rows": rows} if rows and clock.monotonic() - at <= OLD_ROWS_S else more

    async def _meet(self, connection: ServerConnection, request: Request) -> Response | None:
        sockets = ("/pictures", "/hands") if self._hands else ("/pictures",)
        pages = {
            "/": lambda: page_response(self._page),
            "/pictures.js": lambda: page_response(self._script, kind="text/javascript"),
        }
        return self._answer(connection, request, pages, sockets)

    async def _converse(self, connection: ServerConnection) -> None:
        keep, path = functools.partial(self._keep, connection), connection.request.path
        if self._hands and path == "/hands":
            await self._hands.converse(connection, keep)
            return
        kept = self._hands is not None and self._hands.access.has_ticket(path)
        await self._pictures.converse(connection, keep if kept else None)


def main() -> None:
    refresh_s = 0.2
    cv2.setNumThreads(1)  # images this small take more processor time when shared
    config = private_config(StereoViewConfig, "view")
    settings = private_config(WebConfig, "web")
    hands = HeadsetHands(settings) if settings.hands else None
    web = StereoWeb(settings, hands and hands.endpoint, config.jpeg_quality)
    (rospy.logwarn if hands else rospy.loginfo)("The view is at %s", web.address)
    if settings.video != JPEG and not is_loopback(settings.host) and webrtc.missing():
        rospy.logwarn("%s", webrtc.missing())
    if web.fingerprint:
        rospy.loginfo("The fingerprint (SHA-256) of its certificate is %s", web.fingerprint)
    images = StereoImageSource(config)
    view = OnDemand(lambda: [rospy.Subscriber("operator_view/rows", OperatorView, web.put_view, queue_size=1)])
    Diagnostics("stereo_web", images.diagnose)

    def follow() -> None:
        images.subscribe.follow(web.watched)
        view.follow(web.watched)
        if hands:
            hands.watch()

    repeat(follow, refresh_s, "topics")  # beside the images: rospy waits for a master that hangs
    try:
        while not rospy.is_shutdown():
            shown = images.wait(refresh_s)
            if shown is not None and shown.new and web.watched:
                web.put(_picture(shown))
    finally:
        web.close()
        if hands:
            hands.close()


def _picture(shown: ShownView) -> Picture:
    now, age = clock.monotonic(), (rospy.Time.now() - shown.stamp).to_sec()
    about = {"tangents": shown.view.tangents, "deep": shown.eyes.deep}
    return Picture(np.hstack((shown.eyes.left, shown.eyes.right)), now - max(0.0, age), now, about)
