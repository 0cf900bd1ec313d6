"""The judgement of an endurance run: it finds a leak in noise, and reports no leak in noise alone."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaign import soak
from campaign.growth import growth
from campaign.soak_report import BOUNDS

HOURS = np.arange(0.0, 2.0, 10.0 / 3600.0)
SEEDS = st.integers(0, 2**32 - 1)
LEAST = BOUNDS["rss"][0]


def memory(rng: np.random.Generator, leak: float) -> np.ndarray:
    """A node's memory [MiB] every 10 s: it warms up, wanders by a MiB, and has a peak at each fault."""
    wander = np.convolve(rng.normal(0.0, 0.3, len(HOURS) + 30), np.ones(31) / 31**0.5, "valid")
    peaks = rng.random(len(HOURS)) < 0.08
    return 80.0 + 15.0 * (1.0 - np.exp(-HOURS / 0.1)) + leak * HOURS + wander + 20.0 * peaks * rng.random(len(HOURS))


@given(SEEDS, st.floats(2.0 * LEAST, 100.0))
def test_a_leak_in_noise_is_found(seed, leak):
    found = growth(HOURS, memory(np.random.default_rng(seed), leak))
    assert found.verdict(LEAST) == "grows"
    assert found.low <= found.slope <= found.high and abs(found.slope - leak) < 2.0


@given(SEEDS, st.floats(-20.0, 1.0))
def test_no_leak_is_reported_where_there_is_none(seed, leak):
    found = growth(HOURS, memory(np.random.default_rng(seed), leak))
    assert found.verdict(LEAST) == "steady"


@given(SEEDS, st.integers(10, 60), st.booleans())
def test_threads_that_leak_with_every_fault_are_found_and_those_that_come_and_go_are_not(seed, per_hour, leaks):
    rng = np.random.default_rng(seed)
    busy = 12 + rng.integers(0, 3, len(HOURS)) + 5 * (rng.random(len(HOURS)) < 0.1)
    threads = busy + leaks * np.floor(per_hour * HOURS)
    assert growth(HOURS, threads).verdict(BOUNDS["threads"][0]) == ("grows" if leaks else "steady")


@given(SEEDS, st.integers(0, 20))
def test_values_that_are_missing_do_not_count_and_too_few_are_no_judgement(seed, missing):
    rng = np.random.default_rng(seed)
    values = memory(rng, 0.0)
    values[rng.choice(len(values), len(values) // 2, replace=False)] = np.nan
    assert growth(HOURS, values).verdict(LEAST) == "steady"
    assert growth(HOURS[:missing], values[:missing]) is None
    assert growth(HOURS, np.full(len(HOURS), np.nan)) is None


def sample(t, **changes):
    """Returns a record of a rig that works, and one of a fault."""
    process = {"pid": 5, "rss": 80.0, "pss": 70.0, "threads": 12, "sockets": 7, "files": 20, "cpu": 3.0}
    works = {"delay": {"p50": 3.0}, "goals": 100.0, "streams": 3, "servo": 3, "mode": "servo", "log": 2.0}
    return {"t": t, "processes": {"leap_driver.py": {**process, **changes.pop("process", {})}}, **works, **changes}


def judged(tmp_path, records):
    path = tmp_path / "soak.jsonl"
    path.write_text("".join(json.dumps(record) + "\n" for record in records))
    return soak.main(["--judge", str(path)])


FAULT = {"t": 60.0, "fault": "arm slow 2.0 s"}
TIMES = np.arange(0.0, 7200.0, 60.0)  # enough for what does not grow [s]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"streams": 0, "servo": 0, "goals": 0.0}, "followed no hand"),
        ({"goals": 0.0}, "followed no hand"),
        ({"delay": {}}, "delay was never measured"),
        ({"process": {"rss": float("nan")}}, "leap_driver.py: rss was never measured"),
    ],
)
def test_a_rig_that_does_nothing_is_not_called_steady(tmp_path, capsys, changes, said):
    assert judged(tmp_path, [FAULT, *(sample(t, **changes) for t in TIMES)]) == 1
    assert said in capsys.readouterr().out


def test_a_rig_that_works_with_faults_is_steady_and_without_one_it_is_not(tmp_path, capsys):
    assert judged(tmp_path, [FAULT, *(sample(t) for t in TIMES)]) == 0
    assert judged(tmp_path, [sample(t) for t in TIMES]) == 1 and "no fault" in capsys.readouterr().out


@pytest.mark.parametrize(
    "damage",
    [
        lambda records: [{k: v for k, v in r.items() if k != "streams"} for r in records],
        lambda records: [*records, {"t": 1.0, "fault": 3}],
        lambda records: [*records, {"finding": "x"}],
        lambda records: [{**r, "goals": None} for r in records],
        lambda records: [{**r, "processes": {"a": {"rss": 10**400}}} for r in records],
        lambda records: [sample(t, process={"rss": 10**400}) for t in TIMES],
        lambda records: [sample(t, process={"rss": "x"}) for t in TIMES],
        lambda records: [{**r, "t": 5.0} for r in records],
        lambda records: records[::-1],
        lambda records: ["[" * 10**5],
        lambda records: [5, None, []],
        lambda records: [{"t": "x", "processes": 3}],
        lambda records: [{"t": 1, "processes": {}, "log": "x", "delay": 3}],
        lambda records: [],
    ],
)
def test_a_damaged_file_is_refused_in_a_sentence(tmp_path, capsys, damage):
    assert judged(tmp_path, damage([sample(t) for t in TIMES])) == 2
    assert "holds no samples" in capsys.readouterr().err
    assert not (tmp_path / "soak.json").exists()


@pytest.mark.parametrize("leak", [0.0, 40.0])
def test_a_run_is_judged_from_its_file_even_if_its_last_line_was_cut_off(tmp_path, capsys, leak):
    path, rng = tmp_path / "soak.jsonl", np.random.default_rng(0)
    with open(path, "w") as file:
        for t, value in zip(HOURS * 3600.0, memory(rng, leak)):
            process = {"pid": 5, "rss": value, "pss": value, "threads": 12, "sockets": 7, "files": 20, "cpu": 3.0}
            sample = {"delay": {"p50": 3.0}, "goals": 100.0, "streams": 3, "servo": 3, "mode": "servo", "log": 2.0}
            file.write(json.dumps({"t": t, "processes": {"leap_driver.py": process}, **sample}) + "\n")
            file.write(json.dumps({"t": t, "fault": "arm slow 2.0 s"}) + "\n")
        file.write('{"t": 7200, "processes": {"leap_dr')
    assert soak.main(["--judge", str(path)]) == (1 if leak else 0)
    result = json.loads(path.with_suffix(".json").read_text())
    assert {row["measure"] for row in result["rows"]} == set(BOUNDS)
    grown = {(row["process"], row["measure"]) for row in result["rows"] if row["verdict"] == "grows"}
    assert grown == ({("leap_driver.py", "rss"), ("leap_driver.py", "pss"), ("rig", "pss")} if leak else set())
    assert path.with_suffix(".png").stat().st_size < 150_000
    assert "leap_driver.py" in capsys.readouterr().out
    with open(path, "a") as file:
        file.write("\n" + json.dumps({"t": 7201, "finding": "leapd.py has ended"}) + "\n")
    assert soak.main(["--judge", str(path)]) == 1 and "leapd.py has ended" in capsys.readouterr().out


def test_a_node_that_ends_before_the_first_sample_is_a_finding(tmp_path, monkeypatch):
    monkeypatch.setattr(soak, "SAMPLE_S", 0.0)
    process = {"pid": 5, "pss": 1.0, "cpu": 1.0}
    seen = iter([{"a": process, "b": process}, {"a": process}])
    rig = soak.Rig.__new__(soak.Rig)
    rig._nodes, rig.log_folder, rig.processes = None, tmp_path, lambda seconds: next(seen)
    ears = SimpleNamespace(goals=0, streams=0, servo=0, mode="home", delay=dict)
    run = soak.Soak(tmp_path / "soak.jsonl")
    run._sample(rig, ears, SimpleNamespace(start=lambda: None, doing=""), 0.0)
    assert run.findings == ["b has ended"]


def test_the_data_of_the_run_before_are_kept(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(soak.Soak, "run", lambda *_: None)
    path = tmp_path / "soak.jsonl"
    for data in ("hours of data", ""):
        path.write_text(data)
        assert soak.main(["--out", str(path)]) == 2
    assert (tmp_path / "soak.before.jsonl").read_text() == "hours of data"
    assert "soak.before.jsonl" in capsys.readouterr().out
