"""Bytes of messages between ROS 1 and ROS 2, by rosbags; in the environment of requirements-ros2.txt."""

from __future__ import annotations

from typing import Any

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NAMES = {"bool": "boolean", "byte": "octet", "float32": "float", "float64": "double"}  # in ROS 2's classes


def ros2_name(kind: str) -> str:
    """Returns the name of a type of ROS 1, such as std_msgs/Bool, in ROS 2, where each begins with a capital letter."""
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name[:1].upper()}{name[1:]}"


class Ros2Conversions:
    """Converts messages by their types' names in ROS 1. A type that ROS 2 has, too, gets its fields there."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_KILTED)
        self._ros1 = get_typestore(Stores.ROS1_NOETIC)
        self._same: dict[str, bool] = {}
        self._defaults: dict[str, object] = {}

    def learn(self, kind: str, definition: str) -> None:
        """Takes note of a type, with the full definition of ROS 1. Raises rosbags' errors for an invalid definition."""
        for store in (self._ros1, self.store):
            found = get_types_from_msg(definition, ros2_name(kind))
            store.register({name: fields for name, fields in found.items() if name not in store.fielddefs})

    def to_ros2(self, kind: str, data: bytes) -> bytes:
        """Returns a message in CDR. Raises whatever rosbags does with bytes that are not of this type."""
        name = ros2_name(kind)
        if name not in self._same:
            self._same[name] = is_same_wireformat(self._ros1, self.store, name, name)
        if self._same[name]:
            return bytes(self.store.ros1_to_cdr(data, name))
        stores = self._ros1, self.store
        return bytes(migrate_bytes(*stores, name, name, self._defaults, data, src_is2=False, dst_is2=True))

    def to_ros1(self, kind: str, data: bytes) -> bytes:
        """Returns a message that came in CDR. Raises whatever rosbags does with other bytes."""
        return bytes(self.store.cdr_to_ros1(data, ros2_name(kind)))

    def fields(self, kind: str) -> dict[str, str]:
        """Returns the fields of a type in ROS 2 with their types, as its class names them."""
        return {name: _field_type(*found) for name, found in self.store.fielddefs[ros2_name(kind)][1]}


def _field_type(node: Nodetype, what: Any) -> str:
    if node == Nodetype.NAME:
        return what.replace("/msg/", "/")
    if node == Nodetype.BASE:
        return NAMES.get(what[0], what[0])
    inner = _field_type(*what[0])
    return f"{inner}[{what[1]}]" if node == Nodetype.ARRAY else f"sequence<{inner}>"
