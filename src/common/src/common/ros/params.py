"""Typed configuration from the parameter server."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable, Mapping
from typing import Any

import rospy
import yaml

from common import clock
from common.config import Schema, WrittenMapping, parse, required
from common.errors import ConfigError
from common.frames import ArmFrames

POLL_S = 0.2
UPLOAD_S = 1.0  # a launch file uploads a yaml in this time after its first key [s]


def private_values() -> dict[str, Any]:
    """Returns the private parameters of the node, with the texts of those that its command line sets, _name:=text."""
    given = (word[1:].partition(":=") for word in sys.argv if ":=" in word and word.startswith("_"))
    return _with_texts(rospy.get_param("~", {}), {key: text.strip() for key, _, text in given})


def _with_texts(values: Any, texts: Mapping[str, str]) -> Any:
    """Returns the values with the texts of those keys, such as name and part/name, that are what yaml, by which rospy
    reads the texts, makes of them: the others were set later."""
    if not isinstance(values, dict):
        return values
    lost = {key: text for key, text in texts.items() if not isinstance(values.get(key, ""), (str, list, dict))}
    parts = {
        name: _with_texts(value, {k[len(name) + 1 :]: text for k, text in texts.items() if k.startswith(f"{name}/")})
        for name, value in values.items()
    }
    return WrittenMapping(parts, {key: text for key, text in lost.items() if _read(text) == values[key]})


def _read(text: str) -> Any:
    try:
        return yaml.safe_load(text)
    except Exception:  # the library's constructors raise anything
        return text


def private_config(schema: type[Schema], section: str = "", others: Iterable[str] = ()) -> Schema:
    """Returns the node's private parameters, or those of ~section/; `others` may stand beside the schema's own. Raises
    ConfigError if a parameter is missing, unknown or out of range."""
    values = private_values().get(section, {}) if section else private_values()
    return parse(schema, values, prefix=f"~{section}/" if section else "~", others=others)


def arm_frames(of: str = "") -> ArmFrames:
    """Returns the tf frames of this node's arm, by the parameter tf_prefix in its namespace or one above it. `of`: the
    namespace of the arm with a slash, in a node for several. Raises ConfigError if that is no prefix."""
    name = f"{of}tf_prefix" if of else rospy.search_param("tf_prefix")
    values = {} if name is None or not rospy.has_param(name) else {"tf_prefix": rospy.get_param(name)}
    return parse(ArmFrames, values, prefix="" if name is None else name[: -len("tf_prefix")])


def wait_for_param(name: str):
    """Returns the parameter `name`; waits for it and reports that, until ROS shuts down."""
    remind_s = 5.0
    next_reminder = 0.0
    while not rospy.has_param(name):
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException(f"shut down while waiting for {name}")
        if clock.monotonic() >= next_reminder:
            rospy.loginfo("Waiting for the parameter %s.", rospy.resolve_name(name))
            next_reminder = clock.monotonic() + remind_s
        clock.sleep(POLL_S)
    return rospy.get_param(name)


def wait_for_config(
    schema: type[Schema], namespace: str, others: Iterable[str] = (), patience: float = UPLOAD_S
) -> Schema:
    """Returns the configuration under `namespace`; waits for its parameters and reports that. A launch file uploads a
    yaml key by key: this waits until the last key of the schema is there, at most `patience` [s] after the first. The
    keys `others` may stand beside the schema's own. Raises ConfigError if values are missing, unknown or out of range,
    rospy.ROSInterruptException if ROS shuts down while waiting."""
    few = 3  # more missing keys than this: the file was not loaded at all
    wait_for_param(namespace)
    names = [f.name for f in dataclasses.fields(schema)]
    values = _uploaded(namespace, names, min(patience, UPLOAD_S))
    missing = _missing(values, required(schema))
    if missing and patience > UPLOAD_S:
        rospy.logwarn("Waiting for parameters under %s/: %s.", rospy.resolve_name(namespace), ", ".join(missing))
        values = _uploaded(namespace, required(schema), patience - UPLOAD_S)
        missing = _missing(values, required(schema))
    if len(missing) > few:
        raise ConfigError([
            f"{namespace}/ has only the parameters {', '.join(sorted(values)) or 'none'}; {len(missing)} are missing: "
            f"{', '.join(missing)}. Load the parameter file of this node."
        ])  # fmt: skip
    config = parse(schema, values, prefix=f"{namespace}/", others=others)
    rospy.loginfo("%s: %s", namespace, ", ".join(f"{n}={getattr(config, n)}" for n in names))
    return config


def _uploaded(namespace: str, names: Iterable[str], seconds: float):
    """Returns the value of `namespace` once it has all the names, at the latest after `seconds`."""
    deadline = clock.monotonic() + seconds
    values = rospy.get_param(namespace)
    while clock.monotonic() < deadline and _missing(values, names):
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException(f"shut down while waiting for parameters under {namespace}/")
        clock.sleep(POLL_S)
        values = rospy.get_param(namespace)
    return values


def _missing(values, names: Iterable[str]) -> list[str]:
    """Returns the names without a value; a namespace that is a single value is a fault of another kind."""
    return [name for name in names if name not in values] if isinstance(values, dict) else []
