"""A controller on the simulated robot's application, which freezes at random times; all in simulated time.

The bytes are those of the wire; between the client's session and the application there is a queue instead of a socket.
"""

from __future__ import annotations

import random
from functools import partial

import numpy as np
import pytest
from loop_world import CLOCK, rig, shifted

from kst import ConnectionLost, KstClient, KstError, ReplyTimeout, ToolTransform
from kst.codec import parse_reply
from kst.limits import LBR_IIWA_LIMITS
from kst.session import KstSession, KstTiming
from kuka_control.loop import algorithms
from kuka_control.loop.arm import KstArm
from kuka_control.loop.commands import Inputs
from kuka_control.loop.controller import Controller, ReconnectSupervisor
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.switches import SwitchState
from kuka_control.model.tool_load import wrench_at_tool
from rig_simulation.devices.sunrise.application import Application, ControllerIO
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.files import read_urdf

PROBES = {"getPin3", "getJointsPositions"}
LATENCY_S = 0.0005
ROBOT = Robot(read_urdf("LBR7R800", "MF_elektrisch"))


class Wire:
    """The transport of a session to an application that is frozen in the given spans of time [s]."""

    def __init__(self, frozen):
        self.now, self.frozen = 1000.0, frozen
        self.arm = SimulatedArm(ROBOT, ArmSettings())
        self.application = Application(self.arm, ControllerIO())
        self.ended_by_peer = self.lost = False
        self.sent, self._in, self._out = [], [], []

    def monotonic(self):
        return self.now

    def send(self, line, timeout):
        self._check()
        self.sent.append(line.split("_")[0] if line.endswith("_") else line)
        self._in.append(line)
        self._run(self.now + LATENCY_S)

    def receive(self, deadline):
        self._check()
        while not self._out:
            if self.now >= deadline:
                return None
            self._run(min(deadline, self.now + 0.002))
        return self._out.pop(0)

    def waiting(self):
        self._check()
        out, self._out = self._out, []
        return out

    def pause(self, duration):
        self._run(self.now + duration)

    def give_up(self, reason):
        self.lost = True
        self._check()

    def _run(self, now):
        self.now = max(self.now, now)
        if any(begin <= self.now < end for begin, end in self.frozen):
            return
        texts = [self.application.advance(self.now), *(self.application.receive(line, self.now) for line in self._in)]
        self._in.clear()
        self._out += [parse_reply(line.encode()) for text in texts for line in text.split("\n") if line]

    def _check(self):
        if self.lost:
            raise ConnectionLost("given up")


class Bench:
    """What the node does around a controller, without ROS."""

    def __init__(self, wire):
        settings, self.rig = rig(RealTimeConfig, time_out=5.0)
        self.wire = wire
        self.client = KstClient(KstSession(wire, KstTiming()), ToolTransform(self.rig.T_flange_tool), LBR_IIWA_LIMITS)
        arm = KstArm(self.client, partial(wrench_at_tool, self.rig.kinematics))
        self.make = partial(algorithms.real_time_loop, settings, self.rig)
        self.loop = self.make()
        self.controller = Controller(arm, self.loop)
        self.mode = "starting"
        self.arm, self.control_on, self.enable_count, self.lost = arm, True, 1, 0

    def run(self, until, mode=None):
        while self.wire.now < until:
            wire, inputs = self.wire, self.inputs()
            before, silent = len(wire.sent), not self.client._session.in_step
            try:
                step = self.controller.cycle(inputs, wire.now)
                self.mode = step.mode
                if silent and not self.client._session.in_step:
                    assert set(wire.sent[before:]) <= PROBES
                if mode is not None and step.mode == mode:
                    return
            except ReplyTimeout as error:
                self._stand_by(error)
            wire.pause(0.004)
        assert mode is None, f"{mode} was not reached: {step.mode}, {step.reason}"

    def inputs(self):
        now = self.wire.now
        T = shifted(0.0, 0.03 * np.sin(0.8 * now), 0.0)
        # The operator brings the hand in when the arm is at home, as the status asks for.
        shown = self.mode in ("home", "pick_up", "servo")
        desired = DesiredFrame(T, CLOCK + round(now, 2)) if shown else None
        return Inputs(desired, CLOCK + now, SwitchState(self.control_on, self.enable_count))

    def _stand_by(self, error):
        self.lost += 1
        self.control_on, self.mode = False, "stopped"
        self.loop = ReconnectSupervisor(error, self.loop.counts, self.make)
        self.controller.restart(self.arm, self.loop)
        while not self.controller.regained():
            self.wire.pause(0.05)


@pytest.mark.parametrize("seed", range(5))
def test_no_freeze_shorter_than_the_patience_costs_the_link_or_the_state(seed):
    rng = random.Random(seed)
    begin, length = 1000.0 + rng.uniform(0.0, 6.0), rng.choice([0.25, 0.7, 1.3, 2.5, 6.0])
    again = begin + length + rng.uniform(0.0, 2.0)
    wire = Wire([(begin, begin + length), (again, again + rng.choice([0.03, 0.1, 1.3]))])
    bench = Bench(wire)
    try:
        bench.run(wire.frozen[-1][1] + 0.5)
        bench.control_on, bench.enable_count = True, bench.enable_count + 1
        bench.run(1040.0, "servo")
    except KstError as error:
        pytest.fail(f"{type(error).__name__}: {error}")
    assert wire.arm.stops == 0
