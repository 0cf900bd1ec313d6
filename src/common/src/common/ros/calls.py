"""Service calls that end: rospy's own wait for ever for a node that hangs."""

from __future__ import annotations

import threading

import rospy

from common.errors import DeviceError


def call(name: str, kind, *values, timeout: float):
    """Returns the response of a service.

    Args:
        name: of the service.
        kind: its type.
        values: the fields of the request.
        timeout: longest wait for the answer [s]; a node that hangs may still do what was asked for.

    Raises:
        DeviceError: nobody offers the service, it failed, or it did not answer in time; the end of a sentence.
    """
    answers, faults = [], []

    def ask() -> None:
        try:
            answers.append(rospy.ServiceProxy(name, kind)(*values))
        except (rospy.ServiceException, rospy.ROSException) as error:
            faults.append(str(error))

    asker = threading.Thread(target=ask, name=name, daemon=True)
    asker.start()
    asker.join(timeout)
    if answers:
        return answers[0]
    if faults:
        raise DeviceError(f"the service {name} failed: {faults[0]}")
    raise DeviceError(f"the service {name} did not answer within {timeout:g} s")
