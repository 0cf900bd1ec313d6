"""The benchmarks run and give numbers. How fast anything is, is not asked here."""

from __future__ import annotations

import importlib
import json
import math
import re
import shutil

import pytest

from bench import bench_kinematics, compare, run
from bench.measure import HEAD, WHAT_WIDTH, Goal, Peer, Row, aligned, cells


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        *("kinematics", "control", "filter", "client", "shaping", "stopping", "policy", "vision"),
        pytest.param("leap", marks=pytest.mark.ros),
        pytest.param("pictures", marks=pytest.mark.skipif(not shutil.which("chromium"), reason="no chromium")),
    ],
)
def test_a_quick_run_gives_numbers(name):
    rows = importlib.import_module(f"bench.bench_{name}").rows(quick=True)
    assert rows
    for row in rows:
        if row.median is None:
            assert row.p99 is None and re.search("recordings are not|not measured", row.how)
            continue
        assert math.isfinite(row.median) and row.median >= 0.0
        assert row.p99 is None or (math.isfinite(row.p99) and row.p99 >= row.median)
        assert row.what and len(row.what) <= WHAT_WIDTH and row.unit and row.how


def test_the_table_fits_on_a_terminal_and_goes_to_a_file_too(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(run, "NAMES", ("stopping",))
    path = tmp_path / "new.json"
    assert run.main(["--quick", "--json", str(path)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert "stop by gap of 80 ms: jerk" in table[-1] and max(map(len, table[1:])) <= 100
    assert compare.main([str(path), str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(" 1.00 " in line for line in lines[3:])


def test_ctrl_c_ends_the_benchmarks_with_what_there_is(monkeypatch, tmp_path, capsys):
    def rows(quick):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "NAMES", ("stopping", "kinematics", "leap"))
    monkeypatch.setattr(bench_kinematics, "rows", rows)
    path = tmp_path / "new.json"
    assert run.main(["--quick", "--json", str(path)]) == run.INTERRUPTED
    out = capsys.readouterr().out
    assert "stop by gap of 80 ms: jerk" in out and "NOT RUN  kinematics, leap: interrupted" in out
    assert json.loads(path.read_text())["not_run"] == ["kinematics, leap: interrupted"]


def test_a_row_states_goal_peer_and_ratio():
    row = Row("delay", 5.0, 9.0, "ms", "", Goal(2.5, 8.0), Peer("KDL", 4.0))
    assert cells(row) == ("delay", "5.00", "9.00", "ms", "<= 2.5/8", "KDL 4.00", "1.2")
    assert cells(Row("rate", None, None, "Hz", "", Goal(100.0, at_least=True)))[1:5] == ("-", "-", "Hz", ">= 100")
    assert str(Goal(None, 25.0)) == "<= -/25" and str(Goal(0.0)) == "<= 0"
    assert aligned([HEAD, cells(row)], right=(1,))[1].startswith("delay      5.00  9.00")


def test_measures_of_one_file_alone_are_listed_too():
    old = {"what": "a", "median": 2.0, "p99": None, "unit": "ms"}
    new = [{**old, "median": 1.0}, {**old, "what": "b"}]
    assert compare.compared([old, {**old, "what": "c"}], new) == [
        ("a", "2.00", "1.00", "0.50", "-", "-", "ms"),
        ("b", "-", "2.00", "", "-", "-", "ms"),
        ("c", "2.00", "-", "", "-", "-", "ms"),
    ]


ROW = {"what": "a", "median": 1.0, "p99": None, "unit": "ms"}
RUN = {"machine": "x", "python_loop_ms": 1.0, "load_before": 0.0, "load_after": 0.0}


@pytest.mark.parametrize(
    "content",
    ["{}", "[]", "", "[" * 100_000, json.dumps({**RUN, "rows": None}),
     *(json.dumps({**RUN, "rows": [{**ROW, **wrong}]}) for wrong in (
         {"median": "x"}, {"median": math.nan}, {"p99": math.inf}, {"what": ["a"]}, {"unit": 5}))],
    ids=["{}", "[]", "empty", "deep", "rows", "median", "nan", "infinity", "what", "unit"],
)  # fmt: skip
def test_a_file_that_holds_no_figures_is_refused_in_a_sentence(tmp_path, capsys, content):
    (tmp_path / "bad.json").write_text(content)
    for arguments in ([], [str(tmp_path / "bad.json")] * 2, ["absent.json"] * 2, [str(tmp_path)] * 2):
        assert compare.main(arguments) == 2
    assert capsys.readouterr().err.count("cannot read the figures") == 3
