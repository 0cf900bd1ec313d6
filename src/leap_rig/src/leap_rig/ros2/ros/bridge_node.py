"""The node ros2_bridge: the rig's state to ROS 2, and from there desired tool frames and goals of kuka/move. It starts
the process that speaks ROS 2 (`side`) and ends with it. ROS 1 is listened to only where somebody in ROS 2 does."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path

import roslib.message
import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Vector3Stamped, Wrench, WrenchStamped
from sensor_msgs.msg import Image
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

import common.errors
from common import clock
from common.errors import DeviceError
from common.frames import TOOL_DESIRED
from common.ros.compressed_images import jpeg_from_image
from common.ros.diagnostics import Diagnostics
from common.ros.node import repeat, while_running
from common.ros.on_demand import OnDemand
from common.ros.params import arm_frames, private_config
from common.ros.raw_tf import connection_of, data_of, publisher_of
from common.sentences import without_numbers
from kuka_msgs.msg import MoveFeedback, MoveGoal, MoveResult
from leap_rig.ros2 import channels
from leap_rig.ros2.channels import COMPRESSED, DESCRIPTION, IMAGE, MOVE, STATE, STATUS, WRENCH, Channel
from leap_rig.ros2.config import SUBNET, Ros2BridgeConfig
from leap_rig.ros2.key_values import key_values
from leap_rig.ros2.outbox import MessageRateLimit, NewestFrames
from leap_rig.ros2.ros.bytes_of import bytes_of
from leap_rig.ros2.ros.desired_door import DesiredDoor
from leap_rig.ros2.ros.move_door import MoveDoor
from leap_rig.ros2.variables import side_variables
from leap_rig.ros2.wire import BridgeFault, frames, packed
from rig_msgs.msg import KukaStatus, TeleopState

WORKSPACE = Path(__file__).resolve().parents[6]
SOURCES = [str(Path(channels.__file__).parents[2]), str(Path(common.errors.__file__).parents[1])]
# Behind its own packages, whose names are those of ROS 1, too.
PROGRAM = f"import sys; sys.path.extend({SOURCES!r}); from leap_rig.ros2.ros.side import main; main()"
RESCUE = "from leap_rig.ros2.ros.cancel_program import main; main()"
SILENT_S = 15.0  # a ROS 2 side that has not reported for so long hangs, and at its start
LOOK_S = 0.5
REFUSED_S = 2.0  # /diagnostics show what was refused for so long
REMIND_S = 5.0
NEAR_S = 0.5  # between force and torque of a wrench
READ_BYTES = 2**22  # of a subscriber's buffer: rospy's own is smaller than an image


class Ros2Side:
    """The process that speaks ROS 2; `send` to it, `frames` from it. Raises DeviceError if it is not installed."""

    def __init__(self, config: Ros2BridgeConfig, request: dict) -> None:
        python = Path(config.python or WORKSPACE / ".venv-ros2" / "bin" / "python")
        if not python.is_file():
            raise DeviceError(
                f"ROS 2 is not installed: {python} is missing. `make ros2` installs it in the clone; from an install "
                "space, set ~python to the clone's .venv-ros2/bin/python."
            )
        profile = Path(rospkg.RosPack().get_path("leap_rig")) / "config" / "ros2_loopback.xml"
        if not profile.is_file():  # without it Fast DDS would open every interface
            raise DeviceError(f"{profile} is missing, which keeps ROS 2 on this machine: install leap_rig again.")
        self._connection, theirs = socket.socketpair()
        self._connection.settimeout(SILENT_S)
        variables = side_variables(os.environ, config.discovery, str(profile))
        with theirs:
            self._process = subprocess.Popen(
                [str(python), "-c", PROGRAM, json.dumps({**request, "socket": theirs.fileno()})],
                env=variables,
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C ends it by this node, which cancels motions before
            )
        self._outbox = NewestFrames()
        self.put = self._outbox.put
        self._writer = clock.Thread(target=self._write, name="to ROS 2", daemon=True)
        self._writer.start()

    def _write(self) -> None:
        try:
            while data := self._outbox.take():
                self._connection.sendall(data)
        except OSError:
            self.close()

    def receive(self, size: int) -> bytes:
        """Returns what came, nothing once it is closed; raises DeviceError if it is silent."""
        try:
            return self._connection.recv(size)
        except socket.timeout as error:
            raise DeviceError(f"The ROS 2 side has reported nothing for {SILENT_S:g} s, so the bridge ends.") from error
        except OSError:
            return b""

    def close(self) -> None:
        """Ends `receive` and the process, which ends with the connection."""
        self._outbox.close()
        if self._writer is not clock.current_thread():
            self._writer.join(1.0)  # what still waits
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def wait(self) -> int:
        """Returns the exit code of the process, which is killed if it does not end."""
        end_s = 5.0
        self.close()
        try:
            return self._process.wait(end_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()
        finally:
            self._connection.close()


class Ros2Bridge:
    """Passes messages between the ROS 2 side and ROS 1."""

    def __init__(self, config: Ros2BridgeConfig) -> None:
        self._config, self._name = config, rospy.get_name()
        self._arms = [f"{name}/" for name in config.arms] or [""]
        self._channels = {channel.topic: channel for channel in channels.channels(self._arms)}
        desired = [arm_frames(of)(TOOL_DESIRED) for of in self._arms] if config.moves else []
        moves = [f"{of}kuka/move" for of in self._arms]
        request = {
            "channels": [[c.number, c.topic, c.kind, c.depth, c.is_latched] for c in self._channels.values()],
            "desired": desired,
            "moves": moves,
            "definitions": {m._type: m._full_text for m in (TFMessage, MoveGoal, MoveResult, MoveFeedback)},
            "rescue": [sys.executable, "-c", RESCUE, *(rospy.resolve_name(move) for move in moves)],
        }
        self._side = Ros2Side(config, request)
        self._refused: tuple[float, str] = -REFUSED_S, ""
        self._passed, self._odd = 0, set()
        self._warnings = MessageRateLimit(1.0 / REMIND_S, 1)
        self._wanted: set[int] = set()
        kinds = {channel.kind for channel in self._channels.values()}
        self._md5sums = {kind: roslib.message.get_message_class(kind)._md5sum for kind in kinds}
        self._static: dict[str, object] = {}
        self._descriptions: dict[str, str] = {}
        self._force: dict[str, Vector3Stamped] = {}
        self._door = DesiredDoor(desired, self._refuse) if desired else None
        self._moves = [MoveDoor(move, partial(self._send_move, i)) for i, move in enumerate(moves) if desired]
        self._demand = {c.number: OnDemand(partial(self._listen, c)) for c in self._channels.values()}

    def run(self) -> None:
        """Passes messages until ROS shuts down; raises RigError if the ROS 2 side ends before."""
        rospy.on_shutdown(self._close)
        if rospy.is_shutdown():  # before: then nobody calls it
            self._close()
        repeat(self._look, LOOK_S, "look")
        repeat(self._ask_master, LOOK_S, "demand")
        Diagnostics("ros2_bridge", self._state)
        try:
            for channel, body in frames(self._side.receive):
                with while_running():
                    self._take(channel, body)
        finally:
            for move in self._moves:
                move.close()
            code = self._side.wait()
        if not rospy.core.is_shutdown_requested():
            raise DeviceError(f"The ROS 2 side has ended with exit code {code}, so the bridge ends.")

    def _close(self) -> None:
        for move in self._moves:
            move.close()
        self._side.close()

    def _take(self, channel: int, body: bytes) -> None:
        if channel == channels.WANTED:
            self._wanted = set(json.loads(body))
        elif channel == channels.FAULT:
            self._refuse(body.decode())
        elif self._door is not None and channel in (channels.DESIRED, channels.STATIC):
            node, _, data = body.partition(b"\0")
            (self._door.take if channel == channels.DESIRED else self._door.take_static)(node.decode(), data)
        elif self._moves:
            arm, number = MOVE.unpack_from(body)
            if channel == channels.GOAL:
                self._moves[arm].start(number, body[MOVE.size :])
            else:
                self._moves[arm].cancel(number)

    def _refuse(self, sentence: str) -> None:
        now = clock.monotonic()
        self._refused = now, sentence
        if self._warnings.passes(without_numbers(sentence), now):
            rospy.logwarn(sentence)

    def _state(self) -> tuple[int, str, dict[str, object]]:
        listened = sum(bool(demand.subscribers) for demand in self._demand.values())
        values = {"topics with subscribers": listened, "messages to ROS 2": self._passed}
        if self._door is not None:
            values["desired tool frames from ROS 2"] = self._door.taken
        at, sentence = self._refused
        if clock.monotonic() - at < REFUSED_S:
            return DiagnosticStatus.WARN, sentence, values
        may = "may move the arm" if self._door is not None else "reads only: ~network_motion is false"
        where = "this network" if self._config.discovery == SUBNET else "this machine"
        return DiagnosticStatus.OK, f"ROS 2 on {where} {may}.", values

    def _send_move(self, arm: int, channel: int, number: int, body: bytes) -> None:
        depth = 100  # feedback comes a few times a second, and no result may be lost
        self._side.put(("move", arm), packed(channel, MOVE.pack(arm, number) + body), depth)

    def _look(self) -> None:
        for move in self._moves:
            move.look()

    def _ask_master(self) -> None:
        """Subscribes to what ROS 2 wants, in a thread of its own: rospy waits for a master that is gone."""
        for number, demand in self._demand.items():
            demand(number in self._wanted)
        for of in self._arms:  # a description comes from the parameter, which may change
            text = ""
            with contextlib.suppress(OSError, http.client.HTTPException):  # of a master that is gone
                text = rospy.get_param_cached(of + DESCRIPTION, "")
            if text and self._descriptions.get(of) != text:
                self._descriptions[of] = text
                self._put(self._channels[of + DESCRIPTION], self._name, bytes_of(String(text)))

    def _listen(self, channel: Channel) -> list[rospy.Subscriber]:
        """Subscribes to what a topic is made of."""
        of, subscribe = next((of for of in self._arms if of and channel.topic.startswith(of)), ""), rospy.Subscriber
        name = channel.topic[len(of) :]
        if name == DESCRIPTION:
            return []
        if name == COMPRESSED:
            take = partial(self._image, channel)
            return [subscribe(IMAGE, Image, take, queue_size=1, buff_size=READ_BYTES)]
        if name == WRENCH:
            return [
                subscribe(f"{of}kuka/flange_force", Vector3Stamped, partial(self._force.__setitem__, of)),
                subscribe(f"{of}kuka/flange_torque", Vector3Stamped, partial(self._wrench, channel, of)),
            ]
        if name in (STATUS, STATE):
            kind = KukaStatus if name == STATUS else TeleopState
            return [subscribe(channel.topic, kind, partial(self._status, channel), queue_size=2)]
        if name == "tf_static":
            return [subscribe("/tf_static", TFMessage, partial(self._statics, channel))]
        topic = f"/{name}" if name in ("tf", "diagnostics") else channel.topic
        return [subscribe(topic, rospy.AnyMsg, partial(self._bytes, channel), tcp_nodelay=True)]

    def _bytes(self, channel: Channel, message: rospy.AnyMsg) -> None:
        node, header = publisher_of(message), connection_of(message)
        if node == self._name and channel.topic == "tf":
            return  # from ROS 2
        kind = header["type"]
        if kind == channel.kind and header["md5sum"] != self._md5sums[kind]:
            kind += " of another definition"
        if kind != channel.kind:
            if (node, kind) not in self._odd:
                self._odd.add((node, kind))
                rospy.logwarn("%s publishes %s on %s, not %s; it is left out.", node, kind, channel.topic, channel.kind)
            return
        self._put(channel, node, data_of(message))

    def _statics(self, channel: Channel, message: TFMessage) -> None:
        """Sends all static transforms so far: ROS 2 keeps only the last message of a publisher."""
        self._static.update({transform.child_frame_id: transform for transform in message.transforms})
        self._put(channel, self._name, bytes_of(TFMessage(list(self._static.values()))))

    def _wrench(self, channel: Channel, of: str, torque: Vector3Stamped) -> None:
        force = self._force.get(of)
        if force is not None and abs((torque.header.stamp - force.header.stamp).to_sec()) < NEAR_S:
            wrench = WrenchStamped(torque.header, Wrench(force.vector, torque.vector))
            self._put(channel, self._name, bytes_of(wrench))

    def _status(self, channel: Channel, message: KukaStatus | TeleopState) -> None:
        stopped = isinstance(message, KukaStatus) and message.mode == KukaStatus.STOPPED
        level = DiagnosticStatus.ERROR if stopped else DiagnosticStatus.OK
        status = DiagnosticStatus(level=level, name=channel.topic, message=message.reason)
        status.values = [KeyValue(*pair) for pair in key_values(message)]
        self._put(channel, self._name, bytes_of(status))

    def _image(self, channel: Channel, message: Image) -> None:
        try:
            self._put(channel, self._name, bytes_of(jpeg_from_image(message, self._config.jpeg_quality)))
        except ValueError as error:
            rospy.logwarn_throttle(REMIND_S, f"An image is left out: {error}.")
        clock.sleep(1.0 / self._config.camera_rate)  # rospy skips those that come meanwhile

    def _put(self, channel: Channel, node: str, data: bytes) -> None:
        try:
            self._side.put((channel.number, node), packed(channel.number, data), channel.depth)
            self._passed += 1
        except BridgeFault as error:
            rospy.logwarn_throttle(REMIND_S, f"{channel.topic}: {error}")


def main() -> None:
    Ros2Bridge(private_config(Ros2BridgeConfig)).run()
