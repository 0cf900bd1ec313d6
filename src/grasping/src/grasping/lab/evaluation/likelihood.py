"""The likelihood of the pixel where an operator grasped under a quality map.

Which of several equally good grasps an operator takes cannot be predicted: a distance punishes a map for the wrong one
of them, and cannot tell a map that saw the others coming from one that did not. So a map is taken as a distribution
over its pixels, a softmax of the quality, as sharp and as smooth as suits it best on episodes that are not tested.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import torch

from grasping.network.maps import gaussian

BLURS_PX = (0.0, 0.5, 1.0, 1.5)
SHARPNESSES = (5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0)


class Calibration(NamedTuple):
    """How a quality map becomes a distribution."""

    blur: float  # standard deviation [px]
    sharpness: float  # logits by quality


def log_likelihoods(qualities: np.ndarray, places: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Returns the log-likelihood of each place, shape (n,) [nats].

    Args:
        qualities: maps, shape (n, h, w), float32.
        places: bells of sum 1 about the operator's pixels, shape (n, h, w).
    """
    smooth = np.stack([gaussian(quality, calibration.blur) for quality in qualities])
    logits = torch.from_numpy(calibration.sharpness * smooth.reshape(len(smooth), -1))
    return (places.reshape(len(places), -1) * torch.log_softmax(logits, dim=1).numpy()).sum(axis=1)


def calibrated(qualities: np.ndarray, places: np.ndarray) -> Calibration:
    """Returns the calibration that makes the places most probable; maps and places as in `log_likelihoods`."""
    tried = [Calibration(*values) for values in product(BLURS_PX, SHARPNESSES)]
    return max(tried, key=lambda one: float(log_likelihoods(qualities, places, one).mean()))
