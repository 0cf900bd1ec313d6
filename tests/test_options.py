"""Values that a person gives wrong are refused in a sentence, before a rig starts; and what ends in the midst."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.options import is_written, new_file, new_folder, number

ros = pytest.mark.ros


@given(st.floats(0.01, 10.0))
def test_a_number_in_its_range_is_taken(value):
    assert number(0.01, 10.0)(repr(value)) == value


@given(st.one_of(st.floats(max_value=0.0), st.floats(min_value=10.1), st.just(float("nan"))).map(repr) | st.text())
def test_any_other_is_refused(text):
    try:
        inside = 0.01 <= float(text) <= 10.0
    except ValueError:
        inside = False
    if not inside:
        with pytest.raises(argparse.ArgumentTypeError, match="is not a number from 0.01 to 10"):
            number(0.01, 10.0)(text)


@pytest.mark.parametrize("name", ["", "missing/x.json", "file/x.json", "y" * 300])
def test_files_and_folders_that_cannot_be_are_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(argparse.ArgumentTypeError):
        new_file(name)
    with pytest.raises(argparse.ArgumentTypeError):
        new_folder(name.replace("missing", "file").replace("x.json", "x") or "file")
    assert new_file("x.json").name == "x.json" and not (tmp_path / "x.json").exists()
    (tmp_path / "file").write_text("old")
    assert new_file("file").read_text() == "old"
    assert new_folder("a/b").is_dir()


REFUSED = [
    *(("campaign.run", f"--only={rows}")
      for rows in ("0", "999", "x", "5-3", ",", "-3", "1-99999999999", "\n", "dangerous2")),
    *(("campaign.run", argument) for argument in ("--rigs=0", "--rigs=-1", "--json=/")),
    *(("campaign.network.run", argument) for argument in ("--only=x", "--rigs=0", "--json=/nowhere/x.json")),
    *(("campaign.soak", f"--hours={hours}") for hours in ("0", "nan", "")),
    *(("fuzz.run", argument) for argument in ("--minutes=0", "--minutes=inf", "--only=nothing")),
    ("bench.run", "--json=no folder/new.json"),
    ("tools.pictures", "nonsense"),
    *(("golden.__main__", argument) for argument in ("three-claps", "--check")),
]  # fmt: skip


@ros
@pytest.mark.parametrize(("program", "argument"), REFUSED)
def test_what_a_program_does_not_take_is_refused_in_a_sentence_before_it_begins(monkeypatch, capsys, program, argument):
    monkeypatch.setattr(sys, "argv", [program, argument])
    with pytest.raises(SystemExit) as refused:
        importlib.import_module(program).main()
    said = capsys.readouterr().err or refused.value.code
    assert refused.value.code not in (0, None) and "Traceback" not in said
    assert len(said.strip().splitlines()[-1]) < 400


def test_results_that_the_disk_does_not_take_are_a_sentence(capsys):
    assert not is_written(Path("/dev/full"), "x")
    assert "/dev/full: No space left on device" in capsys.readouterr().err


def test_a_run_that_is_too_short_to_judge_is_not_steady(tmp_path, capsys):
    from campaign import soak

    process = {"pid": 5, "rss": 1.0, "pss": 1.0, "threads": 12, "sockets": 7, "files": 20, "cpu": 3.0}
    sample = {"delay": {}, "goals": 0.0, "streams": 0, "servo": 0, "mode": "home", "log": 2.0}
    path = tmp_path / "soak.jsonl"
    lines = (json.dumps({"t": 10.0 * i, "processes": {"a": process}, **sample}) for i in range(1, 5))
    path.write_text("\n".join(lines))
    assert soak.main(["--judge", str(path)]) == 2 and "too short" in capsys.readouterr().err


def test_a_judgement_never_replaces_its_data(tmp_path, capsys):
    from campaign import soak

    for name in ("soak.json", "soak.png"):
        path = tmp_path / name
        path.write_text("data")
        assert soak.main(["--judge", str(path)]) == soak.main(["--out", str(path)]) == 2
        assert path.read_text() == "data" and capsys.readouterr().err.count("no name for data") == 2


class _Rigs:
    """Stands for the rigs of a campaign: rows last until the rigs are stopped, or end at once."""

    def __init__(self, lasts: bool) -> None:
        self.judged: list[int] = []
        self.stopped, self.closed, self.running = threading.Event(), 0, threading.Event()
        self._lasts, self.variant = lasts, None

    def judge(self, entry):
        self.judged.append(entry.number)
        self.running.set()
        if self._lasts:
            self.stopped.wait()
        return {"result": "passed", "faults": [], "seconds": 0.0}

    def stop(self):
        self.stopped.set()

    def close(self):
        self.closed += 1


@ros
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_what_ends_a_campaign_ends_its_rigs_and_no_other_row_begins(monkeypatch, error):
    from campaign import rows, run

    rig = _Rigs(lasts=error is KeyboardInterrupt)
    monkeypatch.setattr(run, "KeptRig", lambda: rig)

    def completed(working):
        rig.running.wait()
        raise KeyboardInterrupt

    def tell(*_):
        raise OSError("the disk is full")

    if error is KeyboardInterrupt:
        monkeypatch.setattr(run.concurrent.futures, "as_completed", completed)
    reported = []
    take = tell if error is OSError else lambda entry, *_: reported.append(entry.number)
    campaign = run.Campaign(run.chosen(rows.load(), "1-5"), 1, take)
    with pytest.raises(error):
        campaign.run()
    assert len(rig.judged) == 1 and rig.closed == 1
    assert not reported, "a row that was cut off says nothing"


def test_golden_renews_nothing_that_it_cannot_draw(monkeypatch):
    import golden.__main__ as golden

    written = []

    def cannot(*_):
        raise OSError("no picture")

    monkeypatch.setattr(golden, "RUNS", {"run": lambda: None})
    monkeypatch.setattr(golden, "PureChain", lambda _: type("P", (), {"run": lambda self: None})())
    monkeypatch.setattr(golden, "World", lambda _: None)
    monkeypatch.setattr(golden, "stored", lambda _: type("N", (), {"write": lambda self, n: written.append(n)})())
    monkeypatch.setattr(golden.Stored, "read", lambda name: None)
    monkeypatch.setattr(golden, "differences", lambda *_: ["it differs"])
    monkeypatch.setattr(golden, "draw", cannot)
    with pytest.raises(OSError, match="no picture"):
        golden.main([])
    assert not written


def test_ctrl_c_ends_golden_in_a_sentence(monkeypatch, capsys):
    import golden.__main__ as golden

    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr(golden, "RUNS", {"run": interrupted})
    with pytest.raises(SystemExit) as ended:
        golden.main([])
    assert ended.value.code == 130 and "Interrupted" in capsys.readouterr().out
