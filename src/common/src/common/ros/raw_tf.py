"""Messages as bytes: a node needs few of the many on /tf, and rospy would build all of them. The one place that knows
what rospy keeps of a message and of a subscriber beside their fields."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple

import genpy
import rospy
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from common.frames import frame_name

_HEADER = struct.Struct("<4I")
_LENGTH = struct.Struct("<I")
_STAMP = struct.Struct("<2I")
_NUMBERS = struct.Struct("<7d")


def data_of(message: rospy.AnyMsg) -> bytes:
    return message._buff


def connection_of(message: genpy.Message) -> dict[str, str]:
    """Returns the header of the connection that a message came by: callerid, type, md5sum, message_definition, ..."""
    return message._connection_header


def publisher_of(message: genpy.Message) -> str:
    """Returns the name of the node that published a message."""
    return connection_of(message)["callerid"]


def callbacks_of(subscriber: rospy.Subscriber) -> list[Callable]:
    """Returns whatever this process does with the messages of a topic: rospy calls all of it in the same thread."""
    return [callback for callback, _ in subscriber.impl.callbacks]


def encoded(*names: str) -> bytes:
    """Returns names as they stand in a message, one after the other: parent and child of a transform, for instance."""
    return b"".join(_LENGTH.pack(len(name.encode())) + name.encode() for name in names)


class RawTransform(NamedTuple):
    """A transform as it came; frames without the leading slash of old nodes, as tf2 names them."""

    child: str
    parent: str
    stamp: tuple[int, int]  # [s], [ns]
    numbers: tuple[float, ...]  # x, y, z [m], and the quaternion x, y, z, w

    @property
    def time(self) -> float:
        """The stamp [s]."""
        return self.stamp[0] + 1e-9 * self.stamp[1]

    def earlier(self, seconds: float) -> RawTransform:
        """Returns it with a stamp that is earlier by so much [s]."""
        if not seconds:
            return self
        nanoseconds = max(10**9 * self.stamp[0] + self.stamp[1] - round(1e9 * seconds), 0)
        return self._replace(stamp=divmod(nanoseconds, 10**9))

    @property
    def message(self) -> TransformStamped:
        transform = Transform(Vector3(*self.numbers[:3]), Quaternion(*self.numbers[3:]))
        return TransformStamped(Header(0, rospy.Time(*self.stamp), self.parent), self.child, transform)


class TransformSearch:
    """Finds the transform of `child` in `parent` in the bytes of tf messages, without reading the others."""

    def __init__(self, parent: str, child: str) -> None:
        self._parent = parent
        self._child = child
        self._names = encoded(parent, child)

    def __call__(self, message: rospy.AnyMsg) -> RawTransform | None:
        """Returns the first one in a message, or None. Names with the leading slash of old nodes are not found."""
        data = data_of(message)
        at = data.find(self._names)
        if at < _STAMP.size or at + len(self._names) + _NUMBERS.size > len(data):
            return None
        numbers = _NUMBERS.unpack_from(data, at + len(self._names))
        return RawTransform(self._child, self._parent, _STAMP.unpack_from(data, at - _STAMP.size), numbers)


class RawTfMessage(TFMessage):
    """A tf message that is received only; `data` has its bytes."""

    data: bytes = bytes(4)

    def deserialize(self, data: bytes) -> RawTfMessage:
        self.data = bytes(data)
        return self

    def raw_transforms(self) -> Iterator[RawTransform]:
        """Yields the transforms in their order. struct.error or UnicodeDecodeError: the bytes are no tf message."""
        data, start = self.data, 4
        for _ in range(_LENGTH.unpack_from(data)[0]):
            _, secs, nsecs, length = _HEADER.unpack_from(data, start)
            start += 16 + length
            parent = frame_name(data[start - length : start].decode())
            (length,) = _LENGTH.unpack_from(data, start)
            start += 4 + length
            child = frame_name(data[start - length : start].decode())
            yield RawTransform(child, parent, (secs, nsecs), _NUMBERS.unpack_from(data, start))
            start += 56
