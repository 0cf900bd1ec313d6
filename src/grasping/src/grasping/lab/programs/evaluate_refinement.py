"""Compares predictors of an operator's grasps on episodes that no training saw; resumable.

GGCNN alone, with the operator's constant offset, the nearest neighbour among the training episodes, and GGCNN with the
refinement network: how far from the operator's grasp, in the last frame of each episode whose grasp held. GGCNN's maps
are those that the episodes recorded, and all are smoothed alike. Where the episodes are simulated, each grasp is tried
by lifting in MuJoCo too, hand wide open, and the bound is what the simulated operator intended: the grasp without the
tremor, which nobody can foresee. Results go to results.csv, one line a grasp, and table.md, with the differences over
the same episodes, and with the likelihood of the operator's places: which of several equal grasps it is to be, nobody
can foresee either; and, taking the place as known, how far orientation and opening of the hand are from the operator's,
and how likely the orientation was. Where refinement networks learned from different numbers of episodes (settings.json
beside their files), curve.png shows what more of them bring.
"""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Callable, Dict, List, NamedTuple, Union

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.errors import RigError
from common.poses import inverse
from common.statistics import median, paired_difference, proportion
from grasping.lab.dataset.episode import EpisodeFrame
from grasping.lab.dataset.labels import own_grasp, pose_from_label
from grasping.lab.evaluation import operator_errors
from grasping.lab.evaluation.operator_errors import NEAR_M, Neighbours, calibrated, miss, place_log_likelihoods
from grasping.lab.evaluation.tables import markdown_table
from grasping.lab.programs import train_refinement
from grasping.lab.programs.evaluate import NETWORK_SMOOTHING, ResultsFile
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.synthetic import simulated_operator
from grasping.lab.training import refinement_examples
from grasping.lab.training.refinement_examples import OperatorOffset
from grasping.network import refinement_file
from grasping.network.depth_image import NETWORK_SIDE, Crop, NetworkImage, prepare
from grasping.network.maps import WIDTH_SCALE_PX, Peak, peaks, smoothed
from grasping.network.refinement import MapRefiner, RefinementNetwork
from grasping.pipeline.projection import CameraGrasp
from grasping.pipeline.refined_grasp import refined_grasp

FIRST = 3  # so many of a method's grasps are what an operator is offered
COLUMNS = ("episode", "object", "method", "position_mm", "rotation_deg", "near", "nearest_of_3_mm", "lifted")
Row = Dict[str, Union[str, float]]  # a line of results.csv, as it was made or as it was read
Method = Callable[[EpisodeFrame], List[np.ndarray]]
ALONE, OFFSET, NEIGHBOUR, BOUND = "GGCNN alone", "GGCNN + constant offset", "nearest neighbour", "bound: without tremor"
MEASURES: dict[str, tuple[Callable[..., np.ndarray], Callable[[Row], float]]] = {
    "position error mm, median": (np.median, lambda r: float(r["position_mm"] or "inf")),
    "within 20 mm %": (np.mean, lambda r: 100.0 * _within(r["position_mm"])),
    "rotation error deg, median": (np.median, lambda r: float(r["rotation_deg"] or "inf")),
    "within 20 mm and 15 deg %": (np.mean, lambda r: 100.0 * (r["near"] == "True")),
    "one of three within 20 mm %": (np.mean, lambda r: 100.0 * _within(r["nearest_of_3_mm"])),
    "lifted %": (np.mean, lambda r: 100.0 * (r["lifted"] == "True")),
}
"""Columns of the tables: what is made of the episodes' values, and the value of a line of results.csv."""


def second_networks(files: list[tuple[str, str]], test: list[train_refinement.Named]) -> dict[str, MapRefiner]:
    """Returns the refinement networks of weight files by name; raises RigError or OSError if one is unusable here."""
    found, rig = {}, train_refinement.origin_of(test, mixed=True)
    for name, file in files:
        found[name], origin = refinement_file.load(Path(file).read_bytes())
        if mismatch := origin.mismatch(rig):
            raise RigError(f"The refinement network in {file} {mismatch} in the episodes.")
    return found


def methods(
    training: list[train_refinement.Named], offset: OperatorOffset, second: dict[str, MapRefiner]
) -> dict[str, Method]:
    """Returns for each name what makes poses before the camera of a frame, each of shape (4, 4) [m], best first."""
    neighbours = Neighbours([f for named in training if named.episode.held for f in named.episode.frames()])

    def own(frame: EpisodeFrame) -> list[tuple[EpisodeFrame, CameraGrasp]]:
        frames = (frame._replace(peak=peak) for peak in _best(*_seen(frame)))
        return [(f, grasp) for f in frames if (grasp := own_grasp(f)) is not None]

    return {
        ALONE: lambda frame: [grasp.T_camera_grasp for _, grasp in own(frame)],
        OFFSET: lambda frame: [pose_from_label(f, refinement_examples.offset_label(f, offset)) for f, _ in own(frame)],
        NEIGHBOUR: lambda frame: [neighbours.grasp(f) for f, _ in own(frame)[:1]],
        **{name: _refined(network) for name, network in second.items()},
    }


def _seen(frame: EpisodeFrame) -> tuple[np.ndarray, NetworkImage]:
    """Returns GGCNN's maps as they were recorded, at their full size, shape (4, 300, 300), and what it saw."""
    output = [cv2.resize(m.astype(np.float32), (NETWORK_SIDE, NETWORK_SIDE)) for m in frame.maps]
    return np.stack(output), prepare(frame.depth_m, Crop(0, 0, frame.crop.side))


def _best(output: np.ndarray, image: NetworkImage) -> list[Peak]:
    return peaks(smoothed(output, image.valid, NETWORK_SMOOTHING), FIRST, threshold=-np.inf)


def _refined(second: MapRefiner) -> Method:
    def grasps(frame: EpisodeFrame) -> list[np.ndarray]:
        output, image = _seen(frame)
        refined = second.apply(output, image)
        found = [(peak, own_grasp(frame._replace(peak=peak))) for peak in _best(refined.output, image)]
        return [refined_grasp(grasp, refined, peak).T_camera_grasp for peak, grasp in found if grasp is not None]

    return grasps


def row(
    named: train_refinement.Named,
    scene: simulated_operator.EpisodeScene | None,
    name: str,
    method: Method | None,
    lift: bool,
) -> dict[str, str | float]:
    """Returns the line of one method's grasp; None is the bound. Only simulated scenes have a bound and are lifted."""
    frame = named.episode.frame(len(named.episode) - 1)
    line: dict[str, str | float] = dict.fromkeys(COLUMNS, "")
    line.update(episode=named.name, object=named.episode.metadata.object, method=name, near="False")
    if method is None:
        assert scene is not None, "the bound is known of simulated scenes alone"
        found = [inverse(frame.T_base_camera) @ simulated_operator.intended(scene, named.episode)]
    else:
        found = method(frame)
    if not found:
        return {**line, "lifted": "False" if lift and scene is not None else ""}
    misses = [miss(frame.T_camera_grasp, T) for T in found]
    line["position_mm"] = 1000.0 * misses[0].position
    line["rotation_deg"] = float(np.degrees(misses[0].rotation))
    line["near"] = str(misses[0].is_near)
    line["nearest_of_3_mm"] = 1000.0 * min(m.position for m in misses)
    if lift and scene is not None:
        line["lifted"] = str(simulated_operator.held(scene, frame.T_base_camera @ found[0]))
    return line


class EvaluationData(NamedTuple):
    """Images as refinement networks see them."""

    seen: torch.Tensor  # input of a refinement network
    target: refinement_examples.RefinementTargets  # what the operator did
    pixel_size: np.ndarray  # of a pixel of the network's image, by the distance, shape (n,)


def _within(millimetres: str | float) -> bool:
    return millimetres != "" and float(millimetres) < 1000.0 * NEAR_M


def _compared(
    measures: Iterable[str], lines: list, second: Iterable[str], difference: Callable[[str, str], Iterator[str]]
) -> str:
    """Returns the tables of the methods, and of the differences of the refinement networks to GGCNN's two."""
    pairs = [(name, other) for name in second for other in (ALONE, OFFSET)]
    differences = [(f"{name} less {other}", *difference(name, other)) for name, other in pairs]
    return f"{markdown_table(('method', *measures), lines)}\n{markdown_table(('difference', *measures), differences)}"


def tables(rows: list[dict], names: list[str], second: list[str]) -> str:
    """Returns the results as Markdown, and the differences of the refinement networks to GGCNN alone and with the
    offset; in brackets the 95 % intervals.
    """
    of = {name: {r["episode"]: r for r in rows if r["method"] == name} for name in (*names, *second)}
    measures = {k: v for k, v in MEASURES.items() if k != "lifted %" or any(r["lifted"] != "" for r in rows)}

    def cells(name: str) -> Iterator[str]:
        for statistic, value in measures.values():
            values = [value(r) for r in of[name].values()]
            yield str(median(values) if statistic is np.median else proportion(np.array(values) > 0.0))

    def difference(name: str, other: str) -> Iterator[str]:
        both = sorted(of[name].keys() & of[other].keys())
        for statistic, value in measures.values():
            one, less = ([value(of[method][e]) for e in both] for method in (name, other))
            yield f"{paired_difference(one, less, statistic):+.1f}"

    return _compared(measures, [(name, *cells(name)) for name in names], second, difference)


def likelihoods(known: EvaluationData, test: EvaluationData, second: dict[str, MapRefiner]) -> str:
    """Returns, as Markdown, how probable the maps make the operator's places, all with the same constant offset."""
    places = [of.target.place.numpy() for of in (known, test)]

    def found(network: RefinementNetwork) -> np.ndarray:
        with torch.no_grad():
            before, now = ((of.seen[:, 0] + network(of.seen)[:, 0]).numpy() for of in (known, test))
        return place_log_likelihoods(now, places[1], calibrated(before, places[0]))

    plain = found(RefinementNetwork())
    lines = [(OFFSET, f"{plain.mean():.2f}", "")]
    for name, one in second.items():
        values = found(one.network)
        lines.append((name, f"{values.mean():.2f}", f"{paired_difference(values, plain):+.2f}"))
    return markdown_table(("map", "log-likelihood of the operator's place [nats], mean", "more than GGCNN's"), lines)


def orientations(
    known: EvaluationData,
    test: EvaluationData,
    offset: OperatorOffset,
    second: dict[str, MapRefiner],
) -> str:
    """Returns, as Markdown, how well orientation and opening of the hand are predicted at the operator's pixels; the
    known images give the standard deviation of the orientation where a method has none.
    """
    untrained = RefinementNetwork()
    did = operator_errors.operators(test.target, offset)
    metres = WIDTH_SCALE_PX * test.pixel_size

    def measured(network: RefinementNetwork, added: OperatorOffset, own_spread: bool) -> list[np.ndarray]:
        found = operator_errors.expected(test.seen, test.target, network, added)
        if not own_spread:
            before = operator_errors.expected(known.seen, known.target, network, added)
            found = operator_errors.with_constant_scale(found, before, operator_errors.operators(known.target, offset))
        turned = np.degrees(operator_errors.errors(found, did))
        return [
            turned,
            operator_errors.log_likelihoods(found, did),
            1000.0 * metres * np.abs(found.opening - did.opening),
        ]

    of = {
        ALONE: measured(untrained, OperatorOffset(), False),
        OFFSET: measured(untrained, offset, False),
    }
    of.update({name: measured(one.network, offset, True) for name, one in second.items()})
    opens = np.isfinite(did.opening)
    names = ["rotation error at the operator's place deg, median", "log-likelihood of the rotation [nats], mean"]
    names += ["opening error mm, median"] * bool(opens.any())
    lines = []
    for name, (turned, likely, opened) in of.items():
        lines.append([name, str(median(turned)), f"{likely.mean():.2f}"])
        lines[-1] += [str(median(opened[opens]))] if opens.any() else []

    def difference(name: str, other: str) -> Iterator[str]:
        one, less = of[name], of[other]
        yield f"{paired_difference(one[0], less[0], np.median):+.1f}"
        yield f"{paired_difference(one[1], less[1]):+.2f}"
        if opens.any():
            yield f"{paired_difference(one[2][opens], less[2][opens], np.median):+.1f}"

    return _compared(names, lines, second, difference)


def seen_of(part: list[train_refinement.Named], offset: OperatorOffset) -> EvaluationData:
    """Returns the last images of episodes whose grasps held, and what the operator did, without the constant offset."""
    frames = [n.episode.frame(len(n.episode) - 1) for n in part if n.episode.held]
    pairs = [(f, one) for f in frames if (one := refinement_examples.example(f, held=True)) is not None]
    sizes = [f.crop.side / NETWORK_SIDE / f.camera.K[0, 0] for f, _ in pairs]
    return EvaluationData(*refinement_examples.batch([one for _, one in pairs], offset), np.array(sizes))


def curve(rows: list[dict], second: list[tuple[str, str]], path: Path) -> None:
    """Draws the learning curve if there is one."""
    counts = {}
    for name, file in second:
        about = Path(file).with_name("settings.json")
        if about.exists():
            counts[json.loads(about.read_text())["episodes"]] = name
    if len(counts) < 2:
        return
    _, error = next(iter(MEASURES.values()))
    of = {name: [error(r) for r in rows if r["method"] == name] for name in (*counts.values(), ALONE, OFFSET, BOUND)}
    others = {name: of[name] for name in (ALONE, OFFSET, BOUND) if of[name]}
    operator_errors.draw_learning_curve(path, {n: of[name] for n, name in counts.items()}, others, 1000.0 * NEAR_M)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("training", type=Path, help="folder of the episodes that training saw")
    parser.add_argument("test", type=Path, help="folder of episodes that it did not see")
    parser.add_argument("folder", type=Path, help="where the results go")
    parser.add_argument(
        "--refinement", nargs=2, action="append", default=[], metavar=("NAME", "FILE"), help="a refinement network"
    )
    parser.add_argument("--held-out", action="store_true", help="test on the episodes that training holds out alone")
    parser.add_argument("--no-lifting", action="store_true", help="lift nothing")
    parser.add_argument("--only", action="append", default=[], metavar="OBJECT", help="test on these things alone")
    parser.add_argument("--without", action="append", default=[], metavar="OBJECT", help="as training had it")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    try:
        every = train_refinement.read_episodes(arguments.training, without=arguments.without)
        training = [named for named in every if not train_refinement.is_held_out(named.name)]
        known = [named for named in every if train_refinement.is_held_out(named.name) and named.episode.held]
        test = [
            named for named in train_refinement.read_episodes(arguments.test, only=arguments.only) if named.episode.held
        ]
        if arguments.held_out:
            test = [named for named in test if train_refinement.is_held_out(named.name)]
        if not test or not any(named.episode.held for named in training):
            raise RigError(f"Of {len(test)} episodes to test on and {len(training)} to learn from, too few held.")
        offset = refinement_examples.constant_offset(
            [f for named in training if named.episode.held for f in named.episode.frames()]
        )
        second = second_networks(arguments.refinement, test)
        found: dict[str, Method | None] = {**methods(training, offset, second)}
    except (RigError, OSError) as error:
        parser.error(str(error))
    if all(simulated_operator.scene_of(named.name) for named in test):
        found[BOUND] = None
    results = ResultsFile(arguments.folder / "results.csv", COLUMNS)
    rows = results.rows
    done = {(r["episode"], r["method"]) for r in rows}
    with contextlib.closing(results):
        for named in tqdm(test, unit="episode"):
            missing = [name for name in found if (named.name, name) not in done]
            at = simulated_operator.scene_of(named.name)
            scene = simulated_operator.situation(*at) if at and missing else None
            for name in missing:
                results.add([row(named, scene, name, found[name], not arguments.no_lifting)])
    text = tables(rows, list(found), [name for name, _ in arguments.refinement])
    if known:
        shown = seen_of(known, offset), seen_of(test, offset)
        text += "\n" + likelihoods(*shown, second) + "\n" + orientations(*shown, offset, second)
    (arguments.folder / "table.md").write_text(text)
    curve(rows, arguments.refinement, arguments.folder / "curve.png")
