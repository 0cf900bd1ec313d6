"""The study of people: laws of its draw and of its test."""

from __future__ import annotations

import csv
import itertools
import os
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from episodes import DOWN, episode
from test_programs import call

from common.errors import RigError
from common.poses import read_only, translation
from grasping.lab.dataset import store
from grasping.lab.dataset.episode import SHOWN
from grasping.lab.evaluation import person_study
from grasping.lab.evaluation.person_study import (
    BOTH,
    CONDITIONS,
    NETWORK,
    PERSON,
    StudyOutcome,
    plan,
    sign_flip,
    williams,
)
from grasping.lab.programs import person_study as program

KINDS = ("cup", "bottle", "hammer")


@pytest.mark.parametrize("n", range(2, 8))
def test_orders_are_balanced(n):
    """Each condition stands as often at each place, and as often behind each other one."""
    orders = williams(n)
    assert all(sorted(order) == list(range(n)) for order in orders)
    places = Counter((place, one) for order in orders for place, one in enumerate(order))
    behind = Counter(pair for order in orders for pair in zip(order, order[1:]))
    assert len(places) == n * n and len(set(places.values())) == 1
    assert len(behind) == n * (n - 1) and len(set(behind.values())) == 1


def test_each_placement_is_grasped_once_with_each_condition():
    trials = plan(6, KINDS, 4, 1)
    cases = {key: list(of) for key, of in itertools.groupby(trials, lambda t: (t.participant, t.kind, t.scene))}
    assert len(cases) == 6 * len(KINDS) * 4
    assert all(sorted(t.condition for t in of) == sorted(CONDITIONS) for of in cases.values())
    assert all(len({(t.x_mm, t.y_mm, t.turn_deg) for t in of}) == 1 for of in cases.values())
    assert all(abs(t.x_mm) <= 80.0 and abs(t.y_mm) <= 80.0 for t in trials)


@pytest.mark.parametrize("seed", range(4))
def test_six_participants_are_balanced_at_each_moment(seed):
    trials = plan(6, KINDS, 3, seed)
    each = len(KINDS) * 3 * len(CONDITIONS)
    for moment in range(each):
        assert set(Counter(trials[p * each + moment].condition for p in range(6)).values()) == {2}


def test_the_draw_is_that_of_its_seed():
    assert plan(6, KINDS, 2, 1) == plan(6, KINDS, 2, 1)
    assert plan(6, KINDS, 2, 1) != plan(6, KINDS, 2, 2)


@pytest.mark.parametrize("n", [5, 6, 9])
def test_where_signs_are_by_chance_the_test_finds_something_no_more_often_than_it_says(n):
    """All signs of one set of differences, which are equally likely then."""
    sizes = np.random.default_rng(n).uniform(0.05, 0.3, n)
    p = [sign_flip(np.array(signs) * sizes) for signs in itertools.product((-1.0, 1.0), repeat=n)]
    for alpha in (0.05, 0.2, 0.5):
        assert np.mean(np.array(p) <= alpha) <= alpha
    assert np.mean(np.array(p) <= 0.5) > 0.4, "and not never"


def test_few_who_agree_are_found_and_drawn_signs_say_the_same():
    assert sign_flip(np.full(6, 0.2)) == pytest.approx(2.0 / 64.0)
    assert sign_flip(np.full(5, 0.2)) > person_study.ALPHA
    differences = np.random.default_rng(1).normal(0.05, 0.1, 14)
    more = np.append(differences, 0.0)  # one too many to try all; a zero changes nothing
    assert sign_flip(more) == pytest.approx(sign_flip(differences), abs=0.02)


def outcomes(rates, participants=8, scenes=12, seed=0):
    """Successes by chance; `rates`: of NETWORK, PERSON and BOTH."""
    rng = np.random.default_rng(seed)
    return [
        StudyOutcome(f"p{p}", ("cup", str(scene)), condition, 20 * (condition == BOTH), bool(rng.random() < rate))
        for p in range(participants)
        for scene in range(scenes)
        for condition, rate in zip((NETWORK, PERSON, BOTH), rates)
    ]


def test_a_known_effect_is_found_and_none_where_there_is_none():
    assert "points, p = 0.0078, 8 participants: found" in person_study.report(outcomes((0.3, 0.9, 0.8)), 20)
    found = [person_study.compare(outcomes((0.5, 0.5, 0.5), seed=seed), BOTH, NETWORK).p for seed in range(200)]
    assert np.mean(np.array(found) <= person_study.ALPHA) <= 0.08


def test_the_second_comparison_counts_only_behind_the_first():
    first, second = person_study.report(outcomes((0.8, 0.1, 0.8)), 20).splitlines()
    assert first.endswith(": not found") and second.endswith(": not tested")


def test_incomplete_cases_and_who_finished_too_few_are_left_out():
    whole = outcomes((0.3, 0.9, 0.8), participants=3, scenes=10)
    assert len(person_study.kept(whole, 20)) == len(whole)
    missing = {("p0", ("cup", str(scene)), BOTH) for scene in range(3)} | {("p1", ("cup", "0"), PERSON)}
    found = person_study.kept([one for one in whole if one[:3] not in missing], 20)
    assert Counter(one.participant for one in found) == {"p1": 27, "p2": 30}
    with pytest.raises(RigError, match="0 participants finished enough"):
        person_study.report(whole, 5)


def test_a_placement_that_was_aborted_in_all_ways_was_begun(tmp_path):
    """Of ten, p0 aborts three and p1 two; p2 aborts one and stops there, behind four that are finished."""
    aborted = {"p0": "789", "p1": "89", "p2": "4"}
    rows = [
        one._replace(success=None) if one.case[1] in aborted[one.participant] else one
        for one in outcomes((0.3, 0.9, 0.8), participants=3, scenes=10)
        if one.participant != "p2" or one.case[1] in "01234"
    ]
    found = person_study.kept(person_study.read(written(tmp_path / "results.csv", rows)), 20)
    assert Counter(one.participant for one in found) == {"p1": 3 * 8, "p2": 3 * 4}
    assert sorted(found) == sorted(one for one in rows if one.participant != "p0" and one.success is not None)


def test_the_curve_counts_what_was_not_aborted():
    rows = outcomes((0.3, 0.9, 0.8))
    half = [one._replace(success=None) if one.case[1] in "01234" else one for one in rows]
    never = [one._replace(participant="p9", shown=5, success=None) for one in rows if one.condition == BOTH]
    finished = [one for one in half if one.success is not None]
    assert person_study.curve(half + never) == person_study.curve(finished)


def test_a_file_without_results_is_refused(tmp_path, monkeypatch, capsys):
    (tmp_path / "results.csv").write_text("a,b\n1,2\n")
    with pytest.raises(SystemExit):
        call(monkeypatch, program, "analyse", tmp_path / "results.csv", tmp_path / "out")
    assert "holds no results of the study" in capsys.readouterr().err


class Rig:
    """Where a person shows a grasp and the arm takes one, some millimetres beside; `stop` ends it at that question."""

    def __init__(self, folder, stop=10**6, aborted=(), lost=()):
        self.folder, self.stop, self.aborted, self.lost = folder, stop, aborted, lost
        self.asked = []

    def __call__(self, text):
        if len(self.asked) == self.stop:
            raise KeyboardInterrupt
        self.asked.append(text)
        number, t_grasp = len(self.asked), 1000.0 + len(list(self.folder.iterdir()))
        of = episode(T_base_tool_closed=DOWN @ translation(0.03, 0.02, 0.81), t_grasp=t_grasp, held=True)
        if text.startswith("Put"):
            shown = replace(of.metadata, source=SHOWN)
            self.write(replace(of, metadata=shown, T_base_tool_shown=of.T_base_tool_closed, held=False))
        elif "and train" not in text and number not in self.lost:
            self.write(
                replace(of, T_base_tool_closed=read_only(of.T_base_tool_closed @ translation(0.004, 0.0, 0.003)))
            )
        return "a" if number in self.aborted else ""

    def write(self, made):
        file = self.folder / store.file_name(made)
        file.write_bytes(store.encode(made))
        os.utime(file, (made.t_grasp, made.t_grasp))


def written(file, found):
    """Returns the file, with outcomes as `run` writes them."""
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, person_study.COLUMNS, restval="")
        writer.writeheader()
        for one in found:
            row = {"operator": one.participant, "object": one.case[0], "scene": one.case[1], "method": one.condition}
            came = {} if one.success is None else {"lifted": True, "meant_near": one.success}
            writer.writerow({**row, "shown": one.shown, **came})
    return file


def rows(folder):
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def test_a_participant_is_led_through_and_continues_where_it_stopped(tmp_path, monkeypatch):
    call(monkeypatch, program, "plan", tmp_path, "cup", "bottle", "--participants", "6", "--scenes", "2")
    grasps = tmp_path / "grasps"
    grasps.mkdir()
    trials = program.read_plan(tmp_path)
    own = [t for t in trials if t.participant == 3]
    rig = Rig(grasps, stop=8)
    monkeypatch.setattr("builtins.input", rig)
    with pytest.raises(KeyboardInterrupt):
        call(monkeypatch, program, "run", tmp_path, 3, grasps)
    assert len(rows(tmp_path)) == 3
    rig = Rig(grasps, aborted=(2,), lost=(4,))
    monkeypatch.setattr("builtins.input", rig)
    call(monkeypatch, program, "run", tmp_path, 3, grasps)
    found = rows(tmp_path)
    assert [(r["object"], r["scene"], r["method"]) for r in found] == [(t.kind, str(t.scene), t.condition) for t in own]
    assert {r["shown"] for r in found if r["method"] == BOTH} == {"20"}
    assert found[3]["lifted"] == "" and found[4]["lifted"] == "False"
    for row in (*found[:3], *found[5:]):
        assert float(row["meant_mm"]) == pytest.approx(5.0) and row["meant_near"] == row["lifted"] == "True"
    assert sum(text.startswith("Let the person show") for text in rig.asked) == 1, "the other kind alone"


def test_a_plan_is_drawn_once(tmp_path, monkeypatch, capsys):
    for refused in (False, True):
        if refused:
            with pytest.raises(SystemExit):
                call(monkeypatch, program, "plan", tmp_path, "cup", "bottle")
        else:
            call(monkeypatch, program, "plan", tmp_path, "cup", "bottle")
    assert "File exists" in capsys.readouterr().err


def test_results_become_a_sentence_and_a_picture(tmp_path, monkeypatch, capsys):
    file = written(tmp_path / "results.csv", outcomes((0.3, 0.9, 0.8)))
    call(monkeypatch, program, "analyse", file, tmp_path / "out")
    assert (tmp_path / "out" / "result.md").read_text() == capsys.readouterr().out
    assert (tmp_path / "out" / "curve.png").stat().st_size > 1000
