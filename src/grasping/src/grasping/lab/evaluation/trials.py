"""One trial: a scene of held-out objects, a method's grasp in its image, and what the physics and the labels say.

The rectangle metric of the grasp data sets: a grasp is right when it is like one labelled rectangle, which stands for
the opening (its length) and half of that (its height), as the published code has it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from common import lift_trial
from common.camera_model import CameraModel, pinhole
from common.poses import pose
from common.rotations import rotation_about
from grasping.lab.evaluation.lifting import lift, nearest_object
from grasping.lab.synthetic import labels
from grasping.lab.synthetic.samples import FOCAL_PX, LabelSettings, SceneView, hand_grasps, view
from grasping.network.depth_image import CROP_SIDE, NETWORK_SIDE, Crop, NetworkImage, prepare
from grasping.network.maps import PARALLEL, Maps, Peak, peaks
from grasping.pipeline.projection import project_grasp
from grasping.poses.gripper import GRIPPER

MAX_ANGLE_RAD = np.pi / 6.0
CROP = Crop(0, 0, CROP_SIDE)
FRICTION = (0.35, 0.6)  # range of the friction of a scene
POSITION_ERROR_M = 0.002
ANGLE_ERROR_RAD = 0.035  # standard deviations of what the arm adds to the grasp


def is_right(peak: Peak, labels: list[Peak]) -> bool:
    """Returns whether a grasp is within 30 degrees of a label and shares 25 % of both areas."""
    min_overlap = 0.25
    return any(
        angle_between(peak.angle, label.angle) < MAX_ANGLE_RAD and overlap(peak, label) > min_overlap
        for label in labels
    )


def angle_between(a: float, b: float) -> float:
    """Returns the angle between two lines, in [0, pi/2] [rad]."""
    return abs((a - b + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def overlap(a: Peak, b: Peak) -> float:
    """Returns the area of the rectangles' intersection over that of their union."""
    if min(a.width, b.width) <= 0.0:
        return 0.0
    _, corners = cv2.rotatedRectangleIntersection(_rectangle(a), _rectangle(b))
    if corners is None:
        return 0.0
    common = cv2.contourArea(cv2.convexHull(corners))
    return common / (0.5 * a.width**2 + 0.5 * b.width**2 - common)


def _rectangle(peak: Peak) -> tuple[tuple[float, float], tuple[float, float], float]:
    return (float(peak.column), float(peak.row)), (peak.width, 0.5 * peak.width), -float(np.degrees(peak.angle))


class TrialScene(NamedTuple):
    """A scene and all that is needed to judge grasps in it."""

    number: int  # of the scene in its split
    view: SceneView  # what the camera sees
    image: NetworkImage  # what the network sees
    best: labels.Labels  # labels in the image
    rectangles: list[Peak]  # labelled grasps in all directions


class Conditions(NamedTuple):
    """How grasps are tried."""

    position_error: float = POSITION_ERROR_M  # standard deviation of the arm's error along both axes of the image [m]
    angle_error: float = ANGLE_ERROR_RAD  # and about the approach [rad]
    shake: bool = False  # after the lift
    hand: str = PARALLEL  # name in `network.maps.HANDS`


USUAL = Conditions()


class TrialOutcome(NamedTuple):
    """What came of one grasp, and the grasp in the network's image."""

    found: bool  # the method returned a grasp
    lifted: bool  # the object that it was meant for was lifted and stayed up
    reached: bool  # the hand met nothing on its way
    rectangle: bool  # right by the rectangle metric
    quality: float  # that the method gave it
    reason: str  # of `common.lift_trial`
    row: int = 0
    column: int = 0
    angle: float = 0.0  # [rad]
    width: float = 0.0  # [px]
    opening: float = 0.0  # [m]


class Executed(NamedTuple):
    """A grasp with the arm's error."""

    T_world_grasp: np.ndarray  # shape (4, 4) [m]
    width: float  # opening [m]
    friction: float  # of the scene
    target: int  # number of the object that the grasp is meant for


def situation(split: str, number: int, count: int, conditions: Conditions = USUAL) -> TrialScene:
    """Returns the scene `number` of a split with `count` objects, and its grasps for the hand that tries them."""
    label_quality = 0.3
    seen = view(split, number, count)
    image = prepare(seen.observed, CROP)
    of_hand = hand_grasps(seen, LabelSettings(conditions.hand))
    found, rectangles = of_hand.found, []
    for k, angle in enumerate(found.angles):
        score = found.scores[k]
        one = labels.Labels(score, np.full_like(score, angle), found.openings[k], np.ones_like(score, bool))
        flat = of_hand.in_image(one)
        maps = Maps(flat.quality.astype(np.float32), flat.angle, flat.opening)
        rectangles += peaks(maps, 20, distance=5, threshold=label_quality)
    return TrialScene(number, seen, image, of_hand.in_image(labels.best(found)), rectangles)


def oracle(of: TrialScene) -> Peak | None:
    """Returns the best labelled grasp, which no method that sees the image alone can know."""
    row, column = (int(i) for i in np.unravel_index(np.argmax(of.best.quality), of.best.quality.shape))
    quality = float(of.best.quality[row, column])
    if quality == 0.0:
        return None
    return Peak(row, column, quality, float(of.best.angle[row, column]), float(of.best.opening[row, column]))


def executed(of: TrialScene, chosen: Peak | None, conditions: Conditions = USUAL) -> Executed | None:
    """Returns a grasp as the arm takes it, None where there is none; friction and error depend on the scene alone."""
    friction, error = drawn(of.number, conditions)
    where = None if chosen is None else project_grasp(chosen, CROP, NETWORK_SIDE, of.view.observed, camera())
    if where is None:
        return None
    T_world_grasp = pose(of.view.camera.R, of.view.camera.position) @ where.T_camera_grasp
    target = nearest_object(of.view.scene, T_world_grasp[:3, 3])
    return Executed(T_world_grasp @ error, where.width, friction, target)


def drawn(number: int, conditions: Conditions) -> tuple[float, np.ndarray]:
    """Returns the friction of a scene, and by how much the arm misses there, as `miss`."""
    rng = np.random.default_rng([99, number])
    return float(rng.uniform(*FRICTION)), miss(rng, conditions)


def miss(rng: np.random.Generator, conditions: Conditions) -> np.ndarray:
    """Returns by how much the arm misses a grasp, in its frame, shape (4, 4) [m]."""
    place, turn = rng.normal(0.0, conditions.position_error, 2), rng.normal(0.0, conditions.angle_error)
    return pose(rotation_about(2, turn), (*place, 0.0))


def judge(of: TrialScene, chosen: Peak | None, conditions: Conditions = USUAL) -> TrialOutcome:
    """Returns what comes of a grasp."""
    tried = executed(of, chosen, conditions)
    if chosen is None or tried is None:
        return TrialOutcome(False, False, False, False, 0.0, lift_trial.NO_GRASP)
    at = tried.T_world_grasp, tried.width
    trial = lift(of.view.scene, *at, GRIPPER, tried.friction, tried.target, conditions.shake)
    return TrialOutcome(
        found=True,
        lifted=trial.lifted,
        reached=trial.reached,
        rectangle=is_right(chosen, of.rectangles),
        reason=trial.reason,
        opening=tried.width,
        **chosen._asdict(),
    )


def camera() -> CameraModel:
    """Returns the camera of the scenes; the window is its whole image."""
    centre = 0.5 * (CROP_SIDE - 1)
    K = np.array([[FOCAL_PX, 0.0, centre], [0.0, FOCAL_PX, centre], [0.0, 0.0, 1.0]])
    return pinhole("simulated", CROP_SIDE, CROP_SIDE, K)
