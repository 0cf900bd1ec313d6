"""What the operator is shown: always the same rows, no bar out of range, and nothing old as if it were new."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.operator_rows import BARS, OLD_ROWS_S, TICKS, Row, RowTone, plain_text
from common.teleop_record import TeleopRecord
from leap_rig.operator.cues import Cue
from leap_rig.operator.view import (
    DELAY_SILENCE_S,
    ArmView,
    DelayView,
    GripView,
    GuardedPair,
    OperatorView,
    jitter,
)

NAMES = ["Hand", "Leader", "Start", "Arm", "Limits", "Guard", "Fingers", "Grip", "Link", "Delay"]
KINDS = (*3 * (TeleopRecord,), ArmView, ArmView, GuardedPair, GripView, GripView, ArmView, DelayView)
KIND_OF = dict(zip(NAMES, KINDS))


def hand_record(state, follows, reason, conditions, fulfilled, limits):
    return TeleopRecord(state, reason, follows, conditions=conditions, fulfilled=fulfilled, limits=limits)


numbers = st.floats(allow_nan=True, allow_infinity=True)
words = st.text("ab c", max_size=30)
states = st.sampled_from(["waiting", "running", "?"])
lists = st.lists(words, max_size=5)
three = st.tuples(numbers, numbers, numbers)
taxels = st.lists(numbers, min_size=1, max_size=3)
records = st.one_of(
    st.builds(hand_record, states, st.booleans(), words, lists, st.lists(st.booleans()), lists),
    st.builds(ArmView, st.sampled_from(["home", "servo", "stopped"]), words, lists, numbers),
    st.builds(GuardedPair, st.booleans(), numbers, numbers, numbers, st.tuples(words, words)),
    st.builds(GripView, three, st.tuples(*[taxels] * 3), st.tuples(*[st.booleans()] * 3)),
    st.builds(DelayView, numbers),
)  # fmt: skip


@given(st.lists(st.tuples(records, st.floats(0.0, 3.0)), max_size=12), st.floats(0.0, 8.0))
def test_the_rows_are_always_the_same_and_show_old_records_as_old(arrivals, silence):
    view, now, at = OperatorView(60.0), 100.0, {}
    for record, pause in arrivals:
        now += pause
        view.take(record, now)
        at[type(record)] = now
    now += silence
    rows = view.rows(now)
    assert [row.name for row in rows] == NAMES
    for row in rows:
        limit = DELAY_SILENCE_S if row.name == "Delay" else OLD_ROWS_S
        kind = KIND_OF[row.name]
        assert (row.tone is RowTone.STALE) == (kind not in at or now - at[kind] > limit)
        assert (row.text == "-") >= (kind not in at) and "nan" not in row.text and "inf" not in row.text
        assert len(row.labels) == len(row.values)
        assert all(0.0 <= value <= 1.0 for value in row.values)
    assert all(0.0 <= value <= 1.0 for taxels in view.taxels(now) for value in taxels)
    cue = view.cue(now)
    hand = view._fresh(TeleopRecord, now)
    assert (rows[0].tone is RowTone.GOOD) == (hand is not None and hand.follows)
    arm_known, limits = rows[3].tone is not RowTone.STALE, rows[4].text
    assert not arm_known or limits.endswith("hand unknown") == (hand is None)
    assert cue.engaged == (hand is not None and hand.state == "running") and cue.stopped >= (
        rows[3].tone is RowTone.FAULT
    )


@given(st.lists(st.floats(0.0, 1.0), max_size=60), st.floats(0.0, 1.0))
def test_jitter_is_the_change_and_not_the_length_of_the_round_trips(times, more):
    found = jitter(times)
    assert 0.0 <= found <= max(times, default=0.0) - min(times, default=0.0) + 1e-12
    assert jitter([time + more for time in times]) == pytest.approx(found, abs=1e-9)


def rows_after(*taken):
    view = OperatorView(60.0)
    for record in taken:
        view.take(record, 1.0)
    return {row.name: row for row in view.rows(1.1)}


@pytest.mark.parametrize(
    ("touches", "text"),
    [
        ((False, False, False), "free"),
        ((True, True, False), "touches"),
        ((False, False, True), "touches"),
        ((False, True, True), "grips"),
    ],
)
def test_a_grip_needs_the_thumb_and_a_finger(touches, text):
    grip = GripView((0.0, 1.0, 2.0), ([6.0] * 9, [0.0] * 8 + [30.0], [math.nan] * 9), touches)
    rows = rows_after(grip)
    assert (rows["Grip"].text, rows["Grip"].values) == (text, (0.1, 0.5, 0.0))
    assert rows["Fingers"].values == (0.0, 0.5, 1.0)


def test_what_acts_is_named():
    waiting = rows_after(hand_record("waiting", False, "", ["in the box", "flat"], [True], []))["Start"]
    assert (waiting.values, waiting.text) == ((1.0, 0.0), "1 of 2 conditions")
    hand = hand_record("running", True, "right hand 3 is followed", ["in the box", "flat"], [True], ["yaw"])
    arm = ArmView("servo", "follows", ["z lower limit"], 0.002, "LeapRigServer 1", ["stop", "watchdog"])
    rows = rows_after(hand, arm, GuardedPair(True, 0.05, 0.02, 0.4, ("distal_1", "table")))
    assert rows["Start"].labels == ()
    assert (rows["Limits"].text, rows["Limits"].tone) == ("z lower limit, hand's yaw", RowTone.WARNING)
    assert rows["Guard"].text == "50 mm from distal_1 to table, 40 % of the speed"
    assert rows["Link"].text == "round trip 2.0 ms, jitter 0.0 ms; LeapRigServer 1 (stop, watchdog)"
    assert rows_after(GuardedPair(True, math.inf, 0.02, 1.0, ("", "")))["Guard"].text == "nothing near"


@pytest.mark.parametrize(("distance", "scale"), [(0.02, 1.0), (-0.01, 1.0), (0.05, 0.0), (0.05, math.nan)])
def test_a_guard_that_stops_the_arm_is_a_fault(distance, scale):
    row = rows_after(GuardedPair(True, distance, 0.02, scale, ("palm", "table")))["Guard"]
    assert row.text.endswith("mm from palm to table, stopped") and row.tone is RowTone.FAULT


def test_what_can_be_heard():
    def cue(*taken, at=1.1):
        view = OperatorView(60.0)
        for record in taken:
            view.take(record, 1.0)
        return view.cue(at)

    hand, arm = hand_record("running", True, "", [], [], []), ArmView("servo", "", [], 0.0)
    assert cue() == Cue(False, False, False)
    assert cue(hand, arm, GuardedPair(True, 0.1, 0.02, 1.0, ("", ""))) == Cue(True, False, False)
    for limited in (
        hand_record("running", True, "", [], [], ["yaw"]),
        ArmView("servo", "", ["z lower limit"], 0.0),
        GuardedPair(True, 0.05, 0.02, 0.4, ("palm", "table")),
    ):
        assert cue(hand, arm, limited) == Cue(True, True, False)
    assert cue(hand, arm, GuardedPair(False, 0.05, 0.02, 0.4, ("", ""))) == Cue(True, False, False)
    assert cue(hand, ArmView("stopped", "", [], 0.0)) == Cue(True, False, True)
    assert cue(hand, arm, at=1.1 + OLD_ROWS_S) == Cue(False, False, True), "a silent controller counts as a stop"


def test_plain_text_is_short():
    rows = [
        Row("Hand", "word " * 40, RowTone.GOOD),
        Row("Start", "1 of 3", RowTone.NORMAL, TICKS, ("slow", "in the box", "level"), (1.0, 0.0, 0.0)),
        Row("Grip", "free", RowTone.GOOD, BARS, ("index",), (0.5,)),
    ]
    lines = plain_text(rows, 40).splitlines()
    assert max(map(len, lines)) <= 40 and lines[2].endswith(" ...")
    assert lines[3:] == ["Start: 1 of 3", "  - in the box, level", "Grip: free"]


@pytest.mark.parametrize(
    ("state", "hold", "leader"),
    [
        ("running", "none", "hand"),
        ("running", "taken", "hand"),
        ("holding", "led", "policy"),
        ("holding", "kept", "nobody"),
        ("waiting", "none", "nobody"),
    ],
)
def test_the_operator_sees_who_leads(state, hold, leader):
    assert rows_after(TeleopRecord(state, "", hold=hold))["Leader"].text == leader


@pytest.mark.ros
@pytest.mark.parametrize("arm", ["", "left", "right"])
def test_a_longer_text_in_rviz_grows_upwards_where_nothing_is(arm):
    from common.frames import ArmFrames
    from common.numbers import LABEL_M
    from leap_rig.operator.ros.markers import view_markers

    bottoms = set()
    for count in (1, 2, 15):
        text = view_markers([Row("Hand", "waits", RowTone.GOOD)] * count, [], ArmFrames(arm)).markers[0]
        bottoms.add(round(text.pose.position.z - 0.5 * count * LABEL_M, 9))
        assert text.scale.z == LABEL_M
    assert len(bottoms) == 1


@pytest.mark.ros
def test_a_marker_outlives_the_pause_between_two_messages():
    from leap_rig.operator.ros.markers import LIFETIME
    from leap_rig.operator.ros.view_node import HEARTBEAT_S, PERIOD_S

    assert LIFETIME.to_sec() >= HEARTBEAT_S + 3.0 * PERIOD_S
