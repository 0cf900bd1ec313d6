"""The whole simulated rig, brought up once for a module of tests, with a hand that each test moves as it likes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))


@pytest.fixture(scope="module")
def whole_rig(ros_master, tmp_path_factory, pytestconfig):
    """The rig of campaign/rig.launch, on ports of its own."""
    from campaign.rig import RigUnderTest

    shared = pytestconfig.pluginmanager.get_plugin(str(pytestconfig.rootpath / "conftest.py"))
    rig = RigUnderTest(shared, tmp_path_factory.mktemp("rig"))
    try:
        rig.bring_up()
        yield rig
    finally:
        rig.end()


@pytest.fixture
def rig(whole_rig):
    """The rig with the arm at home, no hand in view, and both controls off."""
    whole_rig.calm()
    return whole_rig
