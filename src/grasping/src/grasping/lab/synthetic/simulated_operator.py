"""A simulated operator who grasps: knows what holds, has a taste and a bias, and trembles.

Stands in for a teleoperating operator where none is at hand; whatever was found with it is to be called simulated. The
operator sees the exact labels, prefers high and slender parts of things, and grasps beside the chosen place by a
constant bias and a tremor. Orientation and opening of the hand depend on the place, too: the higher it is, the more
the wrist turns and the wider the hand opens, and the less it leans away from the operator, who sits below the image;
and it leans with the surface. All that is visible, and is there to be learned; how people do it, nobody has measured
here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.poses import pose
from grasping.lab.synthetic import scene
from grasping.lab.synthetic.labels import Labels
from grasping.lab.synthetic.samples import GRIPPER
from grasping.network.maps import gaussian

DOWN = np.array([0.0, 0.0, -1.0])
EYE_M = 0.02
"""Standard deviation of the blur through which the lean of a surface is seen."""


class SimulatedOperator(NamedTuple):
    """An operator's taste and hand."""

    holds: float = 0.3  # lowest quality of a grasp that the operator considers
    higher: float = 8.0  # what height is worth, in quality a metre
    slender: float = 6.0  # what a narrow opening is worth, in quality a metre less
    blur: float = 2.0  # standard deviation of the eye's blur of all that [px]
    turn: float = 4.0  # of the line through the fingers, anticlockwise in the image, by the height [rad/m]
    lean: float = 0.3  # away from the operator, on the table [rad]; less with the height, none from
    upright: float = 0.12  # this height on [m]
    follow: float = 0.4  # fraction of the surface's lean that the hand takes over
    margin: float = 0.005  # that the hand opens wider than it must, on the table [m]
    generous: float = 0.15  # how much more by the height [m/m]
    bias: tuple[float, float, float] = (0.008, 0.006, 0.0)  # x, y, z [m] beside the chosen place, in the base frame
    tremor_m: float = 0.005  # standard deviation of a position along each axis [m]
    tremor_rad: float = np.radians(5.0)  # standard deviation of a turn about each axis [rad]


def base_in_world(camera: scene.SceneCamera) -> np.ndarray:
    """Returns a base frame whose x axis points to the image's right, T_world_base, shape (4, 4).

    On a rig the camera stands still before the base; here the scenes stand still before cameras turned anyhow.
    """
    heading = np.arctan2(camera.R[1, 0], camera.R[0, 0])
    return pose(pin.exp3(np.array([0.0, 0.0, heading])))


def chosen_pixel(
    operator: SimulatedOperator, labels: Labels, height: np.ndarray, opening: np.ndarray
) -> tuple[int, int] | None:
    """Returns row and column of the grasp the operator likes best, None where nothing holds.

    Args:
        height: above the table, shape (h, w) [m].
        opening: that the grasp needs, shape (h, w) [m].
    """
    worth = labels.quality + operator.higher * height - operator.slender * opening
    holds = (labels.quality > operator.holds) & labels.known
    if not holds.any():
        return None
    # A place is liked for its neighbourhood; what does not hold is worth little there.
    blurred = gaussian(np.where(holds, worth, worth[holds].min() - 1.0).astype(np.float32), operator.blur)
    row, column = np.unravel_index(np.argmax(np.where(holds, blurred, -np.inf)), blurred.shape)
    return int(row), int(column)


def points(depth: np.ndarray, camera: scene.SceneCamera) -> np.ndarray:
    """Returns where the pixels of a square depth image lie in the world, shape (h, w, 3) [m].

    Args:
        depth: shape (h, w) [m].
    """
    scaled = camera._replace(focal=camera.focal * len(depth) / camera.side, side=len(depth))
    rays = scene.rays(scaled).reshape(*depth.shape, 3)
    return camera.position + (depth[..., None] * rays) @ camera.R.T


def lean(operator: SimulatedOperator, height: np.ndarray, pixel_m: float, at: tuple[int, int]) -> np.ndarray:
    """Returns how much the hand leans about the base frame's x and y axes, shape (2,) [rad].

    Args:
        height: above the table, shape (h, w) [m].
        pixel_m: what a pixel shows of the scene [m].
        at: row and column of the chosen place.
    """
    row, column = at
    seen = gaussian(np.clip(height, 0.0, None).astype(np.float32), EYE_M / pixel_m)
    down, right = (float(np.gradient(seen, pixel_m, axis=axis)[row, column]) for axis in (0, 1))
    steep = 1.0 + np.hypot(down, right)  # an edge is no slope to lean with
    away = operator.lean * max(0.0, 1.0 - max(0.0, height[at]) / operator.upright)
    # Rows run against the base frame's y axis.
    return np.array([away - operator.follow * down / steep, -operator.follow * right / steep])


def grasp_pose(
    operator: SimulatedOperator, place: np.ndarray, line: np.ndarray, leant: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Returns the operator's grasp, T_base_grasp, shape (4, 4) [m]; x through the fingers, z the approach.

    Args:
        place: the chosen place, shape (3,) [m].
        line: direction of the line through the fingers, shape (3,); both in the base frame.
        leant: about the base frame's x and y axes, shape (2,) [rad].
    """
    x = line - (line @ DOWN) * DOWN
    x /= np.linalg.norm(x)
    upright = np.column_stack([x, np.cross(DOWN, x), DOWN])
    R = pin.exp3(np.append(leant, 0.0)) @ upright @ pin.exp3(rng.normal(0.0, operator.tremor_rad, 3))
    return pose(R, place + operator.bias + rng.normal(0.0, operator.tremor_m, 3))


def opening(operator: SimulatedOperator, needed: float, height: float, rng: np.random.Generator) -> float:
    """Returns how wide the operator opens the hand [m], as wide as it goes at most.

    Args:
        needed: opening that the thing needs [m].
        height: of the place above the table [m].
    """
    wanted = needed + operator.margin + operator.generous * max(0.0, height) + rng.normal(0.0, operator.tremor_m)
    return float(np.clip(wanted, needed, GRIPPER.opening))
