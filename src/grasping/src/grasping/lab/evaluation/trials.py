"""One trial: a scene of held-out objects, a method's grasp in its image, and what the physics and the labels say.

The rectangle metric of the grasp data sets: a grasp is right when it is like one labelled rectangle, which stands for
the opening (its length) and half of that (its height), as the published code has it.
The heuristics are grasps without a network, for comparison: a plane is fitted to the image; what stands out of it is an
object. Openings are in pixels of the image.
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
from grasping.lab.synthetic import labels, reflex_labels
from grasping.lab.synthetic.samples import FOCAL_PX, GRIPPER, LabelSettings, SceneView, hand_grasps, view
from grasping.network.depth_image import CROP_SIDE, NETWORK_SIDE, Crop, NetworkImage, prepare
from grasping.network.maps import PARALLEL, Maps, Peak, peaks
from grasping.pipeline.projection import project_grasp

OUTSTANDING_M = 0.012
PLANE_ROUNDS = 8
PLANE_BAND_M = 0.01
CLEARANCE_PX = 5.0
SMALLEST_OBJECT_PX = 60
EDGE_STEP_M = 0.006  # least step of depth across a pixel that is an edge
EDGE_PAIRS = 4000
FRICTION_ANGLE_RAD = 0.46  # atan 0.5
MAX_ANGLE_RAD = np.pi / 6.0
MIN_OVERLAP = 0.25
CROP = Crop(0, 0, CROP_SIDE)
FRICTION = (0.35, 0.6)  # range of the friction of a scene
POSITION_ERROR_M = 0.002
ANGLE_ERROR_RAD = 0.035  # standard deviations of what the arm adds to the grasp
LABEL_QUALITY = 0.3
GRIPPERS = {  # the labels' own, and another one: narrower, with thick fingers
    "labels": GRIPPER,
    "thick": labels.Gripper(opening=0.085, thickness=0.016, breadth=0.022),
}


def random_pixel(image: NetworkImage, widest: float, rng: np.random.Generator) -> Peak | None:
    """Returns any pixel of an object with any angle, fully open."""
    rows, columns = np.nonzero(object_mask(image))
    if not len(rows):
        return None
    i = rng.integers(len(rows))
    return Peak(int(rows[i]), int(columns[i]), 0.5, float(rng.uniform(-0.5, 0.5) * np.pi), widest)


def principal_axis(image: NetworkImage, widest: float, _rng: np.random.Generator) -> Peak | None:
    """Returns the middle of the largest object, across its shorter principal axis."""
    count, parts, sizes, centres = cv2.connectedComponentsWithStats(object_mask(image).astype(np.uint8))
    if count < 2:
        return None
    part = 1 + int(np.argmax(sizes[1:, cv2.CC_STAT_AREA]))
    points = np.argwhere(parts == part)[:, ::-1] - centres[part]
    axis = np.linalg.eigh(points.T @ points)[1][:, 0]
    extent = np.ptp(points @ axis) + 1.0
    column, row = (round(float(c)) for c in centres[part])
    angle = float(np.arctan2(-axis[1], axis[0]))
    return Peak(row, column, 0.5, (angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi, min(widest, extent + 2.0 * CLEARANCE_PX))


def edge_pair(image: NetworkImage, widest: float, rng: np.random.Generator) -> Peak | None:
    """Returns the pair of opposite depth edges that face each other best."""
    smooth = cv2.GaussianBlur(image.depth, (0, 0), 1.0)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) / 8.0, cv2.Sobel(smooth, cv2.CV_32F, 0, 1) / 8.0
    size = np.hypot(gx, gy)
    rows, columns = np.nonzero((size > EDGE_STEP_M) & object_mask(image, margin=2))
    if len(rows) < 2:
        return None
    # The depth grows outwards across the edge of an object.
    outwards = np.stack([gx, gy], axis=-1)[rows, columns] / size[rows, columns][:, None]
    a, b = rng.integers(0, len(rows), (2, EDGE_PAIRS))
    line = np.stack([columns[b] - columns[a], rows[b] - rows[a]], axis=-1).astype(float)
    length = np.linalg.norm(line, axis=1)
    line /= np.maximum(length, 1e-9)[:, None]
    worst = np.minimum((outwards[b] * line).sum(axis=1), -(outwards[a] * line).sum(axis=1))
    fits = (length > 4.0) & (length + 2.0 * CLEARANCE_PX < widest)
    worst = np.where(fits, worst, -1.0)
    i = int(np.argmax(worst))
    if worst[i] < np.cos(FRICTION_ANGLE_RAD):
        return None
    row, column = (round(0.5 * float(v[a[i]] + v[b[i]])) for v in (rows, columns))
    angle = float(np.arctan2(-line[i, 1], line[i, 0]))
    angle = (angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    return Peak(row, column, float(worst[i]), angle, float(length[i] + 2.0 * CLEARANCE_PX))


HEURISTICS = {"random pixel": random_pixel, "principal axis": principal_axis, "edge pair": edge_pair}


def object_mask(image: NetworkImage, margin: int = 0) -> np.ndarray:
    """Returns where something stands out of the table, shape of the image, bool; widened by `margin` pixels."""
    depth = image.depth
    h, w = depth.shape
    row, column = np.mgrid[:h, :w]
    design = np.stack([column / w, row / h, np.ones_like(depth)], axis=-1).reshape(-1, 3)
    flat, kept = depth.ravel(), depth.ravel() > np.median(depth) - 0.03
    for _ in range(PLANE_ROUNDS):
        plane = np.linalg.lstsq(design[kept][::7], flat[kept][::7], rcond=None)[0]
        kept = np.abs(flat - design @ plane) < PLANE_BAND_M
    mask = ((design @ plane).reshape(h, w) - depth > OUTSTANDING_M).astype(np.uint8)
    count, parts, sizes, _ = cv2.connectedComponentsWithStats(mask)
    for part in range(1, count):
        if sizes[part, cv2.CC_STAT_AREA] < SMALLEST_OBJECT_PX:
            mask[parts == part] = 0
    return cv2.dilate(mask, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)) > 0


def is_right(peak: Peak, labels: list[Peak], least: float = MIN_OVERLAP) -> bool:
    """Returns whether a grasp is within 30 degrees of a label and shares the fraction `least` of both areas."""
    return any(
        angle_between(peak.angle, label.angle) < MAX_ANGLE_RAD and overlap(peak, label) > least for label in labels
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
    widest: float  # opening of the hand at the table [px]
    best: labels.Labels  # labels in the image
    rectangles: list[Peak]  # labelled grasps in all directions


class Conditions(NamedTuple):
    """How grasps are tried."""

    gripper: labels.Gripper = GRIPPER  # if the hand is parallel
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
    seen = view(split, number, count)
    image = prepare(seen.observed, CROP)
    of_hand = hand_grasps(seen, LabelSettings(conditions.hand), conditions.gripper)
    found, rectangles = of_hand.found, []
    for k, angle in enumerate(found.angles):
        score = found.scores[k]
        one = labels.Labels(score, np.full_like(score, angle), found.openings[k], np.ones_like(score, bool))
        flat = of_hand.in_image(one)
        maps = Maps(flat.quality.astype(np.float32), flat.angle, flat.opening)
        rectangles += peaks(maps, 20, distance=5, threshold=LABEL_QUALITY)
    best = of_hand.in_image(labels.best(found))
    widest = conditions.gripper.opening if conditions.hand == PARALLEL else 2.0 * reflex_labels.Hand().preshape
    return TrialScene(number, seen, image, widest * of_hand.focal / float(of_hand.exact.max()), best, rectangles)


def oracle(of: TrialScene) -> Peak | None:
    """Returns the best labelled grasp, which no method that sees the image alone can know."""
    row, column = (int(i) for i in np.unravel_index(np.argmax(of.best.quality), of.best.quality.shape))
    quality = float(of.best.quality[row, column])
    if quality == 0.0:
        return None
    return Peak(row, column, quality, float(of.best.angle[row, column]), float(of.best.opening[row, column]))


def executed(of: TrialScene, chosen: Peak | None, conditions: Conditions = USUAL) -> Executed | None:
    """Returns a grasp as the arm takes it, None where there is none; friction and error depend on the scene alone."""
    rng = np.random.default_rng([99, of.number])
    friction = float(rng.uniform(*FRICTION))
    error = rng.normal(0.0, conditions.position_error, 2), rng.normal(0.0, conditions.angle_error)
    where = None if chosen is None else project_grasp(chosen, CROP, NETWORK_SIDE, of.view.observed, camera())
    if where is None:
        return None
    miss = pose(rotation_about(2, error[1]), (*error[0], 0.0))
    T_world_grasp = pose(of.view.camera.R, of.view.camera.position) @ where.T_camera_grasp
    target = nearest_object(of.view.scene, T_world_grasp[:3, 3])
    return Executed(T_world_grasp @ miss, where.width, friction, target)


def judge(of: TrialScene, chosen: Peak | None, conditions: Conditions = USUAL) -> TrialOutcome:
    """Returns what comes of a grasp."""
    tried = executed(of, chosen, conditions)
    if chosen is None or tried is None:
        return TrialOutcome(False, False, False, False, 0.0, lift_trial.NO_GRASP)
    trial = lift(
        of.view.scene,
        tried.T_world_grasp,
        tried.width,
        conditions.gripper,
        tried.friction,
        tried.target,
        conditions.shake,
    )
    right = is_right(chosen, of.rectangles)
    return TrialOutcome(
        True,
        trial.lifted,
        trial.reached,
        right,
        chosen.quality,
        trial.reason,
        chosen.row,
        chosen.column,
        chosen.angle,
        chosen.width,
        tried.width,
    )


def camera() -> CameraModel:
    """Returns the camera of the scenes; the window is its whole image."""
    centre = 0.5 * (CROP_SIDE - 1)
    K = np.array([[FOCAL_PX, 0.0, centre], [0.0, FOCAL_PX, centre], [0.0, 0.0, 1.0]])
    return pinhole("simulated", CROP_SIDE, CROP_SIDE, K)
