"""The tutorial: no step is ticked without its deed, in the fixed order, never on stale records; its texts."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.limits import Limit, known_limits
from common.poses import pose
from common.reasons import ReasonCode
from common.rotations import rotation_about
from common.teleop_record import TeleopRecord
from leap_kuka.start_gate import BOX, CONDITIONS, PITCH, ROLL
from leap_rig.operator.tutorial import (
    DONE,
    FRESH_S,
    HINT_S,
    HINTS,
    STEPS,
    ArmRecord,
    FingersRecord,
    FlangeRecord,
    Tutorial,
)
from leap_rig.operator.tutorial_texts import ENGLISH, GERMAN, TEXTS, language_of

WITHOUT_CLUTCH = tuple(step for step in STEPS if step != "clutch")
NONE_MET, ALL_MET = frozenset(), frozenset(CONDITIONS)
NO_HAND, IN_BOX = (ReasonCode.NO_HAND,), (ReasonCode.FILLING,)
NO_HINT = {
    ReasonCode.FILLING, ReasonCode.FOLLOWED, ReasonCode.TRACKER_SLOW, ReasonCode.ARM_NOT_READY, ReasonCode.OUT_OF_REACH,
    ReasonCode.NOT_ENABLED, ReasonCode.CLUTCHED, ReasonCode.ELSEWHERE, ReasonCode.CONTROL_OFF, ReasonCode.ARM_LEFT,
    ReasonCode.HOLD, ReasonCode.EXPIRED, ReasonCode.LED, ReasonCode.LEAD_LOST,
}  # fmt: skip
"""The visitor cannot do anything about these, or the step's own hint says what to do."""


class Visitor:
    """Publishes what the rig would, ten times a second."""

    def __init__(self, clutch=False):
        self.tutorial, self.now = Tutorial(clutch), 0.0
        self.state, self.fulfilled, self.running, self.codes = "waiting", NONE_MET, False, NO_HAND
        self.mode, self.control_on = "home", True
        self.x, self.angle, self.closed, self.limited_by = 0.0, 0.0, 0.0, ()
        self.clutched = False
        self.silent = set()
        self.view = self.tutorial.view(0.0)

    def records(self):
        fulfilled = ALL_MET if self.running else self.fulfilled
        state = "running" if self.running else self.state
        conditions = tuple(fulfilled)
        yield TeleopRecord(
            state, "", self.running, clutched=self.clutched, codes=self.codes,
            conditions=conditions, fulfilled=(True,) * len(conditions),
        )  # fmt: skip
        yield ArmRecord(self.mode, self.control_on, True, self.limited_by)
        yield FlangeRecord(pose(rotation_about(1, self.angle), [self.x, 0.0, 0.5]))
        yield FingersRecord(self.closed)

    def wait(self, seconds=0.1, **changes):
        for name, value in changes.items():
            setattr(self, name, value)
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            for record in self.records():
                if type(record) not in self.silent:
                    self.tutorial.take(record, self.now)
            self.view = self.tutorial.view(self.now)
        return self.view

    def engage(self):
        return self.wait(1.5, running=True, codes=(ReasonCode.FOLLOWED,), mode="servo")

    def do(self, step):
        """Does what the step asks for."""
        if step == "flat":
            self.wait(0.6, codes=IN_BOX, fulfilled=ALL_MET)
        elif step == "green":
            self.engage()
        elif step == "move":
            self.wait(x=self.x)
            self.wait(x=self.x + 0.1)
        elif step == "fingers":
            self.wait(closed=0.0)
            self.wait(closed=1.0)
        elif step == "tilt":
            self.wait(angle=self.angle)
            self.wait(angle=self.angle + 0.2)
        elif step == "clutch":
            self.wait(clutched=True)
            self.wait(clutched=False)
        else:
            self.wait(1.0, running=False, fulfilled=NONE_MET, codes=NO_HAND, mode="returning")


@pytest.mark.parametrize(("clutch", "steps"), [(False, WITHOUT_CLUTCH), (True, STEPS)])
def test_each_step_is_ticked_by_its_deed_in_the_order(clutch, steps):
    visitor = Visitor(clutch)
    visitor.wait(0.2)
    for i, step in enumerate(steps):
        assert (visitor.view.step, visitor.view.ticked, visitor.view.steps) == (step, i, steps)
        visitor.do(step)
    assert visitor.view.step == DONE and visitor.view.progress == 1.0 and visitor.view.hint == ""


@given(st.data())
@settings(max_examples=60)
def test_no_other_deed_ticks_a_step(data):
    """Whatever is done before, a step is only ticked by its own deed; `away` ends what the others need."""
    visitor = Visitor()
    for i, step in enumerate(WITHOUT_CLUTCH):
        others = [other for other in WITHOUT_CLUTCH if other not in (step, "away")]
        others = {"flat": ["fingers"], "green": ["flat", "fingers"]}.get(step, others)
        for other in data.draw(st.lists(st.sampled_from(others), max_size=4)):
            visitor.do(other)
            assert visitor.view.step == step
        if i > 1 and step != "away":
            visitor.engage()
        visitor.do(step)
        assert visitor.view.ticked == i + 1


@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                ["running", "codes", "mode", "x", "angle", "closed", "clutched", "control_on", "state", "fulfilled"]
            ),
            st.integers(0, 3),
            st.floats(0.1, 3.0),
        ),
        max_size=40,
    ),
    st.booleans(),
)
@settings(max_examples=60)
def test_whatever_happens_steps_never_go_back_and_never_jump(events, clutch):
    values = {
        "running": [True, True, True, False], "codes": [NO_HAND, IN_BOX, (ReasonCode.HAND_GONE,), ()],
        "mode": ["servo", "servo", "returning", ""], "x": [0.0, 0.05, 0.2, float("nan")],
        "angle": [0.0, 0.05, 0.3, float("nan")], "closed": [0.0, 0.5, 1.0, float("nan")],
        "clutched": [False, True, False, True], "control_on": [True, False, True, True],
        "state": ["waiting", "holding", "clutched", ""], "fulfilled": [NONE_MET, ALL_MET, ALL_MET - {PITCH}, {"?"}],
    }  # fmt: skip
    visitor, before = Visitor(clutch), 0
    for name, value, seconds in events:
        setattr(visitor, name, values[name][value])
        for _ in range(round(10 * seconds)):
            view = visitor.wait()
            assert before <= view.ticked <= before + 1 and 0.0 <= view.progress <= 1.0
            assert view.step == (*view.steps, DONE)[view.ticked]
            assert all(f"hint_{view.hint}" in texts for texts in TEXTS.values() if view.hint)
            before = view.ticked


NEEDED = {
    "flat": {TeleopRecord}, "green": {TeleopRecord, ArmRecord}, "move": {TeleopRecord, ArmRecord, FlangeRecord},
    "fingers": {TeleopRecord, ArmRecord, FingersRecord}, "tilt": {TeleopRecord, ArmRecord, FlangeRecord},
    "clutch": {TeleopRecord, ArmRecord}, "away": {TeleopRecord, ArmRecord},
}  # fmt: skip


@pytest.mark.parametrize(("step", "kind"), [(step, kind) for step in STEPS for kind in sorted(NEEDED[step], key=str)])
def test_a_silent_topic_ticks_nothing(step, kind):
    visitor = Visitor(clutch=True)
    visitor.wait()
    for before in STEPS[: STEPS.index(step)]:
        visitor.do(before)
    visitor.silent = {kind}
    visitor.wait(FRESH_S[kind] + 0.2)
    visitor.do(step)
    assert visitor.view.step == step
    visitor.silent = set()
    if step not in ("flat", "green", "away"):
        visitor.engage()
    visitor.do(step)
    assert visitor.view.ticked == STEPS.index(step) + 1


CODES = st.lists(st.sampled_from(ReasonCode), max_size=3)


@given(st.sets(st.sampled_from(CONDITIONS)), st.sampled_from(["waiting", "holding", "clutched"]), CODES)
def test_only_a_hand_in_the_box_and_level_is_flat(met, state, codes):
    visitor = Visitor()
    for reason in (IN_BOX, tuple(codes), NO_HAND):
        visitor.wait(1.0, codes=reason, fulfilled=frozenset(met), state=state)
    assert visitor.view.ticked == (met >= {BOX, PITCH, ROLL} and state == "waiting")


@given(st.booleans(), st.integers(1, 40), st.sampled_from([ReasonCode.NO_HAND, ReasonCode.HAND_GONE]))
def test_with_a_relative_engagement_the_hand_is_away_when_the_hold_has_ended(clutch, held, gone):
    visitor = Visitor(clutch)
    for step in visitor.view.steps[:-1]:
        visitor.do(step)
    visitor.wait(HINT_S + 1.0, running=False, state="holding", codes=(ReasonCode.UNSURE,))
    assert visitor.view.hint == "away"
    for state in ("holding", "clutched"):
        visitor.wait(held, state=state, codes=(gone,))
        assert (visitor.view.step, visitor.view.hint) == ("away", "held")
    visitor.wait(1.0, state="waiting", codes=NO_HAND, mode="returning")
    assert visitor.view.step == DONE


def test_a_leap_that_falls_silent_is_no_hand_taken_away():
    visitor = Visitor()
    for step in visitor.view.steps[:-1]:
        visitor.do(step)
    visitor.wait(9.0, running=False, codes=(ReasonCode.TRACKER_SILENT,), mode="returning")
    assert visitor.view.step == "away"


def test_a_pause_between_two_views_is_no_waiting():
    visitor = Visitor()
    visitor.wait(0.1, codes=IN_BOX, fulfilled=ALL_MET)
    visitor.now += 10.0
    visitor.wait(0.1)
    assert visitor.view.step == "flat"


def test_the_way_of_the_arm_without_a_hand_is_no_move():
    visitor = Visitor()
    for step in ("flat", "green"):
        visitor.do(step)
    visitor.wait(1.0, running=False, codes=NO_HAND, mode="returning")
    visitor.wait(1.0, x=0.5, angle=1.0)
    visitor.engage()
    assert visitor.view.step == "move" and visitor.view.progress == 0.0


def test_a_hint_comes_after_some_seconds_and_names_what_hinders():
    visitor, codes = Visitor(), (ReasonCode.ARM_NOT_READY, ReasonCode.LEFT_OF_BOX, ReasonCode.ABOVE_BOX)
    assert visitor.wait(HINT_S - 0.5, codes=codes).hint == ""
    assert visitor.wait(1.0).hint == "too_left"
    assert visitor.wait(0.2, control_on=False).hint == "control_off"
    visitor.silent = {TeleopRecord}
    assert visitor.wait(2.0).hint == "no_leap"


HINT_AT = {
    "opening angle": "edge",
    "lower z limit": "edge",
    "upper z limit": "edge",
    "inner sphere": "edge",
    "outer sphere": "edge",
    "reach": "move",
    "workspace": "edge",
    "joint limit": "edge",
    "joint speed": "slower",
    "arm speed": "slower",
    "frame rate": "move",
    "joint acceleration": "move",
    "lag of the arm": "move",
    "collision guard": "move",
    "gap between goals": "move",
}
"""The hint in the step "move" while kuka/status names a limit."""


def test_a_limit_of_the_arm_hints_back_to_the_middle_or_slower():
    visitor = Visitor()
    for step in ("flat", "green"):
        visitor.do(step)
    visitor.wait(HINT_S + 0.5)
    for name, hint in HINT_AT.items():
        assert visitor.wait(0.2, limited_by=known_limits([name, "of a newer version"])).hint == hint, name
    assert set(HINT_AT) == {limit.value for limit in Limit}


@pytest.mark.parametrize("code", ReasonCode)
def test_every_reason_has_a_hint_or_is_listed_as_needing_none(code):
    assert (code in HINTS) is not (code in NO_HINT)
    visitor = Visitor()
    assert visitor.wait(HINT_S + 0.5, codes=(code,)).hint == HINTS.get(code, "flat")


def test_every_text_is_there_in_every_language():
    assert TEXTS[ENGLISH].keys() == TEXTS[GERMAN].keys()
    needed = {f"{kind}_{step}" for kind in ("name", "do", "hint") for step in STEPS} | {"title", f"do_{DONE}"}
    needed |= {f"hint_{key}" for key in HINTS.values()}
    assert needed <= TEXTS[ENGLISH].keys() and all(text.strip() for texts in TEXTS.values() for text in texts.values())


def test_the_language_is_the_wanted_one_or_that_of_the_environment():
    assert [language_of("en", "de_DE.UTF-8"), language_of("", "de_AT"), language_of("", "C")] == ["en", "de", "en"]
