"""Laws of the operator's devices, with recorded events as bytes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from common.errors import ConfigError
from leap_kuka.numbers import JOY_SILENCE_S
from leap_kuka.operator_devices import CLUTCH, ENABLE, EVENT, KEYS, OperatorInput, OperatorInputConfig

DEBOUNCE_S = 0.02
PEDAL = {"device": "/dev/input/by-id/pedal", "enable_key": "KEY_F13", "clutch_key": "KEY_B", "debounce": DEBOUNCE_S}
JOY = {"joy_enable_button": 4, "joy_clutch_button": 5}
F13, B = KEYS["KEY_F13"], KEYS["KEY_B"]


def events(*keys):
    """The bytes of a keyboard: scan code, key and report of each (code, value)."""
    records = [r for code, value in keys for r in ((4, 4, 0x70068), (1, code, value), (0, 0, 0))]
    return b"".join(EVENT.pack(1700000000, 123456, *record) for record in records)


def made(**changes):
    return OperatorInput(parse(OperatorInputConfig, {**PEDAL, **changes}, "leap/operator_input/"))


def test_the_kernels_event_has_24_bytes_and_keys_their_codes():
    assert EVENT.size == 24
    assert [KEYS[k] for k in ("KEY_1", "KEY_A", "KEY_B", "KEY_F10", "KEY_F12", "KEY_F13", "KEY_F24", "KEY_SPACE")] == [
        *(2, 30, 48, 68, 88, 183, 194, 57)
    ]


def test_a_recorded_pedal():
    """Press, automatic repetitions and release, in pieces of any length."""
    data = events((F13, 1), *[(F13, 2)] * 5, (B, 1), (30, 1), (B, 0))
    for size in (1, 7, 24, 1000):
        operator, now = made(), 10.0
        for i in range(0, len(data), size):
            operator.device.read(data[i : i + size], now)
        assert operator.state(now)[1], "the release of the clutch is debounced"
        assert operator.state(now + 1.5 * DEBOUNCE_S) == (True, False, "pedal")
        operator.device.read(events((F13, 2), (F13, 0)), now + 1.0)
        assert operator.state(now + 1.0) == (False, False, ""), "the release of enabling acts at once"


@pytest.mark.parametrize("why", ["absent", "lost", "dropped"])
def test_the_clutch_of_a_device_that_is_not_there_is_pressed_until_it_was_used(why):
    operator = made()
    if why != "absent":
        operator.device.read(events((B, 1), (B, 0), (F13, 1)) + events((F13, 1))[:10], 10.0)
        assert operator.state(11.0)[:2] == (True, False)
        if why == "lost":
            operator.device.lost(11.0)
        else:
            operator.device.read(events((F13, 1))[10:] + EVENT.pack(0, 0, 0, 3, 0), 11.0)
    assert operator.state(11.0) == (False, True, "pedal")
    operator.device.read(events((F13, 2)), 12.0)
    operator.device.read(events((B, 1)), 12.0)
    assert operator.state(13.0)[:2] == (False, True)
    operator.device.read(events((B, 0), (F13, 1)), 14.0)
    assert operator.state(15.0)[:2] == (True, False)


def test_a_gamepad_must_report_and_be_released_first():
    operator = made(**JOY, clutch_key="")
    pressed, free = [0, 0, 0, 0, 1, 0], [0] * 6
    for now in (10.0, 10.1, 10.2):
        operator.gamepad.take(pressed, now)
        assert not operator.state(now)[0]
    operator.gamepad.take(free, 10.3)
    operator.gamepad.take(pressed, 10.4)
    assert operator.state(10.45)[0]
    assert not operator.state(10.4 + JOY_SILENCE_S + 0.01)[0]
    operator.gamepad.take(pressed, 12.0)
    assert not operator.state(12.1)[0]
    operator.gamepad.take([], 12.2)
    operator.gamepad.take([0, 0], 12.3)
    assert not operator.state(12.3)[0]


def test_a_gamepads_clutch_that_is_down_or_unknown_is_pressed():
    operator = made(**JOY, clutch_key="")
    down, free = [0] * 5 + [1], [0] * 6
    assert operator.state(10.0)[1], "it never reported"
    operator.gamepad.take(free, 10.0)
    assert operator.state(10.1)[1], "it was not used yet"
    operator.gamepad.take(down, 10.2)
    operator.gamepad.take(free, 10.3)
    assert not operator.state(10.4)[1]
    operator.gamepad.take(down, 10.5)
    for now in (10.6, 11.5, 12.0):
        assert operator.state(now)[1], "it is held, and silent"
    operator.gamepad.take(down, 12.0)
    assert operator.state(12.1)[1]
    operator.gamepad.take(free, 12.2)
    assert not operator.state(12.3)[1] and operator.state(13.0)[1]
    operator.request(CLUTCH, False, 13.0)
    assert not operator.state(14.0)[1]


def test_the_service_releases_no_pedal_that_is_pressed():
    operator = made()
    operator.device.read(events((B, 1)), 1.0)
    operator.request(CLUTCH, True, 1.0)
    operator.request(CLUTCH, False, 2.0)
    assert operator.state(3.0) == (False, True, "pedal")
    operator.device.read(events((B, 0)), 3.0)
    assert not operator.state(4.0)[1]
    operator.device.lost(5.0)
    operator.request(CLUTCH, False, 5.0)
    operator.device.read(events((B, 2)), 6.0)
    assert operator.state(7.0)[1], "a repetition tells that it is down"


@pytest.mark.parametrize(
    ("config", "named"),
    [
        ({}, "pedal"),
        ({**JOY, "device": "", "enable_key": "", "clutch_key": ""}, "gamepad"),
        (JOY, "pedal or the gamep"),
    ],
)
@given(
    st.lists(st.tuples(st.sampled_from(["press", "release", "lost", True, False]), st.floats(0.0, 0.05)), max_size=30)
)
def test_the_service_never_enables_where_a_device_does(config, named, steps):
    operator, now, down = made(**config), 1.0, False
    for what, pause in steps:
        now += pause
        if isinstance(what, bool):
            said = operator.request(ENABLE, what, now)
            assert (f"needs the {named}" in said) if what else not said
        elif what == "lost":
            operator.device.lost(now)
            down = False
        elif not config.get("joy_enable_button"):
            down = what == "press"
            operator.device.read(events((F13, int(down))), now)
        assert operator.state(now)[0] <= down


def test_any_source_counts_and_the_service_clears_the_clutch():
    operator = made(enable_key="")
    assert not operator.request(ENABLE, True, 1.0)
    operator.device.read(events((B, 1)), 2.0)
    assert operator.state(3.0) == (True, True, "service and pedal")
    operator.device.lost(3.0)
    operator.request(ENABLE, False, 3.2)
    assert operator.state(3.3)[1], "only a release of the clutch is one"
    operator.request(ENABLE, True, 3.4)
    operator.request(CLUTCH, False, 4.0)
    assert operator.state(5.0) == (True, False, "service")
    operator.request(ENABLE, False, 5.0)
    assert operator.state(5.0)[0] is False


step = st.tuples(st.sampled_from([F13, B]), st.sampled_from([0, 1, 2]), st.floats(0.0, 0.05))


@given(st.lists(st.one_of(step, st.just(None)), max_size=60))
def test_the_safe_side_acts_at_once_and_the_other_after_the_debounce(steps):
    operator, now = made(), 10.0
    down, since, before = {F13: False, B: True}, {F13: -math.inf, B: -math.inf}, (False, True)
    for taken in steps:
        if taken is None:
            operator.device.lost(now)
            if down[F13]:
                down[F13], since[F13] = False, now
            if not down[B]:
                down[B], since[B] = True, now
        else:
            key, value, dt = taken
            now += dt
            operator.device.read(events((key, value)), now)
            if (value < 2 or key == B) and down[key] != bool(value):
                down[key], since[key] = bool(value), now
        enabled, clutched, _ = operator.state(now)
        assert not enabled or (down[F13] and now - since[F13] >= DEBOUNCE_S)
        assert clutched or not (down[B] or (before[1] and now - since[B] < DEBOUNCE_S))
        before = enabled, clutched


@pytest.mark.parametrize(
    "change, words",
    [
        ({"device": "pedal"}, "device is 'pedal'"),
        ({"enable_key": "KEY_PEDAL"}, "enable_key is 'KEY_PEDAL'"),
        ({"device": ""}, "or none"),
        ({"enable_key": "", "clutch_key": ""}, "or none"),
    ],
)
def test_bad_parameters_get_a_sentence(change, words):
    with pytest.raises(ConfigError) as raised:
        made(**change)
    assert any(words in fault for fault in raised.value.faults)


def test_a_key_may_be_a_number():
    assert made(enable_key="183", clutch_key="").device._keys == {ENABLE: 183}
