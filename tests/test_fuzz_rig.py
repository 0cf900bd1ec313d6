"""Random messages and calls on all topics and services of the whole rig in virtual time, while control is off."""

from __future__ import annotations

import contextlib
import io
import math
import os
import random
import time

import numpy as np
import pytest

pytest.importorskip("rig_msgs.srv")
import rospy
from roslib.message import get_message_class
from tf2_msgs.msg import TFMessage

from common import clock
from common.ros.service_calls import ServiceFailed, call
from fuzz.messages import random_message
from kuka_msgs.msg import MoveActionGoal
from leap_motion.msg import Human
from rig_msgs.msg import KukaStatus, OperatorInput
from rig_msgs.srv import CheckToolPoseRequest
from simulated.rig import VirtualRig

pytestmark = pytest.mark.ros

SECONDS = float(os.environ.get("FUZZ_SECONDS", "0"))
SEED = random.randrange(10**9) if os.environ.get("HYPOTHESIS_SEARCH") == "1" else 1
COUNT, PAUSE_S = 300, 0.02
"""Messages and calls at least, and the time between two."""

MEANT = ("exit_app", "exit_app_emergency")  # that end a node
NOT_OURS = {"/rosout", "/clock", "/diagnostics", "/tf_static"}
"""Of no node of the rig, or what a frame of the arm is for ever after."""

STILL_RAD = 1e-3


def test_random_messages_of_every_type_of_the_rig_can_be_sent():
    for seed in range(20):
        for kind in (Human, KukaStatus, OperatorInput, MoveActionGoal, CheckToolPoseRequest):
            stream = io.BytesIO()
            random_message(kind, random.Random(seed)).serialize(stream)
            kind().deserialize(stream.getvalue())


def not_finite(heard: list[TFMessage]) -> set[str]:
    """The frames whose transforms have numbers that are not finite, with their nodes, but for those of this test."""
    found = set()
    for message in heard:
        sender = message._connection_header["callerid"]
        for t in message.transforms:
            place, turn = t.transform.translation, t.transform.rotation
            numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
            if sender != rospy.get_name() and not all(map(math.isfinite, numbers)):
                found.add(f"{sender}: {t.child_frame_id}")
    return found


@pytest.mark.timeout(8 * SECONDS + 900)
def test_they_do_no_harm_and_afterwards_the_rig_follows_a_hand(virtual_graph):
    rng, used, said = random.Random(SEED), set(), ""
    ends = time.process_time() + SECONDS
    with VirtualRig(virtual_graph) as rig:
        rig.calm()
        nodes, q, heard = rig.pids(), rig.arm.now.q, virtual_graph.record("/tf", TFMessage)
        services = sorted((name, s.kind) for name, s in virtual_graph.services.items() if not name.endswith(MEANT))
        heard_by = {s.name for s in virtual_graph.subscribers if s.node is not virtual_graph.here} - NOT_OURS
        ends_of = [*virtual_graph.subscribers, *virtual_graph.publishers]
        types = {end.name: end.kind._type for end in ends_of if end.kind is not rospy.AnyMsg}
        topics = sorted((name, get_message_class(types[name])) for name in heard_by & types.keys())
        publishers = [rospy.Publisher(name, kind, queue_size=5) for name, kind in topics]
        assert len(services) > 10 and len(publishers) > 9 and "/tf" in heard_by

        def act() -> str:
            if rng.random() < 0.25:
                name, kind = rng.choice(services)
                request = random_message(kind._request_class, rng)
                if name.endswith("/kuka_control"):
                    request.data = False
                with contextlib.suppress(ServiceFailed):
                    call(name, kind, *(getattr(request, slot) for slot in request.__slots__), timeout=15.0)
                return f"{name} {request}"
            publisher = rng.choice(publishers)
            message = random_message(publisher.data_class, rng)
            with contextlib.suppress(rospy.ROSException):  # not serialisable after all
                publisher.publish(message)
            return f"{publisher.name} {message}"

        count = 0
        while count < COUNT or time.process_time() < ends:
            said = act()
            used.add(said.split()[0])
            count += 1
            clock.sleep(PAUSE_S)
            if count % 50 == 0 or "Traceback" in rig.log:
                last = f"seed {SEED}, the last of {count}: {said:.2000}"
                assert "Traceback" not in rig.log, f"{last}\n{rig.log[-4000:]}"
                assert rig.pids() == nodes, last
                assert np.abs(rig.arm.now.q - q).max() < STILL_RAD, last
                assert not not_finite(heard), last
                heard.clear()
        for publisher in publishers:
            publisher.unregister()
        clock.sleep(15.0)
        rig.calm()
        rig.follow(right=-0.06)
    assert len(used) > 10
