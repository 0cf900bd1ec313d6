"""What a message on /tf costs: by tf2_ros' broadcaster, and by the DirectPublisher of this rig, to as many listeners.

As a program, `python -m bench.bench_tf KIND COUNT`, it is one node of that: `listen`, or a key of SENDERS.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

import numpy as np
import rosgraph
import rospy
import tf2_ros
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from bench.measure import ROOT, BenchError, Peer, Row, number, row
from common.ros.publishing import DirectPublisher
from simulated.ports import free_port

RATE_HZ = 115.3  # of the tracking frames
LISTENERS = 4  # as in the rig: controller, operator's view, RViz, and leap_kuka_node, which measures the delay
FRAMES = ("leap_motion/virtual_frame", "hand/frame", "hand/frame/filtered", "kuka/tool_frame/desired",
          "kuka/flange_frame/desired")  # fmt: skip
ROUNDS = 3  # in turns, since a machine is now faster, now slower
START_S, SETTLING_S = 20.0, 0.5
END = "end"  # the frame of the last message
BROADCASTER, DIRECT = "tf2_ros", "DirectPublisher"


def rows(quick: bool) -> list[Row]:
    """Returns processor time of the sender, and delay to the listeners, of both.

    Raises:
        BenchError: a node did not start or end.
    """
    count = 60 if quick else 1200
    cpu: dict[str, list[float]] = {BROADCASTER: [], DIRECT: []}
    delays: dict[str, list[float]] = {BROADCASTER: [], DIRECT: []}
    with _master():
        for _ in range(1 if quick else ROUNDS):
            for kind in cpu:
                listeners = [_node("listen", count) for _ in range(LISTENERS)]
                cpu[kind].append(_result(_node(kind, count))["cpu"])
                for listener in listeners:
                    delays[kind] += _result(listener)["delays"]
    how = f"{count} messages of {len(FRAMES)} frames at {RATE_HZ:g} Hz to {LISTENERS} listeners"
    table, peer = [], None
    for kind, median in {kind: float(np.median(times)) for kind, times in cpu.items()}.items():
        table.append(number(f"tf by {kind}: CPU", median, "us", f"the sender's, a message; {how}", peer=peer))
        peer = Peer(BROADCASTER, median)
    peer = None
    for kind, samples in delays.items():
        table.append(row(f"tf by {kind}: delay", samples, "us", how, peer=peer))
        peer = Peer(BROADCASTER, float(np.median(samples)))
    return table


@contextlib.contextmanager
def _master() -> Iterator[None]:
    before, port = os.environ.get("ROS_MASTER_URI"), free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    with tempfile.TemporaryFile() as log:
        core = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=log, stderr=log)
        try:
            deadline = time.monotonic() + START_S
            while not rosgraph.is_master_online():
                if time.monotonic() > deadline:
                    raise BenchError("The ROS master did not start.")
                time.sleep(0.1)
            yield
        finally:
            core.terminate()
            core.wait()
            os.environ.pop("ROS_MASTER_URI") if before is None else os.environ.update(ROS_MASTER_URI=before)


def _node(kind: str, count: int) -> subprocess.Popen:
    command = [sys.executable, "-m", "bench.bench_tf", kind, str(count)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def _result(node: subprocess.Popen) -> dict:
    try:
        text, _ = node.communicate(timeout=60.0)
        return json.loads(text.splitlines()[-1])
    except (subprocess.TimeoutExpired, IndexError, json.JSONDecodeError) as error:
        node.kill()
        raise BenchError(f"A node of the tf bench did not end: {error}.") from error


def send(kind: str, count: int) -> dict:
    """Publishes at the rate of the tracking frames once all listen; returns the processor time a message [us]."""
    if kind == DIRECT:
        publisher = DirectPublisher("/tf", TFMessage, queue_size=10)
        publish = lambda transforms: publisher.publish(TFMessage(transforms))  # noqa: E731 - as leap_kuka_node
    else:
        broadcaster = tf2_ros.TransformBroadcaster()
        publisher, publish = broadcaster.pub_tf, broadcaster.sendTransform
    deadline = time.monotonic() + START_S
    while publisher.get_num_connections() < LISTENERS:
        if time.monotonic() > deadline:
            raise BenchError("Not all listeners came.")
        time.sleep(0.05)
    time.sleep(SETTLING_S)
    transform, begun, next_at = Transform(Vector3(0.4, 0.1, 0.3), Quaternion(w=1.0)), time.process_time(), 0.0
    for _ in range(count):
        next_at = max(next_at + 1.0 / RATE_HZ, time.monotonic())
        stamp = rospy.Time.now()
        publish([TransformStamped(Header(0, stamp, "kuka/base_frame"), name, transform) for name in FRAMES])
        time.sleep(max(next_at - time.monotonic(), 0.0))
    used = time.process_time() - begun
    publish([TransformStamped(Header(0, rospy.Time.now(), ""), END, transform)])
    time.sleep(SETTLING_S)
    return {"cpu": 1e6 * used / count}


def listen(count: int) -> dict:
    """Returns the delays from the stamp to the callback [us]."""
    delays: list[float] = []
    ended = []

    def take(message: TFMessage) -> None:
        now = rospy.Time.now()
        if message.transforms[0].child_frame_id == END:
            ended.append(True)
        else:
            delays.append((now - message.transforms[0].header.stamp).to_sec() * 1e6)

    rospy.Subscriber("/tf", TFMessage, take, tcp_nodelay=True)
    deadline = time.monotonic() + 2.0 * START_S + count / RATE_HZ
    while not ended and time.monotonic() < deadline:
        time.sleep(0.1)
    return {"delays": delays}


def main(kind: str, count: str) -> None:
    """Runs one node, and prints its result."""
    rospy.init_node(f"bench_tf_{kind}", anonymous=True)
    print(json.dumps(listen(int(count)) if kind == "listen" else send(kind, int(count))))
    rospy.signal_shutdown("done")


if __name__ == "__main__":
    main(*sys.argv[1:3])
