"""What the network sees and finds, as images for people."""

from __future__ import annotations

import textwrap

import cv2
import numpy as np

from common.camera_model import CameraModel
from common.poses import inverse
from grasping.network.depth_image import Crop
from grasping.network.maps import Maps
from grasping.pipeline.pipeline import GraspProposal, PipelineResult

BEST, OTHER, REFUSED, DISC = (255, 255, 255), (0, 190, 255), (80, 80, 255), (0, 255, 0)
FONT, FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45
FINGER_M = (0.01, 0.1)  # half the breadth of a finger, and how much of the approach is drawn


def plain(maps: Maps) -> np.ndarray:
    """Returns the quality in the red channel, as the published node draws it, shape (h, w, 3), uint8, blue first."""
    image = np.zeros((*maps.quality.shape, 3), np.uint8)
    image[..., 2] = np.uint8(255.0 * np.clip(maps.quality, 0.0, 1.0))
    return image


def with_disc(image: np.ndarray, best: GraspProposal | None) -> np.ndarray:
    """Returns a copy of `plain` with a green disc at the best grasp."""
    disc_radius = 5
    image = image.copy()
    if best is not None:
        cv2.circle(image, (best.peak.column, best.peak.row), disc_radius, DISC, cv2.FILLED)
    return image


def heat_map(result: PipelineResult, refused: set[int], reason: str) -> np.ndarray:
    """Returns the network's image in grey under the quality in colours, shape (600, 600, 3), uint8, blue first, with
    the grasps: as `gripper`, number and quality beside it; the `refused` numbers in another colour; below it the
    `reason`, if any.
    """
    scale = 2  # pixels of the heat map to one of the network's, in rows and columns
    line_letters = 66
    assert result.view is not None and result.maps is not None, "there is something to draw"
    quality = result.maps.quality
    colours = cv2.applyColorMap((255.0 * np.clip(quality, 0.0, 1.0)).astype(np.uint8), cv2.COLORMAP_JET)
    opacity = np.clip(1.5 * quality, 0.0, 0.6)[..., None]
    mixed = (1.0 - opacity) * grey(result.view.image.depth)[..., None] + opacity * colours
    image = cv2.resize(mixed.astype(np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    T_view_camera, view = inverse(result.view.T_camera_view), result.view
    for proposal in reversed(result.grasps):
        best, T = proposal is result.grasps[0], T_view_camera @ proposal.T_camera_grasp
        colour = REFUSED if proposal.id in refused else BEST if best else OTHER
        label = f"{proposal.id}: {proposal.quality:.2f}"
        gripper(image, view.camera, T, proposal.width, label, colour, 2 if best else 1, view.image.crop)
    for i, line in enumerate(reversed(textwrap.wrap(reason, line_letters))):
        cv2.putText(image, line, (8, len(image) - 10 - 20 * i), FONT, FONT_SCALE, BEST, 1, cv2.LINE_AA)
    return image


def grey(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image, shape (h, w) [m], with a reading, in grey, uint8: nearest white, not finite black."""
    dark = 60  # grey of what is farthest away, and of all that is farther than `far` times the image's median depth
    far = 1.3
    known = np.isfinite(depth)
    low, high = float(depth[known].min()), min(float(depth[known].max()), far * float(np.median(depth[known])))
    bright = dark + (255 - dark) * (high - np.where(known, depth, high)) / max(1e-6, high - low)
    return np.where(known, np.maximum(bright, dark), 0.0).astype(np.uint8)


def gripper(
    image: np.ndarray,
    camera: CameraModel,
    T_camera_grasp: np.ndarray,
    width: float,
    label: str,
    colour: tuple[int, int, int],
    thickness: int,
    crop: Crop | None = None,
) -> None:
    """Draws a grasp, shape (4, 4) [m], as a camera sees it into its image, shape (h, w, 3), uint8, or into the part
    that `crop` cuts from it: a bar of its opening, `width` [m], a finger's breadth at each end, and the approach. What
    is too near to the camera for that is not drawn.
    """
    near_m = 0.02
    half = 0.5 * max(0.0, width)
    bar = [(-half, 0.0, 0.0), (half, 0.0, 0.0)]
    fingers = [(x, y, 0.0) for x in (-half, half) for y in (-FINGER_M[0], FINGER_M[0])]
    points = np.array([*bar, *fingers, (0.0, 0.0, -FINGER_M[1]), (0.0, 0.0, 0.0)])
    points = points @ T_camera_grasp[:3, :3].T + T_camera_grasp[:3, 3]
    if points[:, 2].min() < near_m:
        return
    seen = camera.project(points)
    if crop is not None:
        seen = (seen - (crop.column, crop.row) + 0.5) * len(image) / crop.side - 0.5
    for i, (start, end) in enumerate(seen.reshape(-1, 2, 2)):
        cv2.line(image, _pixel(start), _pixel(end), colour, thickness + (i in (1, 2)), cv2.LINE_AA)
    beside = seen[np.argmax(seen[:2, 0])] + (8.0, 4.0)
    cv2.putText(image, label, _pixel(beside), FONT, FONT_SCALE, colour, 1, cv2.LINE_AA)


def _pixel(point: np.ndarray) -> tuple[int, int]:
    return round(point[0]), round(point[1])
