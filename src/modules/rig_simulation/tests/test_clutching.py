"""The operator with a clutch, against a tool that follows."""

import numpy as np
import pytest

from rig_simulation.operator.clutching import REACH_M, STROKES, Clutching


def test_the_tool_travels_by_strokes():
    operator, now = Clutching(), 0.0
    tool, hand, clutched, asked = np.array([0.4, 0.0, 0.4]), np.zeros(3), False, []
    while now < 100.0:
        now += 0.1
        result = operator.step(tool, "clutched" if clutched else "running", True, now)
        assert not result.failure
        if result.clutch is not None:
            clutched = result.clutch
            asked.append(clutched)
        if result.move is not None:
            tool = tool + (0.0 if clutched else 1.0) * (result.move.palm - hand)
            hand = result.move.palm
        if result.over:
            break
    assert result.step == "done" and asked == [True, False] * STROKES
    assert (operator.clutched, operator.engagement_step) == (STROKES, 0.0)
    assert operator.travel == pytest.approx(STROKES * REACH_M)


@pytest.mark.parametrize("state, following", [("waiting", True), ("running", False)])
def test_the_operator_gives_up_with_a_reason(state, following):
    operator = Clutching()
    results = [operator.step(np.zeros(3), state, following, 0.1 * i) for i in range(300)]
    assert results[-1].over and state in results[-1].failure
