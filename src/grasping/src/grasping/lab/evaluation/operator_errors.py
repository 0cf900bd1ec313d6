"""How near predictions come to an operator's grasps: errors, likelihood of the place, and orientation at that place.

Which of several equally good grasps an operator takes cannot be predicted: a distance punishes a map for the wrong one.
So a map is taken as a distribution over its pixels, a softmax of the quality, as sharp and as smooth as suits it best
on episodes that are not tested. Orientation and opening are judged with the place taken as known; a method without a
standard deviation of its own gets the constant one that fits best on episodes outside the test.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any, Callable, Mapping, NamedTuple, Sequence

import cv2
import numpy as np
import pinocchio as pin
import torch

from common.poses import inverse
from common.rotations import rotation_about, rotation_angle
from common.statistics import median, proportion
from grasping.lab.dataset.episode import EpisodeFrame
from grasping.lab.dataset.labels import pose_from_label, relative_label
from grasping.lab.training.refinement_examples import OperatorOffset, RefinementTargets
from grasping.network.depth_image import NETWORK_SIDE, Crop, prepare
from grasping.network.maps import gaussian
from grasping.network.refinement import COS, LEAN_X, LEAN_Y, OPENING, SIN, RefinementNetwork, RefinementOutput

NEAR_M, NEAR_RAD = 0.020, np.radians(15.0)
PATCH_SIDE = 120  # of the image's part about GGCNN's pixel by which frames are compared, in the network's image [px]
PATCH_CELLS = 24
HALF_TURN = rotation_about(2, np.pi)
BLURS_PX = (0.0, 0.5, 1.0, 1.5)
SHARPNESSES = (5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0)
CONCENTRATIONS = np.geomspace(0.1, 100.0, 61)
COLOURS = ("tab:gray", "tab:orange", "tab:green")


class Miss(NamedTuple):
    """A predicted grasp against the operator's."""

    position: float  # distance [m]
    rotation: float  # angle between the orientations, half a turn about the approach being none [rad]

    @property
    def is_near(self) -> bool:
        """Whether both are within 20 mm and 15 degrees."""
        return self.position < NEAR_M and self.rotation < NEAR_RAD


def miss(T_wanted: np.ndarray, T_found: np.ndarray) -> Miss:
    """Returns how far a grasp, shape (4, 4) [m], is from the wanted one."""
    T = inverse(T_wanted) @ T_found
    return Miss(float(np.linalg.norm(T[:3, 3])), rotation_miss(T_wanted[:3, :3], T_found[:3, :3]))


def rotation_miss(R_wanted: np.ndarray, R_found: np.ndarray) -> float:
    """Returns the angle between orientations, shape (3, 3), half a turn about the approach being none [rad]."""
    R = R_wanted.T @ R_found
    return float(min(rotation_angle(R), rotation_angle(R @ HALF_TURN)))


class Neighbours:
    """Predicts what the operator did in the most similar frame: the nearest neighbour."""

    def __init__(self, frames: list[EpisodeFrame]) -> None:
        """Keeps frames, of which at least one has GGCNN's grasp and the operator's in sight, of grasps that held."""
        labelled = [(patch(frame), relative_label(frame)) for frame in frames]
        self._patches = np.stack([seen for seen, label in labelled if label is not None])
        self._labels = [label for _, label in labelled if label is not None]

    def grasp(self, frame: EpisodeFrame) -> np.ndarray:
        """Returns the pose before the camera, shape (4, 4) [m]."""
        nearest = int(np.argmin(np.square(self._patches - patch(frame)).sum(axis=1)))
        label = self._labels[nearest]
        scale = frame.maps.shape[-1] / NETWORK_SIDE
        row, column = ((i + 0.5) * scale - 0.5 for i in (frame.peak.row, frame.peak.column))
        return pose_from_label(frame, label._replace(row=row + label.row_shift, column=column + label.column_shift))


def patch(frame: EpisodeFrame) -> np.ndarray:
    """Returns what lies about GGCNN's pixel: depths less the pixel's, coarse, shape (PATCH_CELLS^2,) [m]."""
    depth = prepare(frame.depth_m, Crop(0, 0, frame.crop.side)).depth
    half = PATCH_SIDE // 2
    row, column = frame.peak.row + half, frame.peak.column + half
    bordered = cv2.copyMakeBorder(depth, half, half, half, half, cv2.BORDER_REPLICATE)
    window = bordered[row - half : row + half, column - half : column + half] - bordered[row, column]
    return cv2.resize(window, (PATCH_CELLS, PATCH_CELLS), interpolation=cv2.INTER_AREA).ravel()


class Calibration(NamedTuple):
    """How a quality map becomes a distribution."""

    blur: float  # standard deviation [px]
    sharpness: float  # logits by quality


def place_log_likelihoods(qualities: np.ndarray, places: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Returns the log-likelihood of each place, shape (n,) [nats]; `qualities`: maps, shape (n, h, w), float32;
    `places`: bells of sum 1 about the operator's pixels, shape (n, h, w).
    """
    smooth = np.stack([gaussian(quality, calibration.blur) for quality in qualities])
    logits = torch.from_numpy(calibration.sharpness * smooth.reshape(len(smooth), -1))
    return (places.reshape(len(places), -1) * torch.log_softmax(logits, dim=1).numpy()).sum(axis=1)


def calibrated(qualities: np.ndarray, places: np.ndarray) -> Calibration:
    """Returns the calibration that makes the places most probable; maps and places as in `place_log_likelihoods`."""
    tried = [Calibration(*values) for values in product(BLURS_PX, SHARPNESSES)]
    return max(tried, key=lambda one: float(place_log_likelihoods(qualities, places, one).mean()))


class Expected(NamedTuple):
    """The expected grasp at the operators' n pixels, each shape (n,)."""

    angle: np.ndarray  # of the line through the fingers in the image [rad]
    tilt_x: np.ndarray  # of the approach [rad]
    tilt_y: np.ndarray  # likewise
    opening: np.ndarray  # of the hand [GGCNN's unit x m]
    concentration: np.ndarray  # of twice the angle
    tilt_scale: np.ndarray  # scale of the Laplace distribution of the lean [rad]


def expected(
    seen: torch.Tensor, target: RefinementTargets, network: RefinementNetwork, offset: OperatorOffset
) -> Expected:
    """Returns what a network (untrained: only the offset) says of its input `seen`, shape (n, LEAN_Y + 1, h, w)."""
    at = target.place.flatten(1).argmax(1)
    n = torch.arange(len(at))
    with torch.no_grad():
        said = RefinementOutput.of(network(seen))
    of = {name: value.flatten(1)[n, at].double().numpy() for name, value in said._asdict().items()}
    cos, sin, lean_x, lean_y, opening = (
        seen[:, i].flatten(1)[n, at].double().numpy() for i in (COS, SIN, LEAN_X, LEAN_Y, OPENING)
    )
    turn = np.arctan2(of["turn_sin"], of["turn_cos"])
    return Expected(
        0.5 * (np.arctan2(sin, cos) + turn) + offset.angle,
        of["tilt_x"] + of["follow"] * lean_x + offset.tilt_x,
        of["tilt_y"] + of["follow"] * lean_y + offset.tilt_y,
        opening + of["opening"] + offset.opening,
        np.hypot(of["turn_cos"], of["turn_sin"]),
        of["tilt_scale"],
    )


def operators(target: RefinementTargets, offset: OperatorOffset) -> Expected:
    """Returns what the operators did, without uncertainty."""
    cos, sin, x, y, opening = (
        value.double().numpy() for value in (target.cos, target.sin, target.tilt_x, target.tilt_y, target.opening)
    )
    angle = 0.5 * np.arctan2(sin, cos) + offset.angle
    nothing = np.zeros_like(angle)
    return Expected(angle, x + offset.tilt_x, y + offset.tilt_y, opening + offset.opening, nothing, nothing)


def errors(found: Expected, did: Expected) -> np.ndarray:
    """Returns the angles between orientations, half a turn about the approach being none, shape (n,) [rad]."""
    return np.array([rotation_miss(a, b) for a, b in zip(_rotations(did), _rotations(found))])


def log_likelihoods(found: Expected, did: Expected) -> np.ndarray:
    """Returns the log-likelihood of each orientation, of angle and lean, shape (n,) [nats, of densities by rad]."""
    k, b = found.concentration, found.tilt_scale
    off = 2.0 * (did.angle - found.angle)
    scale = np.log(torch.special.i0e(torch.from_numpy(k)).numpy()) + k
    lean = np.hypot(did.tilt_x - found.tilt_x, did.tilt_y - found.tilt_y)
    return k * np.cos(off) - scale - np.log(np.pi) - lean / b - np.log(2.0 * np.pi * b**2)


def with_constant_scale(found: Expected, known: Expected, did: Expected) -> Expected:
    """Returns the expected grasps with the constant distribution that fits the known ones best."""
    b = 0.5 * float(np.hypot(did.tilt_x - known.tilt_x, did.tilt_y - known.tilt_y).mean())

    def scaled(one: Expected, k: float) -> Expected:
        n = len(one.angle)
        return one._replace(concentration=np.full(n, k), tilt_scale=np.full(n, b))

    best = max(CONCENTRATIONS, key=lambda k: float(log_likelihoods(scaled(known, k), did).mean()))
    return scaled(found, float(best))


def _rotations(of: Expected) -> list[np.ndarray]:
    return [
        pin.exp3(np.array([x, y, 0.0])) @ rotation_about(2, -angle)
        for angle, x, y in zip(of.angle, of.tilt_x, of.tilt_y)
    ]


def draw_learning_curve(
    path: Path, learned: Mapping[int, Sequence[float]], others: Mapping[str, Sequence[float]], near_mm: float
) -> None:
    """Draws the median error and the fraction below `near_mm`, with 95 % intervals, by the number of training episodes.

    `learned`: errors [mm] of the refinement network by that number; `others`: of other methods by name, as lines.
    """
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)

    def middle(errors: Sequence[float]) -> tuple[float, float, float]:
        found = median(errors)
        return found.value, found.low, found.high

    def near(errors: Sequence[float]) -> tuple[float, float, float]:
        found = proportion(np.asarray(errors) < near_mm)
        return 100.0 * found.value, 100.0 * found.low, 100.0 * found.high

    _curve(left, learned, others, middle)
    _curve(right, learned, others, near)
    left.set(ylabel="position error [mm], median", ylim=(0, None))
    right.set(ylabel=f"within {near_mm:.0f} mm [%]", ylim=(0, 100))
    left.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def _curve(
    axes: Any,
    learned: Mapping[int, Sequence[float]],
    others: Mapping[str, Sequence[float]],
    summary: Callable[[Sequence[float]], tuple[float, float, float]],
) -> None:
    counts = sorted(learned)
    value, low, high = np.transpose([summary(learned[n]) for n in counts])
    axes.errorbar(counts, value, [value - low, high - value], marker="o", capsize=3, label="with refinement network")
    for (name, errors), colour in zip(others.items(), COLOURS):
        value, low, high = summary(errors)
        axes.axhline(value, color=colour, linestyle="--", label=name)
        axes.axhspan(low, high, color=colour, alpha=0.12)
    axes.set(xlabel="episodes learned from", xscale="log", xticks=counts, xticklabels=map(str, counts))
    axes.minorticks_off()
