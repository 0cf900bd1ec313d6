"""Typed configuration from the parameter server."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable

import rospy

from common.config import Schema, parse

POLL_S = 0.2
REMIND_S = 5.0


def wait_for_param(name: str):
    """Returns the parameter `name` once it is there; says what it waits for.

    Raises:
        rospy.ROSInterruptException: ROS shut down while waiting.
    """
    next_reminder = 0.0
    while not rospy.has_param(name):
        if rospy.is_shutdown():
            raise rospy.ROSInterruptException(f"shut down while waiting for {name}")
        if time.monotonic() >= next_reminder:
            rospy.loginfo("Waiting for the parameter %s.", rospy.resolve_name(name))
            next_reminder = time.monotonic() + REMIND_S
        time.sleep(POLL_S)
    return rospy.get_param(name)


def wait_for_config(schema: type[Schema], namespace: str, others: Iterable[str] = ()) -> Schema:
    """Returns the configuration under `namespace` once its parameters are there; says so while it waits.

    A launch file uploads a yaml key by key, so it waits until the last key of the schema has come, for a second at most
    after the first.

    Raises:
        ConfigError: the values are missing, unknown or out of range.
    """
    wait_for_param(namespace)
    names = [f.name for f in dataclasses.fields(schema)]
    deadline = time.monotonic() + 1.0
    values = rospy.get_param(namespace)
    while time.monotonic() < deadline and not (isinstance(values, dict) and all(n in values for n in names)):
        time.sleep(POLL_S)
        values = rospy.get_param(namespace)
    config = parse(schema, values, prefix=f"{namespace}/", others=others)
    rospy.loginfo("%s: %s", namespace, ", ".join(f"{n}={getattr(config, n)}" for n in names))
    return config
