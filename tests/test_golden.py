"""Recorded hands through the pure chain, compared with what is stored; `make golden` renews that."""

from __future__ import annotations

import numpy as np
import pytest

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


@pytest.mark.parametrize("kind", ["tools", "hands", "goals"])
def test_one_sample_that_differs_or_is_missing_is_noticed(kind):
    rng = np.random.default_rng(3)
    trace = Trace(*([row for row in rng.normal(size=(37, n))] for n in (9, 4, 7)), events=["0.1 kuka: home"])
    old = stored(trace)
    assert not differences(old, stored(trace))
    samples = getattr(trace, kind)
    samples[17] = samples[17] + np.eye(len(samples[17]))[1] * 2e-6
    assert [kind in sentence for sentence in differences(old, stored(trace))] == [True]
    samples[17] = np.full(len(samples[17]), np.nan)
    assert [kind in sentence for sentence in differences(old, stored(trace))] == [True]
    del samples[-7:]
    assert kind in differences(old, stored(trace))[0]


def test_writing_and_reading_changes_nothing(tmp_path):
    trace = Trace([np.arange(9.0)] * 7, [np.full(4, np.nan)] * 7, [np.ones(7)], ["0.1 kuka: home", "0.2 kuka: servo"])
    stored(trace).write("run", tmp_path)
    again = Stored.read("run", tmp_path)
    assert not differences(stored(trace), again)
    again.write("other", tmp_path)
    assert (tmp_path / "run.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()
