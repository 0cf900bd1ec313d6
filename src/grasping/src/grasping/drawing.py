"""What the network sees and finds, as pictures for people."""

from __future__ import annotations

import cv2
import numpy as np

from grasping.live import Findings, Proposal
from grasping.maps import Maps

SCALE = 2
"""Pixels of the heat map to one of the network's, in rows and columns."""
BEST, OTHER, REFUSED, DISC = (255, 255, 255), (170, 170, 170), (80, 80, 255), (0, 255, 0)
DISC_RADIUS = 5
DARK = 60
"""Grey of what is farthest away."""
FONT, FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45


def plain(maps: Maps) -> np.ndarray:
    """Returns the quality in the red channel, as the published node draws it, shape (h, w, 3), uint8, blue first."""
    picture = np.zeros((*maps.quality.shape, 3), np.uint8)
    picture[..., 2] = np.uint8(255.0 * np.clip(maps.quality, 0.0, 1.0))
    return picture


def with_disc(picture: np.ndarray, best: Proposal | None) -> np.ndarray:
    """Returns a copy of `plain` with a green disc at the best grasp."""
    picture = picture.copy()
    if best is not None:
        cv2.circle(picture, (best.peak.column, best.peak.row), DISC_RADIUS, DISC, cv2.FILLED)
    return picture


def heat_map(findings: Findings, refused: set[int], reason: str) -> np.ndarray:
    """Returns the network's picture in grey under the quality in colours, with the grasps: a bar from finger to
    finger, its ends the fingers, number and quality beside it; shape (600, 600, 3), uint8, blue first.

    Args:
        findings: with a view and maps.
        refused: numbers of the grasps that the arm's controller refuses.
        reason: written below where there is one.
    """
    depth, quality = findings.view.picture.depth, findings.maps.quality
    grey = DARK + np.uint8((255 - DARK) * (depth.max() - depth) / max(1e-6, float(np.ptp(depth))))
    colours = cv2.applyColorMap(np.uint8(255.0 * np.clip(quality, 0.0, 1.0)), cv2.COLORMAP_JET)
    share = np.clip(1.5 * quality, 0.0, 0.6)[..., None]
    picture = np.uint8((1.0 - share) * grey[..., None] + share * colours)
    picture = cv2.resize(picture, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_LINEAR)
    for proposal in reversed(findings.proposals):
        best = proposal is findings.proposals[0]
        _gripper(picture, proposal, REFUSED if proposal.id in refused else BEST if best else OTHER, 2 if best else 1)
    if reason:
        cv2.putText(picture, reason, (8, len(picture) - 10), FONT, FONT_SCALE, BEST, 1, cv2.LINE_AA)
    return picture


def _gripper(picture: np.ndarray, proposal: Proposal, colour: tuple[int, int, int], thickness: int) -> None:
    peak = proposal.peak
    middle = SCALE * (np.array([peak.column, peak.row]) + 0.5)
    line = np.array([np.cos(peak.angle), -np.sin(peak.angle)])
    half, finger = 0.5 * SCALE * max(0.0, peak.width) * line, 6.0 * line[::-1] * (-1.0, 1.0)
    ends = [middle - half, middle + half]
    cv2.line(picture, *(_pixel(end) for end in ends), colour, thickness, cv2.LINE_AA)
    for end in ends:
        cv2.line(picture, _pixel(end - finger), _pixel(end + finger), colour, thickness + 1, cv2.LINE_AA)
    label = f"{proposal.id}: {peak.quality:.2f}"
    cv2.putText(picture, label, _pixel(ends[1] + (8.0, 4.0)), FONT, FONT_SCALE, colour, 1, cv2.LINE_AA)


def _pixel(point: np.ndarray) -> tuple[int, int]:
    return round(point[0]), round(point[1])
