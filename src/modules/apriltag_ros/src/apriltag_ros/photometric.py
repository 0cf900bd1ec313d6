"""Refines the pose of a target with all grey values of its tags, starting from the pose by the corners. The tags are
rendered as the camera would see them. Gauss-Newton steps with damping change pose and blur until the sum of squared
differences to the image is smallest; brightness and contrast are fitted for each tag. Where a second pose explains
nearly the same corners, the search also starts from it, and the result with the smaller residual wins. The raw image is
used and the lens distortion is part of the rendering: rectification would blur the image again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from apriltag_ros.settings import TagTarget
from apriltag_ros.tag_pose import corner_jacobian, covariance, tag_pose
from apriltag_ros.tag_rendering import BLURS_PX, TagPattern, TagView, black_cells
from common.camera_model import CameraModel
from common.poses import pose, read_only

FIRST_BLUR_PX = 0.7
MAX_STEPS = 25
SETTLED_PX = 2e-3
"""The search stops when a step moves no corner by more."""
AMBIGUITY_PX = 2.0
"""The second pose is tried if it moves no corner by more."""
MAX_MOVED_PX = 3.0
"""Corner errors stay below this: a pose that moves a corner by more matched something else."""
MAX_CLIPPED = 0.25
MIN_CONTRAST = 20.0
MAX_RESIDUAL = 0.2
MAX_BLUR_CELLS = 0.6
VARIANCE_FACTOR = 4.0
"""Neighbouring pixels share rendering errors, so the variance from their number alone is too small."""
MODEL_SIGMA_PX = 0.05
"""Remaining corner error from lens, print and light."""


@dataclass(frozen=True, eq=False)
class PoseRefinement:
    """A refined pose, or the reason for its rejection."""

    T_camera_tag: np.ndarray  # pose in the camera's optical frame, shape (4, 4) [m]; the start pose if rejected
    covariance: np.ndarray | None  # as in TagPose, shape (6, 6); None if rejected
    rejection: str  # reason why the start pose is kept, without a full stop; empty for a refined pose
    blur: float = np.nan  # standard deviation of the point spread, without the pixel's own width [px]
    residual: float = np.nan  # rms difference of image and rendering at the worst tag, as a fraction of its contrast
    moved: float = np.nan  # largest distance of a corner from the start [px]


class PhotometricRefiner:
    """Refines poses of one target, whose tags are of one `family`; raises ValueError if that has no such tag."""

    def __init__(self, family: str, target: TagTarget) -> None:
        self._patterns = tuple(TagPattern(tag, black_cells(family, tag.id)) for tag in target.tags)
        self._points = target.corners

    def refine(self, grey: np.ndarray, camera: CameraModel, T_start: np.ndarray) -> PoseRefinement:
        """Returns the pose whose rendering matches the raw grey image, shape (height, width), uint8, best. T_start is
        the pose by the corners, shape (4, 4) [m], and the camera has its distortion. Raises ValueError if the image
        does not have the camera's size, or is not grey."""
        if grey.shape != (camera.height, camera.width) or grey.dtype != np.uint8:
            raise ValueError(
                f"the image has shape {grey.shape} and type {grey.dtype}, but the camera's grey image is "
                f"({camera.height}, {camera.width}) uint8: use raw images with their own camera_info"
            )
        views = [TagView.of(pattern, grey, camera, T_start) for pattern in self._patterns]
        cut = [str(pattern.tag.id) for pattern, view in zip(self._patterns, views) if view is None]
        if cut:
            return _rejected(T_start, f"the image edge cuts off the tags {', '.join(cut)}")
        visible = [view for view in views if view is not None]
        clipped = float(np.mean(np.concatenate([(view.grey == 0) | (view.grey == 255) for view in visible])))
        if clipped > MAX_CLIPPED:
            return _rejected(T_start, f"{clipped:.0%} of the tag pixels are over- or underexposed: change the exposure")
        fits = [_search(visible, self._points, camera, T) for T in (T_start, *self._second(camera, T_start))]
        return self._checked(min(fits, key=lambda fit: fit.variance), camera, T_start)

    def _second(self, camera: CameraModel, T: np.ndarray) -> list[np.ndarray]:
        """Returns the other pose that explains the corners of T, if it does so nearly as well."""
        pixels = _pixels(self._points, camera, T)
        other = tag_pose(self._points, pixels, camera).other
        if other is None or np.abs(_pixels(self._points, camera, other) - pixels).max() > AMBIGUITY_PX:
            return []
        return [other]

    def _checked(self, fit: _Fit, camera: CameraModel, T_start: np.ndarray) -> PoseRefinement:
        corners = _pixels(self._points, camera, fit.T)
        moved = float(np.linalg.norm(corners - _pixels(self._points, camera, T_start), axis=1).max())
        quads = corners.reshape(-1, 4, 2)
        sides = np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2).min(axis=1)
        cell = min(side / pattern.cells for side, pattern in zip(sides, self._patterns))
        contrast = min(fit.gains)
        residual = max(rms / max(abs(gain), 1e-9) for rms, gain in zip(fit.rms, fit.gains))
        if not contrast >= MIN_CONTRAST:
            rejection = f"the contrast of a tag is only {contrast:.0f} grey levels: add light"
        elif not (fit.settled and moved <= MAX_MOVED_PX):
            rejection = f"the search did not converge near the corners, but {moved:.1f} px away"
        elif not fit.blur <= MAX_BLUR_CELLS * cell:
            rejection = f"the blur is {fit.blur:.1f} px where a tag cell is {cell:.1f} px wide: focus, or hold still"
        elif not residual <= MAX_RESIDUAL:
            rejection = f"image and pattern differ by {residual:.0%} of the contrast: uncover the tags"
        else:
            measured = VARIANCE_FACTOR * fit.variance * np.linalg.inv(fit.J.T @ fit.J)[:6, :6]
            rest = covariance(fit.T, self._points, camera.K, MODEL_SIGMA_PX)
            return PoseRefinement(read_only(fit.T), read_only(measured + rest), "", fit.blur, residual, moved)
        return PoseRefinement(read_only(T_start), None, rejection, fit.blur, residual, moved)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A pose with its rendering, compared to the image at the best brightness and contrast for each tag."""

    T: np.ndarray  # pose, shape (4, 4) [m]
    blur: float  # [px]
    differences: np.ndarray  # image minus rendering, shape (n,) [grey levels]
    J: np.ndarray  # derivatives of the rendering by pose and blur, shape (n, 7)
    gains: tuple[float, ...]  # white minus black of each tag [grey levels]
    rms: tuple[float, ...]  # rms difference of each tag [grey levels]
    settled: bool = False  # whether the last step of the search was small

    @property
    def square(self) -> float:
        return float(self.differences @ self.differences)

    @property
    def variance(self) -> float:
        """Variance of a pixel's difference; pose, blur, and brightness and contrast of each tag are fitted."""
        return self.square / max(len(self.differences) - 7 - 2 * len(self.gains), 1)


def _search(views: list[TagView], points: np.ndarray, camera: CameraModel, T: np.ndarray) -> _Fit:
    damping, settled = 1e-3, False
    fit = _compare(views, T, FIRST_BLUR_PX)
    for _ in range(MAX_STEPS):
        H = fit.J.T @ fit.J
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)) + 1e-12 * np.eye(7), fit.J.T @ fit.differences)
        moved = pose(pin.exp3(step[3:6]) @ fit.T[:3, :3], fit.T[:3, 3] + step[:3])
        settled = bool(np.abs(corner_jacobian(fit.T, points, camera.K) @ step[:6]).max() < SETTLED_PX)
        after = _compare(views, moved, float(np.clip(fit.blur + step[6], *BLURS_PX)))
        if after.square <= fit.square:
            fit, damping = after, damping / 10.0
        else:
            damping *= 10.0
        if settled:
            break
    return replace(fit, settled=settled)


def _compare(views: list[TagView], T: np.ndarray, blur: float) -> _Fit:
    gains, rms, Js, differences = [], [], [], []
    for view in views:
        rendered, J = view.render(T, blur)
        light = np.column_stack((rendered, np.ones_like(rendered)))
        gain, offset = np.linalg.lstsq(light, view.grey, rcond=None)[0]
        difference = view.grey - gain * rendered - offset
        gains.append(float(gain))
        rms.append(float(np.sqrt(np.mean(difference**2))))
        # Brightness and contrast absorb a part of each derivative; only the rest constrains the pose.
        Js.append(gain * (J - light @ np.linalg.lstsq(light, J, rcond=None)[0]))
        differences.append(difference)
    return _Fit(T, blur, np.concatenate(differences), np.concatenate(Js), tuple(gains), tuple(rms))


def _pixels(points: np.ndarray, camera: CameraModel, T: np.ndarray) -> np.ndarray:
    return camera.project(points @ T[:3, :3].T + T[:3, 3])


def _rejected(T_start: np.ndarray, reason: str) -> PoseRefinement:
    return PoseRefinement(read_only(T_start), None, reason)
