"""Laws of hold-to-enable and clutch: what is unsure goes to the side on which the tool stays."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from common.errors import ConfigError
from leap_kuka.config import LeapConfig
from leap_kuka.numbers import CLOSED, DEBOUNCE_S, DEVICE_SILENCE_S, LEFT_S, OPENED
from leap_kuka.operator_switches import DeviceSwitches, SecondHandSwitch

strength = st.one_of(st.floats(0.0, 1.0), st.sampled_from([0.0, OPENED, CLOSED, 1.0, math.nan]))
view = st.one_of(st.none(), st.tuples(strength, st.sampled_from([1.0, 1.0, 0.0])))
script = st.lists(st.tuples(view, st.floats(0.001, 0.2)), max_size=60)


@given(script, st.sampled_from(["grab", "pinch"]))
def test_the_second_hand(sample, script, kind):
    """Over any sequence: the safe side at once, the other one only after DEBOUNCE_S of clear frames."""
    gesture = {"grab": "second_hand_fist", "pinch": "second_hand_pinch"}[kind]
    clutch, enabling = SecondHandSwitch(gesture, True, 0.05), SecondHandSwitch(gesture, False, 0.05)
    now, opened_at, closed_at = 0.0, None, None
    was_clutched = was_enabled = False
    for seen, dt in script:
        now += dt
        hands = [] if seen is None else [sample(**{kind: seen[0]}, confidence=seen[1])]
        clutch.update(hands, now, latched=True)
        enabling.update(hands, now, latched=True)
        value, sure = (math.nan, False) if seen is None else (seen[0], seen[1] > 0.05)
        opened_at = None if not (sure and value <= OPENED) else now if opened_at is None else opened_at
        closed_at = None if not (sure and value >= CLOSED) else now if closed_at is None else closed_at
        if value >= CLOSED:
            assert clutch.pressed
        if was_clutched and not clutch.pressed:
            assert opened_at is not None and now - opened_at >= DEBOUNCE_S
        if not sure or not value > OPENED:
            assert not enabling.pressed
        if enabling.pressed and not was_enabled:
            assert closed_at is not None and now - closed_at >= DEBOUNCE_S
        was_clutched, was_enabled = clutch.pressed, enabling.pressed


def test_a_fist_that_enters_enables_nothing_until_it_was_open(sample):
    switch = SecondHandSwitch("second_hand_fist", False, 0.05)
    fist, opened = [sample(grab=1.0)], [sample(grab=0.0)]
    time = iter(range(1000))

    def frames(hands, count=30):
        for _ in range(count):
            switch.update(hands, 0.01 * next(time), True)
        return switch.pressed

    assert not frames(fist)
    frames(opened)
    assert frames(fist)
    frames([], 5)
    assert not switch.pressed and frames(fist), "a flicker of the tracker"
    frames([], 15)
    assert not frames(fist)


@pytest.mark.parametrize("clutch", [True, False])
@pytest.mark.parametrize(
    "grab, confidence, moves", [(1.0, 1.0, True), (0.0, 1.0, False), (math.nan, 1.0, False), (1.0, 0.0, False)]
)
def test_of_two_second_hands_none_may_be_unclear(sample, clutch, grab, confidence, moves):
    """The second one: as the first, the other way round, without a number, or without confidence."""
    asks = 1.0 - grab if clutch else grab
    first, both = sample(grab=0.0 if clutch else 1.0), sample(id=13, grab=asks, confidence=confidence)
    switch = SecondHandSwitch("second_hand_fist", clutch, 0.05)
    for i in range(90):
        before = [sample(grab=1.0 if clutch else 0.0)]
        switch.update(before if i < 30 else [first, both], 0.01 * i, True)
        assert switch.pressed == clutch or i > 30
    assert (switch.pressed != clutch) == moves


@pytest.mark.hazard(21)
@given(
    st.lists(
        st.tuples(st.booleans(), st.booleans(), st.sampled_from([0.0, 0.0, 0.3, -0.3, math.nan]), st.floats(0.01, 0.4)),
        max_size=50,
    )
)
def test_a_device_enables_only_by_a_press_after_a_release(messages):
    device, now, released, last = DeviceSwitches(), 0.0, False, -math.inf
    for enabled, clutched, age, dt in messages:
        now += dt
        refused = device.take(enabled, clutched, "pedal", age, now)
        assert (refused is None) == (age == 0.0)
        if refused is None:
            released = not enabled or (released and now - last <= DEVICE_SILENCE_S)
            last = now
            assert device.clutch(now) is clutched
            assert device.enabled(now) == (enabled and released)
        else:
            assert not clutched or device.clutch(now)
            assert enabled or not device.enabled(now)
        assert not device.enabled(last + DEVICE_SILENCE_S + 0.01)


@given(st.lists(st.tuples(st.sampled_from("ab"), st.booleans(), st.booleans(), st.floats(0.01, 0.4)), max_size=60))
def test_of_several_programs_all_must_enable_and_any_clutches(messages):
    device, now, newest = DeviceSwitches(), 0.0, {}
    for program, enabled, clutched, dt in messages:
        now += dt
        assert device.take(enabled, clutched, program, 0.0, now, program) is None
        newest[program] = now, enabled, clutched
        there = [message for message in newest.values() if now - message[0] <= LEFT_S]
        assert not device.enabled(now) or all(on and now - at <= DEVICE_SILENCE_S for at, on, _ in there)
        assert device.clutch(now) or not any(off or now - at > DEVICE_SILENCE_S for at, _, off in there)
    for enabled in (False, True):
        now += 0.01
        for program in "ab":
            device.take(enabled, False, program, 0.0, now, program)
    assert device.enabled(now) and device.source in ("a and b", "b and a")


def test_when_one_of_two_programs_has_left_what_the_other_enables_counts_after_a_release():
    device, steps = DeviceSwitches(), 0
    for program in "ab":
        device.take(False, False, program, 0.0, 0.0, program)
        device.take(True, False, program, 0.0, 0.0, program)
    assert device.enabled(0.0)
    while steps < 40:
        steps += 1
        device.take(True, False, "a", 0.0, 0.1 * steps, "a")
        assert not device.enabled(0.1 * steps) or steps < 3
    assert not device.clutch(4.0) and device.source == "a"
    device.take(False, False, "a", 0.0, 4.0, "a")
    device.take(True, False, "a", 0.0, 4.0, "a")
    assert device.enabled(4.0)


@given(st.floats(0.0, DEVICE_SILENCE_S), st.floats(0.0, 0.3))
def test_a_device_is_silent_from_its_newest_stamp_on(age, later):
    device = DeviceSwitches()
    device.take(False, False, "pedal", age, 1.0)
    device.take(True, False, "pedal", age, 1.0)
    if abs(age + later - DEVICE_SILENCE_S) > 1e-9:
        assert device.enabled(1.0 + later) == (age + later < DEVICE_SILENCE_S) == (not device.clutch(1.0 + later))


@pytest.mark.parametrize(
    "change, words",
    [
        ({"clutch": "device"}, "needs the engagement relative"),
        ({"clutch": "device", "engagement": "relative"}, "needs a hold_time above 0"),
        ({"enabling": "device"}, "arm drives home"),
        ({"enabling": "device", "engagement": "relative"}, "arm drives home"),
        ({"enabling": "second_hand_fist", "clutch": "second_hand_pinch"}, "cannot both be the second hand"),
    ],
)
def test_bad_parameters_get_a_sentence(leap, change, words):
    values = vars(leap())
    with pytest.raises(ConfigError) as raised:
        parse(LeapConfig, {**values, "engagement": "absolute", **change}, "leap/")
    assert any(words in fault for fault in raised.value.faults)
