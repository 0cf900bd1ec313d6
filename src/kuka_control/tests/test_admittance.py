"""Admittance: the law, up to which contact and delay it is stable, and the whole loop on the simulated robot."""

from __future__ import annotations

import collections
import dataclasses
import math
import re
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link_world import bench
from loop_world import rig, shifted, tipped
from test_robot_application import KNOWN, events, following

from common import clock
from common.errors import ConfigError
from common.modes import Mode
from kuka_control.loop.arm import ArmState
from kuka_control.loop.commands import Inputs, Observation, Step, Wait
from kuka_control.loop.controller import Controller
from kuka_control.loop.giving_way import GivingWay
from kuka_control.model.admittance import (
    Admittance,
    AdmittanceSettings,
    delay_margin,
    stability_fault,
    stiffest_contact,
)
from kuka_control.model.config import RealTimeConfig
from kuka_control.numbers import FORCE_DELAY_S

DT = 0.001
FREE = {"dead_band": 0.0, "farthest": math.inf, "fastest": math.inf}
X = np.array([1.0, 0.0, 0.0])


def run(admittance, force, seconds, age=0.0, dt=DT):
    for _ in range(round(seconds / dt)):
        admittance.step(force, age, dt)
    return admittance.displacement


@given(st.floats(1.0, 30.0), st.floats(100.0, 800.0), st.floats(200.0, 2000.0))
@settings(max_examples=8, deadline=None)
def test_a_force_displaces_by_the_stiffness_and_the_tool_goes_back(mass, damping, stiffness):
    admittance = Admittance(AdmittanceSettings(mass, damping, stiffness, **FREE))
    slowest = 8.0 * max(damping / stiffness, 2.0 * mass / damping)
    assert run(admittance, 20.0 * X, slowest, dt=0.01) == pytest.approx(20.0 / stiffness * X, rel=0.01)
    assert run(admittance, np.zeros(3), slowest, dt=0.01) == pytest.approx(np.zeros(3), abs=0.01 * 20.0 / stiffness)


def test_it_moves_as_mass_and_damper_say():
    admittance = Admittance(AdmittanceSettings(8.0, 800.0, 1e-6, **FREE))
    assert not admittance.step(1e3 * X, 0.0, 0.0).any()
    run(admittance, 40.0 * X, 0.2)
    before = admittance.displacement
    assert (run(admittance, 40.0 * X, 0.1) - before) / 0.1 == pytest.approx(40.0 / 800.0 * X, rel=1e-3)
    fast = Admittance(AdmittanceSettings(8.0, 1e-6, 1e-6, **FREE))
    assert run(fast, 40.0 * X, 0.1) == pytest.approx(0.5 * 40.0 / 8.0 * 0.1**2 * X, rel=0.02)


def test_small_old_and_broken_forces_do_nothing():
    limits = AdmittanceSettings()
    for force, age in (
        (4.9 * X, 0.0), (100.0 * X, 0.11), (None, 0.0), (np.full(3, np.nan), 0.0), (np.full(3, np.inf), 0.0),
        (0.0 * X, 0.0), (100.0 * X, math.nan), (1e200 * X, 0.0), (1.1e4 * X, 0.0),
    ):  # fmt: skip
        assert not run(Admittance(limits), force, 1.0, age).any(), (force, age)
    pushed = Admittance(limits)
    far = run(pushed, np.array([0.0, -15.0, 0.0]), 20.0)
    assert far == pytest.approx(np.array([0.0, -10.0 / limits.stiffness, 0.0]), rel=0.01), "less the dead band"
    for force, age in ((np.full(3, np.nan), 0.0), (np.zeros(3), 0.11), (None, 0.0)):
        assert run(pushed, force, 2.0, age) == pytest.approx(far), "it stays while the force is not known"
    assert np.linalg.norm(run(pushed, np.zeros(3), 20.0)) < 1e-3, "it goes back"


@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), min_size=1, max_size=40))
@settings(max_examples=50, deadline=None)
def test_nothing_moves_it_farther_or_faster_than_its_bounds(forces):
    limits = AdmittanceSettings()
    admittance = Admittance(limits)
    for force in forces:
        before = admittance.displacement
        after = admittance.step(np.array(force), 0.0, 0.004)
        assert np.linalg.norm(after) <= limits.farthest * (1.0 + 1e-9)
        assert np.linalg.norm(after - before) <= limits.fastest * 0.004 * (1.0 + 1e-9)


def grows(limits, contact, delay):
    """Returns whether the tool at a body of this stiffness, whose force comes late, swings ever farther."""
    dt = delay / 50.0
    admittance, late = Admittance(limits), collections.deque([np.zeros(3)] * 50)
    sizes = []
    for step in range(50 * 60):
        late.append(-contact * admittance.displacement if step > 20 else 1.0 * X)
        sizes.append(abs(float(admittance.step(late.popleft(), 0.0, dt)[0])))
    third = len(sizes) // 3
    return max(sizes[-third:]) > max(sizes[third : 2 * third])


@given(st.floats(2.0, 20.0), st.floats(200.0, 2000.0), st.floats(100.0, 1000.0), st.floats(0.02, 0.15))
@settings(max_examples=10, deadline=None)
def test_the_bound_of_stability_is_where_the_swing_begins_to_grow(mass, damping, stiffness, delay):
    limits = AdmittanceSettings(mass, damping, stiffness, **FREE)
    contact = stiffest_contact(limits, delay)
    assert delay_margin(limits, contact) == pytest.approx(delay, rel=1e-3)
    assert not grows(limits, 0.85 * contact, delay)
    assert grows(limits, 1.15 * contact, delay)


def test_more_damping_and_less_delay_bear_a_stiffer_contact():
    bears = [stiffest_contact(AdmittanceSettings(damping=d), 0.1) for d in (200.0, 400.0, 800.0, 1600.0)]
    assert bears == sorted(bears) and bears[-1] > 6.0 * bears[0]
    bears = [stiffest_contact(AdmittanceSettings(), t) for t in (0.2, 0.1, 0.05, 0.02)]
    assert bears == sorted(bears)
    assert delay_margin(AdmittanceSettings(), 300.0) == math.inf, "softer than its own spring: stable with any delay"


FAST = {"admittance_stiffness": 2000.0, "torque_limit": 1e3}  # it comes and goes in 0.6 s


def loop(application=None, **changes):
    """A bench whose tool gives way, and whose tool of 1.12 kg its robot takes for a force."""
    return bench(application=application, tool_weight=True, admittance=True, **{**FAST, **changes})


def displaced(one):
    """How far the tool is from where the hand wants it [m], with the robot's lag."""
    return one.robot.tool[:3, 3] - one.wanted[:3, 3]


def holding(one, tool=None):
    """The operator holds the hand still, and the arm follows it."""
    one.wanted = shifted(0.0, 0.0, 0.0) if tool is None else tool
    return following(one)


def touched(one, seconds, force):
    """Runs so long; `force`: on the tool in the base [N], or a function that returns it. Returns the displacements."""
    places, end = [], clock.monotonic() + seconds
    while clock.monotonic() < end:
        one.robot.set_tool_force(one.robot.tool[:3, :3].T @ np.array(force() if callable(force) else force))
        step = one.cycle()
        assert step.mode == "servo", step.reason
        one.mode, one.said = step.mode, step.reason
        places.append(displaced(one))
        clock.sleep(0.004)
    return np.array(places)


NOTHING, PUSH = (0.0, 0.0, 0.0), (45.0, 0.0, 0.0)
GIVES_WAY = "The tool gives way to a force."
UNKNOWN = "The force on the tool is not known; it gives way no further."


def is_back(places):
    return np.linalg.norm(places[-1]) < 1e-3


@pytest.mark.parametrize("application", [None, KNOWN])
def test_the_whole_arm_gives_way_and_comes_back(application):
    noise = np.random.default_rng(1)
    with loop(application) as one:
        places = touched(holding(one, tipped(0.3, -0.03)), 3.0, lambda: noise.normal(0.0, 1.5, 3))
        assert np.max(np.linalg.norm(places[250:], axis=1)) < 1e-3, "noise makes it creep"
        np.testing.assert_allclose(touched(one, 4.0, PUSH)[-1], (40.0 / 2000.0, 0.0, 0.0), atol=2e-3)
        assert GIVES_WAY in one.said
        assert is_back(touched(one, 4.0, NOTHING)) and "gives way" not in one.said


@pytest.mark.parametrize("application", [None, KNOWN])
def test_the_weight_of_what_the_hand_holds_is_no_contact(application):
    weight = np.array([0.0, 0.0, -0.8 * 9.81])
    with loop(application) as one:
        one.payload = 0.8
        one.robot.set_tool_force(one.rig.home.T_base_tool[:3, :3].T @ weight)
        assert is_back(touched(holding(one), 1.0, weight))
        assert touched(one, 2.0, weight + PUSH)[-1][0] > 0.01


def test_it_never_goes_farther_than_its_path_nor_out_of_the_workspace():
    with loop(admittance_path=0.01) as one:
        assert np.max(np.linalg.norm(touched(holding(one), 1.5, PUSH), axis=1)) < 0.012
    with loop() as one:
        lowest = one.rig.workspace.z_lower
        holding(one, shifted(0.0, 0.0, lowest + 0.005 - one.rig.home.T_base_tool[2, 3]))
        touched(one, 1.5, (0.0, 0.0, -60.0))
        assert lowest - 1e-3 < one.robot.tool[2, 3] < lowest + 1e-3


def test_a_force_that_is_not_known_holds_the_tool_where_it_is(monkeypatch):
    with loop() as one:
        holding(one)
        take, lost = one.arm._take, {}

        def broken(field, value):
            if field == "force":
                one.arm.state = dataclasses.replace(one.arm.state, force=lost.get("force", value))
            else:
                take(field, value)

        monkeypatch.setattr(one.arm, "_take", broken)
        touched(one, 3.0, PUSH)
        for value in (np.full(3, np.nan), one.arm.state.force, None):
            lost["force"] = value
            held = touched(one, 0.3, NOTHING)[-1]
            assert held[0] > 0.01 and UNKNOWN in one.said, value
            np.testing.assert_allclose(touched(one, 1.0, NOTHING)[-1], held, atol=1e-4)
            del lost["force"]
            assert touched(one, 0.5, PUSH)[-1][0] > held[0] and UNKNOWN not in one.said
        assert is_back(touched(one, 4.0, NOTHING))


class Pushed:
    """A tool at home that gives way to forces, frame by frame."""

    def __init__(self):
        config, self.rig = rig(RealTimeConfig, admittance=True)
        self.way, self.now = GivingWay(config.gives_way, self.rig.load), 0.0

    def step(self, force, age=0.01, dt=0.01):
        q, R = self.rig.home.q, self.rig.home.T_base_tool[:3, :3]
        self.now += dt
        force = self.rig.load.wrench(q)[0] + R.T @ force
        return self.way.step(Observation(q, force=force, force_age=age), self.now)

    def run(self, seconds, force, *ages):
        for step in range(round(seconds / 0.01)):
            given = self.step(force, ages[step % len(ages)])
        return given


def test_what_was_felt_before_the_tool_follows_is_not_weighed():
    one = Pushed()
    one.step(45.0 * X, age=0.05)
    assert one.run(1.0, 45.0 * X, 0.01)[0] == 0.0 and "does not give way: where it begins" in one.way.says
    one.way.begin(one.now)
    one.step(45.0 * X, age=0.05)
    assert not one.run(0.2, 0.0 * X, 0.01).any() and one.way.says is None
    assert one.run(0.5, 45.0 * X, 0.01)[0] > 0.01


def test_after_a_stall_the_tool_goes_on_as_slowly():
    one = Pushed()
    before = one.run(0.2, 0.0 * X, 0.01)
    after = one.step(500.0 * X, dt=1.0)
    assert 0.001 < after[0] - before[0] <= 0.1 * 0.05 + 1e-9


def test_a_force_is_as_old_as_its_question():
    ages, q = [], np.zeros(7)
    arm = SimpleNamespace(
        **{"measured_joints": q, "silence": lambda: 0.0, "round_trip": 0.03, "abilities": frozenset(), "read": Mock()},
        **{"reckoned": (False, 0.0), "carry": Mock(), "take_remarks": list, "state": ArmState(q)},
    )

    def step(seen, now):
        ages.append(seen.force_age)
        return Step(Wait(), Mode.HOME, "", ())

    controller = Controller(arm, SimpleNamespace(step=step))
    controller.cycle(Inputs(), 1.0)
    arm.state = ArmState(q, force=X)
    for now in (1.01, 1.1):
        controller.cycle(Inputs(), now)
    assert ages == [math.inf, pytest.approx(0.04), pytest.approx(0.13)]


def test_each_stay_begins_where_the_hand_wants_the_tool_and_weighs_anew():
    with loop() as one:
        touched(holding(one), 1.0, PUSH)
        assert one.loop._yielded[0] > 0.005 and GIVES_WAY in one.said
        one.robot.set_tool_force(one.robot.tool[:3, :3].T @ (10.0 * X))
        one.wanted = shifted(0.0, 0.1, 0.0)
        _, said = events(one, 0.5)
        assert any("The desired tool frame jumped" in text for text in said)
        one.run(clock.monotonic() + 20.0, "servo")
        _, said = events(one, 0.3)
        assert any("The tool does not give way: where it begins" in text for text in said)
        assert not one.loop._yielded.any()


def test_forces_with_gaps_hold_the_tool_for_a_while():
    one = Pushed()
    way, after = one.way, one.run
    assert not after(0.2, 0.0 * X, 0.01).any() and way.why_not is None
    far = after(1.0, 45.0 * X, 0.09)
    assert far[0] > 0.01 and way.says == GIVES_WAY
    held = after(1.0, 45.0 * X, 0.09, 0.09, 0.09, 0.11)
    assert held[0] < far[0] + 1e-3 and way.says == UNKNOWN
    assert after(0.25, 45.0 * X, 0.09)[0] == held[0]
    assert after(0.5, 45.0 * X, 0.09)[0] > held[0] + 1e-3 and way.says == GIVES_WAY


def test_a_push_makes_no_desired_frame_infeasible():
    with loop() as one:
        holding(one, shifted(0.0, 0.0, 0.005 - one.rig.home.T_base_tool[2, 3]))
        touched(one, 1.5, (0.0, 0.0, -60.0))
        assert one.loop._yielded[2] < -0.005 and "shuts down" not in one.said


def test_a_weight_that_is_not_known_keeps_the_tool_stiff():
    with loop(tool_mass=0.3) as one:
        one.wanted = shifted(0.0, 0.0, 0.0)
        one.run(clock.monotonic() + 30.0, "servo")
        _, said = events(one, 0.5)
        assert any("The tool does not give way: where it begins to follow, 8 N are on it" in text for text in said)
        assert is_back(touched(one, 1.0, PUSH)) and "does not give way" in one.said


def test_a_soft_arm_of_the_robot_application_is_not_displaced_twice():
    with loop(KNOWN) as one:
        one.soft = True
        touched(holding(one), 1.0, (20.0, 0.0, 0.0))
        assert not one.loop._yielded.any() and "gives way" not in one.said


def swings(contact, seconds=6.0):
    """Returns by how much the force of a body of this stiffness [N/m], against which the hand presses, still changes
    in the last three seconds [N]."""
    pressed = []
    with loop(admittance_stiffness=500.0) as one:
        wall = holding(one).robot.tool[0, 3]
        one.wanted = shifted(0.02, 0.0, 0.0)

        def body():
            pressed.append(contact * max(one.robot.tool[0, 3] - wall, 0.0))
            return (-pressed[-1], 0.0, 0.0)

        touched(one, seconds, body)
    return np.ptp(pressed[-750:])


def test_the_bound_of_stability_holds_for_the_whole_arm():
    bears = stiffest_contact(rig(RealTimeConfig, admittance=True)[0].gives_way, FORCE_DELAY_S)
    assert swings(bears) < 0.5
    assert swings(3.0 * bears) > 5.0


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"compliance": "soft", "robot_server": "leap_rig"}, "admittance is true, but compliance is soft"),
        ({"tool_mass": 0.0}, "admittance is true, but tool_mass is 0"),
        ({"shaping": "none"}, "admittance is true, but shaping is none"),
        (
            {"admittance_damping": 300.0},
            r"admittance_damping is 300 Ns/m, .* body of 10000 N/m; use admittance_damping",
        ),
        ({"admittance_damping": 49.0}, r"admittance_damping is 49.0, but must be .* in \[50, 5000\] Ns/m"),
    ],
)
def test_what_it_cannot_be_used_with_is_refused(changes, sentence):
    with pytest.raises(ConfigError, match=sentence):
        rig(RealTimeConfig, admittance=True, **changes)
    if "admittance_damping" in changes and changes["admittance_damping"] > 50.0:
        rig(RealTimeConfig, **changes)


def test_it_keeps_the_arm_stiff_as_does_a_mass_that_is_not_known():
    for changes, why in (
        ({"admittance": True}, "admittance is true"),
        ({"tool_mass": 0.0}, "tool_mass is 0, and the arm would sink"),
        ({}, None),
    ):
        assert rig(RealTimeConfig, **changes)[0].stiff_because == why


def test_a_refusal_for_stability_names_what_would_do():
    limits = AdmittanceSettings(damping=300.0)
    fault = stability_fault(limits, 10000.0, 5000.0)
    damping, contact = (int(text) for text in re.search(r"in \[(\d+), 5000\], or .* up to (\d+)\.", fault).groups())
    for good, bad in ((damping, damping - 2), (damping + 3000, 300)):
        assert stability_fault(dataclasses.replace(limits, damping=good), 10000.0, 5000.0) is None
        assert stability_fault(dataclasses.replace(limits, damping=bad), 10000.0, 5000.0) is not None
    assert stability_fault(limits, contact, 5000.0) is None and stability_fault(limits, contact + 2, 5000.0)
    assert "use admittance_contact up to" in stability_fault(limits, 1e5, 5000.0), "no damping is enough"
