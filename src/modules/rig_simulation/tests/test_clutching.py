"""The operator with a clutch, against a tool that follows."""

import numpy as np
import pytest

from rig_simulation.operator.clutching import Clutching


@pytest.mark.parametrize("state, following", [("waiting", True), ("running", False)])
def test_the_operator_gives_up_with_a_reason(state, following):
    operator = Clutching()
    results = [operator.step(np.zeros(3), state, following, 0.1 * i) for i in range(300)]
    assert results[-1].over and state in results[-1].failure
