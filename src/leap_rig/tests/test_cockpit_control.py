"""Who has control in the cockpit, and what a page may hold."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_kuka.numbers import DEVICE_SILENCE_S
from leap_kuka.operator_switches import DeviceSwitches
from leap_rig.cockpit.control import CLUTCH, ENABLE, HEARTBEAT_S, CockpitControl, CockpitPage, DeviceReports
from leap_rig.cockpit.messages import MARKS, PageMessageFault, read_command, state_text

ARMS = ("left", "right")
HELD = st.sampled_from([frozenset(), frozenset({ENABLE}), frozenset({CLUTCH}), frozenset({ENABLE, CLUTCH})])
EVENTS = st.one_of(
    st.tuples(st.just("take"), st.integers(0, 2)),
    st.tuples(st.just("give"), st.integers(0, 2)),
    st.tuples(st.just("beat"), st.integers(0, 2), st.booleans(), HELD),
    st.tuples(st.just("wait"), st.sampled_from([0.1, HEARTBEAT_S, HEARTBEAT_S + 0.01])),
)


def admitted(control, name="page", address="10.0.0.1"):
    page = CockpitPage(name)
    assert control.admit(page, control.access.code, address, 0.0) == ""
    return page


@given(st.lists(EVENTS, max_size=60))
def test_what_is_held_is_what_one_page_with_the_code_holds_now(events):
    control, now = CockpitControl(ARMS), 100.0
    pages = [admitted(control, "a"), admitted(control, "b"), CockpitPage("without the code")]
    last = {}  # of each page: when it was heard, with focus, and what it held
    clutched = False
    for kind, which, *more in events:
        if kind == "take":
            control.take(pages[which], now)
        elif kind == "give":
            control.give(pages[which])
        elif kind == "wait":
            now += which
        else:
            focused, held = more
            control.beat(pages[which], focused, {"left": held}, now)
            last[which] = now, focused, held
        control.watch(now)
        switches, controller = control.switches["left"], control.controller
        assert controller is None or controller.page.key
        if switches.enable:
            heard, focused, held = last[pages.index(controller.page)]
            assert now - heard <= HEARTBEAT_S and focused and ENABLE in held
        if clutched and not switches.clutch:  # opened by a live page that just said so
            assert kind == "beat" and controller.page is pages[which] and more[0] and CLUTCH not in more[1]
        clutched = switches.clutch
        assert control.switches["right"].enable is False
        live = control.live(now)
        assert live is (controller is not None and controller.focused and now - controller.heard <= HEARTBEAT_S)
        assert [control.refusal(page, now) == "" for page in pages] == [
            live and controller.page is page for page in pages
        ]


@given(st.lists(st.tuples(st.sampled_from(["hold", "hide", "lose", "take"]), HELD, st.integers(0, 20)), max_size=30))
def test_leap_kuka_enables_only_while_a_live_page_holds_that_and_unclutches_only_by_one(events):
    """The arm's side of the reports, at the period of the cockpit's node."""
    control, reports, device, now = CockpitControl(("",)), DeviceReports(), DeviceSwitches(), 100.0
    page, dead_since = admitted(control), 0.0
    for kind, held, periods in events:
        if kind == "take":
            control.take(page, now)
        elif kind == "lose":
            control.give(page)
        for _ in range(periods):
            if kind in ("hold", "hide"):
                control.beat(page, kind == "hold", {"": held}, now)
            now += 0.05
            control.watch(now)
            switches, live = control.switches[""], control.live(now)
            if reports.due(switches.enable, switches.clutch, live, now):
                device.take(switches.enable, switches.clutch, "cockpit", 0.0, now)
            if device.enabled(now):
                assert live and switches.enable
            dead_since = math.inf if live else min(dead_since, now)
            assert device.clutch(now) or now - dead_since <= DEVICE_SILENCE_S
            if live or switches.clutch:
                assert not device.silent(now)


def test_the_first_press_on_a_page_counts_and_each_change_at_once():
    control, reports, device, now = CockpitControl(("",)), DeviceReports(), DeviceSwitches(), 100.0
    page = admitted(control)
    control.take(page, now)
    for held in [set()] * 2 + [{ENABLE}] * 3 + [set()]:
        now += 0.03
        control.beat(page, True, {"": held}, now)
        switches = control.switches[""]
        if reports.due(switches.enable, switches.clutch, control.live(now), now):
            device.take(switches.enable, switches.clutch, "cockpit", 0.0, now)
        assert device.enabled(now) is bool(held)


def test_enabling_needs_a_press_after_a_release_and_after_each_loss():
    control = CockpitControl(("",))
    page = admitted(control)
    assert control.take(page, 0.0) == ""
    enable, nothing = {"": {ENABLE}}, {}
    assert_enabled = lambda expected: control.switches[""].enable is expected  # noqa: E731
    control.beat(page, True, enable, 0.1)
    assert assert_enabled(False)
    control.beat(page, True, nothing, 0.2)
    control.beat(page, True, enable, 0.3)
    assert assert_enabled(True)
    control.watch(0.3 + HEARTBEAT_S)
    assert assert_enabled(True)
    control.watch(0.31 + HEARTBEAT_S)
    assert assert_enabled(False)
    control.beat(page, True, enable, 1.0)
    assert assert_enabled(False)
    control.beat(page, True, nothing, 1.1)
    control.beat(page, True, enable, 1.2)
    control.beat(page, False, enable, 1.3)
    control.beat(page, True, enable, 1.4)
    assert assert_enabled(False)


def test_a_clutch_that_was_held_stays_pressed_after_a_loss_until_it_is_pressed_and_released():
    control = CockpitControl(("",))
    page = admitted(control)
    control.take(page, 0.0)
    control.beat(page, True, {"": {CLUTCH}}, 0.1)
    assert not control.switches[""].stuck
    control.give(page)
    assert control.switches[""].stuck
    other = admitted(control)
    control.take(other, 1.0)
    control.beat(other, True, {}, 1.1)
    assert control.switches[""].clutch and control.switches[""].stuck
    control.beat(other, True, {"": {CLUTCH}}, 1.2)
    control.beat(other, True, {}, 1.3)
    assert not control.switches[""].clutch and not control.switches[""].stuck


def test_another_page_reads_who_has_control_and_since_when():
    control = CockpitControl(("",))
    first, second = admitted(control, "Page 1 at 10.0.0.1"), admitted(control)
    control.take(first, 10.0)
    assert control.take(second, 52.0) == "Page 1 at 10.0.0.1 has had control for 42 s. Ask there to give it back."
    control.give(first)
    assert control.take(second, 53.0) == ""


def test_a_page_that_comes_back_with_its_key_has_its_control_again_but_holds_nothing():
    control = CockpitControl(("",))
    page = admitted(control)
    control.take(page, 0.0)
    control.beat(page, True, {}, 0.1)
    control.beat(page, True, {"": {ENABLE}}, 0.2)
    back = CockpitPage("back")
    assert control.admit(back, page.key, "10.0.0.1", 0.3) == "" and control.take(back, 0.3) == ""
    assert not control.switches[""].enable and control.refusal(page, 0.3)
    control.give(page)
    assert control.controller.page is back


def test_an_old_code_is_no_code():
    control = CockpitControl(("",))
    code = control.access.code
    admitted(control)
    assert "not the code" in control.admit(CockpitPage("late"), code, "10.0.0.2", 0.0)
    assert "try again in" in control.admit(CockpitPage("late"), control.access.code, "10.0.0.2", 0.5)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
NAMES = st.sampled_from(
    ["control", "pause", "guide", "gripper", "scaling", "exit", "record", "mark", "tutorial", "operator", "choose",
     "beat", "secret", "policy", "x"]
)  # fmt: skip


@given(
    st.one_of(
        st.text(), st.binary(), JSON.map(json.dumps),
        st.fixed_dictionaries(
            {"do": NAMES | JSON},
            optional={
                "arm": st.sampled_from(ARMS) | JSON, "value": JSON | st.sampled_from([*MARKS, *ARMS, "both"]),
                "text": JSON, "held": JSON, "focus": JSON,
            },
        ).map(json.dumps),
    )
)  # fmt: skip
def test_whatever_a_page_sends_is_a_sound_command_or_refused(text):
    try:
        name, arm, value, _ = read_command(text, ARMS)
    except PageMessageFault:
        return
    if name in ("control", "pause", "guide", "gripper", "policy", "scaling", "exit"):
        assert arm in ARMS
    if name in ("control", "pause", "guide", "gripper", "policy", "record", "tutorial"):
        assert value is True or value is False
    if name == "mark":
        assert value[0] in MARKS and value[1].isprintable() and len(value[1]) <= 200
    if name == "operator":
        assert arm in ARMS and value.isprintable() and len(value) <= 200
    if name == "choose":
        assert value in (*ARMS, "both")
    if name == "scaling":
        assert 0.1 <= value <= 1.5
    if name == "beat":
        assert value[0] in (True, False) and set(value[1]) <= set(ARMS)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 10**5,
        '{"do": "choose", "value": "x"}',
        '{"do": "scaling", "arm": "left", "value": NaN}',
        '{"do": "control"}',
    ],
)
def test_what_no_page_sends_is_refused(text):
    with pytest.raises(PageMessageFault):
        read_command(text, ARMS)


def test_the_state_is_json_that_a_browser_reads():
    assert json.loads(state_text({"a": float("nan"), "b": (1.0, float("inf")), "c": {"d": None}})) == {
        "a": None, "b": [1.0, None], "c": {"d": None},
    }  # fmt: skip
