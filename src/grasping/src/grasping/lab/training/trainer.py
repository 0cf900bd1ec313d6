"""Trains a grasp network with Adam: a short warm-up, a constant learning rate, and a linear decay at the end.

Windows of labelled images are mirrored at random, not turned: between equally good directions the labels prefer the
horizontal one (synthetic.labels). Unlike in the published loss, angle and width count only where there is a grasp.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, Mapping, NamedTuple

import numpy as np
import torch
from torch import nn

from grasping.lab.synthetic.samples import Sample
from grasping.network.networks import NETWORKS

CPU = torch.device("cpu")

GRASPABLE = 0.3  # from this quality on a pixel teaches angle and width
_DOUBLE_ANGLES = np.arange(256, dtype=np.float32) * np.float32(2.0 * np.pi / 256.0)
"""Twice the angle of each value of `Sample.angle` [rad]."""

Samples = Mapping[str, np.ndarray]


class MapTargets(NamedTuple):
    """What the network should say; each shape (n, h, w)."""

    quality: torch.Tensor  # 0 to 1
    cos: torch.Tensor  # of twice the angle
    sin: torch.Tensor  # of twice the angle
    width: torch.Tensor  # in units of `WIDTH_SCALE_PX`
    known: torch.Tensor  # where the quality counts, bool
    graspable: torch.Tensor  # where cos, sin and width count, bool


class Images(NamedTuple):
    """Labelled images on the device that trains on them."""

    arrays: dict[str, torch.Tensor]  # those of `synthetic.samples.Sample`, each shape (m, h, w)
    quality: np.ndarray  # theirs again, in the processor's memory: windows are chosen by it


def images(samples: Samples, device: torch.device = CPU) -> Images:
    """Returns samples, the arrays of `synthetic.samples.Sample`, each shape (m, h, w), on a device."""
    arrays = {name: torch.from_numpy(samples[name]).to(device) for name in Sample._fields}
    return Images(arrays, samples["quality"])


def random_batch(of: Images, rng: np.random.Generator, count: int, side: int) -> tuple[torch.Tensor, MapTargets]:
    """Returns `count` random windows, some of them mirrored, as input, shape (n, 1, side, side), and targets."""
    mean_jitter_m = 0.02
    windows = [_window(of.quality, rng, side) for _ in range(count)]
    jitter = rng.normal(0.0, mean_jitter_m, (count, 1, 1, 1)).astype(np.float32)
    device = of.arrays["depth"].device
    i, row, column, *flips = (torch.from_numpy(v).to(device) for v in np.array(windows).T)
    line = torch.arange(side, device=device)
    row, column = (
        first[:, None] + torch.where(flip[:, None] > 0, side - 1 - line, line)
        for first, flip in zip((row, column), flips)
    )
    cut = {name: values[i[:, None, None], row[:, :, None], column[:, None, :]] for name, values in of.arrays.items()}
    mirrored = (flips[0] != flips[1])[:, None, None]
    cut["angle"] = torch.where(mirrored, -cut["angle"], cut["angle"])  # modulo 256
    depth, target = batch(cut)
    return depth + torch.from_numpy(jitter).to(device), target


def batch(arrays: Mapping[str, torch.Tensor]) -> tuple[torch.Tensor, MapTargets]:
    """Returns whole images, the arrays of `Images`, as input and targets."""
    depth = arrays["depth"].float().clamp(-1.0, 1.0)[:, None]
    cos, sin = (torch.from_numpy(of(_DOUBLE_ANGLES)).to(depth.device)[arrays["angle"].int()] for of in (np.cos, np.sin))
    quality, width = arrays["quality"].float() / 255.0, arrays["width"].float() / 255.0
    known = arrays["known"]
    return depth, MapTargets(quality, cos, sin, width, known, known & (quality > GRASPABLE))


def _window(quality: np.ndarray, rng: np.random.Generator, side: int) -> tuple[int, ...]:
    """Returns image, first row, first column of a window, and whether its rows and columns are mirrored."""
    centred_share = 0.8  # share of the windows that are centred near a pixel that can be grasped
    i = rng.integers(len(quality))
    h, w = quality.shape[1:]
    row, column = rng.integers(0, h - side + 1), rng.integers(0, w - side + 1)
    graspable = np.flatnonzero(quality[i] > GRASPABLE * 255.0)
    if len(graspable) and rng.random() < centred_share:
        y, x = divmod(int(rng.choice(graspable)), w)
        row, column = (
            int(np.clip(c - side // 2 + rng.integers(-side // 3, side // 3 + 1), 0, n - side))
            for c, n in ((y, h), (x, w))
        )
    return int(i), int(row), int(column), *(int(flip) for flip in rng.random(2) < 0.5)


class MapLosses(NamedTuple):
    """Mean squared errors; `total` is their weighted sum."""

    total: torch.Tensor
    quality: torch.Tensor
    angle: torch.Tensor
    width: torch.Tensor


def losses(maps: torch.Tensor, target: MapTargets) -> MapLosses:
    """Returns the losses of the network's output, shape (n, 4, h, w)."""
    quality_weight = 10.0
    grasp_weight = 4.0  # how much more a pixel of quality 1 counts than the background
    angle_weight = 0.5
    width_weight = 2.0
    quality, cos, sin, width = maps.float().unbind(1)
    weight = target.known * (1.0 + grasp_weight * target.quality)
    of_quality = (weight * (quality - target.quality) ** 2).sum() / target.known.sum().clamp(min=1)
    graspable = target.graspable
    count = graspable.sum().clamp(min=1)
    of_angle = (graspable * ((cos - target.cos) ** 2 + (sin - target.sin) ** 2)).sum() / count
    of_width = (graspable * (width - target.width) ** 2).sum() / count
    total = quality_weight * of_quality + angle_weight * of_angle + width_weight * of_width
    return MapLosses(total, of_quality, of_angle, of_width)


@dataclass(frozen=True)
class NetworkTraining:
    """How to train."""

    network: str = "ggcnn2"  # name in `NETWORKS`
    steps: int = 6000  # of the whole training; over the last fraction `decay` the rate falls to zero
    count: int = 16  # windows per step
    side: int = 156  # of the windows [px]
    rate: float = 1.5e-3  # learning rate
    warm_up: int = 200  # steps
    decay: float = 0.25  # fraction of the steps
    memory: float = 0.998  # of the running mean of the weights, per step
    seed: int = 1  # of weights and batches
    half: bool = True  # compute in bfloat16, which is faster where the device knows it


class NetworkTrainer:
    """A grasp network in training, from the weights of `start` or from random ones; it takes the `Images` of `device`.
    `step` counts its steps; `mean` is the same network with the running mean of the weights, usable at any time.
    """

    def __init__(self, settings: NetworkTraining, device: torch.device = CPU, start: nn.Module | None = None) -> None:
        torch.manual_seed(settings.seed)
        network = NETWORKS[settings.network]()
        if start is not None:
            network.load_state_dict(start.state_dict())
        network.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in torch's types
        self.network, self.mean = network, copy.deepcopy(network)
        self.step, self.steps = 0, settings.steps
        self._settings, self._device = settings, device
        self._optimiser = torch.optim.Adam(network.parameters(), lr=settings.rate)

    def rate(self) -> float:
        """Returns the learning rate of the next step."""
        s = self._settings
        left = (s.steps - self.step) / max(1.0, s.decay * s.steps)
        return s.rate * min(1.0, (self.step + 1) / s.warm_up, max(0.0, left))

    def train(self, of: Images) -> float:
        """Takes one step down the loss of the network and returns it."""
        longest_gradient = 1.0
        s = self._settings
        made = random_batch(of, np.random.default_rng([s.seed, self.step]), s.count, s.side)
        loss = losses(*self._said(self.network.train(), *made)).total
        for group in self._optimiser.param_groups:
            group["lr"] = self.rate()
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), longest_gradient)
        self._optimiser.step()
        memory = min(s.memory, (self.step + 1) / (self.step + 10))
        with torch.no_grad():
            for kept, new in zip(self.mean.parameters(), self.network.parameters()):
                kept.lerp_(new, 1.0 - memory)
        self.step += 1
        return loss.item()

    def validate(self, of: Images) -> dict[str, float]:
        """Returns the mean network's losses, `validation` the total, and the share of images whose best pixel hits."""
        rows = []
        for i in range(len(of.quality)):
            whole = batch({name: values[i : i + 1] for name, values in of.arrays.items()})
            with torch.no_grad():
                maps, target = self._said(self.mean, *whole)
            rows.append([*(v.item() for v in losses(maps, target)), _best_is_grasp(maps.float(), target)])
        return dict(zip(("validation", "quality", "angle", "width", "hits"), np.mean(rows, axis=0).tolist()))

    def _said(self, network: nn.Module, depth: torch.Tensor, target: MapTargets) -> tuple[torch.Tensor, MapTargets]:
        with torch.autocast(self._device.type, dtype=torch.bfloat16, enabled=self._settings.half):
            maps: torch.Tensor = network(depth.to(memory_format=torch.channels_last))
        return maps, target

    def state(self) -> dict:
        """Returns the checkpoint for `resume`."""
        parts: dict[str, Any] = {"network": self.network, "mean": self.mean, "optimiser": self._optimiser}
        return {"step": self.step, **{name: part.state_dict() for name, part in parts.items()}}

    def resume(self, state: dict) -> None:
        """Continues from a checkpoint of `state`."""
        self.network.load_state_dict(state["network"])
        self.mean.load_state_dict(state["mean"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]


def _best_is_grasp(maps: torch.Tensor, target: MapTargets) -> float:
    """Returns 1 where the pixel of highest quality is a grasp whose angle is right within 30 degrees, else 0."""
    i = int(maps[0, 0].argmax())
    cos, sin = maps[0, 1].flatten()[i], maps[0, 2].flatten()[i]
    agreement = cos * target.cos.flatten()[i] + sin * target.sin.flatten()[i]
    right = agreement > 0.5 * torch.hypot(cos, sin)  # cos of twice 30 degrees
    return float(right & target.graspable.flatten()[i])
