"""A controller on the simulated robot, and what a person does with both; for tests of the nodes, real or simulated."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import yaml

from common import clock
from common.poses import pose
from rig_simulation.control_port import ControlClient

CONFIG = Path(__file__).parents[1] / "config"
REAL_TIME, PTP = "real_time_controller.py", "ptp_controller.py"
MOVE_S = 60.0
"""Longest wait for a motion."""
QUICK = {
    REAL_TIME: {"velocity_ptp_slow": 0.8, "velocity_ptp_fast": 0.8, "rate_servo": 100.0},
    PTP: {"velocity_ptp": 0.8},
}
"""Quicker motions and fewer goals than in the yaml files, whose values one test has: the others need half the time."""
RATES = {"rate_joints": 25.0, "rate_state": 10.0}
SLOW = {"velocity_ptp_slow": 0.15}
"""For what must happen while the arm moves."""


class Robot:
    """The simulated robot, and the truth about it from its control port."""

    def __init__(self, process, port, control_port):
        self.process, self.port = process, port
        self.ask = ControlClient("127.0.0.1", control_port, 60.0).ask

    @property
    def joints(self):
        return np.array(self.ask("state")["joints"])

    @property
    def tool(self):
        """The pose of the tool of the parameters, shape (4, 4) [m]."""
        return np.array(self.ask("state")["flange"]) @ pose(p=(0.0, 0.0, 0.106))

    def is_at(self, T, tolerance=3e-3):
        return np.linalg.norm(self.tool[:3, 3] - T[:3, 3]) < tolerance

    @property
    def log(self):
        return self.process.log_path.read_text()


def run_robot(ros, wait_until, *arguments):
    process = ros.run("rig_simulation", "sunrise_controller.py", *arguments)
    ready = r"listening on 127\.0\.0\.1:(\d+), control port 127\.0\.0\.1:(\d+)"
    found = wait_until(lambda: re.search(ready, process.log_path.read_text()), 20.0, "the simulated robot")
    return Robot(process, int(found[1]), int(found[2]))


class Node:
    """A controller that runs, and what a person does with it."""

    def __init__(self, process, wait_until):
        self.process, self._wait_until = process, wait_until

    def call(self, name, kind, *values):
        import rospy

        import kuka_msgs.srv

        rospy.wait_for_service(f"kuka/{name}", 20.0)
        return rospy.ServiceProxy(f"kuka/{name}", getattr(kuka_msgs.srv, kind))(*values)

    def control(self, on):
        return self.call("kuka_control", "setKukaControl", on)

    def wait_for_mode(self, *modes, timeout=MOVE_S):
        self._wait_until(lambda: self.modes and self.modes[-1].data in modes, timeout, f"mode {modes}")

    def wait_for_end(self, timeout=MOVE_S):
        self._wait_until(lambda: self.process.poll() is not None, timeout, "the end of the node")
        return self.process.returncode

    def engage(self):
        """Switches control on and waits until the arm came home."""
        self.modes.clear()
        answer = self.control(True)
        assert answer.success
        self._wait_until(lambda: "home" in self.moved_through(), MOVE_S, "the arm at home")
        return answer

    def moved_through(self):
        """Returns the modes so far, without that of a controller that is still judging its first motion."""
        return [message.data for message in self.modes if message.data != "starting"]

    @property
    def log(self):
        return self.process.log_path.read_text()


def set_params(executable, **changes):
    import rospy

    file = CONFIG / ("kuka_params_rt.yaml" if executable == REAL_TIME else "kuka_params_ptp.yaml")
    rospy.set_param("kuka", {**yaml.safe_load(file.read_text()), **changes})


def quick_params(executable, port, **changes):
    """Sets the parameters of the simulated robot at a port, with quick motions."""
    set_params(executable, ip="127.0.0.1", port=port, tool_mass=0.0, **{**QUICK[executable], **RATES, **changes})


class Hand:
    """Publishes the desired tool frame `of` an arm at 100 Hz until it is hidden."""

    def __init__(self, T, parent_chain=False, of=""):
        import rospy
        import tf2_ros

        self.T = T
        self.delay = rospy.Duration(0.0)
        self._parent_chain, self._of = parent_chain, of
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self.show()

    def show(self):
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._publish, daemon=True)
        self._thread.start()

    def hide(self):
        self._stop.set()
        self._thread.join()

    def _publish(self):
        import rospy

        from common.ros.conversions import stamped_transform

        while not self._stop.wait(0.01):
            now = rospy.Time.now() + self.delay
            steps = [(f"{self._of}kuka/base_frame", f"{self._of}kuka/tool_frame/desired", self.T)]
            if self._parent_chain:
                middle = "leap_motion/virtual_frame"
                half, rest = pose(p=self.T[:3, 3] / 2.0), pose(self.T[:3, :3], self.T[:3, 3] / 2.0)
                steps = [("kuka/base_frame", middle, half), (middle, "kuka/tool_frame/desired", rest)]
            self._broadcaster.sendTransform([stamped_transform(T, a, b, now) for a, b, T in steps])


def home_tool():
    """Tool at the workspace centre of the default parameters, z down, x back to the base."""
    import rospy

    c = np.sqrt(0.5)
    R = np.column_stack([[-c, c, 0.0], [c, c, 0.0], [0.0, 0.0, -1.0]])
    return pose(R, rospy.get_param("kuka/ws_center"))


def shifted(T, x, y, z):
    T = T.copy()
    T[:3, 3] += (x, y, z)
    return T
