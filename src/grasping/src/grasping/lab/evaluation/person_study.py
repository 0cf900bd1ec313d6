"""The study of people who grasp with and without the network: whose turn is what, and the test that was fixed before.

Each participant shows grasps of each kind of object. Then each placement of it is grasped three times: by the network
alone, by the person alone, and by the network with what the person showed. The orders are those of a Williams design:
each condition stands as often at each place, and as often behind each other one.
"""

from __future__ import annotations

import csv
import itertools
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from common.errors import RigError
from common.statistics import Estimate, paired_difference

NETWORK, PERSON, BOTH = CONDITIONS = "GG-CNN alone", "operator alone", "taste"
ALPHA = 0.05
LEAST_FINISHED = 0.8  # of the placements begun: what a participant must have finished with all three conditions
PLACE_M = 0.08  # placements lie up to so far from the middle of the table
COLUMNS = ("operator", "object", "scene", "method", "shown", "meant_mm", "meant_deg", "meant_near", "lifted")


class StudyTrial(NamedTuple):
    """One grasp of a participant."""

    participant: int
    kind: str
    scene: int  # number of the placement among those of a participant and a kind
    condition: str
    x_mm: float  # of the placement, from the middle of the table
    y_mm: float
    turn_deg: float


def williams(n: int) -> list[list[int]]:
    """Returns orders of n conditions, 2 n of them where n is odd, else n: each condition is equally often at each place
    and equally often behind each other one (Williams, Australian Journal of Scientific Research, 1949)."""
    first = [0]
    for step in range(1, n):
        first.append((first[-1] + (step if step % 2 else -step)) % n)
    square = [[(one + shift) % n for one in first] for shift in range(n)]
    return square if n % 2 == 0 else square + [row[::-1] for row in square]


def plan(participants: int, kinds: Sequence[str], scenes: int, seed: int) -> list[StudyTrial]:
    """Returns all trials, in their order; `scenes`: placements of each kind."""
    rng = np.random.default_rng(seed)
    orders, turns = williams(len(CONDITIONS)), williams(len(kinds))
    found = []
    start = [row for _ in range(-(-participants // len(orders))) for row in rng.permutation(len(orders))]
    for participant in range(participants):
        for block, kind in enumerate(turns[participant % len(turns)]):
            for scene in range(scenes):
                order = orders[(start[participant] + block * scenes + scene) % len(orders)]
                x, y = 1000.0 * rng.uniform(-PLACE_M, PLACE_M, 2)
                at = round(float(x)), round(float(y)), round(float(rng.uniform(0.0, 360.0)))
                found += [StudyTrial(participant, kinds[kind], scene, CONDITIONS[one], *at) for one in order]
    return found


class StudyOutcome(NamedTuple):
    """What came of a grasp."""

    participant: str
    case: tuple[str, str]  # kind and scene
    condition: str
    shown: int  # grasps that had taught
    success: bool | None  # lifted, and as the person meant it; None: aborted


class Finding(NamedTuple):
    """A comparison of two conditions."""

    difference: Estimate  # of the fractions of successes, over participants
    p: float  # two-sided
    participants: int


def read(path: Path) -> list[StudyOutcome]:
    """Returns the outcomes of a file of results; raises RigError for any other file."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return [
            StudyOutcome(
                row["operator"],
                (row["object"], row["scene"]),
                row["method"],
                int(row["shown"]),
                row["lifted"] == row["meant_near"] == "True" if row["lifted"] else None,
            )
            for row in rows
        ]
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror}.") from None
    except (KeyError, ValueError, UnicodeDecodeError) as error:
        raise RigError(f"{path} holds no results of the study: {error}.") from None


def kept(outcomes: Iterable[StudyOutcome], shown: int) -> list[StudyOutcome]:
    """Returns the outcomes of the test, `shown` grasps having taught: cases finished with all three conditions, of
    participants who finished enough of those that they began; what was aborted is begun."""
    conditions = {NETWORK, PERSON, (BOTH, shown)}
    of: dict[str, dict[tuple[str, str], dict[object, StudyOutcome]]] = defaultdict(lambda: defaultdict(dict))
    for one in outcomes:
        case = of[one.participant][one.case]
        if one.success is not None:
            case[(BOTH, one.shown) if one.condition == BOTH else one.condition] = one
    found = []
    for cases in of.values():
        whole = [case for case in cases.values() if conditions <= case.keys()]
        if len(whole) >= LEAST_FINISHED * len(cases):
            found += [case[name] for case in whole for name in conditions]
    return found


def fractions(outcomes: Iterable[StudyOutcome], condition: str) -> dict[str, float]:
    """Returns the fraction of successes of each participant, by name; aborted trials do not count."""
    of = defaultdict(list)
    for one in outcomes:
        if one.condition == condition and one.success is not None:
            of[one.participant].append(one.success)
    return {name: float(np.mean(values)) for name, values in sorted(of.items())}


def compare(outcomes: Sequence[StudyOutcome], one: str, other: str) -> Finding:
    """Returns how much more often `one` succeeds than `other`. Raises RigError for fewer than two participants."""
    a, b = fractions(outcomes, one), fractions(outcomes, other)
    if len(a) < 2:
        raise RigError(f"{len(a)} participants finished enough trials, but the test needs at least 2.")
    pair = np.array(list(a.values())), np.array([b[name] for name in a])
    return Finding(paired_difference(*pair), sign_flip(pair[0] - pair[1]), len(a))


def sign_flip(differences: np.ndarray) -> float:
    """Returns the two-sided p of the hypothesis that each participant's difference has either sign equally likely: all
    signs where they are few, else drawn ones (Fisher, The Design of Experiments, 1935)."""
    most, draws, close = 14, 20_000, 1e-12
    n = len(differences)
    if n <= most:
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=n)))
    else:
        signs = np.random.default_rng(0).choice((-1.0, 1.0), (draws, n))
        signs[0] = 1.0
    return float(np.mean(np.abs(signs @ differences) >= abs(differences.sum()) - close))


def report(outcomes: Sequence[StudyOutcome], shown: int) -> str:
    """Returns the result in words: the primary comparison first; the second one counts only where that is found."""
    of = kept(outcomes, shown)
    lines, open_test = [], True
    for name, other in (("primary", NETWORK), ("secondary", PERSON)):
        found = compare(of, BOTH, other)
        said = "found" if open_test and found.p <= ALPHA else "not found" if open_test else "not tested"
        open_test = said == "found"
        lines.append(
            f"{name}: {BOTH} after {shown} shown grasps less {other}: {_percent(found.difference)} points, "
            f"p = {found.p:.4f}, {found.participants} participants: {said}"
        )
    return "".join(line + "\n" for line in lines)


def curve(outcomes: Sequence[StudyOutcome]) -> Mapping[int, Estimate]:
    """Returns the successes after each number of shown grasps, with intervals over participants."""
    counts = sorted({one.shown for one in outcomes if one.condition == BOTH and one.success is not None})
    found = {}
    for shown in counts:
        values = list(fractions([one for one in outcomes if one.shown == shown], BOTH).values())
        found[shown] = paired_difference(values, np.zeros(len(values)))
    return found


def draw(path: Path, outcomes: Sequence[StudyOutcome]) -> None:
    """Draws the successes over the number of shown grasps; raises OSError."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(6.5, 4.5), layout="constrained")
    axes = figure.subplots()
    found = curve(outcomes)
    values = 100.0 * np.array(list(found.values()))
    positions = np.arange(len(found))
    error = [values[:, 0] - values[:, 1], values[:, 2] - values[:, 0]]
    axes.errorbar(positions, values[:, 0], error, marker="o", capsize=3, color="C0", label="network and person")
    for number, (condition, name) in enumerate(((NETWORK, "network alone"), (PERSON, "person alone")), start=1):
        own = list(fractions(outcomes, condition).values())
        value, low, high = 100.0 * np.array(paired_difference(own, np.zeros(len(own))))
        axes.axhline(value, color=f"C{number}", label=name)
        axes.axhspan(low, high, color=f"C{number}", alpha=0.12)
    axes.set(xlabel="grasps of the kind that the person had shown", ylabel="lifted as the person meant it [%]")
    axes.set(ylim=(0.0, 100.0), title=f"{len(own)} participants; 95 % intervals over participants")
    axes.set_xticks(positions, [str(shown) for shown in found])
    axes.legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=110)


def _percent(of: Estimate) -> str:
    return format(Estimate(*(100.0 * value for value in of)), "+.1f")
