"""A controller at the pace of its node, and the simulated robot behind a link that a test worsens; in virtual time."""

from __future__ import annotations

import contextlib
import dataclasses
from functools import partial

import numpy as np
from loop_world import CLOCK, rig, shifted

from common import clock
from kst import KstClient, ReplyTimeout, SoftSettings, ToolTransform
from kuka_control.loop import assembly
from kuka_control.loop.arm import KstArm
from kuka_control.loop.commands import Inputs
from kuka_control.loop.controller import Controller, ReconnectSupervisor
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.switches import SwitchState
from kuka_control.model.tool_load import wrench_at_tool
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.leap_rig_server import LeapRigServer
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.devices.sunrise.server import ServerSettings, SunriseServer
from rig_simulation.files import read_urdf
from simulated.wires import virtual_wires

PROBES = {"getPin3", "getJointsPositions"}
CYCLE_S = 0.004
ARM_KEYS = {field.name for field in dataclasses.fields(ArmSettings)}
SOFT = SoftSettings(500.0, 100.0, 0.7, 40.0, 20.0, 0.2)
GROUP = "robot"
ROBOT = Robot(read_urdf("LBR7R800", "MF_elektrisch"))


class Bench:
    """What the node does around a controller, without ROS.

    Attributes:
        up, down: the link's ways to the robot and back.
        sent: the words of the commands so far.
        goals: when servo goals were sent [s].
    """

    def __init__(self, scheduler, wires, application=None, **changes):
        arm = {key: changes.pop(key) for key in ARM_KEYS & changes.keys()}
        self.scheduler = scheduler
        self.robot = SimulatedArm(ROBOT, ArmSettings(**arm))
        with scheduler.in_group(GROUP):
            kind = SunriseServer if application is None else LeapRigServer
            self.server = kind(self.robot, ServerSettings(), "127.0.0.1", 0, 0)
            clock.Thread(target=self.server.run, name="robot", daemon=True).start()
        settings, self.rig = rig(RealTimeConfig, time_out=5.0, **changes)
        tool = ToolTransform(self.rig.T_flange_tool)
        self.client = KstClient.connect("127.0.0.1", self.server.port, tool, application=application)
        _, self.up, self.down = wires.connections[0]
        self.sent, self.goals = [], []
        self.up.sent = self._note
        weighed = application is not None and application.tool_mass > 0.0
        arm = KstArm(
            self.client, partial(wrench_at_tool, self.rig.kinematics), guarded=True, weighed=weighed, soft=SOFT
        )
        self.make = partial(assembly.real_time_loop, settings, self.rig)
        self.loop = self.make()
        self.controller = Controller(arm, self.loop)
        self.mode = "starting"
        self.arm, self.control_on, self.enable_count, self.stop_count, self.payload = arm, True, 1, 0, 0.0
        self.paused, self.stop_because = False, "control is off"
        self.soft = False
        self.hand = True  # whether the operator has one
        self.wanted = None  # where a hand that is held still wants the tool, shape (4, 4) [m]
        self.move = None  # that a program asks for

    def freeze(self, *spans):
        """Lets the robot's controller stand still in the given spans of time [s]."""

        def frozen():
            for begin, end in spans:
                clock.sleep(begin - clock.monotonic())
                self.scheduler.suspended.add(GROUP)
                clock.sleep(end - clock.monotonic())
                self.scheduler.suspended.discard(GROUP)

        clock.Thread(target=frozen, name="freezes", daemon=True).start()

    def run(self, until, mode=None):
        """Runs until a time [s], or until a mode, which must be reached before."""
        while clock.monotonic() < until:
            before, silent = len(self.sent), not self.client._session.in_step
            try:
                step = self.cycle()
                self.mode = step.mode
                if silent and not self.client._session.in_step:
                    assert set(self.sent[before:]) <= PROBES
                if mode is not None and step.mode == mode:
                    return
            except ReplyTimeout as error:
                self._stand_by(error)
            clock.sleep(CYCLE_S)
        assert mode is None, f"{mode} was not reached: {step.mode}, {step.reason}"

    def follow(self, seconds):
        """Follows the hand; returns the begin [s], the step and the number of goals of each cycle."""
        steps = []
        end = clock.monotonic() + seconds
        while clock.monotonic() < end:
            begun, before = clock.monotonic(), len(self.goals)
            step = self.cycle()
            steps.append((begun, step, len(self.goals) - before))
            clock.sleep(max(begun + CYCLE_S - clock.monotonic(), 0.0))
        return steps

    def cycle(self):
        """One cycle of the controller."""
        return self.controller.cycle(self.inputs(), clock.monotonic())

    def inputs(self):
        now = clock.monotonic()
        T = shifted(0.0, 0.03 * np.sin(0.8 * now), 0.0) if self.wanted is None else self.wanted
        # The operator brings the hand in when the arm is at home, as the status asks for.
        shown = self.hand and self.mode in ("home", "pick_up", "servo")
        desired = DesiredFrame(T, CLOCK + round(now, 2)) if shown else None
        return Inputs(desired, CLOCK + now, self.switches(), self.move)

    def switches(self):
        return SwitchState(
            *(self.control_on, self.enable_count),
            payload=self.payload,
            stop_count=self.stop_count,
            stop_because=self.stop_because,
            paused=self.paused,
            soft=self.soft,
        )

    def switch(self, on):
        self.control_on = on
        self.enable_count += on
        self.stop_count += not on

    def _stand_by(self, error):
        self.control_on, self.mode = False, "stopped"
        self.loop = ReconnectSupervisor(error, self.loop.counts, self.make)
        self.controller.restart(self.arm, self.loop)
        while not self.controller.regained():
            clock.sleep(0.05)

    def _note(self, data, now):
        for line in data.decode().splitlines():
            self.sent.append(line.split("_")[0] if line.endswith("_") else line)
            if line.startswith("jp"):
                self.goals.append(now)


@contextlib.contextmanager
def bench(seed=0, application=None, **changes):
    """A bench in virtual time; `application`: on the robot's controller, None: the toolbox's; `changes`: settings of
    the arm, and parameters of its controller."""
    with virtual_wires(seed) as wires:
        yield Bench(wires.scheduler, wires, application, **changes)
