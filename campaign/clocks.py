"""The clock of a rig under test: the machine's, one that can be set as NTP sets it, or simulated ROS time."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import rospy
from rosgraph_msgs.msg import Clock as ClockMessage

from campaign.trial import SHIFTED, SIMULATED
from common import clock

PERIOD_S = 0.01  # of /clock


class Clock:
    """The machine's clock, which nobody changes.

    Args:
        folder: for its files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def start(self) -> None:
        """Lets it run, once there is a ROS master; the rig starts afterwards."""

    def stop(self) -> None:
        """Ends it."""


class ShiftedClock(Clock):
    """The wall clocks of all programs that are started from now on; `step` sets them all at the same moment. No
    namespace of the kernel has a wall clock of its own, so each program's `time.time` is another one, from which ROS
    takes its time."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / "clock")
        self._folder.mkdir()
        self._write("all", 0.0)
        paths = [str(Path(__file__).with_name("shifted")), *filter(None, os.environ.get("PYTHONPATH", "").split(":"))]
        os.environ.update(CAMPAIGN_CLOCK=str(self._folder), PYTHONPATH=":".join(paths))

    def step(self, seconds: float, node: str = "all") -> None:
        """Sets the clocks of all programs forwards by so much, or only that of a node."""
        (before,) = struct.unpack("d", (self._folder / node).read_bytes())
        self._write(node, before + seconds)

    def _write(self, name: str, offset: float) -> None:
        path = self._folder / name
        with open(path, "r+b" if path.exists() else "wb") as file:  # in place, since programs have it in their memory
            file.write(struct.pack("d", offset))


class SimulatedTime(Clock):
    """ROS time by /clock, published from this process."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._offset = 0.0
        self._running = clock.Event()
        self._publisher: rospy.Publisher | None = None

    def start(self) -> None:
        rospy.set_param("/use_sim_time", True)  # for nodes that start later, not for this one
        self._publisher = rospy.Publisher("/clock", ClockMessage, queue_size=10, tcp_nodelay=True)
        self._running.set()
        clock.Thread(target=self._run, daemon=True).start()

    def stop(self) -> None:
        self._publisher = None

    def pause(self, yes: bool) -> None:
        """Stops publishing, or resumes."""
        (self._running.clear if yes else self._running.set)()

    def step(self, seconds: float) -> None:
        """Sets the clock forwards, or back."""
        self._offset += seconds

    def _run(self) -> None:
        while self._publisher is not None:
            if self._running.wait(0.1):
                self._publisher.publish(rospy.Time.from_sec(clock.time() + self._offset))
                clock.sleep(PERIOD_S)


def clock_of(variant: str, folder: Path) -> Clock:
    """Returns the clock of a variant of the rig, before anything of it was started."""
    return {SHIFTED: ShiftedClock, SIMULATED: SimulatedTime}.get(variant, Clock)(folder)
