"""Leads through the study of people who grasp with the network, and says what came of it.

`plan` draws all trials. `run` leads one participant through them beside the rig and writes results.csv; it continues
where it stopped. `analyse` tests what was fixed before (docs/handbook/refinement-study.md) and draws curve.png; it
reads the results of evaluate_refinement.py as well, whose simulated operators say nothing about people.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from common.command_line import whole
from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.dataset.episode import SHOWN, Episode
from grasping.lab.evaluation import person_study
from grasping.lab.evaluation.grasp_distance import miss
from grasping.lab.evaluation.person_study import BOTH, COLUMNS, NETWORK, PERSON, StudyTrial

HOW = {
    NETWORK: "Start the rig with refine: false and lifts: never, call grasping/execute, and let the person close the "
    "hand unmoved.",
    PERSON: "Let the person grasp without a proposal.",
    BOTH: "Start the rig with refine: true, call grasping/execute, and let the person close the hand unmoved.",
}
PLAN, RESULTS = "plan.csv", "results.csv"


def write_plan(folder: Path, trials: Sequence[StudyTrial]) -> None:
    """Writes the plan; raises OSError, also if there is one: a plan is drawn once."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / PLAN).open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(StudyTrial._fields)
        writer.writerows(trials)


def read_plan(folder: Path) -> list[StudyTrial]:
    try:
        with (folder / PLAN).open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        types = int, str, int, str, float, float, float
        return [StudyTrial(*(of(row[name]) for of, name in zip(types, StudyTrial._fields))) for row in rows]
    except OSError as error:
        raise RigError(f"{folder / PLAN} cannot be read: {error.strerror}. Draw it first, with plan.") from None
    except (KeyError, TypeError, ValueError) as error:
        raise RigError(f"{folder / PLAN} is no plan of the study: {error}.") from None


class Session:
    """One participant's trials; `ask` shows a text and returns what was typed."""

    def __init__(self, results: Path, episodes: Path, shown: int, ask: Callable[[str], str]) -> None:
        self._results, self._episodes, self._shown, self._ask = results, episodes, shown, ask
        self._used = set(self._files())

    def run(self, participant: int, trials: Sequence[StudyTrial]) -> None:
        """Leads through the trials that have no result yet. Raises OSError or RigError; what is written stays."""
        name = str(participant)
        done = {(r["object"], r["scene"], r["method"]) for r in self._written() if r["operator"] == name}
        taught: set[str] = {kind for kind, _, _ in done}
        for trial in trials:
            if trial.participant != participant or (trial.kind, str(trial.scene), trial.condition) in done:
                continue
            if trial.kind not in taught:
                taught.add(trial.kind)
                self._ask(f"Let the person show {self._shown} grasps of {trial.kind}, and train. Enter: done. ")
            self._write(trial, self._tried(trial))

    def _tried(self, trial: StudyTrial) -> dict[str, Any]:
        self._used = set(self._files())
        at = f"{trial.x_mm:+.0f}, {trial.y_mm:+.0f} mm, turned by {trial.turn_deg:.0f} deg"
        self._ask(f"Put {trial.kind} at {at}. The person shows the grasp that is meant. Enter: done. ")
        reference = self._newest(lambda of: of.metadata.source == SHOWN)
        if self._ask(f"{HOW[trial.condition]} Enter: done; a: aborted, whatever came of it. ").strip() == "a":
            return {}
        made = self._newest(lambda of: of.metadata.source != SHOWN)
        if made is None:
            return {"lifted": False, "meant_near": False}
        if reference is None:
            sys.stdout.write("No grasp was shown: this trial does not count.\n")
            return {}
        off = miss(reference.T_base_grasp, made.T_base_grasp)
        distance = {"meant_mm": 1000.0 * off.position, "meant_deg": float(np.degrees(off.rotation))}
        return {**distance, "meant_near": off.is_near, "lifted": made.held}

    def _newest(self, wanted: Callable[[Episode], bool]) -> Episode | None:
        for file in reversed(self._files()):
            if file not in self._used:
                episode = store.decode(file.read_bytes())
                if wanted(episode):
                    return episode
        return None

    def _files(self) -> list[Path]:
        return sorted(self._episodes.rglob("*" + store.SUFFIX), key=lambda file: file.stat().st_mtime_ns)

    def _written(self) -> list[dict[str, str]]:
        if not self._results.exists():
            return []
        with self._results.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def _write(self, trial: StudyTrial, outcome: dict[str, Any]) -> None:
        row = {"operator": trial.participant, "object": trial.kind, "scene": trial.scene, "method": trial.condition}
        row["shown"] = self._shown if trial.condition == BOTH else 0
        with self._results.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
            if not file.tell():
                writer.writeheader()
            writer.writerow({**row, **outcome})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parts = parser.add_subparsers(dest="part", required=True)
    part = parts.add_parser("plan")
    part.add_argument("folder", type=Path, help="of the study")
    part.add_argument("kinds", nargs="+", help="kinds of object")
    part.add_argument("--participants", type=whole(2, 1000), default=12, help="a multiple of 6 is balanced; default 12")
    part.add_argument("--scenes", type=whole(1, 100), default=6, help="placements of each kind, default 6")
    part.add_argument("--seed", type=whole(0, 2**32 - 1), default=1, help="of the draw, default 1")
    part = parts.add_parser("run")
    part.add_argument("folder", type=Path, help="of the study")
    part.add_argument("participant", type=whole(0, 999), help="number, from 0")
    part.add_argument("episodes", type=Path, help="folder into which collect.launch writes")
    part.add_argument("--shown", type=whole(1, 1000), default=20, help="grasps that teach, default 20")
    part = parts.add_parser("analyse")
    part.add_argument("results", type=Path, help="results.csv")
    part.add_argument("folder", type=Path, help="where the result goes")
    part.add_argument("--shown", type=whole(0, 1000), default=20, help="grasps that taught in the test, default 20")
    given = parser.parse_args()
    try:
        if given.part == "plan":
            write_plan(given.folder, person_study.plan(given.participants, given.kinds, given.scenes, given.seed))
        elif given.part == "run":
            session = Session(given.folder / RESULTS, given.episodes, given.shown, input)
            session.run(given.participant, read_plan(given.folder))
        else:
            outcomes = person_study.read(given.results)
            text = person_study.report(outcomes, given.shown)
            given.folder.mkdir(parents=True, exist_ok=True)
            (given.folder / "result.md").write_text(text, encoding="utf-8")
            person_study.draw(given.folder / "curve.png", outcomes)
            sys.stdout.write(text)
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename} cannot be used: {error.strerror}.")
