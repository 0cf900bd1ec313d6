"""One look of the shipped policy, from a depth image to its actions, with one processor; what is measured is its time.
run_policy.py looks each 0.8 s."""

from __future__ import annotations

import numpy as np
import torch

from bench.bench_grasping import CAMERA, CLOCK, synthetic_depth_image
from bench.measure import SRC, Row, row
from common.poses import pose
from leap_rig.policy.network import loaded
from leap_rig.policy.view import FINGERS, DepthView, height_map, state_numbers

FILE = SRC / "leap_rig" / "policies" / "pick_cup.pt"
DOWN = np.diag([1.0, -1.0, -1.0])
TAXELS = 27


def rows(quick: bool) -> list[Row]:
    """Returns the times of map and network [ms]."""
    count = 5 if quick else 200
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return _rows([synthetic_depth_image(seed) for seed in range(5)], count)
    finally:
        torch.set_num_threads(before)


def _rows(images: list[np.ndarray], count: int) -> list[Row]:
    network, view = loaded(FILE.read_bytes()), DepthView(CAMERA)
    T_base_camera, T_base_tool = pose(DOWN, (0.5, 0.0, 0.9)), pose(DOWN, (0.5, 0.0, 0.3))
    state = state_numbers(T_base_tool, np.full(FINGERS, 0.5), np.zeros(TAXELS))
    times = np.empty((count + 1, 3))
    for i in range(count + 1):
        times[i, 0] = CLOCK()
        heights = height_map(view.points(images[i % len(images)], T_base_camera), T_base_tool)
        times[i, 1] = CLOCK()
        network.act(heights, state)
        times[i, 2] = CLOCK()
    seen, said = 1e3 * np.diff(times[1:], axis=1).T  # the first one compiles
    how = "time of one processor"
    return [
        row("policy: map of 640 x 480 depths", seen, "ms", how),
        row("policy: network", said, "ms", how),
        row("policy: a look", seen + said, "ms", how),
    ]
