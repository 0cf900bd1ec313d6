"""The requests of the world's control port; see `rig_simulation.control_port`."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

from rig_simulation.devices.sunrise.server import SunriseServer
from rig_simulation.world.clock import Clock
from rig_simulation.world.files import read_scene
from rig_simulation.world.physics import World

MOST_STEPS = 1000
STEPS_AT_ONCE = 20
"""Fewer than the arm catches up in one go."""


class WorldRequests:
    """The requests.

    Args:
        world: of the requests.
        server: of the arm, which steps the world and holds its lock.
        clock: of both.

    Attributes:
        handlers: for the control port.
    """

    def __init__(self, world: World, server: SunriseServer, clock: Clock) -> None:
        self._world, self._server, self._clock = world, server, clock
        self._started, self._steps_at_start = time.monotonic(), world.steps
        names = ("state", "snapshot", "scene", "objects", "contacts", "reset", "set_scene", "step")
        self.handlers = {name: self._up_to_date(getattr(self, f"_{name}")) for name in names}

    def _up_to_date(self, request: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
        @wraps(request)
        def answer(**fields: Any) -> dict[str, Any]:
            with self._server.lock:
                self._server.advance()
                return request(**fields)

        return answer

    def _state(self) -> dict[str, Any]:
        world = self._world
        passed = time.monotonic() - self._started
        return {
            "time": world.time,
            "steps": world.steps,
            "timestep": world.timestep,
            "stepped": self._clock.stepped,
            "speed": self._clock.speed,
            "loads": world.loads,
            "contacts": int(world.data.ncon),
            "real_time_factor": (world.steps - self._steps_at_start) * world.timestep / passed,
        }

    def _snapshot(self) -> dict[str, Any]:
        world = self._world
        return {"time": world.time, "loads": world.loads, "qpos": world.data.qpos.tolist()}

    def _scene(self) -> dict[str, Any]:
        return {"loads": self._world.loads, **self._world.description.as_fields()}

    def _objects(self) -> dict[str, Any]:
        listed = {name: dataclasses.asdict(state) for name, state in self._world.objects().items()}
        mounting = list(self._world.description.mounting)
        return {"time": self._world.time, "mounting": mounting, "objects": listed}

    def _contacts(self) -> dict[str, Any]:
        return {"contacts": [dataclasses.asdict(contact) for contact in self._world.contacts()]}

    def _reset(self) -> dict[str, Any]:
        self._world.reset()
        return {}

    def _set_scene(self, scene: str | Mapping[str, Any]) -> dict[str, Any]:
        self._world.set_scene(read_scene(scene) if isinstance(scene, str) else scene)
        return {"loads": self._world.loads}

    def _step(self, count: int = 1) -> dict[str, Any]:
        if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_STEPS:
            raise ValueError(f"The count of steps is {count!r}, but must be a whole number from 1 to {MOST_STEPS}.")
        while count > 0:
            self._clock.move(min(count, STEPS_AT_ONCE) * self._world.timestep)
            self._server.advance()
            count -= STEPS_AT_ONCE
        return {"time": self._world.time, "steps": self._world.steps}
