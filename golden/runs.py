"""The recordings that the gate plays, each with the parameters that make the chain work on it."""

from __future__ import annotations

import gzip
import json
import lzma
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from golden.chain import SWITCHED_ON, Run
from leap_motion.service import wire

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data" / "leap"
TAKEN = Path(__file__).parent / "runs"
"""Parts of recorded runs of the simulated rig, JSON: `frames` [time of receipt [s], the tracker's text] with the first
one at FIRST_S, `switched` and `settings` as of a Run. The recordings' reader is leap_rig.recording."""
FIRST_S = 0.4  # the first frame comes so long after the begin, when the arm is at home
ASIDE_MM = (400.0, 0.0, 0.0)  # from where the hands come in before, which the recordings do not show

# Offset of the palms [mm], which are lower than the interaction box; parameters that differ from the shipped ones: the
# hand may start where it is, and every filter and servo law is used.
HANDS: dict[str, tuple[tuple[float, float, float], dict[str, dict[str, Any]]]] = {
    "HandSplay-110fps": ((0.0, 190.0, 0.0), {"leap": {"start_tol_pitch": 60.0, "filter": "one_euro"}}),
    "confidence-74fps": ((0.0, 190.0, 0.0), {}),
    "grab": ((-50.0, 165.0, 0.0), {"leap": {"filter": "mean"}}),
    "rollAndPitchWithEntry": ((-50.0, 190.0, 0.0), {"kuka": {"servo_law": "lts"}}),
    "three-claps": ((0.0, 190.0, 0.0), {"leap": {"start_tol_roll": 89.0}, "kuka": {"collision_guard": False}}),
}


SCALE = {"rollAndPitchWithEntry": 0.7}


class Missing(Exception):
    """A recording is not on this machine; the text is a sentence."""


def hand(name: str) -> Run:
    """Returns a recorded hand of the folder beside the project. Missing: it is not there."""
    path = SHARED / f"{name}.jsonl.gz"
    if not path.is_file():
        raise Missing(f"The recorded hand {name} is not on this machine: {path} is missing.")
    offset, settings = HANDS[name]
    with gzip.open(path, "rt", encoding="utf-8") as file:
        frames = [json.loads(line) for line in file]
    begin = frames[0]["timestamp"]
    times = [FIRST_S + 1e-6 * (frame["timestamp"] - begin) for frame in frames]
    texts = tuple((t, json.dumps(wire.shifted(frame, offset))) for t, frame in zip(times, frames))
    return Run(name, coming_in(texts), ((0.0, "scale", SCALE.get(name, 1.0)), *SWITCHED_ON), settings)


def coming_in(frames: tuple[tuple[float, str], ...]) -> tuple[tuple[float, str], ...]:
    """Returns frames before which the hands of the first one come in: beside the box, then hidden for a moment."""
    begin, text = frames[0]
    first = json.loads(text)
    beside = wire.shifted(first, ASIDE_MM)
    shown = (beside, beside, beside, {**first, "hands": [], "pointables": []})
    return (
        tuple(
            (
                begin + 0.01 * i,
                json.dumps({**frame, "id": first["id"] + i, "timestamp": first["timestamp"] + 10000 * i}),
            )
            for i, frame in zip(range(-len(shown), 0), shown)
        )
        + frames
    )


def taken(path: Path) -> Run:
    content = json.loads(lzma.decompress(path.read_bytes()))
    switched = sorted((*SWITCHED_ON, *map(tuple, content["switched"])), key=lambda switch: switch[0])
    return Run(name_of(path), coming_in(tuple(map(tuple, content["frames"]))), tuple(switched), content["settings"])


def name_of(path: Path) -> str:
    """Returns the name of a file without its endings."""
    return path.name.partition(".")[0]


RUNS: dict[str, Callable[[], Run]] = {name: partial(hand, name) for name in HANDS}
RUNS.update({name_of(path): partial(taken, path) for path in sorted(TAKEN.glob("*.json.xz"))})
