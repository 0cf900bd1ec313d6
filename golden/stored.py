"""What is stored of a trace, and how another one is compared with it.

Numbers are stored as the weighted means of blocks of samples, so every sample counts although few numbers are stored.
The weights are the square roots of primes, of which no sum with whole factors is zero: goals that are exchanged, or
that tremble about the old ones, have another mean. Events are stored as text, all of them.

Two machines agree to 1e-13 in all that is compared, except in the goals of one recording. Products of matrices differ
in the last digit between processors (BLAS kernels, fused multiplication). Ruckig's search for roots, and the search for
the largest step after which the arm can still stop, end at a tolerance: where both act along a bound of the workspace,
that last digit becomes 1e-8 rad, whatever its size. So the goals of confidence-74fps are compared to 1e-7 rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.chain import CYCLE_S, Trace

FOLDER = Path(__file__).parent / "stored"
BLOCK = {"tools": 5, "hands": 5, "goals": 10}  # samples in a block
WEIGHTS = np.sqrt([17, 5, 23, 13, 3, 19, 29, 2, 11, 7])  # of the samples in a block, by their places; neighbours differ
TOLERANCE = {"tools": 1e-9, "hands": 1e-9, "goals": 1e-9}  # m and no unit, rad, rad
ALONG_BOUNDS = {**TOLERANCE, "goals": 1e-7}
TOLERANCES = {"confidence-74fps": ALONG_BOUNDS}  # of recordings, where it is not TOLERANCE
SHAPE = {"tools": 9, "hands": 4, "goals": 7}
NAMES = {
    "tools": ("x", "y", "z", *(f"{part} of its {axis} axis" for axis in "xy" for part in "xyz")),
    "hands": ("index", "middle", "thumb", "spread"),
    "goals": tuple(f"joint {i}" for i in range(1, 8)),
}


@dataclass(frozen=True)
class Stored:
    """The weighted means of blocks by kind, shape (n, SHAPE[kind]), NaN where a block has no sample; counts of samples
    that are there, by kind, shape (n,); and the events.
    """

    means: dict[str, np.ndarray]
    counts: dict[str, np.ndarray]
    events: tuple[str, ...]

    def write(self, name: str, folder: Path = FOLDER) -> None:
        counts = {f"{kind}_counts": count for kind, count in self.counts.items()}
        np.savez_compressed(folder / f"{name}.npz", **self.means, **counts)
        (folder / f"{name}.txt").write_text("".join(f"{event}\n" for event in self.events))

    @classmethod
    def read(cls, name: str, folder: Path = FOLDER) -> Stored:
        """Returns what is stored of a recording; empty where nothing is."""
        if not (folder / f"{name}.npz").is_file():
            return stored(Trace())
        with np.load(folder / f"{name}.npz", allow_pickle=False) as file:
            means, counts = ({kind: file[kind + end] for kind in BLOCK} for end in ("", "_counts"))
        return cls(means, counts, tuple((folder / f"{name}.txt").read_text().splitlines()))


def stored(trace: Trace) -> Stored:
    means, counts = {}, {}
    for kind, size in BLOCK.items():
        samples = np.array(getattr(trace, kind)).reshape(-1, SHAPE[kind])
        blocks = [samples[i : i + size] for i in range(0, len(samples), size)]
        there = [np.isfinite(block[:, 0]) for block in blocks]
        counts[kind] = np.array([np.sum(given) for given in there], dtype=np.uint8)
        means[kind] = np.array([_mean(block, given) for block, given in zip(blocks, there)]).reshape(-1, SHAPE[kind])
    return Stored(means, counts, tuple(trace.events))


def _mean(block: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Returns the weighted mean of the samples of a block that are `given`, NaN if none is."""
    if not given.any():
        return np.full(block.shape[1], np.nan)
    return np.average(block[given], axis=0, weights=WEIGHTS[: len(block)][given])


def differing(kind: str, old: Stored, new: Stored, tolerance: dict[str, float] = TOLERANCE) -> np.ndarray:
    a, b = old.means[kind], new.means[kind]
    n = min(len(a), len(b))
    same = old.counts[kind][:n] == new.counts[kind][:n]
    # Not `apart > tolerance`: a number that is none is not greater than anything.
    far = ~((np.abs(a[:n] - b[:n]) <= tolerance[kind]) | (np.isnan(a[:n]) & np.isnan(b[:n])))
    return np.concatenate([np.nonzero(~same | far.any(axis=1))[0], np.arange(n, max(len(a), len(b)))])


def differences(old: Stored, new: Stored, tolerance: dict[str, float] = TOLERANCE) -> list[str]:
    """Returns a sentence about each kind that differs; none if the traces agree."""
    sentences = []
    for kind in BLOCK:
        blocks = differing(kind, old, new, tolerance)
        if not len(blocks):
            continue
        a, b = old.means[kind], new.means[kind]
        common = blocks[blocks < min(len(a), len(b))]
        apart = np.abs(b[common] - a[common])
        text = f"{kind}: {len(blocks)} of {max(len(a), len(b))} blocks differ, first {_when(kind, blocks[0])}"
        if np.isfinite(apart).any():
            row, column = np.unravel_index(np.nanargmax(apart), apart.shape)
            before, now = a[common[row], column], b[common[row], column]
            text += f"; most {NAMES[kind][column]}, from {before:.6g} to {now:.6g} in {_when(kind, common[row])}"
        sentences.append(f"{text}.")
    if old.events != new.events:
        pairs = zip((*old.events, "the end"), (*new.events, "the end"))
        before, now = next(pair for pair in pairs if pair[0] != pair[1])
        sentences.append(f"events: stored {before!r}, now {now!r}.")
    return sentences


def _when(kind: str, block: int) -> str:
    if kind == "goals":
        return f"block {block} ({block * BLOCK[kind] * CYCLE_S:.2f} s)"
    return f"block {block} (frame {block * BLOCK[kind]})"
