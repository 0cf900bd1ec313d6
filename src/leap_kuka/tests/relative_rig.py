"""A teleoperation with relative engagement, and an arm that follows it."""

from __future__ import annotations

from common.poses import pose
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import StreamState
from leap_motion.frames import TrackingFrame

BOX_HEIGHT = 0.35
HOLD_S = 2.0
TIME_OUT_S, ARRIVES_S = 0.2, 0.5  # of the arm's controller


class Rig:
    """A teleoperation, the arm that follows it, and the operator's device, at 100 Hz."""

    def __init__(self, leap, arm, sample, T_home, scale=1.0, **changes):
        chosen = {"engagement": "relative", "hold_time": HOLD_S, "clutch": "device", "enabling": "device", **changes}
        self.T_home, self.T_arm, self.scale = T_home, T_home, scale
        self.centre = T_home[:3, 3].copy()
        placement = arm(ws_center=self.centre, z_lower_limit=T_home[2, 3] - 0.2)
        self.teleop = ArmTeleop(leap(**chosen), placement, measured_tool=self._measured)
        self.mode, self.control_on, self.silent = "home", True, 1.0
        self.pressed, self.clutched, self.device_there, self.held = True, False, True, False
        self.number, self.now = 0, 50.0
        self.results = []
        self.teleop.control(False, self.mode, self.scale, self.now)
        self.device(enabled=False)
        self.step()
        self.steps(3, sample(position=(0.3, BOX_HEIGHT, 0.0)))  # the hand comes in while control is on
        self.step()

    def _measured(self):
        return self.T_arm

    def device(self, enabled=None, clutched=None):
        self.pressed = self.pressed if enabled is None else enabled
        self.clutched = self.clutched if clutched is None else clutched

    def step(self, *hands, dt=0.01):
        self.number += 1
        self.now += dt
        self.teleop.control(self.control_on, self.mode, self.scale, self.now)
        if self.device_there:
            self.teleop.switches.device.take(self.pressed, self.clutched, "pedal", 0.0, self.now)
        result = self.teleop.step(TrackingFrame(self.number, 0.0, hands), self.now)
        self._follow(result, dt)
        self.results.append(result)
        return result

    def steps(self, count, *hands):
        return [self.step(*hands) for _ in range(count)][-1]

    def _follow(self, result, dt):
        if result.T_virtual_tool is not None and self.control_on and self.mode in ("home", "servo"):
            T = result.T_base_virtual @ result.T_virtual_tool
            self.T_arm = pose(T[:3, :3], self.centre + self.scale * (T[:3, 3] - self.centre))
            self.mode, self.silent = "servo", 0.0
            return
        self.silent += dt
        if self.mode == "servo" and (self.silent > TIME_OUT_S or not self.control_on):
            self.mode = "returning"
        elif self.mode == "returning" and self.silent > ARRIVES_S:
            self.mode, self.T_arm = "home", self.T_home

    def engaged(self, hand):
        self.device(enabled=False, clutched=False)
        self.step()
        self.device(enabled=True)
        self.steps(11, hand)
        assert self.results[-1].state is StreamState.RUNNING, self.results[-1].reason
        return self
