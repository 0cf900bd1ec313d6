"""The hands of the headset's page as a Leap service, and what the page draws of the rig: box, desired tool, state."""

from __future__ import annotations

import rospy
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.errors import DeviceError
from common.frames import TOOL_DESIRED, VIRTUAL_LEAP
from common.ros.on_demand import OnDemand
from common.ros.raw_tf import TransformSearch
from common.ros.sentence_writer import SentenceWriter
from common.teleop_record import teleop_record
from leap_motion.headset.hand_stream import HandFrame, HandStream
from leap_motion.headset.transport import HandsEndpoint, Scene
from leap_motion.service import wire
from leap_motion.service.server import LeapService, LeapServiceError
from rig_msgs.msg import TeleopState
from vision.stereo.view import WebConfig

FRESH_S = 0.3  # an older desired tool is not drawn


class RigScene:
    """Called, returns what leap_kuka publishes. `watch` listens to the desired tool as well."""

    def __init__(self) -> None:
        height_m = 0.35  # of the box above the Leap, until leap_kuka publishes it
        buffer_bytes = 2**20
        self._height, self._box = height_m, {}
        self._tool: tuple[list[float], float] = [], -FRESH_S
        self._steers, self._find = False, TransformSearch(VIRTUAL_LEAP, TOOL_DESIRED)
        options = {"buff_size": buffer_bytes, "tcp_nodelay": True}
        self.watch = OnDemand(lambda: [rospy.Subscriber("/tf", rospy.AnyMsg, self._take_tool, **options)])
        rospy.Subscriber("leap_kuka/interaction_box", MarkerArray, self._take_box, queue_size=1)
        rospy.Subscriber("leap_kuka/state", TeleopState, self._take_state, queue_size=1)

    def __call__(self) -> Scene:
        tool, at = self._tool
        drawn = {**self._box, "tool": tool} if clock.monotonic() - at < FRESH_S else self._box
        return Scene(self._height, self._steers, drawn)

    def _take_box(self, message: MarkerArray) -> None:
        for marker in message.markers:
            if marker.type == Marker.LINE_LIST and marker.points:
                centre, corner, colour = marker.pose.position, marker.points[0], marker.color
                size = [2.0 * abs(length) for length in (corner.x, corner.y, corner.z)]
                self._box = {"box": [centre.x, centre.y, centre.z, *size], "colour": [colour.r, colour.g, colour.b]}
                self._height = centre.y

    def _take_state(self, message: TeleopState) -> None:
        self._steers = teleop_record(message).running

    def _take_tool(self, message: rospy.AnyMsg) -> None:
        tool = self._find(message)
        if tool is not None:
            self._tool = list(tool.numbers), clock.monotonic()


class HeadsetHands:
    """Serves the hands of one headset on the port of a Leap service, in a thread; `endpoint` takes the page's
    socket. Raises DeviceError if the port is taken."""

    def __init__(self, config: WebConfig) -> None:
        try:
            self._service = LeapService(port=config.leap_port, serial="WebXR")
        except LeapServiceError as error:
            raise DeviceError(str(error)) from error
        self._frames = 0
        self._scene = RigScene()
        stream = HandStream(config.box_ahead, config.box_below)
        log, terminal = SentenceWriter(lambda text: rospy.logwarn("%s", text)), SentenceWriter()
        self.endpoint = HandsEndpoint(stream, self, self._scene, log.show, terminal.show)
        self._thread = clock.Thread(target=self._service.run, name="leap service", daemon=True)
        self._thread.start()

    def offer(self, frame: HandFrame) -> None:
        """Sends a frame to the clients of the Leap service."""
        self._frames += 1
        text = wire.frame(frame.hands, frame.rate).text(self._frames, round(1e6 * frame.time))
        self._service.offer(text)

    def plug(self, attached: bool) -> None:
        """Tells the clients of the Leap service whether a headset is there."""
        self._service.plug(attached)

    def watch(self) -> None:
        """Listens to what the page draws while a headset drives."""
        self._scene.watch.follow(self.endpoint.driven)

    def close(self) -> None:
        close_s = 2.0
        self._service.stop()
        self._thread.join(close_s)
