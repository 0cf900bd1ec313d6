"""Episodes of a session: marks, labels on the disk, what counts as success, and the sign of the second hand."""

import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from leap_rig.recording import session as s
from leap_rig.recording.criterion import SeenObject, SuccessJudge, SuccessRule
from leap_rig.recording.fist_sign import FistSign
from leap_rig.recording.session import EpisodeChange, EpisodeFault, EpisodeLabel, EpisodeSession

steps = st.lists(st.tuples(st.sampled_from([*s.MARKS, ""]), st.sampled_from([0.1, 1.0, 4.0])), max_size=40)


def done(walk, countdown=2, longest=8.0):
    """All changes of marks that follow each other, each after a time."""
    session, now, found = EpisodeSession(5, countdown, longest), 100.0, []
    for mark, passed in walk:
        now += passed
        found += session.step(now)
        if mark:
            try:
                found += session.mark(mark, now)
            except EpisodeFault as fault:
                assert str(fault).endswith(".")
    return found + list(session.close())


@given(steps)
def test_each_episode_begins_once_and_ends_once_in_order(walk):
    found = [one for one in done(walk) if one.what in (s.BEGUN, s.ENDED)]
    assert [one.what for one in found] == [s.BEGUN, s.ENDED] * (len(found) // 2)
    assert [one.number for one in found] == [5 + i // 2 for i in range(len(found))]


@given(steps)
def test_only_an_ended_episode_gets_another_label(walk):
    ended = set()
    for one in done(walk):
        if one.what == s.ENDED:
            ended.add(one.number)
        assert one.what != s.LABELLED or one.number == max(ended)


@given(steps)
def test_no_episode_begins_without_its_whole_countdown(walk):
    counted = []
    for one in done(walk):
        counted = [*counted, one.number] if one.what == s.COUNTED else counted
        if one.what == s.BEGUN:
            assert counted and counted[0] == 2
        if one.what in (s.BEGUN, s.ENDED):
            counted = []


def test_an_episode_is_begun_ended_and_labelled_anew():
    session = EpisodeSession(0, 2, 30.0)
    assert session.mark(s.BEGIN, 0.0) == (EpisodeChange(s.COUNTED, 2),)
    assert session.step(0.5) == () and session.step(1.0) == (EpisodeChange(s.COUNTED, 1),)
    assert session.step(2.0) == (EpisodeChange(s.BEGUN, 0),)
    with pytest.raises(EpisodeFault, match="Episode 0 runs"):
        session.mark(s.BEGIN, 3.0)
    assert session.mark(s.SUCCESS, 4.0) == (EpisodeChange(s.ENDED, 0, s.SUCCESS),)
    assert session.mark(s.FAILURE, 5.0) == (EpisodeChange(s.LABELLED, 0, s.FAILURE),)
    assert session.mark(s.AGAIN, 6.0) == (EpisodeChange(s.LABELLED, 0, s.DISCARDED), EpisodeChange(s.COUNTED, 2))
    assert session.step(8.0) == (EpisodeChange(s.BEGUN, 1),)
    assert session.mark(s.AGAIN, 9.0) == (EpisodeChange(s.ENDED, 1, s.DISCARDED), EpisodeChange(s.COUNTED, 2))
    assert session.mark(s.DISCARD, 9.5) == () and session.step(60.0) == ()


def test_an_episode_that_nobody_ends_ends_without_an_outcome():
    session = EpisodeSession(0, 0, 30.0)
    assert session.mark(s.BEGIN, 0.0) == () and session.step(0.0) == (EpisodeChange(s.BEGUN, 0),)
    assert session.step(29.9) == () and session.step(30.0) == (EpisodeChange(s.ENDED, 0),)
    with pytest.raises(EpisodeFault, match="must be one of"):
        session.mark("won", 31.0)


def test_before_the_first_episode_there_is_nothing_to_label():
    with pytest.raises(EpisodeFault, match="no episode yet"):
        EpisodeSession(0, 1, 1.0).mark(s.SUCCESS, 0.0)


def labelled(tmp_path, number, **values):
    folder = s.episode_folder(tmp_path, number)
    folder.mkdir()
    s.write_label(folder, EpisodeLabel(**values))
    return folder


def test_what_a_person_says_counts_before_what_was_measured(tmp_path):
    good = labelled(tmp_path, 0, said=s.SUCCESS, measured=s.FAILURE, task="lift the cup")
    measured = labelled(tmp_path, 3, measured=s.SUCCESS)
    labelled(tmp_path, 4, said=s.DISCARDED, measured=s.SUCCESS)
    labelled(tmp_path, 5)
    (tmp_path / "notes").mkdir()
    assert s.chosen(tmp_path) == [good, measured] and s.next_number(tmp_path) == 6
    s.relabel(measured, s.FAILURE)
    assert s.chosen(tmp_path) == [good] and s.chosen(tmp_path, (s.FAILURE,)) == [measured]
    assert s.read_label(measured).measured == s.SUCCESS, "it stays beside"
    with pytest.raises(EpisodeFault, match="none is labelled unfinished"):
        s.chosen(tmp_path, (s.UNFINISHED,))
    assert s.next_number(tmp_path / "none") == 0


@pytest.mark.parametrize(
    "content",
    ["", "[", "- 1", "schema: 2", "schema: 1\nsaid: won", "schema: 1\nmeasured: discarded", "schema: 1\ntask: 5",
     "schema: 1\nmore: x", "said: success"],
)  # fmt: skip
def test_a_bad_label_is_named(tmp_path, content):
    (tmp_path / s.LABEL).write_text(content)
    with pytest.raises(EpisodeFault, match=r"label\.yaml .*\.$"):
        s.read_label(tmp_path)
    with pytest.raises(EpisodeFault, match="cannot be read"):
        s.read_label(tmp_path / "none")


def test_a_label_is_read_as_it_was_written(tmp_path):
    label = EpisodeLabel(s.SUCCESS, s.FAILURE, "the cup fell: é", "Lift the cup, twice", "7")
    s.write_label(tmp_path, label)
    assert s.read_label(tmp_path) == label
    assert yaml.safe_load((tmp_path / s.LABEL).read_text())["why"] == "the cup fell: é"


def cup(x=0.5, clearance=0.0, touched=False, speed=0.0, name="cup"):
    return SeenObject(name, x, 0.1, clearance, speed, touched)


def verdict(rule, *seen, fingers=None, thing=""):
    judge = SuccessJudge(SuccessRule.parse(rule), thing)
    for one in seen:
        judge.objects([one])
    if fingers is not None:
        judge.fingers(fingers)
    return judge.verdict()[0]


UP = cup(clearance=0.06, touched=True)


@pytest.mark.parametrize(
    ("rule", "seen", "expected"),
    [
        ("", (UP,), ""),
        ("lifted", (), ""),
        ("lifted", (UP,), s.SUCCESS),
        ("lifted", (UP, cup()), s.FAILURE),
        ("lifted", (cup(clearance=0.06),), s.FAILURE),
        ("lifted", (cup(clearance=0.04, touched=True),), s.FAILURE),
        ("placed:0.5,0.1,0.02", (UP, cup(0.51)), s.SUCCESS),
        ("placed:0.5,0.1,0.02", (UP, cup(0.53)), s.FAILURE),
        ("placed:0.5,0.1,0.02", (UP, cup(0.51, touched=True)), s.FAILURE),
        ("placed:0.5,0.1,0.02", (UP, cup(0.51, speed=0.1)), s.FAILURE),
        ("placed:0.5,0.1,0.02", (cup(0.51),), s.FAILURE),
    ],
)
def test_the_world_says_whether_it_succeeded(rule, seen, expected):
    assert verdict(rule, *seen) == expected


def test_one_object_counts_alone():
    assert verdict("lifted", UP, thing="cup") == s.SUCCESS
    assert verdict("lifted", UP, thing="box") == s.FAILURE


def test_two_fingers_that_touch_hold():
    assert verdict("held") == "" and verdict("held", fingers=1) == s.FAILURE and verdict("held", fingers=2) == s.SUCCESS


@pytest.mark.parametrize(
    "rule", ["won", "lifted:1", "placed", "placed:1,2", "placed:1,2,x", "placed:0,0,0", "placed:nan,0,1", "held:"]
)
def test_a_rule_that_says_nothing_is_refused(rule):
    if rule == "held:":
        assert SuccessRule.parse(rule) == SuccessRule("held")
        return
    with pytest.raises(EpisodeFault, match="must be held, lifted, or placed"):
        SuccessRule.parse(rule)


def signs(*grabs, step=0.1):
    sign = FistSign()
    return [i for i, grab in enumerate(grabs) if sign.step(grab, 7.0 + step * i)]


def test_a_fist_held_for_a_second_is_a_sign_once():
    assert signs(*[0.0] * 3, *[1.0] * 40) == [13]
    assert signs(*[0.0] * 3, *[1.0] * 40, 0.0, *[1.0] * 20) == [13, 54]
    assert signs(*[1.0] * 40) == [], "it must be seen open first"
    assert signs(*[0.0] * 3, *[1.0] * 9, 0.5, *[1.0] * 9, 0.5) == []


def test_a_hand_that_is_lost_gives_no_sign():
    assert signs(0.0, *[1.0] * 5, math.nan, *[1.0] * 30) == []
