"""From a depth image to a grasp, stage by stage, with one processor; what is measured is its time. GG-CNN is measured
where its published weights, which are not shipped, are in `shared/data/ggcnn`."""

from __future__ import annotations

import copy
import time
from pathlib import Path

import cv2
import numpy as np
import torch
import yaml

from bench.measure import SHARED_DATA, SRC, Goal, Peer, Row, row
from common.camera_model import pinhole
from grasping.network.networks import frozen, infer
from grasping.network.weights import load
from grasping.pipeline.pipeline import GraspPipeline
from grasping.pipeline.settings import GgcnnSettings, overlaid, settings_from
from grasping.poses.chooser import ImageMaps, choose
from grasping.poses.lift_network import loaded

CAMERA = pinhole("bench", 640, 480, [[570.0, 0.0, 319.5], [0.0, 570.0, 239.5], [0.0, 0.0, 1.0]])
WEIGHTS = SRC / "grasping" / "weights"
GGCNN_WEIGHTS = SHARED_DATA / "ggcnn" / "epoch_29_model.hdf5"
STAGES = ("view", "network", "peaks", "poses")
UP = np.array([0.0, 0.0, 1.0])
RATE = 30  # images of a depth camera in a second
CLOCK = time.thread_time
"""With one processor all work is done in this thread; what others do on a busy machine does not count."""


def rows(quick: bool) -> list[Row]:
    """Returns the time of each stage [ms] of the live chain."""
    count = 3 if quick else 40
    images = [synthetic_depth_image(seed) for seed in range(count + 1)]
    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        table = _rows("GG-CNN2", WEIGHTS / "ggcnn2_wide.pt", images) + _choices(images)
        if GGCNN_WEIGHTS.exists():
            table += _rows("GG-CNN", GGCNN_WEIGHTS, images)
        else:
            table.append(Row("GG-CNN", None, None, "ms", f"{GGCNN_WEIGHTS} is not there"))
        return table
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])


def _rows(name: str, weights: Path, images: list[np.ndarray]) -> list[Row]:
    network = load(weights.read_bytes()).network
    chains = {}
    for view in ("camera", "table"):
        s = _settings(view)
        finder = GraspPipeline(s.views(), network, s.steps(UP), clock=CLOCK)
        chains[f"view {view}"] = lambda depth, now, f=finder: f.step(depth, CAMERA, np.eye(4), now).seconds
    times: dict[str, list] = {chain: [] for chain in chains}
    for i, depth in enumerate(images):  # in turns, so that a busy moment meets all
        for chain, call in chains.items():
            times[chain].append(call(depth, i / 15.0))
    return _table(name, times)


def _choices(images: list[np.ndarray]) -> list[Row]:
    """Returns the times of the choice of a grasp by the network of lifts beside that of GG-CNN2's forward pass: where
    one from straight above is sure, and where none is, so that tilted ones are tried, too."""
    network, s = frozen(load((WEIGHTS / "ggcnn2_wide.pt").read_bytes()).network), _settings("table")
    lifts = loaded((WEIGHTS / "lifts_parallel.pt").read_bytes())
    unsure = copy.deepcopy(lifts)
    unsure.temperature *= 100.0
    views, widest = s.views(), s.steps(UP).tool.max_opening
    times: dict[str, list[float]] = {"pass": [], "lifts: choice": [], "lifts: choice, tilts tried, too": []}
    for depth in images:
        view = views.step(depth, CAMERA)
        begin = CLOCK()
        output = infer(network, view.image.input)
        times["pass"].append(1e3 * (CLOCK() - begin))
        for name, of in zip(list(times)[1:], (lifts, unsure)):
            maps = ImageMaps.of_output(view.image, view.camera, output)
            begin = CLOCK()
            choose(of, maps, widest)
            times[name].append(1e3 * (CLOCK() - begin))
    beside = Goal(15.0), Peer("GG-CNN2's pass", float(np.median(times.pop("pass")[1:])))  # the first compiles
    return [row(name, each[1:], "ms", "time of one processor", *beside) for name, each in times.items()]


def _settings(view: str) -> GgcnnSettings:
    folder = SRC / "grasping" / "config"
    values = yaml.safe_load((folder / "ggcnn.yaml").read_text())
    values["tool"] = yaml.safe_load((folder / "tool_pose.yaml").read_text())
    return settings_from(overlaid(values, {"view": view}))


def _table(name: str, times: dict[str, list]) -> list[Row]:
    """Returns the whole time of each chain; of the last one also its share of a processor at `RATE`, and its stages."""
    totals = {
        chain: [1e3 * sum(s.values()) for s in seconds[1:]] for chain, seconds in times.items()
    }  # the first compiles
    how = "all stages, time of one processor"
    table = [row(f"{name}, {chain}", whole, "ms", how) for chain, whole in totals.items()]
    chain, seconds = list(times.items())[-1]
    busy = [100.0 * RATE * 1e-3 * whole for whole in totals[chain]]
    table.append(row(f"{name}, {chain}, {RATE} Hz", busy, "%", "of one processor"))
    for stage in STAGES:
        part = [1e3 * s[stage] for s in seconds[1:]]
        table.append(row(f"{name}, {chain}: {stage}", part, "ms", "time of one processor"))
    return table


def synthetic_depth_image(seed: int) -> np.ndarray:
    """Returns a noisy depth image, float32 [m], of boxes on a table below, with shadows, NaN, beside them."""
    random = np.random.default_rng(seed)
    depth = 0.8 + 0.0015 * random.standard_normal((480, 640)).astype(np.float32)
    for _ in range(6):
        row_, column = random.integers(60, 380), random.integers(140, 460)
        height, width = random.integers(20, 60, 2)
        depth[row_ : row_ + height, column : column + width] -= np.float32(random.uniform(0.03, 0.1))
        depth[row_ : row_ + height, column - 12 : column] = np.nan
    depth[random.random(depth.shape) < 0.03] = np.nan
    return depth
