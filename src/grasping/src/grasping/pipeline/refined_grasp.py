"""The grasp of the refined maps at a pixel, and its uncertainty: the distribution of the operator's grasp there.

Over the pixels it is a softmax of the refined quality, and what lies near a pixel is the same choice. Standard
deviations are those of the grasp's own axes: x through the fingers, z the approach.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import torch

from common.poses import pose, read_only
from grasping.network.maps import Peak
from grasping.network.refinement import LOBE_PX, SHARPNESS, SHRINK, SIDE, RefinedMaps, shrunk
from grasping.pipeline.projection import CameraGrasp

LAPLACE, LAPLACE_OF_TWO = np.sqrt(2.0), np.sqrt(3.0)  # standard deviation of an axis by scale, in 1 and 2 dimensions
UNIFORM = np.pi / np.sqrt(12.0)  # standard deviation of an angle that is not known at all, modulo pi [rad]


class GraspUncertainty(NamedTuple):
    """The distribution of the operator's grasp."""

    probability: float  # that the operator grasps here rather than elsewhere in the image, 0 to 1
    pose_sd: np.ndarray  # standard deviations along x, y, z [m] and about x, y, z [rad], shape (6,)
    opening_sd: float  # standard deviation of the opening [m]


def opened(peak: Peak, refined: RefinedMaps) -> Peak:
    """Returns the peak with the operator's opening instead of the one that the grasp needs."""
    return peak._replace(width=peak.width + float(refined.wider[peak.row, peak.column]))


def refined_grasp(grasp: CameraGrasp, refined: RefinedMaps, peak: Peak) -> CameraGrasp:
    """Returns `project_grasp` of `opened`, on the surface along the axis, with the refined depth and tilt at `peak`."""
    at = peak.row, peak.column
    z = grasp.T_camera_grasp[2, 3]
    factor = 1.0 + float(refined.dz[at]) / z
    tilt = pin.exp3(np.array([refined.tilt_x[at], refined.tilt_y[at], 0.0], dtype=float))
    T = pose(tilt @ grasp.T_camera_grasp[:3, :3], factor * grasp.T_camera_grasp[:3, 3])
    return grasp._replace(T_camera_grasp=read_only(T), width=factor * grasp.width)


def pixel_probabilities(refined: RefinedMaps) -> np.ndarray:
    """Returns how probable it is that the operator grasps at a pixel, shape (SIDE, SIDE), sum 1."""
    logits = SHARPNESS * shrunk(refined.output[0]).astype(float)
    mass = np.exp(logits - logits.max())
    return mass / mass.sum()


def grasp_uncertainty(
    refined: RefinedMaps, place: np.ndarray, peak: Peak, grasp: CameraGrasp, pixel_m: float
) -> GraspUncertainty:
    """Returns the distribution about a grasp; `pixel_m`: what a pixel of the network's image shows of the scene [m]."""
    at = peak.row, peak.column
    probability, covariance = _about(place, *((i + 0.5) / SHRINK - 0.5 for i in at))
    c, s = np.cos(grasp.angle), np.sin(grasp.angle)
    axes = np.array([[c, -s], [s, c]])  # rows: through the fingers and across them, in columns and rows of the map
    across = SHRINK * pixel_m * np.sqrt(np.diag(axes @ covariance @ axes.T))
    depth, opening, tilt = (float(b[at]) for b in refined.scales)
    lean = LAPLACE_OF_TWO * tilt
    angle = angle_deviation(float(refined.concentration[at]))
    return GraspUncertainty(
        probability, np.array([*across, LAPLACE * depth, lean, lean, angle]), LAPLACE * abs(opening) * pixel_m
    )


def angle_deviation(concentration: float) -> float:
    """Returns the standard deviation of an angle [rad] of whose double this is the concentration."""
    k = torch.tensor(concentration, dtype=torch.float64)
    length = float(torch.special.i1e(k) / torch.special.i0e(k))
    return min(UNIFORM, 0.5 * float(np.sqrt(-2.0 * np.log(max(length, 1e-12)))))


def _about(place: np.ndarray, row: float, column: float) -> tuple[float, np.ndarray]:
    """Returns the mass about a pixel, and its covariance (columns, rows), shape (2, 2) [px of the map]."""
    rows, columns = np.indices((SIDE, SIDE))
    near = place * (np.hypot(rows - row, columns - column) <= LOBE_PX)
    mass = float(near.sum())
    off = np.stack([columns - column, rows - row]).reshape(2, -1)
    # About the published grasp, not about the mean; within a pixel it may be anywhere.
    return mass, (off * near.ravel()) @ off.T / max(mass, 1e-12) + np.eye(2) / 12.0
