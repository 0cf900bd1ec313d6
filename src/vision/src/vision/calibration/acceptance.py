"""The calibration of the camera's place: which views count, and whether the result may be used.

A view is the mean of the panel's poses in several pictures while arm and camera stand still. Its covariance is that of
one picture, since most of a corner's error stays the same from picture to picture, and that of the arm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.config import flag, integer, number
from common.poses import inverse, pose
from common.rotations import rotation_angle
from vision.calibration.hand_eye import Degenerate, HandEye, View, leave_one_out, point_sd, scales, solve


@dataclass(frozen=True)
class CalibrationConfig:
    """The schema of camera_calibration.yaml."""

    pictures: int = integer(low=1, high=100, doc="poses of the panel that make a view")
    photometric: bool = flag("refine these poses by all grey values of the tags, not their corners alone")
    still_mm: float = number("mm", above=0.0, high=100.0, doc="farthest a pose of a view may be from their mean")
    still_deg: float = number("deg", above=0.0, high=30.0, doc="likewise, turned")
    new_mm: float = number("mm", low=0.0, high=1000.0, doc="a view nearer to an earlier one, and")
    new_deg: float = number("deg", low=0.0, high=90.0, doc="less turned than this, tells nothing new")
    arm_mm: float = number("mm", low=0.0, high=10.0, doc="standard deviation of the flange's place as the arm tells it")
    arm_deg: float = number("deg", low=0.0, high=5.0, doc="likewise, of its turn")
    min_views: int = integer(low=4, high=100, doc="views that have to fit together")
    min_share: float = number(above=0.5, high=1.0, doc="share of the views that have to fit")
    max_rms_mm: float = number("mm", above=0.0, high=50.0, doc="greatest root mean square error of the views")
    max_rms_deg: float = number("deg", above=0.0, high=10.0, doc="likewise, turned")
    max_point_sd_mm: float = number(
        "mm", above=0.0, high=50.0, doc="greatest standard deviation of a point at the panel"
    )
    max_turn_sd_deg: float = number("deg", above=0.0, high=10.0, doc="greatest standard deviation of the camera's turn")
    max_scale: float = number(above=0.0, high=0.2, doc="greatest share by which size or distance may look wrong")
    max_panel_mm: float = number("mm", above=0.0, high=100.0, doc="farthest the panel may be from its drawing")
    max_panel_deg: float = number("deg", above=0.0, high=90.0, doc="likewise, turned")


@dataclass(frozen=True, eq=False)
class Sight:
    """The panel in one picture.

    Attributes:
        T_camera_panel: shape (4, 4) [m].
        covariance: of its small changes, shape (6, 6).
    """

    T_camera_panel: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Verdict:
    """A calibration and whether it is good enough.

    Attributes:
        result: the calibration.
        accepted: whether it may be used.
        reasons: a sentence for each thing that speaks against it.
        rms: of the fitting views' errors at the panel [mm, deg], shape (2,).
        predicted: each view's distance from what the others predict [mm, deg], shape (n, 2); nan where unknown.
        point_sd_mm: standard deviation of a point where the panel was in the middle of the views [mm].
        turn_sd_deg: standard deviation of the camera's turn [deg].
        size: factor by which all looks too large, as with tags of another size than is stated.
        ahead: factor by which the panel looks too far ahead, as with a wrong focal length.
        panel: how far the panel is from its drawing [mm, deg], shape (2,).
    """

    result: HandEye
    accepted: bool
    reasons: tuple[str, ...]
    rms: np.ndarray
    predicted: np.ndarray
    point_sd_mm: float
    turn_sd_deg: float
    size: float
    ahead: float
    panel: np.ndarray

    @property
    def sentence(self) -> str:
        """What a person is told."""
        accuracy = (
            f"rms {self.rms[0]:.2f} mm and {self.rms[1]:.2f} deg in {int(self.result.fits.sum())} of "
            f"{len(self.result.fits)} views, a point at the panel known to {self.point_sd_mm:.2f} mm"
        )
        if self.accepted:
            return f"The calibration is good: {accuracy}."
        return f"The calibration is refused: {' '.join(self.reasons)} ({accuracy}.)"


def view_from(sights: list[Sight], T_base_flange: np.ndarray, earlier: list[View], config: CalibrationConfig) -> View:
    """Returns the view of the arm at one place.

    Args:
        sights: the panel in the pictures that were taken there.
        T_base_flange: measured by the arm, shape (4, 4) [m].
        earlier: views that count already.

    Raises:
        ValueError: a sentence that says why it does not count.
    """
    if len(sights) < config.pictures:
        raise ValueError(f"the panel was seen in {len(sights)} pictures, {config.pictures} are needed")
    for view in earlier:
        shift, turn = _apart(view.T_base_flange, T_base_flange)
        if shift < config.new_mm and turn < config.new_deg:
            raise ValueError(f"the arm was here before: {shift:.1f} mm and {turn:.1f} deg from an earlier view")
    T = mean_pose([sight.T_camera_panel for sight in sights])
    spread = np.max([_apart(T, sight.T_camera_panel) for sight in sights], axis=0)
    if spread[0] > config.still_mm or spread[1] > config.still_deg:
        raise ValueError(
            f"the panel did not keep still: seen up to {spread[0]:.1f} mm and {spread[1]:.1f} deg from the mean"
        )
    covariance = np.mean([sight.covariance for sight in sights], axis=0)
    arm = np.repeat([1e-3 * config.arm_mm, np.radians(config.arm_deg)], 3)
    return View(T_base_flange, T, covariance + np.diag(arm**2))


def mean_pose(poses: list[np.ndarray]) -> np.ndarray:
    """Returns the mean, shape (4, 4), of poses that are not far apart."""
    first = poses[0]
    turn = np.mean([pin.log3(T[:3, :3] @ first[:3, :3].T) for T in poses], axis=0)
    return pose(pin.exp3(turn) @ first[:3, :3], np.mean([T[:3, 3] for T in poses], axis=0))


def judge(views: list[View], T_flange_panel: np.ndarray, config: CalibrationConfig) -> Verdict:
    """Returns the calibration from the views and what speaks against it.

    Args:
        views: of the panel.
        T_flange_panel: by the panel's drawing, shape (4, 4) [m].

    Raises:
        Degenerate: the views do not determine it.
    """
    if len(views) < config.min_views:
        raise Degenerate(f"{len(views)} views are too few, {config.min_views} are needed")
    result = solve(views)
    errors = result.errors[result.fits]
    unit = np.array([1e3, np.degrees(1.0)])
    rms = unit * np.sqrt([np.mean(np.sum(part**2, axis=1)) for part in (errors[:, :3], errors[:, 3:])])
    predicted = unit * leave_one_out(views, result)
    middle = np.mean([(view.T_base_flange @ result.T_flange_panel)[:3, 3] for view in views], axis=0)
    point = 1e3 * point_sd(result, middle)
    turn = float(np.degrees(np.sqrt(np.trace(result.covariance[9:, 9:]))))
    panel = np.array(_apart(T_flange_panel, result.T_flange_panel))
    (size, ahead), sds = scales(views, result)
    count, share = int(result.fits.sum()), float(result.fits.mean())
    limits = (
        (count >= config.min_views, f"Only {count} views fit together, {config.min_views} are needed."),
        (share >= config.min_share, f"Only {share:.0%} of the views fit together, {config.min_share:.0%} are needed."),
        (rms[0] <= config.max_rms_mm, f"The views are {rms[0]:.2f} mm off, {config.max_rms_mm:g} mm are allowed."),
        (rms[1] <= config.max_rms_deg, f"The views are {rms[1]:.2f} deg off, {config.max_rms_deg:g} deg are allowed."),
        *_known(point, turn, config),
        (
            not np.isnan(predicted[result.fits]).any(),
            "All hangs on one view: without it the flange turns about one axis only.",
        ),
        (
            abs(size - 1.0) <= config.max_scale + 2.0 * sds[0],
            f"All looks {size - 1.0:+.1%} too large, allowed are {config.max_scale:.1%}: measure the tags.",
        ),
        (
            abs(ahead - 1.0) <= config.max_scale + 2.0 * sds[1],
            f"The panel looks {ahead - 1.0:+.1%} too far ahead, allowed are {config.max_scale:.1%}: calibrate the "
            "camera's focal length.",
        ),
        (
            panel[0] <= config.max_panel_mm and panel[1] <= config.max_panel_deg,
            f"The panel would sit {panel[0]:.1f} mm and {panel[1]:.1f} deg from its drawing, allowed are "
            f"{config.max_panel_mm:g} mm and {config.max_panel_deg:g} deg: check the sizes of the tags and the panel.",
        ),
    )
    reasons = tuple(sentence for holds, sentence in limits if not holds)
    return Verdict(result, not reasons, reasons, rms, predicted, point, turn, float(size), float(ahead), panel)


def check_alone(view: View, config: CalibrationConfig) -> float:
    """Returns the standard deviation of a point at the panel [mm] where one view alone tells the camera's place.

    Raises:
        ValueError: with a sentence for each thing that is known too badly.
    """
    point = 1e3 * float(np.sqrt(np.trace(view.covariance[:3, :3])))
    turn = float(np.degrees(np.sqrt(np.trace(view.covariance[3:, 3:]))))
    reasons = [sentence for holds, sentence in _known(point, turn, config) if not holds]
    if reasons:
        raise ValueError(" ".join(reasons))
    return point


def table(verdict: Verdict) -> list[str]:
    """Returns lines with the errors of each view, and whether it counts."""
    lines = ["view   error [mm]  [deg]   predicted by the others [mm]  [deg]"]
    for i, (error, predicted, fits) in enumerate(
        zip(verdict.result.errors, verdict.predicted, verdict.result.fits), start=1
    ):
        shift, turn = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
        rest = f"{predicted[0]:28.2f}{predicted[1]:9.2f}" if fits else f"{'left out':>37}"
        lines.append(f"{i:4d}{shift:13.2f}{turn:7.2f}{rest}")
    return lines


def _known(point: float, turn: float, config: CalibrationConfig) -> tuple[tuple[bool, str], ...]:
    """Returns whether a point [mm] and the camera's turn [deg] are known well enough, each with what is said if not."""
    return (
        (
            point <= config.max_point_sd_mm,
            f"A point is known to {point:.2f} mm only, {config.max_point_sd_mm:g} mm are needed.",
        ),
        (
            turn <= config.max_turn_sd_deg,
            f"The camera's turn is known to {turn:.2f} deg only, {config.max_turn_sd_deg:g} deg are needed.",
        ),
    )


def _apart(T: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Returns how far apart two poses are [mm, deg]."""
    between = inverse(T) @ other
    return 1e3 * float(np.linalg.norm(between[:3, 3])), float(np.degrees(rotation_angle(between[:3, :3])))
