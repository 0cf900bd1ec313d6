"""What is first wrong with the inputs of a node: a table of what came when, and laws."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.input_watch import KEPT_S, OUTPUT_S, InputWatch

A, B, INFO = "/a", "/b", "/info"
PERIOD_S = 0.1


def watch_after(seconds, slop=0.04, a=PERIOD_S, b=PERIOD_S, info=True, apart=0.0, refused="", output=True, watch=None):
    """A watch after so long [s] of inputs every `a` and `b` [s] (None: not at all), and the time then."""
    made = watch or InputWatch([A, B], once=[INFO], slop=slop)
    begin = 0.0 if watch is None else 100.0
    if info:
        made.came(INFO, begin)
    for i in range(round(seconds / PERIOD_S)):
        now = begin + PERIOD_S * (i + 1)
        if a is not None and i % round(a / PERIOD_S) == 0:
            made.came(A, now, 1000.0 + now)
        if b is not None and i % round(b / PERIOD_S) == 0:
            made.came(B, now, 1000.0 + now + apart)
        if refused:
            made.refused(refused, now)
        elif output and None not in (a, b) and info and abs(apart) <= (slop or 1e9):
            made.done(now)
    return made, begin + seconds


APART = "the nearest stamps on /a and /b are {:.3f} s apart, but at most 0.02 s are allowed (slop)"
STALLED = "the inputs have come, but nothing has come out of them yet"
LATER = "the inputs come, but nothing has come out of them for 97.0 s"
TABLE = [  # how they come, what is wrong from the start, and the same after a good time
    ({}, "", ""),
    ({"a": None, "b": None, "info": False}, f"nothing has come on {A}, {B}, {INFO}", f"{A}, {B} for 97.0 s"),
    ({"a": None}, f"nothing has come on {A}", f"nothing has come on {A} for 97.0 s"),
    ({"info": False}, f"nothing has come on {INFO}", LATER),
    ({"b": None, "refused": "its size is 0"}, f"nothing has come on {B}", f"nothing has come on {B} for 97.0 s"),
    ({"refused": "its encoding is bgra8"}, "its encoding is bgra8", "its encoding is bgra8"),
    ({"apart": 0.06}, APART.format(0.04), APART.format(0.04)),
    ({"apart": 0.03}, APART.format(0.03), APART.format(0.03)),
    ({"apart": 0.06, "slop": None, "output": False}, STALLED, LATER),
    ({"output": False}, STALLED, LATER),
]


@pytest.mark.parametrize(("how", "fault", "later"), TABLE)
def test_the_first_thing_that_is_wrong_is_said_from_the_start_and_after_a_good_time(how, fault, later):
    how = {"slop": 0.02, **how}
    watch, now = watch_after(2.0, **how)
    assert watch.fault(now) == fault
    watch, now = watch_after(2.0, watch=watch_after(5.0, slop=how["slop"])[0], **how)
    assert watch.fault(now).endswith(later) and bool(later) == bool(watch.fault(now))


def test_messages_without_stamps_are_named():
    watch = InputWatch([A, B], slop=0.02)
    for i in range(20):
        watch.came(A, 0.1 * i, 1e9)
        watch.came(B, 0.1 * i, 0.0)
    assert watch.fault(2.0) == "the messages on /b have no stamp"


def test_it_is_fine_for_a_second_after_the_last_output_and_no_longer():
    watch, now = watch_after(3.0)
    assert watch.fault(now + OUTPUT_S) == ""
    assert watch.fault(now + OUTPUT_S + 0.01) == "nothing has come on /a, /b for 1.0 s"


def test_the_reason_is_kept_beyond_the_last_input_and_then_it_is_silent():
    watch, now = watch_after(3.0, refused="its size is 0 x 0")
    assert watch.fault(now + KEPT_S) == "its size is 0 x 0"
    assert watch.fault(now + KEPT_S + 0.1) == "nothing has come on /a, /b for 2.1 s"
    watch, now = watch_after(3.0, slop=0.02, apart=0.06)
    assert watch.fault(now + KEPT_S) == APART.format(0.04)
    assert watch.fault(now + KEPT_S + 0.1) == "nothing has come on /a, /b for 2.1 s"


def test_streams_that_begin_to_be_apart_are_so_as_soon_as_there_is_no_output():
    watch, now = watch_after(3.0, slop=0.02)
    for _ in range(11):
        now += PERIOD_S
        watch.came(A, now, 1000.0 + now)
        watch.came(B, now, 1000.0 + now + 0.03)
    assert watch.fault(now) == APART.format(0.03)


def test_a_silence_of_several_is_the_shortest():
    watch, now = watch_after(3.0)
    watch.came(A, now + 1.5, 1000.0)
    assert watch.fault(now + 3.0) == "nothing has come on /a, /b for 1.5 s"


@pytest.mark.parametrize("silent", [A, B])
def test_a_stream_that_stops_is_silent_and_not_apart(silent):
    watch, now = watch_after(3.0)
    for _ in range(40):
        now += PERIOD_S
        watch.came(B if silent == A else A, now, 1000.0 + now)
        assert "stamps" not in watch.fault(now)
    assert watch.fault(now) == f"nothing has come on {silent} for 4.0 s"


def test_after_an_output_the_reason_before_it_is_forgotten():
    watch, now = watch_after(1.0, refused="tf does not know x")
    watch.done(now)
    assert watch.fault(now + OUTPUT_S + 0.1).startswith("nothing has come on")


def test_a_stream_that_is_slower_than_its_partner_is_not_apart():
    watch, now = watch_after(6.0, a=1.5, refused="its encoding is mono8")
    assert watch.fault(now) == "its encoding is mono8"


def test_a_node_that_subscribes_anew_begins_anew_but_keeps_what_comes_once():
    watch, now = watch_after(3.0)
    watch.restart()
    assert watch.fault(now) == "nothing has come on /a, /b"
    watch.came(A, now)
    assert watch.missing(now) == "nothing has come on /b"


EVENTS = st.lists(
    st.tuples(st.floats(0.0, 0.7), st.sampled_from([A, B, INFO, "refused", "done"]), st.floats(0.0, 2.0)), max_size=40
)


@given(EVENTS, st.floats(0.0, 5.0))
def test_it_is_fine_exactly_if_there_was_output_in_the_last_second(events, wait):
    watch, now, output = InputWatch([A, B], once=[INFO], slop=0.02), 0.0, None
    for pause, what, stamp in events:
        now += pause
        if what == "refused":
            watch.refused("a reason", now)
        elif what == "done":
            watch.done(now)
            output = now
        else:
            watch.came(what, now, stamp)
        assert (watch.fault(now) == "") == (output is not None and now - output <= OUTPUT_S)
    now += wait
    fault = watch.fault(now)
    assert (fault == "") == (output is not None and now - output <= OUTPUT_S)
    assert fault == fault.strip() and not fault.endswith(".")
