"""Rounds of a cup that stands elsewhere each time: what is marked, when the policy may steer, and when a round ends."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rig_msgs.msg")
import rospy

from common import clock
from common.errors import RigError
from common.modes import Mode
from rig_simulation.files import read_scene
from rig_simulation.node_parameters import NEEDED, NEVER, ONCE
from rig_simulation.operator.cup_scenes import cup_scene
from rig_simulation.operator.pick_and_place import Plan
from rig_simulation.ros import rounds, scenarios
from rig_simulation.ros.rounds import PolicyScenario

pytestmark = pytest.mark.ros


class Cell:
    """An arm at home, the world with a cup, the operator's hand, and services."""

    def __init__(self, lifts_after=float("inf"), touched=True):
        self.lifts_after, self.touched = lifts_after, touched
        self.asked, self.called, self.told, self.scenes = [], [], [], []
        self.let_at, self.refused = float("inf"), ()
        self.grip, self.center_line, self.mode = np.array([0.4, 0.1, 0.3]), np.array([1.0, 0.0, 0.0]), Mode.HOME
        self.streams = self.following = False

    def tell(self, step, failure, **more):
        self.told.append((step, failure, more))

    def call(self, service, kind, *values, **times):
        self.called.append((service, *values))
        if service == "leap_kuka/run_policy":
            self.let_at = clock.monotonic() if values[0] else float("inf")
        return SimpleNamespace(success=service not in self.refused, message="no")

    def ask(self, what, **more):
        self.asked.append(what)
        if what == "scene":
            return {"scene": read_scene("cup")}
        self.scenes += [more["scene"]] if "scene" in more else []
        lifted = clock.monotonic() - self.let_at > self.lifts_after
        cup = {"position": [0.4, 0.1, 0.1], "clearance": 0.1 * lifted, "touches": ["reflex/pad"] * self.touched}
        return {"objects": {"cup": cup}}


@pytest.fixture
def run(virtual_graph, monkeypatch):
    def play(cell, takes_over, count=1):
        for module, name, stand_in in ((scenarios, "SeenArm", lambda *_: cell), (rounds, "call", cell.call)):
            monkeypatch.setattr(module, name, stand_in)
        began = clock.monotonic()
        PolicyScenario(count, 0, takes_over, cell, cell).run()
        return clock.monotonic() - began

    return play


def marks(cell):
    return [service for service, *_ in cell.called if service.startswith("episodes/")]


def lets(cell):
    return [on for service, *on in cell.called if service == "leap_kuka/run_policy"]


def test_a_policy_that_lifts_is_let_and_stopped_in_each_round_and_its_episodes_are_marked(run):
    cell = Cell(lifts_after=5.0)
    assert 2 * 7.5 < run(cell, NEVER, count=2) < 2 * 9.0
    assert marks(cell) == ["episodes/begin", "episodes/success"] * 2
    assert lets(cell) == [[True], [False]] * 2
    step, failure, values = cell.told[-1]
    assert (step, failure, values["good"], values["taken"], values["rounds"]) == ("done", "", "2", "0", "2")
    assert "show" not in cell.asked and len(cell.scenes) == 2
    assert cell.scenes == [cup_scene(read_scene("cup"), seed) for seed in (0, 1)]


@pytest.mark.parametrize("cell", [Cell(), Cell(lifts_after=5.0, touched=False)])
def test_a_policy_that_does_not_lift_by_the_hand_ends_the_round_as_a_failure(run, cell):
    assert 31.0 < run(cell, NEVER) < 33.0
    assert marks(cell) == ["episodes/begin", "episodes/failure"] and lets(cell) == [[True], [False]]
    assert cell.told[-1][2]["good"] == "0"


@pytest.mark.parametrize("takes_over, after", [(ONCE, 2.5), (NEEDED, 11.0)])
def test_an_operator_whom_the_arm_does_not_follow_gives_up(run, takes_over, after):
    cell = Cell(lifts_after=12.0)
    assert 30.0 + after < run(cell, takes_over) < 35.0 + after
    assert cell.told[-1][2]["taken"] == "1" and marks(cell)[-1] == "episodes/failure"
    assert cell.asked.count("show") == 1


def test_an_operator_takes_over_once_and_gives_back(run):
    cell = Cell(lifts_after=15.0)
    cell.streams = True
    assert 15.0 < run(cell, ONCE) < 20.0
    assert cell.told[-1][2]["taken"] == "1" and marks(cell)[-1] == "episodes/success"


def test_a_recorder_that_comes_within_a_round_ends_no_rounds_but_one_that_cannot_begin_does(run):
    cell = Cell(lifts_after=5.0)
    cell.refused = ("episodes/success",)
    run(cell, NEVER, count=2)
    assert marks(cell) == ["episodes/begin", "episodes/success"] * 2 and cell.told[-1][0] == "done"
    cell.refused = ("episodes/begin",)
    with pytest.raises(RigError, match="episodes/begin: no"):
        run(cell, NEVER)


def test_who_takes_over_lets_go_of_what_the_policys_fingers_hold_and_rises_before_coming_down(run):
    cell = Cell()
    cell.streams, cell.moves = True, []
    ask = cell.ask

    def asked(what, **more):
        cell.moves += [more] if what == "reach" and "curl" in more else []
        return ask(what, **more)

    cell.ask = asked
    run(cell, NEEDED)
    close, open_, rise = cell.moves[:3]
    assert (close["curl"], open_["curl"], rise["curl"]) == (1.0, 0.0, 0.0)
    assert close["up"] == open_["up"] == rise["up"] - Plan().clearance


def test_a_round_that_is_interrupted_is_neither_good_nor_bad(run, virtual_graph, monkeypatch):
    cell = Cell()
    cell.ask_before = cell.ask

    def ends(what, **more):
        if what == "objects" and clock.monotonic() - cell.let_at > 3.0:
            monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
        return cell.ask_before(what, **more)

    cell.ask = ends
    run(cell, NEVER)
    assert marks(cell) == ["episodes/begin"] and lets(cell) == [[True]]
