"""The grasps of an image that an operator prefers, and their uncertainty: the distribution of the operator's grasp.

Over the candidates it is a softmax of what they are worth, and what lies near a candidate is the same choice. Standard
deviations are those of the grasp's own axes: x through the fingers, z the approach.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.camera_model import CameraModel
from common.poses import pose, read_only
from grasping.network.depth_image import NetworkImage
from grasping.network.maps import Maps, Peak, Smoothing
from grasping.pipeline.projection import CameraGrasp
from grasping.refinement import preference
from grasping.refinement.candidates import Candidates, candidates
from grasping.refinement.preference import Preference, Preferred

SMOOTHING = Smoothing(quality=2.0)
"""Of the maps that candidates are taken from: a wider blur would take the grasps on slender parts for bad."""


class GraspUncertainty(NamedTuple):
    """The distribution of the operator's grasp."""

    probability: float  # that the operator grasps here rather than elsewhere in the image, 0 to 1
    pose_sd: np.ndarray  # standard deviations along x, y, z [m] and about x, y, z [rad], shape (6,)
    opening_sd: float  # standard deviation of the opening [m]


class RefinedPeak(NamedTuple):
    """A grasp as an operator would take it."""

    peak: Peak  # in the network's image, open as wide as the operator opens the hand
    R_camera_grasp: np.ndarray  # orientation before the camera, shape (3, 3)
    uncertainty: GraspUncertainty


def refined_peaks(
    known: Preference,
    maps: Maps,
    certainty: np.ndarray,
    image: NetworkImage,
    camera: CameraModel,
    count: int,
    distance: int,
    threshold: float | None,
    widest: float = np.inf,
) -> list[RefinedPeak]:
    """Returns the preferred grasps, best first, `distance` rows or columns apart; None as `threshold`: the best alone.
    `maps`: smoothed by `SMOOTHING`; `certainty`: length of GGCNN's (cos, sin), shape of the maps; `widest`: opening of
    the hand [m].
    """
    of = candidates(maps, certainty, image, camera)
    found: list[RefinedPeak] = []
    for one in preference.preferences(of, known):
        peak = of.peaks[one.candidate]
        apart = (max(abs(peak.row - r.peak.row), abs(peak.column - r.peak.column)) > distance for r in found)
        if (threshold is not None and one.quality <= threshold) or not all(apart):
            continue
        found.append(_refined(of, one, known, widest))
        if threshold is None or len(found) == count:
            break
    return found


def refined_grasp(grasp: CameraGrasp, refined: RefinedPeak) -> CameraGrasp:
    """Returns `project_grasp` of a refined peak with the orientation that the operator prefers."""
    return grasp._replace(T_camera_grasp=read_only(pose(refined.R_camera_grasp, grasp.T_camera_grasp[:3, 3])))


def _refined(of: Candidates, one: Preferred, known: Preference, widest: float) -> RefinedPeak:
    peak, needed = of.peaks[one.candidate], float(of.openings[one.candidate])
    opened = max(needed, min(needed + one.wider, widest))
    wide = peak.width * opened / needed if needed > 0.0 else peak.width
    angle = peak.angle + one.turn
    turned = peak._replace(quality=one.quality, angle=(angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi, width=wide)
    return RefinedPeak(turned, preference.rotation(of, one), uncertainty(of, one, known))


def uncertainty(of: Candidates, one: Preferred, known: Preference) -> GraspUncertainty:
    """Returns the distribution about a preferred grasp."""
    angle = of.angles[one.candidate] + one.turn
    axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    about, hand = known.taste, known.taste.hand
    across = np.sqrt(np.diag(axes @ one.covariance @ axes.T) + about.spread**2)
    turns = (hand.tilt_spread, hand.tilt_spread, about.angle_spread)
    return GraspUncertainty(one.probability, np.array([*across, about.spread, *turns]), hand.opening_spread)
