"""What a refinement learns from: an operator's choices, and what was lifted; each from a frame of an episode."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from grasping.lab.dataset.episode import Episode, EpisodeFrame
from grasping.lab.dataset.labels import tilt_and_angle
from grasping.lab.training.lift_examples import image_maps
from grasping.poses.taste import Options, Shown
from grasping.refinement import lifts, taste
from grasping.refinement.candidates import Candidates, candidates
from grasping.refinement.lifts import LiftModel
from grasping.refinement.taste import Choice

SAME_M, SAME_RAD = 0.010, 0.35  # a grasp as near to a candidate tells whether that one is lifted
FEWEST = 100  # outcomes, both lifted and not among them, that a model is made of


class Outcome(NamedTuple):
    """What came of a grasp."""

    terms: np.ndarray  # of `lifts.terms`, shape (d,)
    lifted: bool


def seen(frame: EpisodeFrame) -> Candidates | None:
    """Returns the candidates of a frame, from GGCNN's maps as they were recorded; None if the frame holds nothing."""
    of = image_maps(frame)
    return None if of is None else candidates(of.maps, of.certainty, of.image, of.camera)


def choice(frame: EpisodeFrame, of: Candidates) -> Choice | None:
    """Returns the operator's grasp among a frame's candidates; None where the camera cannot see it."""
    T = frame.T_camera_grasp
    if T[2, 3] <= 0.0:
        return None
    try:
        tilt, angle = tilt_and_angle(of.frame.R.T @ T[:3, :3])
    except ValueError:
        return None
    return Choice(of, of.frame.R.T @ T[:3, 3], angle, tilt, frame.opening)


def shown(episode: Episode, given: Options) -> Shown | None:
    """Returns the operator's grasp among the options of an episode's last frame; None as `choice`."""
    found = choice(episode.frame(len(episode) - 1), given.of)
    return None if found is None else Shown(given, *found[1:])


def outcome(of: Choice, held: bool) -> Outcome | None:
    """Returns what a grasp says of the candidate that it was near; None where it was near none."""
    c = of.candidates
    if not c.peaks:
        return None
    off = np.linalg.norm(c.points - of.place, axis=1)
    turned = taste.half_turn(of.angle - c.angles)
    i = int(np.argmin((off / SAME_M) ** 2 + (turned / SAME_RAD) ** 2))
    if off[i] > SAME_M or abs(turned[i]) > SAME_RAD:
        return None
    return Outcome(lifts.terms(c.lifts[[i]], c.angles[[i]], of.tilt[None], turned[[i]])[0], held)


def lift_model(outcomes: Iterable[Outcome]) -> LiftModel | None:
    """Returns what outcomes teach of lifts; None if they are too few."""
    rows = list(outcomes)
    if len(rows) < FEWEST or len({row.lifted for row in rows}) < 2:
        return None
    return lifts.learned(np.stack([row.terms for row in rows]), [row.lifted for row in rows])
