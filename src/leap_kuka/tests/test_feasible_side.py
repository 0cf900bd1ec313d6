"""A hand that is drawn back or put down takes the tool to a border, and never to where the controller ends."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from golden.chain import parsed
from kuka_control.model.rig import Rig
from kuka_control.model.target import scaled
from kuka_control.model.workspace import Infeasible
from leap_kuka.config import ArmPlacement
from leap_kuka.feasible_side import FeasibleSide
from leap_kuka.scaling import Scaling

CONFIG = parsed("kuka", {})
RIG = Rig.of(CONFIG)
WORKSPACE, CENTRE = RIG.workspace, RIG.home.centre
VALUES = {**vars(CONFIG), "ws_center": CENTRE}
SIDE = FeasibleSide(parse(ArmPlacement, VALUES, "kuka/", others=VALUES))
positions = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
scales = st.floats(0.1, 1.5)


@given(positions, scales)
def test_no_position_is_infeasible_for_the_controller(position, scale):
    there = scaled(position + SIDE.back(position, Scaling(CENTRE, scale)), CENTRE, scale)
    assert not isinstance(WORKSPACE.constrain(there), Infeasible)


@given(positions, scales)
def test_what_the_workspace_lets_through_stays_as_it_is(position, scale):
    goal = WORKSPACE.constrain(scaled(position, CENTRE, scale))
    if not isinstance(goal, Infeasible):
        inside = CENTRE + (goal.position - CENTRE) / scale
        assert not np.any(SIDE.back(inside, Scaling(CENTRE, scale)))


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.5])
def test_the_tool_slides_along_the_border(scale):
    forward = CONFIG.center_line / np.linalg.norm(CONFIG.center_line)
    left = np.array([-forward[1], forward[0], 0.0])
    for way in (0.0, 0.3, -0.2):
        position = CENTRE - 4.0 * forward + way * left
        there = position + SIDE.back(position, Scaling(CENTRE, scale))
        assert left @ (there - CENTRE) == pytest.approx(way)
        assert forward @ scaled(there, CENTRE, scale) == pytest.approx(0.1)
    position = CENTRE - np.array([0.0, 0.0, 3.0])
    assert scaled(position + SIDE.back(position, Scaling(CENTRE, scale)), CENTRE, scale)[2] == pytest.approx(1e-3)
