"""Messages of the rig's own types as keys and values: ROS 2 has no rig_msgs."""

from __future__ import annotations

from typing import Any


def key_values(message: Any) -> list[tuple[str, str]]:
    """Returns each field of a ROS 1 message but its header, as text; of messages within it their fields."""
    found = []
    for name in message.__slots__:
        value = getattr(message, name)
        if name == "header":
            continue
        if hasattr(value, "__slots__"):
            found += [(f"{name}.{key}", text) for key, text in key_values(value)]
        else:
            found.append((name, _text(value)))
    return found


def _text(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_text, value))
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.7g}" if isinstance(value, float) else str(value)
