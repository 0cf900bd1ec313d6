"""The benchmarks run and give numbers. How fast anything is, is not asked here."""

from __future__ import annotations

import importlib
import math
import sys

import pytest

from bench import bench_kinematics, run


@pytest.mark.parametrize(
    "name", ["kinematics", "control", "client", "lag", "shaping", pytest.param("leap", marks=pytest.mark.ros)]
)
def test_a_quick_run_gives_numbers(name):
    rows = importlib.import_module(f"bench.bench_{name}").rows(quick=True)
    assert rows
    for row in rows:
        if row.median is None:
            assert row.p99 is None and ("not installed" in row.how or "no recordings" in row.how)
            continue
        assert math.isfinite(row.median) and (row.median >= 0.0 or "negative: " in row.how)
        assert row.p99 is None or (math.isfinite(row.p99) and row.p99 >= row.median)
        assert row.what and row.unit and row.how


def test_the_numerical_solvers_find_the_pose_they_are_compared_on():
    rows = bench_kinematics.rows(quick=True)
    solved = {row.what: row.median for row in rows if row.what.endswith(", solved") and " near: " in row.what}
    assert len(solved) >= 4 and min(solved.values()) > 90.0, solved


def test_without_kdl_the_rows_say_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "PyKDL", None)
    rows = bench_kinematics.rows(quick=True)
    kdl = [row for row in rows if "KDL" in row.what]
    assert len(kdl) == 8 and all(row.median is None and "not installed" in row.how for row in kdl)


def test_the_table_goes_to_a_file_too(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run, "NAMES", ("lag",))
    assert run.main(["--quick"]) == 0
    assert "lag behind 0.1 rad/s, law lts" in capsys.readouterr().out
    everything = (tmp_path / "build" / "bench.json").read_text()
    assert '"rows"' in everything
    assert run.main(["--quick", "--only", "lag"]) == 0
    assert (tmp_path / "build" / "bench.json").read_text() == everything, "one part does not stand for all"


def test_the_closed_form_solves_every_pose():
    law = [row for row in bench_kinematics.rows(quick=True) if " law: " in row.what]
    assert [row.median for row in law if row.what.endswith("solved")] == [100.0, 100.0]
    assert max(row.median for row in law if row.what.endswith("error")) < 1e6, "1e-9 m"
