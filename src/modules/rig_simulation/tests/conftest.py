"""What several tests share stands beside them; the simulated controller on wires in virtual time stands here."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))


@pytest.fixture
def serve(wires):
    """Starts a simulated controller, with a client of its control port."""
    from toolbox_client import ROBOT

    from common import clock
    from rig_simulation.control_port import ControlClient
    from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
    from rig_simulation.devices.sunrise.server import ServerSettings, SunriseServer

    def start(**settings):
        with wires.scheduler.in_group("robot"):
            server = SunriseServer(SimulatedArm(ROBOT, ArmSettings()), ServerSettings(**settings), "127.0.0.1", 0, 0)
            server.thread = clock.Thread(target=server.run, name="robot", daemon=True)
            server.thread.start()
        server.control = ControlClient("127.0.0.1", server.control_port)
        return server

    return start


@pytest.fixture
def network():
    """A network for simulated hands in virtual time."""
    from simulated.hand_wire import HandNetwork

    with HandNetwork() as network:
        yield network
