"""One trial: a scene of held-out objects, a method's grasp in its image, and what the physics and the labels say."""

from __future__ import annotations

from typing import Callable, NamedTuple

import cv2
import numpy as np

from common.camera_model import CameraModel, pinhole
from common.poses import pose
from common.rotations import rotation_about
from grasping.lab.evaluation.lifting import lift
from grasping.lab.evaluation.rectangles import is_right
from grasping.lab.synthetic import labels
from grasping.lab.synthetic.samples import CELL_M, GRIPPER, SceneView, view
from grasping.lab.synthetic.sensor import FOCAL_PX
from grasping.network.depth_image import CROP_SIDE, NETWORK_SIDE, Crop, NetworkImage, prepare
from grasping.network.maps import Maps, Peak, peaks
from grasping.pipeline.projection import project_grasp

CROP = Crop(0, 0, CROP_SIDE)
FRICTION = (0.35, 0.6)
"""Range of the friction of a scene."""
POSITION_ERROR_M = 0.002
ANGLE_ERROR_RAD = 0.035
"""Standard deviations of what the arm adds to the grasp."""
LABEL_QUALITY = 0.3

Method = Callable[[NetworkImage, float, np.random.Generator], "Peak | None"]


class TrialScene(NamedTuple):
    """A scene and all that is needed to judge grasps in it."""

    number: int  # of the scene in its split
    view: SceneView  # what the camera sees
    image: NetworkImage  # what the network sees
    widest: float  # opening of the gripper at the table [px]
    best: labels.Labels  # labels in the image
    rectangles: list[Peak]  # labelled grasps in all directions


class TrialOutcome(NamedTuple):
    """What came of one grasp."""

    found: bool  # the method returned a grasp
    lifted: bool  # an object was lifted
    reached: bool  # the hand met nothing on its way
    rectangle: bool  # right by the rectangle metric
    quality: float  # that the method gave it


class Executed(NamedTuple):
    """A grasp with the arm's error."""

    T_world_grasp: np.ndarray  # shape (4, 4) [m]
    width: float  # opening [m]
    friction: float  # of the scene


def situation(split: str, number: int, count: int) -> TrialScene:
    """Returns the scene `number` of a split with `count` objects."""
    seen = view(split, number, count)
    image = prepare(seen.observed, CROP)
    focal = FOCAL_PX * NETWORK_SIDE / CROP_SIDE
    exact = cv2.resize(seen.exact, (NETWORK_SIDE, NETWORK_SIDE), interpolation=cv2.INTER_NEAREST)
    found = labels.grasps(seen.surface, seen.table, CELL_M, GRIPPER)
    rectangles = []
    for k, angle in enumerate(found.angles):
        score = found.scores[k]
        one = labels.Labels(score, np.full_like(score, angle), found.openings[k], np.ones_like(score, bool))
        flat = labels.in_image(one, seen.surface, CELL_M, exact, focal)
        maps = Maps(flat.quality.astype(np.float32), flat.angle, flat.opening)
        rectangles += peaks(maps, 20, distance=5, threshold=LABEL_QUALITY)
    best = labels.in_image(labels.best(found), seen.surface, CELL_M, exact, focal)
    return TrialScene(number, seen, image, GRIPPER.opening * focal / float(exact.max()), best, rectangles)


def oracle(of: TrialScene) -> Peak | None:
    """Returns the best labelled grasp, which no method that sees the image alone can know."""
    row, column = (int(i) for i in np.unravel_index(np.argmax(of.best.quality), of.best.quality.shape))
    quality = float(of.best.quality[row, column])
    if quality == 0.0:
        return None
    return Peak(row, column, quality, float(of.best.angle[row, column]), float(of.best.opening[row, column]))


def executed(of: TrialScene, chosen: Peak | None) -> Executed | None:
    """Returns a grasp as the arm takes it, None where there is none; friction and error depend on the scene alone."""
    rng = np.random.default_rng([99, of.number])
    friction = float(rng.uniform(*FRICTION))
    error = rng.normal(0.0, POSITION_ERROR_M, 2), rng.normal(0.0, ANGLE_ERROR_RAD)
    where = None if chosen is None else project_grasp(chosen, CROP, NETWORK_SIDE, of.view.observed, camera())
    if where is None:
        return None
    miss = pose(rotation_about(2, error[1]), (*error[0], 0.0))
    T_world_camera = pose(of.view.camera.R, of.view.camera.position)
    return Executed(T_world_camera @ where.T_camera_grasp @ miss, where.width, friction)


def judge(of: TrialScene, chosen: Peak | None) -> TrialOutcome:
    """Returns what comes of a grasp."""
    tried = executed(of, chosen)
    if chosen is None or tried is None:
        return TrialOutcome(False, False, False, False, 0.0)
    trial = lift(of.view.scene, tried.T_world_grasp, tried.width, GRIPPER, tried.friction)
    return TrialOutcome(True, trial.lifted, trial.reached, is_right(chosen, of.rectangles), chosen.quality)


def camera() -> CameraModel:
    """Returns the camera of the scenes; the window is its whole image."""
    centre = 0.5 * (CROP_SIDE - 1)
    K = np.array([[FOCAL_PX, 0.0, centre], [0.0, FOCAL_PX, centre], [0.0, 0.0, 1.0]])
    return pinhole("simulated", CROP_SIDE, CROP_SIDE, K)
