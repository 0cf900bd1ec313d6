"""Scenes that differ in what a policy has to see: where the cup stands, how high the table is, how bright the light."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

CUP = "cup"
CENTRE_M = 0.0, 0.11  # of where the cup may stand, from the table's centre along its sides
REACH_M = 0.07  # to each side of it
TOPS_M = 0.04, 0.07  # heights of the table
LIGHTS = 0.6, 1.3  # factors


def cup_scene(scene: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Returns a scene with the object `cup` like this one, drawn by a seed."""
    rng = np.random.default_rng(seed)
    drawn = copy.deepcopy(dict(scene))
    place = np.array(CENTRE_M) + rng.uniform(-REACH_M, REACH_M, 2)
    drawn["objects"][CUP].update(position=place.tolist(), yaw=float(rng.uniform(-180.0, 180.0)))
    drawn["table"]["top"] = float(rng.uniform(*TOPS_M))
    drawn["light"] = float(rng.uniform(*LIGHTS))
    return drawn
