"""A grasp without a network: opposed surfaces in the point cloud, the baseline of grasps in six degrees of freedom.

At random points of what stands on the table the open hand comes along the surface's normal, as upright as it must,
turned in eight ways, as deep as it goes without a touch. It is as good as the smaller of both sides: the number of
points near the pads whose normals lie within the friction cone of the closing direction. After the idea of Grasp Pose
Detection (ten Pas, Gualtieri, Saenko, Platt, 2017), without its network.
"""

from __future__ import annotations

import cv2
import numpy as np

from common.camera_model import CameraModel
from grasping.network.depth_image import NetworkImage
from grasping.poses.candidates import LevelFrame, image_rays
from grasping.poses.chooser import ImageMaps
from grasping.poses.gripper import Gripper
from grasping.poses.hypotheses import OBJECT_M, upright

SAMPLES, TURNS = 150, 8
DEPTHS_M = (0.0, 0.008, 0.016, 0.024)  # of the tips below the sampled point
NEAR_M = 0.005  # points so near the outermost one touch a pad


def antipodal_grasp(
    of: ImageMaps, gripper: Gripper, max_tilt: float, rng: np.random.Generator
) -> tuple[np.ndarray, float, float] | None:
    """Returns T_camera_grasp, shape (4, 4) [m], the opening [m] and how many points the weaker side has; None where
    the hand finds no place with points on both sides."""
    frame = of.frame
    points, normals = cloud(of.image, of.camera, frame)
    if not len(points):
        return None
    best: tuple[np.ndarray, float, float] | None = None
    for i in rng.choice(len(points), min(SAMPLES, len(points)), replace=False):
        near = np.linalg.norm(points - points[i], axis=1) < 0.5 * gripper.opening + gripper.thickness + gripper.palm
        for R in _turned(normals[i], frame, max_tilt):
            found = _at(points[near] @ R - points[i] @ R, normals[near] @ R, gripper)
            if found is None:
                continue
            middle, deep, opening, score = found
            tips = points[i] + R @ (middle, 0.0, deep)
            low = gripper.ground - (frame.distance - tips @ frame.R[:, 2])
            if score > (0.0 if best is None else best[2]) and low < gripper.reach:
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = R, tips - gripper.reach * R[:, 2]
                best = T, opening, score
    return best


def cloud(image: NetworkImage, camera: CameraModel, frame: LevelFrame) -> tuple[np.ndarray, np.ndarray]:
    """Returns the points that stand out of the table, of every other pixel, and their normals towards the camera, both
    shape (n, 3) [m], in the camera's frame."""
    eye_px = 1.5  # standard deviation of the blur over which a normal is seen
    depth = cv2.GaussianBlur(image.depth, (0, 0), eye_px)
    at = depth[..., None] * image_rays(image, camera)
    normal = np.cross(np.gradient(at, axis=0), np.gradient(at, axis=1))
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)
    normal *= -np.sign((normal * at).sum(axis=2, keepdims=True))
    seen = image.valid & (frame.distance - at @ frame.R[:, 2] > OBJECT_M)
    seen[1::2], seen[:, 1::2] = False, False
    return at[seen], normal[seen]


def _turned(normal: np.ndarray, frame: LevelFrame, max_tilt: float) -> np.ndarray:
    """Returns orientations of hands that come against a normal, shape (TURNS, 3, 3)."""
    z = -normal
    x = frame.R[:, 0] - (frame.R[:, 0] @ z) * z
    x /= max(float(np.linalg.norm(x)), 1e-6)
    y = np.cross(z, x)
    angle = np.pi * np.arange(TURNS)[:, None] / TURNS
    across = np.cos(angle) * x + np.sin(angle) * y
    R = np.stack([across, np.cross(z, across), np.broadcast_to(z, across.shape)], axis=-1)
    return upright(R, frame, max_tilt)


def _at(points: np.ndarray, normals: np.ndarray, gripper: Gripper) -> tuple[float, float, float, float] | None:
    """Returns the middle of the opening, the depth of the tips, the opening [m], and the weaker side's points, of the
    deepest place without a touch; `points`, `normals`: in the hand's axes from the sampled point, shape (n, 3)."""
    half, cone = 0.5 * gripper.opening, np.cos(np.arctan(gripper.friction))
    beside = np.abs(points[:, 1]) < 0.5 * gripper.breadth
    x, z, along = points[beside, 0], points[beside, 2], normals[beside, 0]
    found = None
    for deep in DEPTHS_M:
        in_way = z < deep
        between = in_way & (np.abs(x) < half)
        if not between.any() or (z < deep - gripper.palm).any():
            break
        left, right = x[between].min(), x[between].max()
        opening = right - left + 2.0 * gripper.clearance
        middle = 0.5 * (left + right)
        finger = (
            in_way & (np.abs(x - middle) > 0.5 * opening) & (np.abs(x - middle) < 0.5 * opening + gripper.thickness)
        )
        if opening > gripper.opening or finger.any():
            continue
        sides = (
            between & (x < left + NEAR_M) & (along < -cone),
            between & (x > right - NEAR_M) & (along > cone),
        )
        score = float(min(side.sum() for side in sides))
        if score:
            found = float(middle), deep, float(opening), score
    return found
