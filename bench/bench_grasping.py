"""From a depth image to a grasp, stage by stage: the live chain against the published pipeline, in the same run.

The published pipeline is written here from its description: scaling of the window, filling of its holes, the network
layer by layer with four heads, blurs of the quality and of the angle itself, the highest pixel, and its place before
the camera. Both have the same weights, the same images and one processor, and what is measured is its time for them.
The live chain does more: it averages maps over time, and finds, follows and turns several grasps.
GG-CNN is measured where its published weights, which are not shipped, are in `shared/data/ggcnn`.
"""

from __future__ import annotations

import copy
import functools
import time
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
import yaml

from bench.measure import SHARED_DATA, SRC, Peer, Row, row
from common.camera_model import pinhole
from grasping.network.networks import GGCNN, HEADS
from grasping.network.weights import load
from grasping.pipeline.pipeline import GraspPipeline
from grasping.pipeline.settings import overlaid, settings_from

CAMERA = pinhole("bench", 640, 480, [[570.0, 0.0, 319.5], [0.0, 570.0, 239.5], [0.0, 0.0, 1.0]])
ROWS, COLUMNS = slice(40, 440), slice(120, 520)
GGCNN_WEIGHTS = SHARED_DATA / "ggcnn" / "epoch_29_model.hdf5"
STAGES = ("view", "network", "peaks", "poses")
UP = np.array([0.0, 0.0, 1.0])
RATE = 30  # images of a depth camera in a second
CLOCK = time.thread_time
"""With one processor all work is done in this thread; what others do on a busy machine does not count."""


def rows(quick: bool) -> list[Row]:
    """Returns the time of each stage [ms] of the published pipeline and of the live chain."""
    count = 3 if quick else 40
    images = [synthetic_depth_image(seed) for seed in range(count + 1)]
    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        table = _rows("GG-CNN2", SRC / "grasping" / "weights" / "ggcnn2.pt", images)
        if GGCNN_WEIGHTS.exists():
            table += _rows("GG-CNN", GGCNN_WEIGHTS, images)
        else:
            table.append(Row("GG-CNN", None, None, "ms", f"{GGCNN_WEIGHTS} is not there"))
        return table
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])


def _rows(name: str, weights: Path, images: list[np.ndarray]) -> list[Row]:
    folder = SRC / "grasping"
    network = load(weights.read_bytes()).network
    values = yaml.safe_load((folder / "config" / "ggcnn.yaml").read_text())
    values["tool"] = yaml.safe_load((folder / "config" / "tool_pose.yaml").read_text())
    chains = {"published": functools.partial(published, copy.deepcopy(network))}  # the live chain rearranges its own
    for view in ("camera", "table"):
        s = settings_from(overlaid(values, {"view": view}))
        finder = GraspPipeline(s.views(), network, s.steps(UP), clock=CLOCK)
        chains[f"live, view {view}"] = lambda depth, now, f=finder: f.step(depth, CAMERA, np.eye(4), now).seconds
    times: dict[str, list] = {chain: [] for chain in chains}
    for i, depth in enumerate(images):  # in turns, so that a busy moment meets all
        for chain, call in chains.items():
            times[chain].append(call(depth, i / 15.0))
    return _table(name, times)


def _table(name: str, times: dict[str, list]) -> list[Row]:
    """Returns the whole time of each live chain beside the published one; of the last chain also its share of one
    processor at `RATE` and its stages.
    """
    totals = {
        chain: [1e3 * sum(s.values()) for s in seconds[1:]] for chain, seconds in times.items()
    }  # the first compiles
    peer = Peer("published", float(np.median(totals.pop("published"))))
    how = "all stages, time of one processor"
    table = [row(f"{name}, {chain}", whole, "ms", how, peer=peer) for chain, whole in totals.items()]
    chain, seconds = list(times.items())[-1]
    busy = [100.0 * RATE * 1e-3 * whole for whole in totals[chain]]
    table.append(row(f"{name}, {chain}, {RATE} Hz", busy, "%", "of one processor"))
    for stage in STAGES:
        part = [1e3 * s[stage] for s in seconds[1:]]
        published = Peer("published", float(np.median([1e3 * s[stage] for s in times["published"][1:]])))
        table.append(row(f"{name}, {chain}: {stage}", part, "ms", "time of one processor", peer=published))
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


def published(network: torch.nn.Module, depth: np.ndarray, _) -> dict[str, float]:
    """Returns how long each stage takes [s]; the time of the image does not matter."""
    marks = [CLOCK()]
    crop = cv2.resize(depth[ROWS, COLUMNS], (300, 300))
    crop = cv2.copyMakeBorder(crop, 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    holes = np.isnan(crop).astype(np.uint8)
    crop[holes == 1] = 0
    scale = np.abs(crop).max()
    crop = cv2.inpaint(crop.astype(np.float32) / scale, holes, 1, cv2.INPAINT_NS)[1:-1, 1:-1] * scale
    seen = np.clip(crop - crop.mean(), -1, 1)
    marks.append(CLOCK())
    with torch.no_grad():
        quality, cos, sin, width = (m[0, 0].numpy() for m in plain(network, torch.from_numpy(seen)[None, None]))
    marks.append(CLOCK())
    quality[cv2.resize(holes[1:-1, 1:-1], (300, 300)) > 0] = 0
    quality = cv2.GaussianBlur(quality, (41, 41), 5.0, borderType=cv2.BORDER_REFLECT)
    angle = cv2.GaussianBlur(np.arctan2(sin, cos) / 2.0, (17, 17), 2.0, borderType=cv2.BORDER_REFLECT)
    v, u = np.unravel_index(np.argmax(quality), quality.shape)
    marks.append(CLOCK())
    column, line = round(u / 300 * 400 + 120), round(v / 300 * 400 + 40)
    z = depth[line, column]
    x, y = (column - CAMERA.K[0, 2]) / CAMERA.K[0, 0] * z, (line - CAMERA.K[1, 2]) / CAMERA.K[1, 1] * z
    _ = (x, y, z, angle[v, u], 150.0 * width[v, u], np.sort(crop[100:140, 130:170].ravel())[:10].mean())
    marks.append(CLOCK())
    return dict(zip(STAGES, np.diff(marks)))


def plain(network: torch.nn.Module, x: torch.Tensor) -> list[torch.Tensor]:
    """Returns quality, cos, sin and width as the published code computes them: layer by layer, one head at a time."""
    if isinstance(network, GGCNN):
        borders = network.borders
        for layer, (before, after) in zip((network.conv1, network.conv2, network.conv3), borders.conv):
            x = F.relu(layer(F.pad(x, (before, after, before, after))))
        for layer, start, rest in zip(
            (network.convt1, network.convt2, network.convt3), borders.crop, (0, 0, borders.rest)
        ):
            side = layer.stride[0] * x.shape[2] + rest
            x = F.relu(layer(x)[:, :, start : start + side, start : start + side])
        x = F.pad(x, borders.head * 2)
    else:
        x = network.features(x)
    return [getattr(network, head)(x) for head in HEADS]
