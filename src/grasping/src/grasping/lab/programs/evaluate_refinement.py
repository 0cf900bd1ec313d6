"""Compares predictors of operators' grasps after a few episodes of a kind of object.

Of each operator and object in the folder the first episodes teach (`--few`, by the files' names), the others test:
GG-CNN alone, GG-CNN with the operator's constant miss, the refinement, and the refinement without its constraint. How
far each grasp is from the operator's, in the last frame: as recorded; and as it was meant, without the constant miss
and the tremor, which is known of simulated operators alone. Where the episodes are simulated, each grasp is tried by
lifting in MuJoCo, hand wide open. Results go to results.csv, one line a grasp, and table.md, with the differences over
the same episodes. Intervals are over scenes: several operators in one scene are one case.
"""

from __future__ import annotations

import argparse
import functools
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.errors import RigError
from common.poses import inverse, pose
from common.rotations import rotation_about, rotation_angle
from common.statistics import RESAMPLES
from grasping.lab.dataset.episode import EpisodeFrame
from grasping.lab.dataset.labels import own_grasp
from grasping.lab.evaluation.tables import markdown_table
from grasping.lab.programs import train_refinement
from grasping.lab.programs.evaluate import open_results
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.programs.train_refinement import Lesson, Named
from grasping.lab.synthetic import simulated_operator
from grasping.refinement import preference
from grasping.refinement.candidates import Candidates
from grasping.refinement.lifts import LiftModel
from grasping.refinement.preference import Preference

ALONE, MISS, REFINED, FREE = METHODS = "GG-CNN alone", "GG-CNN + constant miss", "refinement", "without constraint"
COLUMNS = (
    *("episode", "scene", "operator", "object", "method", "meant_mm", "meant_deg", "meant_near"),
    *("position_mm", "rotation_deg", "near", "lifted"),
)
NEAR_M = 0.020
NEAR_MM = 1000.0 * NEAR_M
NEAR_RAD = np.radians(15.0)
MEASURES: dict[str, tuple[str, Callable[[Any], bool] | None]] = {
    "correction mm, median": ("meant_mm", None),
    "within 20 mm %": ("meant_mm", lambda value: value < NEAR_MM),
    "rotation deg, median": ("meant_deg", None),
    "within 20 mm and 15 deg %": ("meant_near", bool),
    "from the recorded grasp mm, median": ("position_mm", None),
    "from it within 20 mm and 15 deg %": ("near", bool),
    "lifted %": ("lifted", bool),
}
"""Columns of the table: the column of results.csv, and the condition of a fraction; None: a median."""


class Miss(NamedTuple):
    """A predicted grasp against the operator's."""

    position: float  # distance [m]
    rotation: float  # angle between the orientations, half a turn about the approach being none [rad]

    @property
    def is_near(self) -> bool:
        """Whether both are within 20 mm and 15 degrees."""
        return self.position < NEAR_M and self.rotation < NEAR_RAD


def miss(T_wanted: np.ndarray, T_found: np.ndarray) -> Miss:
    """Returns how far a grasp, shape (4, 4) [m], is from the wanted one."""
    T = inverse(T_wanted) @ T_found
    R = T[:3, :3]
    rotation = min(rotation_angle(R), rotation_angle(R @ rotation_about(2, np.pi)))
    return Miss(float(np.linalg.norm(T[:3, 3])), float(rotation))


class Group(NamedTuple):
    """The episodes of one operator and one kind of object."""

    operator: str
    object: str
    few: list[Named]  # that teach
    test: list[Named]


def groups(named: Sequence[Named], few: int) -> list[Group]:
    """Returns the episodes by operator and object, split; groups without episodes to test on are left out."""
    found = defaultdict(list)
    for one in named:
        found[one.episode.metadata.operator, one.episode.metadata.object].append(one)
    split = [Group(*key, of[:few], of[few:]) for key, of in sorted(found.items())]
    return [group for group in split if group.test]


def grasps(frame: EpisodeFrame, of: Candidates, known: Preference) -> dict[str, np.ndarray]:
    """Returns the grasp of each method before the camera, shape (4, 4) [m]; nothing where GGCNN's has no reading."""
    alone = own_grasp(frame._replace(peak=of.peaks[0]))
    if alone is None:
        return {}
    shifted = alone.T_camera_grasp.copy()
    shifted[:3, 3] += of.frame.R @ known.taste.miss
    found = {ALONE: alone.T_camera_grasp, MISS: shifted}
    for name, one in ((REFINED, known), (FREE, known._replace(lifts=None))):
        favourite = preference.preferences(of, one)[0]
        where = own_grasp(frame._replace(peak=of.peaks[favourite.candidate]))
        if where is not None:
            found[name] = pose(preference.rotation(of, favourite), where.T_camera_grasp[:3, 3])
    return found


def rows(group: Group, lifts: LiftModel | None, lift: bool) -> Iterator[dict]:
    known = train_refinement.preference(train_refinement.lessons(group.few))._replace(lifts=lifts)
    for named in group.test:
        lesson = train_refinement.lesson(named.episode)
        if lesson is not None and lesson.choice.candidates.peaks:
            yield from _rows(group, named, lesson, known, lift)


def _rows(group: Group, named: Named, lesson: Lesson, known: Preference, lift: bool) -> Iterator[dict]:
    frame = named.episode.frame(len(named.episode) - 1)
    at = simulated_operator.scene_of(Path(named.name).name)
    scene = None if at is None else _situation(*at)
    meant = None
    if scene is not None:
        meant = inverse(frame.T_base_camera) @ simulated_operator.meant(scene, named.episode)
    for method, T in grasps(frame, lesson.choice.candidates, known).items():
        line: dict = dict.fromkeys(COLUMNS, "")
        of_scene = named.name if at is None else simulated_operator.file_name(*at)
        line.update(episode=named.name, scene=of_scene, operator=group.operator, object=group.object, method=method)
        recorded = miss(frame.T_camera_grasp, T)
        line.update(position_mm=1000.0 * recorded.position, rotation_deg=np.degrees(recorded.rotation))
        line["near"] = recorded.is_near
        if meant is not None:
            wanted = miss(meant, T)
            line.update(meant_mm=1000.0 * wanted.position, meant_deg=np.degrees(wanted.rotation))
            line["meant_near"] = wanted.is_near
        if lift and at is not None:
            line["lifted"] = _held(*at, (frame.T_base_camera @ T).tobytes())
        yield line


@functools.lru_cache(maxsize=512)
def _situation(split: str, number: int) -> simulated_operator.EpisodeScene:
    return simulated_operator.situation(split, number)


@functools.lru_cache(maxsize=None)
def _held(split: str, number: int, T_base_grasp: bytes) -> bool:
    return simulated_operator.held(_situation(split, number), np.frombuffer(T_base_grasp).reshape(4, 4))


def tables(lines: Sequence[dict]) -> str:
    """Returns the results as Markdown, and the differences to GG-CNN alone; in brackets 95 % intervals over scenes."""
    of = {name: {r["episode"]: r for r in lines if r["method"] == name} for name in METHODS}
    both = sorted(set.intersection(*(set(found) for found in of.values())))
    scenes = np.unique([of[ALONE][e]["scene"] for e in both], return_inverse=True)[1]
    measures = {name: m for name, m in MEASURES.items() if all(of[ALONE][e][m[0]] != "" for e in both)}
    values = {
        method: {
            name: np.array([found[e][key] if true is None else 100.0 * true(found[e][key]) for e in both])
            for name, (key, true) in measures.items()
        }
        for method, found in of.items()
    }
    draws = drawn(scenes)

    def statistic(name: str) -> Callable[..., Any]:
        return np.median if measures[name][1] is None else np.mean

    def cell(method: str, name: str) -> str:
        return interval(values[method][name], None, statistic(name), draws, "")

    def difference(method: str, name: str) -> str:
        return interval(values[method][name], values[ALONE][name], statistic(name), draws, "+")

    counted = f"n = {len(both)} episodes in {len(np.unique(scenes))} scenes"
    first = markdown_table((counted, *measures), [(m, *(cell(m, name) for name in measures)) for m in METHODS])
    others = [m for m in METHODS if m != ALONE]
    second = [(f"{m} - {ALONE}", *(difference(m, name) for name in measures)) for m in others]
    return first + "\n" + markdown_table(("difference", *measures), second)


def drawn(scenes: np.ndarray) -> list[np.ndarray]:
    """Returns the bootstrap's samples of cases, whole scenes each; `scenes`: number of each case's scene."""
    rng = np.random.default_rng(0)
    members = [np.flatnonzero(scenes == scene) for scene in range(scenes.max() + 1)]
    picks = rng.integers(0, len(members), (RESAMPLES, len(members)))
    return [np.concatenate([members[i] for i in pick]) for pick in picks]


def interval(
    one: np.ndarray, other: np.ndarray | None, statistic: Callable[..., Any], draws: list[np.ndarray], sign: str
) -> str:
    """Returns a statistic of `one`, less that of `other` if given, with its interval."""

    def of(part: np.ndarray | slice) -> float:
        return float(statistic(one[part]) - (0.0 if other is None else statistic(other[part])))

    low, high = np.percentile([of(draw) for draw in draws], (2.5, 97.5))
    return f"{of(slice(None)):{sign}.1f} ({low:{sign}.1f} to {high:{sign}.1f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the operators' episodes")
    parser.add_argument("folder", type=Path, help="where the results go")
    parser.add_argument("--few", type=int, default=20, help="episodes of an operator and a kind that teach")
    parser.add_argument("--outcomes", type=Path, help="folder of episodes by anybody, for what is lifted")
    parser.add_argument("--no-lifting", action="store_true", help="lift nothing")
    arguments = parser.parse_args()
    if arguments.few < 0:
        parser.error(f"--few is {arguments.few}, but must be at least 0.")
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    try:
        found = groups(train_refinement.read_episodes(arguments.data), arguments.few)
        if not found:
            raise RigError(
                f"No operator in {arguments.data} has more than {arguments.few} episodes of a kind to test on."
            )
        train_refinement.origin_of([n for group in found for n in group.test])
        others = [] if arguments.outcomes is None else train_refinement.read_episodes(arguments.outcomes)
    except (RigError, OSError) as error:
        parser.error(str(error))
    lifts = train_refinement.preference((), train_refinement.lessons(others)).lifts
    lines: list[dict] = []
    try:
        with open_results(arguments.folder, COLUMNS) as writer:
            for group in tqdm(found, unit="group"):
                for line in rows(group, lifts, not arguments.no_lifting):
                    writer.writerow(line)
                    lines.append(line)
    except RigError as error:
        parser.error(str(error))
    text = tables(lines)
    (arguments.folder / "table.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text + "\n")
