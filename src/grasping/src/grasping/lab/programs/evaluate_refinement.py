"""Compares predictors of operators' grasps after a few shown grasps of a kind of object.

Of each operator and object in the folder the first episodes teach, as many as each number of `--few` says, by the
files' names; those behind the greatest number test: GG-CNN alone, the network of lifts alone, it with the operator's
taste, and the operator's own grasp. How far each grasp is from the operator's, in the last frame: as recorded; and as
it was meant, without the constant miss and the tremor, which is known of simulated operators alone. Of these also what
they would take another time: they have whims, which nobody can know. Where the episodes are simulated, each grasp is
lifted in MuJoCo with the arm's error and shaken. Results go to results.csv, one line a grasp, and table.md, with the
differences over the same episodes. Intervals are over scenes: several operators in one scene are one case.
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

from common.command_line import whole
from common.errors import RigError
from common.poses import inverse
from common.statistics import RESAMPLES
from grasping.lab.dataset.labels import own_grasp
from grasping.lab.evaluation.grasp_distance import NEAR_M, miss
from grasping.lab.evaluation.person_study import BOTH, NETWORK, PERSON
from grasping.lab.evaluation.tables import markdown_table
from grasping.lab.programs import train_refinement
from grasping.lab.programs.evaluate import open_results
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.programs.train_refinement import Named
from grasping.lab.synthetic import simulated_operator
from grasping.lab.training import lift_examples
from grasping.poses import taste
from grasping.poses.chooser import ImageMaps
from grasping.poses.lift_network import LiftNetwork, loaded
from grasping.poses.preferred import Offer, offer, preferred
from grasping.poses.taste import PoseTaste

LIFTS, AGAIN = "network of lifts", "operator another time"
COLUMNS = (
    *("episode", "scene", "operator", "object", "method", "shown", "meant_mm", "meant_deg", "meant_near"),
    *("position_mm", "rotation_deg", "near", "lifted"),
)
NEAR_MM = 1000.0 * NEAR_M
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


class Group(NamedTuple):
    """The episodes of one operator and one kind of object."""

    operator: str
    object: str
    few: list[Named]  # that teach
    test: list[Named]


class Predicted(NamedTuple):
    """A method's grasp."""

    method: str
    shown: int  # grasps that taught it
    T_camera_grasp: np.ndarray  # shape (4, 4) [m]
    opening: float  # [m]


def groups(named: Sequence[Named], few: int) -> list[Group]:
    """Returns the episodes by operator and object, split; groups without episodes to test on are left out."""
    found = defaultdict(list)
    for one in named:
        found[one.episode.metadata.object, one.episode.metadata.operator].append(one)
    split = [Group(who, what, of[:few], of[few:]) for (what, who), of in sorted(found.items())]
    return [group for group in split if group.test]


class Offers:
    """What images offer; operators of a simulated scene have one image."""

    def __init__(self, network: LiftNetwork) -> None:
        self.network = network
        self._kept: dict[bytes, tuple[ImageMaps, Offer]] = {}

    def of(self, named: Named) -> tuple[ImageMaps, Offer] | None:
        """Returns what the last frame of an episode offers, None if it shows nothing."""
        most = 64  # that are kept
        frame = named.episode.frame(len(named.episode) - 1)
        key = frame.depth.tobytes()
        if key not in self._kept:
            of = lift_examples.image_maps(frame)
            if of is None:
                return None
            if len(self._kept) == most:
                self._kept.clear()
            self._kept[key] = of, offer(self.network, of, self.network.gripper.opening)
        return self._kept[key]


def predictions(
    named: Named, of: ImageMaps, offered: Offer, network: LiftNetwork, tastes: dict[int, PoseTaste]
) -> Iterator[Predicted]:
    """Yields the grasp of each method where it has one; `tastes`: by how many grasps taught them."""
    frame = named.episode.frame(len(named.episode) - 1)
    alone = own_grasp(frame)
    if alone is not None:
        yield Predicted(NETWORK, 0, alone.T_camera_grasp, alone.width)
    yield Predicted(PERSON, 0, frame.T_camera_grasp, frame.opening)
    safest = offered.safest
    if not len(safest.probability):
        return
    yield Predicted(LIFTS, 0, safest.of.T[0], float(safest.of.opening[0]))
    for shown, known in tastes.items():
        best = preferred(network, of, offered, known, network.gripper.opening)
        yield Predicted(BOTH, shown, best.of.T[0], float(best.of.opening[0]))


def rows(group: Group, offers: Offers, counts: Sequence[int], lift: bool) -> Iterator[dict]:
    lessons = []
    for named in group.few:
        found = offers.of(named)
        lessons.append(None if found is None else lift_examples.shown(named.episode, found[1].options))
    tastes = {n: taste.learned([one for one in lessons[:n] if one is not None]) for n in counts}
    for named in group.test:
        yield from _rows(group, named, offers, tastes, lift)


def _rows(group: Group, named: Named, offers: Offers, tastes: dict[int, PoseTaste], lift: bool) -> Iterator[dict]:
    frame = named.episode.frame(len(named.episode) - 1)
    found = offers.of(named)
    if found is None:
        return
    at = simulated_operator.scene_of(Path(named.name).name)
    meant, others = None, []
    if at is not None:
        meant, again = (
            inverse(frame.T_base_camera) @ simulated_operator.meant(_situation(*at), named.episode, time)
            for time in (0, 1)
        )
        others.append(Predicted(AGAIN, 0, again, frame.opening))
    for method, shown, T, opening in (*predictions(named, *found, offers.network, tastes), *others):
        line: dict = dict.fromkeys(COLUMNS, "")
        of_scene = named.name if at is None else simulated_operator.file_name(*at)
        line.update(episode=named.name, scene=of_scene, operator=group.operator, object=group.object)
        recorded = miss(frame.T_camera_grasp, T)
        line.update(method=method, shown=shown, near=recorded.is_near)
        line.update(position_mm=1000.0 * recorded.position, rotation_deg=np.degrees(recorded.rotation))
        if meant is not None:
            wanted = miss(meant, T)
            line.update(meant_mm=1000.0 * wanted.position, meant_deg=np.degrees(wanted.rotation))
            line["meant_near"] = wanted.is_near
        if lift and at is not None:
            line["lifted"] = _held(*at, (frame.T_base_camera @ T).tobytes(), opening)
        yield line


@functools.lru_cache(maxsize=512)
def _situation(split: str, number: int) -> simulated_operator.EpisodeScene:
    return simulated_operator.situation(split, number)


@functools.lru_cache(maxsize=None)
def _held(split: str, number: int, T_base_grasp: bytes, opening: float) -> bool:
    T = np.frombuffer(T_base_grasp).reshape(4, 4)
    return simulated_operator.held(_situation(split, number), T, opening, hard=True)


def tables(lines: Sequence[dict]) -> str:
    """Returns the results as Markdown, and the differences to GG-CNN alone; in brackets 95 % intervals over scenes."""
    of: dict[str, dict[str, dict]] = defaultdict(dict)
    for line in lines:
        shown = f", {line['shown']} shown" if line["method"] == BOTH else ""
        of[line["method"] + shown][line["episode"]] = line
    both = sorted(set.intersection(*(set(found) for found in of.values())))
    scenes = np.unique([of[NETWORK][e]["scene"] for e in both], return_inverse=True)[1]
    measures = {name: m for name, m in MEASURES.items() if all(of[NETWORK][e][m[0]] != "" for e in both)}
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
        return interval(values[method][name], values[NETWORK][name], statistic(name), draws, "+")

    counted = f"n = {len(both)} episodes in {len(np.unique(scenes))} scenes"
    first = markdown_table((counted, *measures), [(m, *(cell(m, name) for name in measures)) for m in of])
    others = [m for m in of if m != NETWORK]
    second = [(f"{m} - {NETWORK}", *(difference(m, name) for name in measures)) for m in others]
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
    parser.add_argument("lifts", type=Path, help="weights of the network of lifts")
    few_help = "episodes of an operator and a kind that teach, default 20"
    parser.add_argument("--few", type=whole(0, 1000), nargs="+", default=[20], help=few_help)
    parser.add_argument("--no-lifting", action="store_true", help="lift nothing")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    most = max(arguments.few)
    lines: list[dict] = []
    try:
        network = loaded(arguments.lifts.read_bytes())
        found = groups(train_refinement.read_episodes(arguments.data), most)
        if not found:
            raise RigError(f"No operator in {arguments.data} has more than {most} episodes of a kind to test on.")
        train_refinement.origin_of([n for group in found for n in group.test])
        with open_results(arguments.folder, COLUMNS) as writer:
            offers = Offers(network)
            for group in tqdm(found, unit="group"):
                for line in rows(group, offers, sorted(set(arguments.few)), not arguments.no_lifting):
                    writer.writerow(line)
                    lines.append(line)
    except (RigError, OSError) as error:
        parser.error(str(error))
    text = tables(lines)
    (arguments.folder / "table.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text + "\n")
