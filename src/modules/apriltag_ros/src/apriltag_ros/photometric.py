"""The pose of a target from all the grey values of its tags, where its corners alone gave a first one.

The tags are drawn as the camera would show them. Pose and blur are changed until the squares of the differences to the
picture are least (Gauss and Newton, with damping); brightness and contrast follow for each tag by themselves. Where a
second pose explains nearly the same corners, that is tried too, and the one with the smaller differences counts.

The picture is taken as it is, with the lens in the drawing: rectifying it first would blur it once more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from apriltag_ros.tag_drawing import BLURS_PX, Pattern, TagView
from apriltag_ros.tag_pattern import black_cells
from apriltag_ros.tag_pose import corner_jacobian, covariance, tag_pose
from apriltag_ros.target import Target
from common.camera_model import CameraModel
from common.poses import pose, read_only

FIRST_BLUR_PX = 0.7
MAX_STEPS = 25
SETTLED_PX = 2e-3
"""The search ends when a step moves no corner by more."""
DOUBT_PX = 2.0
"""The second pose is tried if it moves no corner by more."""

MAX_MOVED_PX = 3.0
"""Corners are never so wrong: a pose that moves one by more has found something else."""
MAX_CLIPPED = 0.25
MIN_CONTRAST = 20.0
MAX_RESIDUAL = 0.2
MAX_BLUR_CELLS = 0.6
VARIANCE_FACTOR = 4.0
"""Neighbouring pixels share errors of the drawing: the variances from their number alone are too small."""
MODEL_SIGMA_PX = 0.05
"""What lens, print and light leave of a corner's error, besides."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined pose, or why there is none.

    Attributes:
        T_camera_tag: pose in the camera's optical frame, shape (4, 4) [m]; that of the start if it was refused.
        covariance: as of a TagPose, shape (6, 6); None if it was refused.
        refused: why the start stays, a sentence without its end; empty if the refined pose counts.
        blur: standard deviation of the point spread, the pixel's own width not included [px].
        residual: root mean square difference between picture and drawing at the worst tag, as a share of its contrast.
        moved: farthest that a corner moved from the start [px].
    """

    T_camera_tag: np.ndarray
    covariance: np.ndarray | None
    refused: str
    blur: float = np.nan
    residual: float = np.nan
    moved: float = np.nan


class PhotometricRefiner:
    """Refines poses of one target.

    Args:
        family: of the tags.
        target: whose patterns are compared.

    Raises:
        ValueError: the family has no such tag.
    """

    def __init__(self, family: str, target: Target) -> None:
        self._patterns = tuple(Pattern(tag, black_cells(family, tag.id)) for tag in target.tags)
        self._points = np.concatenate([tag.corners for tag in target.tags])

    def refine(self, grey: np.ndarray, camera: CameraModel, T_start: np.ndarray) -> Refinement:
        """Returns the pose whose drawing is most like the picture.

        Args:
            grey: picture as the camera took it, shape (height, width), uint8.
            camera: that took it, distortion included.
            T_start: pose from the corners, shape (4, 4) [m].

        Raises:
            ValueError: the picture is not of the camera's size, or not grey.
        """
        if grey.shape != (camera.height, camera.width) or grey.dtype != np.uint8:
            raise ValueError(
                f"a grey picture of {camera.width} x {camera.height} is needed, not {grey.shape} {grey.dtype}"
            )
        shown = [TagView.of(pattern, grey, camera, T_start) for pattern in self._patterns]
        views = [view for view in shown if view is not None]
        cut = [str(pattern.tag.id) for pattern, view in zip(self._patterns, shown) if view is None]
        if cut:
            return _refusal(T_start, f"the tags {', '.join(cut)} are cut off by the picture's edge")
        clipped = float(np.mean(np.concatenate([(view.grey == 0) | (view.grey == 255) for view in views])))
        if clipped > MAX_CLIPPED:
            return _refusal(T_start, f"{clipped:.0%} of the tags' pixels are quite black or white: change the exposure")
        found = [_search(views, self._points, camera, T) for T in (T_start, *self._second(camera, T_start))]
        best = min(found, key=lambda fit: fit.variance)
        return self._judged(best, camera, T_start)

    def _second(self, camera: CameraModel, T: np.ndarray) -> list[np.ndarray]:
        """Returns the other pose that explains the corners of T, if it does so nearly as well."""
        pixels = _pixels(self._points, camera, T)
        other = tag_pose(self._points, pixels, camera).other
        if other is None or np.abs(_pixels(self._points, camera, other) - pixels).max() > DOUBT_PX:
            return []
        return [other]

    def _judged(self, fit: _Fit, camera: CameraModel, T_start: np.ndarray) -> Refinement:
        corners = _pixels(self._points, camera, fit.T)
        moved = float(np.linalg.norm(corners - _pixels(self._points, camera, T_start), axis=1).max())
        quads = corners.reshape(-1, 4, 2)
        sides = np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2).min(axis=1)
        cell = min(side / pattern.cells for side, pattern in zip(sides, self._patterns))
        contrast = min(fit.gains)
        residual = max(rms / max(abs(gain), 1e-9) for rms, gain in zip(fit.rms, fit.gains))
        limits = (
            (contrast >= MIN_CONTRAST, f"white and black are only {contrast:.0f} grey levels apart"),
            (
                fit.settled and moved <= MAX_MOVED_PX,
                f"the search did not settle near the corners, but {moved:.1f} px away",
            ),
            (
                fit.blur <= MAX_BLUR_CELLS * cell,
                f"the picture is blurred by {fit.blur:.1f} px where a cell is {cell:.1f} px wide",
            ),
            (
                residual <= MAX_RESIDUAL,
                f"picture and pattern differ by {residual:.0%} of the contrast: is a tag covered?",
            ),
        )
        refused = next((sentence for holds, sentence in limits if not holds), "")
        if refused:
            return Refinement(read_only(T_start), None, refused, fit.blur, residual, moved)
        drawn = VARIANCE_FACTOR * fit.variance * np.linalg.inv(fit.H)[:6, :6]
        rest = covariance(fit.T, self._points, camera.K, MODEL_SIGMA_PX)
        return Refinement(read_only(fit.T), read_only(drawn + rest), "", fit.blur, residual, moved)


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Picture and drawing, with the best brightness and contrast for each tag.

    Attributes:
        differences: picture less drawing, shape (n,) [grey levels].
        J: derivatives of the drawing by pose and blur, shape (n, 7).
        gains: white less black, of each tag [grey levels].
        rms: root mean square difference of each tag [grey levels].
    """

    differences: np.ndarray
    J: np.ndarray
    gains: tuple[float, ...]
    rms: tuple[float, ...]

    @property
    def square(self) -> float:
        """Sum of the squares of the differences."""
        return float(self.differences @ self.differences)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Where a search ended.

    Attributes:
        T: pose, shape (4, 4) [m].
        blur: [px].
        settled: whether the last step was small.
        variance: of a pixel's difference.
        H: matrix of the normal equations, shape (7, 7).
        gains, rms: of each tag.
    """

    T: np.ndarray
    blur: float
    settled: bool
    variance: float
    H: np.ndarray
    gains: tuple[float, ...]
    rms: tuple[float, ...]


def _search(views: list[TagView], points: np.ndarray, camera: CameraModel, T: np.ndarray) -> _Fit:
    blur, damping, settled = FIRST_BLUR_PX, 1e-3, False
    now = _compare(views, T, blur)
    for _ in range(MAX_STEPS):
        H = now.J.T @ now.J
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)) + 1e-12 * np.eye(7), now.J.T @ now.differences)
        moved = pose(pin.exp3(step[3:6]) @ T[:3, :3], T[:3, 3] + step[:3])
        blurred = float(np.clip(blur + step[6], *BLURS_PX))
        settled = np.abs(corner_jacobian(T, points, camera.K) @ step[:6]).max() < SETTLED_PX
        after = _compare(views, moved, blurred)
        if after.square <= now.square:
            T, blur, now, damping = moved, blurred, after, damping / 10.0
        else:
            damping *= 10.0
        if settled:
            break
    freedom = max(len(now.differences) - 7 - 2 * len(views), 1)
    return _Fit(T, blur, bool(settled), now.square / freedom, now.J.T @ now.J, now.gains, now.rms)


def _compare(views: list[TagView], T: np.ndarray, blur: float) -> _Comparison:
    gains, rms, Js, differences = [], [], [], []
    for view in views:
        shown, J = view.draw(T, blur)
        light = np.column_stack((shown, np.ones_like(shown)))
        gain, offset = np.linalg.lstsq(light, view.grey, rcond=None)[0]
        difference = view.grey - gain * shown - offset
        gains.append(float(gain))
        rms.append(float(np.sqrt(np.mean(difference**2))))
        # Brightness and contrast follow the pose, so only what they cannot follow is left of the derivatives.
        Js.append(gain * (J - light @ np.linalg.lstsq(light, J, rcond=None)[0]))
        differences.append(difference)
    return _Comparison(np.concatenate(differences), np.concatenate(Js), tuple(gains), tuple(rms))


def _pixels(points: np.ndarray, camera: CameraModel, T: np.ndarray) -> np.ndarray:
    return camera.project(points @ T[:3, :3].T + T[:3, 3])


def _refusal(T_start: np.ndarray, sentence: str) -> Refinement:
    return Refinement(read_only(T_start), None, sentence)
