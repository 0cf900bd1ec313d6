"""Recorded hands through the pure chain, compared with what is stored; `make golden` renews that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden import stored as stored_module
from golden.chain import PureChain, Trace, World
from golden.runs import RUNS, Missing
from golden.stored import FOLDER, TOLERANCE, TOLERANCES, Stored, differences, stored


@pytest.mark.parametrize("name", RUNS)
def test_what_comes_out_is_what_is_stored(name):
    try:
        run = RUNS[name]()
    except Missing as missing:
        pytest.skip(str(missing))
    found = differences(Stored.read(name), stored(PureChain(World(run)).run()), TOLERANCES.get(name, TOLERANCE))
    assert not found, f"{name}: {' '.join(found)} If this is meant, run `make golden` and look at its pictures."


def test_every_recording_is_stored_and_nothing_else():
    assert {path.stem for path in FOLDER.iterdir()} == set(RUNS)


def test_every_recording_has_something_to_compare():
    for name in RUNS:
        counts = Stored.read(name).counts
        assert min(count.sum() for count in counts.values()) > 50, name


def test_no_stored_number_is_none():
    for name in RUNS:
        old = Stored.read(name)
        for kind, means in old.means.items():
            assert np.all(np.isfinite(means) == (old.counts[kind] > 0)[:, None]), f"{name}: {kind}"


@pytest.mark.parametrize("kind", ["tools", "hands", "goals"])
def test_one_sample_that_differs_or_is_missing_is_noticed(kind):
    rng = np.random.default_rng(3)
    trace = Trace(*([row for row in rng.normal(size=(37, n))] for n in (9, 4, 7)), events=["0.1 kuka: home"])
    old = stored(trace)
    assert not differences(old, stored(trace))
    samples = getattr(trace, kind)
    for number in range(len(samples[17])):
        damaged = samples[17].copy()
        damaged[number] = np.nan
        none = replace(trace, **{kind: [*samples[:17], damaged, *samples[18:]]})
        assert [kind in sentence for sentence in differences(old, stored(none))] == [True], f"number {number} is none"
    samples[17] = samples[17] + np.eye(len(samples[17]))[1] * 2e-6
    assert [kind in sentence for sentence in differences(old, stored(trace))] == [True]
    samples[17] = np.full(len(samples[17]), np.nan)
    assert [kind in sentence for sentence in differences(old, stored(trace))] == [True]
    del samples[-7:]
    assert kind in differences(old, stored(trace))[0]


@pytest.mark.parametrize("kind", ["tools", "hands", "goals"])
@pytest.mark.parametrize(
    "pattern",
    [(1, -1), (1, -2, 1), (1, -1, -1, 1), (1, 0, -1), (1, -1, 1, -1), (2, -1, -1)],
    ids=["one step", "a kick", "a step and back", "two apart", "trembling", "uneven"],
)
def test_changes_that_cancel_each_other_within_a_block_are_noticed(kind, pattern):
    """Goals that tremble would shake an arm although their plain mean is as before."""
    size, first = stored_module.SHAPE[kind], stored_module.BLOCK[kind]
    trace = Trace(**{kind: [np.zeros(size) for _ in range(3 * first)]})
    for begin in range(first, 2 * first - len(pattern) + 1):
        shaken = [row.copy() for row in getattr(trace, kind)]
        for i, part in enumerate(pattern):
            shaken[begin + i][-1] = 1e-7 * part
        assert kind in differences(stored(trace), stored(Trace(**{kind: shaken})))[0], begin


def test_samples_that_are_exchanged_are_noticed():
    goals = list(np.random.default_rng(5).normal(size=(30, 7)))
    for i in range(10, 20):
        for j in range(10, i):
            other = list(goals)
            other[i], other[j] = goals[j], goals[i]
            assert differences(stored(Trace(goals=goals)), stored(Trace(goals=other))), (i, j)


def test_a_sentence_says_what_differs_most_and_from_what_to_what():
    goals = [np.zeros(7) for _ in range(200)]
    old = stored(Trace(goals=goals))
    (sentence,) = differences(old, stored(Trace(goals=goals[:150] + [-0.25 * np.eye(7)[3]] * 50)))
    assert "first block 15 (0.60 s)" in sentence and "joint 4, from 0 to -0.25" in sentence


def test_the_picture_marks_what_the_gate_says_differs(tmp_path, monkeypatch):
    from golden import picture

    asked = []
    monkeypatch.setattr(picture, "differing", lambda kind, old, new, bounds: asked.append(bounds[kind]) or [])
    trace = stored(Trace(goals=[np.zeros(7)] * 30))
    picture.draw("run", trace, trace, tmp_path / "run.png", {"tools": 1.0, "hands": 2.0, "goals": 3.0})
    assert asked == [1.0, 1.0, 2.0, 3.0] and (tmp_path / "run.png").stat().st_size > 1000


def test_writing_and_reading_changes_nothing(tmp_path):
    trace = Trace([np.arange(9.0)] * 7, [np.full(4, np.nan)] * 7, [np.ones(7)], ["0.1 kuka: home", "0.2 kuka: servo"])
    stored(trace).write("run", tmp_path)
    again = Stored.read("run", tmp_path)
    assert not differences(stored(trace), again)
    again.write("other", tmp_path)
    assert (tmp_path / "run.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()
