"""Hostile peers of the running rig: nodes that publish tf frames, tracking frames, or ask services, with bad values. As
a program, `python -m campaign.hostile NAME X Y Z`, it is a node of that name which publishes a frame `MOUNT` without
rotation in the arm's base, at X Y Z [m], from SIGUSR1 on until it is ended."""

from __future__ import annotations

import contextlib
import math
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from common import clock
from common.frames import BASE, TOOL_DESIRED
from common.poses import pose, translation
from common.ros.conversions import transform_message
from common.rotations import rotation_about

MOUNT = "campaign/mount"  # a frame that the desired tool frame may stand in
RATE_HZ = 80.0
HEARD_S = 6.0  # a reason is said within this time [s]


@dataclass(frozen=True)
class Frame:
    """A frame as it is published: a pose, shape (4, 4) [m], or seven numbers x, y, z and x, y, z, w of a quaternion."""

    T: np.ndarray | tuple[float, ...]
    parent: str = BASE
    child: str = TOOL_DESIRED
    ahead: float = 0.0  # of its stamp [s]

    @property
    def message(self) -> TransformStamped:
        """It, stamped now."""
        transform = numbers(*self.T) if isinstance(self.T, tuple) else transform_message(self.T)
        stamp = rospy.Time.from_sec(max(rospy.get_time() + self.ahead, 0.0))
        return TransformStamped(Header(0, stamp, self.parent), self.child, transform)


def numbers(x: float, y: float, z: float, *quaternion: float) -> Transform:
    """Returns a Transform of any numbers."""
    return Transform(Vector3(x, y, z), Quaternion(*quaternion))


class FrameStream:
    """Publishes frames on /tf from a thread of its own, as another node does.

    Args:
        path: returns the frames to publish at a time since the start [s]. May be replaced.
        silent: whether none are published until this changes."""

    def __init__(self, path: Callable[[float], Iterable[Frame]], silent: bool = False, rate: float = RATE_HZ) -> None:
        self.path, self.silent, self._period = path, silent, 1.0 / rate
        self._publisher = rospy.Publisher("/tf", TFMessage, queue_size=100, tcp_nodelay=True)
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._run, daemon=True)
        deadline = clock.monotonic() + HEARD_S
        while self._publisher.get_num_connections() < 2 and clock.monotonic() < deadline:  # the controller, and we
            clock.sleep(0.05)

    def __enter__(self) -> FrameStream:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._publisher.unregister()

    def send(self, *frames: Frame) -> None:
        """Publishes frames in one message."""
        self._publisher.publish(TFMessage([frame.message for frame in frames]))

    def _run(self) -> None:
        begin = clock.monotonic()
        while not self._stop.wait(self._period):
            frames = [] if self.silent else list(self.path(clock.monotonic() - begin))
            if frames:
                self.send(*frames)


def swaying(T: np.ndarray, along: tuple[float, float, float], period: float) -> Callable[[float], np.ndarray]:
    """Returns a pose by time: T, shape (4, 4), moved to and fro along a vector [m], beginning at rest."""

    def at(t: float) -> np.ndarray:
        return translation(*(0.5 * (1.0 - math.cos(2.0 * math.pi * t / period)) * np.array(along)).tolist()) @ T

    return at


def turning(T: np.ndarray, axis: np.ndarray, angle: float, period: float) -> Callable[[float], np.ndarray]:
    """Returns a pose by time: T turned to and fro by up to `angle` [rad] in place, about an axis of the base."""

    def at(t: float) -> np.ndarray:
        part = 0.5 * (1.0 - math.cos(2.0 * math.pi * t / period)) * angle
        return pose(about(axis, part) @ T[:3, :3], T[:3, 3])

    return at


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Returns the rotation by an angle [rad] about a unit vector that is level or vertical, shape (3, 3)."""
    if abs(axis[2]) > 0.5:
        return rotation_about(2, angle * axis[2])
    R_z = rotation_about(2, math.atan2(axis[1], axis[0]))
    return R_z @ rotation_about(0, angle) @ R_z.T


@dataclass
class Attack:
    """Bad input, and the regular expression of what is said to it; empty: the row looks at a counter."""

    what: str
    send: Callable[[Any], object]  # takes the trial; the answer of a service, or None
    says: str
    following: bool = True  # whether it is also sent while the arm follows a hand


def by_frames(what: str, says: str, *frames: Frame, count: int = 20) -> Attack:
    """Returns the attack by frames on /tf; where a hand is followed they would be a second desired tool."""

    def send(trial: Any) -> None:
        with FrameStream(lambda _: frames):
            clock.sleep(count / RATE_HZ)

    return Attack(what, send, says, following=False)


def by_service(name: str, kind: Any, says: str, *values: Any) -> Attack:
    """Returns the attack by the request to a service."""
    return Attack(f"{name} {_short(values)}", lambda trial: trial.rig.call(name, kind, *values), says)


def by_message(topic: str, says: str, message: Any, what: str = "", count: int = 5, following: bool = True) -> Attack:
    """Returns the attack by messages on a topic."""

    def send(trial: Any) -> None:
        publisher = rospy.Publisher(topic, type(message), queue_size=10)
        trial.rig.wait(lambda: publisher.get_num_connections() > 0, f"somebody who hears {topic}")
        for _ in range(count):
            if hasattr(message, "header"):
                message.header.stamp = rospy.Time.now()
            publisher.publish(message)
            clock.sleep(0.02)
        publisher.unregister()

    return Attack(f"{topic} {what}", send, says, following)


def attack(trial: Any, attacks: Iterable[Attack], following: bool = False) -> None:
    """Sends each attack; notes whether it was refused, with its reason where the arm is at home."""
    rig = trial.rig
    for bad in attacks:
        if following and not bad.following:
            continue
        since = clock.monotonic()
        rig.listen_anew()
        answer = bad.send(trial)
        if answer is not None:
            rig.hear(bad.what.split()[0], answer.message)
            trial.check(f"{bad.what} is refused", not answer.success, answer.message)
        if following or not bad.says:
            continue
        deadline = clock.monotonic() + HEARD_S
        while not _said(rig, bad.says, since) and clock.monotonic() < deadline:
            clock.sleep(0.02)
        trial.check(f"the reason of {bad.what} is said", _said(rig, bad.says, since), _last(rig, since))


def counted(trial: Any, node: str, *names: str) -> None:
    """Notes whether /diagnostics of a node counts something."""
    rig = trial.rig
    deadline = clock.monotonic() + HEARD_S
    while not all(rig.count(node, name) for name in names) and clock.monotonic() < deadline:
        clock.sleep(0.1)
    trial.check(f"{node} counts {', '.join(names)}", all(rig.count(node, name) for name in names), rig._counts[node])


def at_home_and_while_following(trial: Any, attacks: list[Attack]) -> None:
    """Sends bad input with control on: at home, and while the arm follows a hand, which it must continue to do."""
    rig = trial.rig
    assert rig.control(True).success
    trial.begins()
    attack(trial, attacks)
    trial.check("the controller stays at home", rig.mode == "home" and set(rig.modes) <= {"home"}, str(rig.modes))
    rig.control(False)
    trial.operator()
    rig.watch(1.5)  # so long the node before counts as a second publisher of its frames
    trial.follow()
    rig.modes.clear()
    attack(trial, attacks, following=True)
    rig.watch(1.0)
    trial.check("the arm follows the hand as before", rig.mode == "servo" and not rig.modes, str(rig.modes))


def pose_of(x: float, y: float, z: float, *quaternion: float, frame: str = BASE) -> PoseStamped:
    """Returns a PoseStamped of any numbers."""
    message = PoseStamped(header=Header(0, rospy.Time.now(), frame))
    message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, z
    message.pose.orientation = Quaternion(*quaternion)
    return message


@contextlib.contextmanager
def mount(trial: Any, x: float, y: float, z: float, name: str = "campaign_mount") -> Iterator[Any]:
    """Runs the program of this module; yields its process."""
    process = trial.rig.program(sys.executable, "-m", "campaign.hostile", name, str(x), str(y), str(z))
    try:
        trial.rig.wait(lambda: trial.rig.pid(name) is not None, f"the node {name}", 20.0)
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)


def _said(rig: Any, pattern: str, since: float) -> bool:
    return any(when >= since and re.search(pattern, text) for when, _, text in list(rig.said))


def _last(rig: Any, since: float) -> str:
    return " | ".join(text for when, _, text in list(rig.said) if when >= since)[-300:]


def _short(values: tuple) -> str:
    return " ".join(" ".join(str(value).split()) for value in values)[:80]


def main(name: str, x: str, y: str, z: str) -> None:
    """Publishes the frame."""
    begin: list[int] = []
    signal.signal(signal.SIGUSR1, lambda *_: begin.append(1))
    rospy.init_node(name)
    frame = Frame(translation(float(x), float(y), float(z)), BASE, MOUNT)
    with FrameStream(lambda _: [frame] if begin else []):
        rospy.spin()


if __name__ == "__main__":
    main(*sys.argv[1:5])
