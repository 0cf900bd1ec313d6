"""The half of the bridge that speaks ROS 2: a program in the environment of requirements-ros2.txt. Its argument is the
request of `bridge_node` in JSON; it ends with the socket to there."""

from __future__ import annotations

import importlib
import json
import os
import socket
import subprocess
import sys
import traceback
import zlib
from functools import partial
from typing import Any

import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future

from common import clock
from kuka_msgs.action import Move
from leap_rig.ros2 import channels
from leap_rig.ros2.channels import MOVE, Channel
from leap_rig.ros2.conversions import Ros2Conversions, ros2_name
from leap_rig.ros2.outbox import MessageRateLimit
from leap_rig.ros2.wire import BridgeFault, frames, packed

NAME = "leap_rig"  # of the node
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # of one that was not discovered yet
LOOK_S = 0.25  # between two looks at who is there
END_S = 0.3  # for a result to reach its client
MAX_TF_BYTES = 2**16
MAX_TF_HZ, MAX_TF_BURST = 400.0, 40  # of a publisher and a frame
RENEW = "Run make ros2; ~python, where it is set, must be the Python that it makes."
TF = "tf2_msgs/TFMessage"
GOAL, RESULT, FEEDBACK = "kuka_msgs/MoveGoal", "kuka_msgs/MoveResult", "kuka_msgs/MoveFeedback"
MESSAGES = {GOAL: Move.Goal, RESULT: Move.Result, FEEDBACK: Move.Feedback}


def message_type(kind: str) -> Any:
    """Returns ROS 2's class of a type, named as in ROS 1."""
    package, _, name = kind.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


class OtherSide:
    """The socket to the half that speaks ROS 1."""

    def __init__(self, connection: socket.socket) -> None:
        self.receive = connection.recv
        self._connection, self._lock = connection, clock.Lock()

    def send(self, channel: int, body: bytes) -> None:
        with self._lock:
            self._connection.sendall(packed(channel, body))


class Topics:
    """What ROS 2 hears."""

    def __init__(self, node: Any, other: OtherSide, conversions: Ros2Conversions, topics: list[Channel]) -> None:
        self._node, self._other, self._conversions = node, other, conversions
        self._topics = {topic.number: topic for topic in topics}
        self._publishers = {}
        for topic in topics:
            durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.is_latched else DurabilityPolicy.VOLATILE
            quality = QoSProfile(depth=topic.depth, durability=durability)
            kind = message_type(topic.kind)
            self._publishers[topic.number] = node.create_publisher(kind, f"/{topic.topic}", quality)
            self._check(topic)
        self.own: dict[str, int] = {}  # subscribers of this node itself, by topic
        self._others: set[bytes] = set()  # who named another type, and was told

    def _check(self, topic: Channel) -> None:
        """Ends this process if the type of a topic has other fields in ROS 2 than the bridge writes."""
        name, infos = ros2_name(topic.kind), self._node.get_publishers_info_by_topic(f"/{topic.topic}")
        installed = next(str(info.topic_type_hash) for info in infos if info.node_name == NAME)
        if installed != self._conversions.store.hash_rihs01(name):
            sys.exit(
                f"ros2_bridge: /{topic.topic}: {name} as it is installed has other fields than the bridge makes of "
                f"{topic.kind}, so nothing could be read. {RENEW}"
            )

    def publish(self, number: int, data: bytes) -> None:
        topic = self._topics[number]
        try:
            message = self._conversions.to_ros2(topic.kind, data)
        except Exception as error:  # whatever bytes do to the library
            fault = f"A message on {topic.topic} cannot be read ({type(error).__name__}); ROS 2 does not get it."
            self._other.send(channels.FAULT, fault.encode())
            return
        self._publishers[number].publish(message)

    def report(self) -> None:
        """Says which topics have subscribers; also that this process is alive."""
        wanted = [
            number
            for number, publisher in self._publishers.items()
            if publisher.get_subscription_count() > self.own.get(self._topics[number].topic, 0)
        ]
        self._other.send(channels.WANTED, json.dumps(wanted).encode())
        for topic in self._topics.values():
            self._compare(topic)

    def _compare(self, topic: Channel) -> None:
        """Says who takes a topic for one of another type, which DDS keeps apart without a word."""
        name = ros2_name(topic.kind)
        for info in self._node.get_subscriptions_info_by_topic(f"/{topic.topic}"):
            gid = bytes(info.endpoint_gid)
            if info.topic_type != name and info.node_name != UNKNOWN and gid not in self._others:
                self._others.add(gid)
                fault = f"{_name(info)} in ROS 2 expects {info.topic_type} on /{topic.topic}, which is {name}"
                self._other.send(channels.FAULT, f"{fault}: it hears nothing.".encode())


def _name(info: Any) -> str:
    """Returns the name of a node of ROS 2."""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


class DesiredTools:
    """Passes on what others publish of the desired tool frames."""

    def __init__(self, node: Any, other: OtherSide, conversions: Ros2Conversions, names: list[str]) -> None:
        self._node, self._other, self._conversions = node, other, conversions
        self._names = [name.encode() for name in names]
        self._nodes: dict[bytes, str] = {}  # publishers by their identifiers; own ones have no name
        self._limit, self._said = MessageRateLimit(MAX_TF_HZ, MAX_TF_BURST), MessageRateLimit(1.0, 1)
        kind, latched = message_type(TF), DurabilityPolicy.TRANSIENT_LOCAL
        qualities = {"tf": QoSProfile(depth=100), "tf_static": QoSProfile(depth=10, durability=latched)}
        for topic, quality in qualities.items():
            take = self._taker(topic, channels.DESIRED if topic == "tf" else channels.STATIC)
            node.create_subscription(kind, f"/{topic}", take, quality, raw=True)

    def _taker(self, topic: str, channel: int) -> Any:
        def take(data: bytes, info: Any) -> None:
            found = tuple(name for name in self._names if name in data)
            if not found:
                return
            node, now = self._publisher(topic, bytes(info["publisher_gid"]["data"])), clock.monotonic()
            if not node:
                return
            if not self._limit.passes((node, found), now):
                if self._said.passes(node, now):
                    self._fault(node, topic, f"is one of more than {MAX_TF_HZ:g} a second")
                return
            if len(data) > MAX_TF_BYTES:
                self._fault(node, topic, f"has {len(data)} bytes, more than {MAX_TF_BYTES}")
                return
            try:
                message = self._conversions.to_ros1(TF, data)
            except Exception as error:  # whatever bytes do to the library, which says little of its errors
                self._fault(node, topic, f"cannot be read ({type(error).__name__})")
                return
            self._other.send(channel, node.encode() + b"\0" + message)

        return take

    def _fault(self, node: str, topic: str, what: str) -> None:
        self._other.send(channels.FAULT, f"A message of {node} in ROS 2 on /{topic} {what}; it is left out.".encode())

    def _publisher(self, topic: str, gid: bytes) -> str:
        """Returns the name of the node that published a message; empty for this one, and while it is not known yet."""
        if gid not in self._nodes:
            found = {bytes(i.endpoint_gid): i for i in self._node.get_publishers_info_by_topic(f"/{topic}")}
            info = found.get(gid)
            if info is None or info.node_name == UNKNOWN:
                return ""
            own = info.node_name == NAME and info.node_namespace == "/"
            self._nodes[gid] = "" if own else f"{_name(info)} ({zlib.crc32(gid):08x})"
        return self._nodes[gid]


class MoveRelay:
    """Offers an arm's kuka/move in ROS 2. One goal at a time; a client that goes meanwhile cancels it."""

    def __init__(self, node: Any, other: OtherSide, conversions: Ros2Conversions, arm: int, name: str) -> None:
        self._node, self._other, self._conversions = node, other, conversions
        self._arm, self._name, self._service = arm, name, f"/{name}/_action/send_goal"
        self._number = 0
        self._handle: Any = None
        self._ended: Any = None
        self._clients = 0  # the most that were there since the goal came
        self._lost = False
        self._server = ActionServer(node, Move, f"/{name}", self._execute, cancel_callback=self._cancel)

    @property
    def moves(self) -> bool:
        return self._ended is not None and not self._ended.done()

    async def _execute(self, handle: Any) -> Any:
        if self._handle is not None:
            handle.abort()  # a rejection could not say why
            return Move.Result(message="The motion before has not ended; cancel it or wait.")
        self._number += 1
        self._handle, self._ended = handle, Future(executor=self._node.executor)
        self._clients, self._lost = self._node.count_clients(self._service), False
        self._send(channels.GOAL, self._conversions.to_ros1(GOAL, serialize_message(handle.request)))
        if handle.is_cancel_requested:  # before it began
            self._send(channels.CANCEL)
        state, result = await self._ended
        self._handle = self._ended = None
        ends = {channels.SUCCEEDED: handle.succeed}
        if handle.is_cancel_requested:
            ends[channels.CANCELLED] = handle.canceled
        ends.get(state, handle.abort)()
        return result

    def _cancel(self, handle: Any) -> CancelResponse:
        if handle == self._handle:
            self._send(channels.CANCEL)
        return CancelResponse.ACCEPT

    def _send(self, channel: int, body: bytes = b"") -> None:
        self._other.send(channel, MOVE.pack(self._arm, self._number) + body)

    def take(self, channel: int, number: int, body: bytes) -> None:
        """Receives feedback or the result of a goal."""
        handle, ended = self._handle, self._ended
        if number != self._number or handle is None or ended is None:
            return
        if channel == channels.FEEDBACK:
            handle.publish_feedback(self._message(FEEDBACK, body))
        else:
            ended.set_result((body[0], self._message(RESULT, body[1:])))
            self._node.executor.wake()

    def _message(self, kind: str, body: bytes) -> Any:
        return deserialize_message(self._conversions.to_ros2(kind, body), MESSAGES[kind])

    def look(self) -> None:
        """Cancels the motion if a client has gone."""
        if not self.moves or self._lost:
            return
        clients = self._node.count_clients(self._service)
        self._clients = max(self._clients, clients)
        if clients < self._clients:
            self._lost = True
            sentence = f"A client of {self._name} in ROS 2 has gone, so its motion is cancelled."
            self._other.send(channels.FAULT, sentence.encode())
            self._send(channels.CANCEL)


def main() -> None:
    """Runs until the other side ends, which cancels a motion that is left."""
    request = json.loads(sys.argv[1])
    conversions = Ros2Conversions()
    for kind, definition in request["definitions"].items():
        conversions.learn(kind, definition)
    for kind, message in MESSAGES.items():
        if conversions.fields(kind) != message.get_fields_and_field_types():
            sys.exit(
                f"ros2_bridge: kuka/move: kuka_msgs/action/{message.__name__} as it is installed has other fields than "
                f"the rig's {kind}, so no goal could be read. {RENEW}"
            )
    other = OtherSide(socket.socket(fileno=request["socket"]))
    rclpy.init(args=[])
    node = rclpy.create_node(NAME)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    topics = Topics(node, other, conversions, [Channel(*row) for row in request["channels"]])
    relays: list[MoveRelay] = []
    if request["desired"]:
        DesiredTools(node, other, conversions, request["desired"])
        topics.own = {"tf": 1, "tf_static": 1}
        relays = [MoveRelay(node, other, conversions, *move) for move in enumerate(request["moves"])]
    for job in (topics.report, *(relay.look for relay in relays)):
        node.create_timer(LOOK_S, job)
    hear = partial(_hear, other, topics, relays, request["rescue"])
    clock.Thread(target=hear, name="ROS 1", daemon=True).start()
    try:
        topics.report()
        executor.spin()
    except OSError:  # the other side has gone; _hear ends this process
        clock.Event().wait()


def _hear(other: OtherSide, topics: Topics, relays: list[MoveRelay], rescue: list[str]) -> None:
    """Takes what comes from ROS 1, and ends this process with it."""
    code = 1
    try:
        for channel, body in frames(other.receive):
            if channel >= channels.FIRST_TOPIC:
                topics.publish(channel, body)
            else:
                arm, number = MOVE.unpack_from(body)
                relays[arm].take(channel, number, body[MOVE.size :])
        code = 0
    except (OSError, BridgeFault) as error:
        print(f"ros2_bridge: {error}", file=sys.stderr)
    except Exception:  # a defect, which must not leave a process that hears nothing
        traceback.print_exc()
    finally:
        clock.sleep(END_S)
        if any(relay.moves for relay in relays):
            environment = {**os.environ, "PYTHONPATH": os.environ.get("LEAP_RIG_PYTHONPATH", "")}
            subprocess.run(rescue, env=environment, check=False, timeout=30.0)
        os._exit(code)  # the executor may be anywhere
