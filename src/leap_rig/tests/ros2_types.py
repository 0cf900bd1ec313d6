"""In ROS 2's environment, for test_ros2_types.py: what ROS 2 itself makes of each type that passes through the bridge.
The input is a JSON list of type, definition and bytes as of ROS 1; the output, what ROS 2 and the bridge make of it."""

import importlib
import itertools
import json
import re
import sys
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message

from leap_rig.ros2.conversions import Ros2Conversions, ros2_name
from leap_rig.ros2.ros.side import MESSAGES, message_type

HEADER_BYTES = 4  # before each message, which say how it is encoded
LISTS = re.compile(r"sequence<([\w/]+)>|([\w/]+)\[(\d+)\]")


def filled(kind, numbers):
    """Returns a message in which no two fields are the same."""
    message = kind()
    for name, text in kind.get_fields_and_field_types().items():
        setattr(message, name, value(text, numbers))
    return message


def value(kind, numbers):
    found = LISTS.fullmatch(kind)
    if found:
        return [value(found[1] or found[2], numbers) for _ in range(int(found[3] or 2))]
    if "/" in kind:
        package, name = kind.split("/")
        return filled(getattr(importlib.import_module(f"{package}.msg"), name), numbers)
    number = next(numbers)
    other = {"double": number + 0.5, "string": f"s{number}", "octet": bytes([number]), "boolean": True}
    return other.get(kind, number)


def definition_hash(kind):
    """Returns the hash of ROS 2's installed definition of a message; none for the parts of an action."""
    package, _, name = kind.partition("/")
    file = Path(sys.prefix, "share", package, "msg", f"{name}.json")
    return json.loads(file.read_text())["type_hashes"][0]["hash_string"] if file.is_file() else None


def without_padding(data, kind):
    """Returns the bytes of a message with zeros where nothing is read; ROS 2 leaves there what was in memory."""
    message, cleared = deserialize_message(data, kind), bytearray(data)
    for i in range(HEADER_BYTES, len(data)):
        cleared[i] = 0
        try:
            same = deserialize_message(bytes(cleared), kind) == message
        except Exception:  # as of a text without its end
            same = False
        if not same:
            cleared[i] = data[i]
    return bytes(cleared)


def main():
    conversions, rows = Ros2Conversions(), {}
    for kind, definition, data in json.load(sys.stdin):
        conversions.learn(kind, definition)
        made = MESSAGES.get(kind) or message_type(kind)
        own, sent = serialize_message(filled(made, itertools.count(1))), conversions.to_ros2(kind, bytes.fromhex(data))
        hashed = definition_hash(kind)
        rows[kind] = {
            "ros2": without_padding(own, made).hex(),
            "bridge": sent.hex(),
            "read as sent": deserialize_message(sent, made) == filled(made, itertools.count(1)),
            "back": conversions.to_ros1(kind, own).hex(),
            "same definition": hashed is None or hashed == conversions.store.hash_rihs01(ros2_name(kind)),
        }
    print(json.dumps(rows))


main()
