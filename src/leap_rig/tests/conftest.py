"""The whole simulated rig in virtual time, with a hand that each test moves as it likes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))


@pytest.fixture
def rig(virtual_graph):
    """The rig as shipped, with the arm at home, no hand in view, and both controls off."""
    from simulated.rig import VirtualRig

    with VirtualRig(virtual_graph) as rig:
        rig.calm()
        yield rig
