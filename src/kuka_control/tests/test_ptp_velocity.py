"""No PTP motion of the controllers takes any point of the arm beyond the speed limit, whatever is configured."""

from __future__ import annotations

import numpy as np
import pytest
from loop_world import World, rig, shifted

from iiwa_kinematics import PTP_M_PER_S, full_speed_time, path_speed
from kuka_control.loop.commands import StartPtp
from kuka_control.model.config import PtpConfig, RealTimeConfig


def speeds(world):
    """The fastest point's planned speed in every motion so far [m/s]; the arm is at each goal before the next start."""
    q, found = np.full(7, 0.1), []
    for step in world.steps:
        if isinstance(step.command, StartPtp):
            q_next, velocity = step.command.q, step.command.velocity
            way = path_speed(world.rig.model, world.rig.carried(None), q, q_next)
            found.append(velocity * way / full_speed_time(world.rig.model, q, q_next))
            assert f"at {velocity:g} of the full joint speed" in step.reason
            q = q_next
    return found


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    "schema, fast", [(RealTimeConfig, ("velocity_ptp_slow", "velocity_ptp_fast")), (PtpConfig, ("velocity_ptp",))]
)
def test_home_pick_up_return_and_zero_keep_the_limit(schema, fast):
    world = World(schema, **dict.fromkeys(fast, 0.99)).at_home()
    world.control_on = True
    world.until("pick_up", 4.0, shifted(0.0, 0.1, -0.1)).run(1.0, shifted(0.0, 0.1, -0.1))
    world.control_on = False
    world.until("home", 9.0)
    world.exit_requested = True
    world.run(9.0)
    found = speeds(world)
    limit = rig(schema)[0].tcp_speed if schema is RealTimeConfig else PTP_M_PER_S
    assert len(found) >= 4 and max(found) <= limit
    assert max(found) > 0.9 * limit, "slowed to the limit, not more"
