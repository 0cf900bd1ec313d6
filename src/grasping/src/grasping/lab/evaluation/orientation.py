"""How well the hand's orientation and opening are predicted where the operator grasped.

Which of several grasps an operator takes is another question (`likelihood`), and would hide this one: so here it is
taken as known. Measured are the error of the expected orientation and the likelihood of the operator's. A method
without a standard deviation of its own gets the constant one that fits best on episodes outside the test.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import torch

from common.rotations import rotation_about
from grasping.lab.evaluation.operator_errors import rotation_miss
from grasping.lab.training.refinement_batches import RefinementTargets
from grasping.lab.training.refinement_examples import OperatorOffset
from grasping.network.refinement import COS, LEAN_X, LEAN_Y, OPENING, SIN, RefinementNetwork, RefinementOutput

CONCENTRATIONS = np.geomspace(0.1, 100.0, 61)


class Expected(NamedTuple):
    """The expected grasp at the operators' n pixels, each shape (n,).

    Attributes:
        angle: of the line through the fingers in the image [rad].
        tilt_x, tilt_y: of the approach [rad].
        opening: of the hand [GGCNN's unit x m].
        concentration: of twice the angle.
        tilt_scale: scale of the Laplace distribution of the lean [rad].
    """

    angle: np.ndarray
    tilt_x: np.ndarray
    tilt_y: np.ndarray
    opening: np.ndarray
    concentration: np.ndarray
    tilt_scale: np.ndarray


def expected(
    seen: torch.Tensor, target: RefinementTargets, network: RefinementNetwork, offset: OperatorOffset
) -> Expected:
    """Returns what a network says, untrained if it is only to add the offset.

    Args:
        seen: its input, shape (n, LEAN_Y + 1, h, w).
    """
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
