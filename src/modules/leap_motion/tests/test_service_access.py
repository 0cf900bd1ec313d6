"""Who may connect: limits of connections, names of this computer, and codes that are guessed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_motion.service.access import (
    FIRST_WAIT_S,
    LONGEST_WAIT_S,
    MAX_ADDRESSES,
    MAX_KEYS,
    REMEMBERED_S,
    AccessCode,
    ConnectionLimits,
    Place,
    VisitLimits,
    is_loopback,
    is_own_host,
)

THERE, ELSEWHERE = "10.0.0.5", "10.0.0.6"
CODE = "right one"


@given(st.lists(st.tuples(st.booleans(), st.sampled_from(["10.0.0.1", "10.0.0.2", "::1", "fe80::1%eth0"]))))
def test_there_are_never_more_connections_than_allowed_and_who_leaves_makes_room(steps):
    limits, places = ConnectionLimits(5, 3), {}
    for comes, address in steps:
        of_address = places.setdefault(address, [])
        if comes:
            free = sum(map(len, places.values())) < 5 and len(of_address) < 3
            place = limits.enter(address, pytest.fail)
            assert (place is not None) is free
            of_address += [place] * free
        elif of_address:
            limits.leave(of_address.pop())


STEPS = st.tuples(st.sampled_from(["comes", "comes with a ticket", "leaves", "sends the code"]), st.integers(0, 9))


@given(st.lists(STEPS, min_size=20, max_size=40), st.booleans())
def test_a_kept_place_gives_way_to_none_and_is_given_while_others_are_there(steps, newest_first):
    limits, places, ended = ConnectionLimits(3, 2, newest_first), [], []
    for step, number in steps:
        chosen = places[number % len(places)] if places else None
        if step.startswith("comes"):
            machine, kept = f"10.0.0.{number % 3}", step != "comes"
            gone = len(ended)
            place = limits.enter(machine, lambda: ended.append(1), kept)
            others = [each for each in places if not each.kept]
            own = [each for each in others if each.machine == machine]
            crowd = own if not kept and len(own) >= 2 else others if len(places) >= 3 else []
            full = len(places) >= 3 or bool(crowd)
            assert (place is None) is (full and not (crowd and (kept or newest_first)))
            if place is not None:
                assert len(ended) - gone == full
                places = [each for each in places if not (full and each is crowd[0])] + [place]
        elif chosen and step == "leaves":
            limits.leave(chosen)
            places.remove(chosen)
        elif chosen:
            chosen.kept = True
        assert len(places) <= 3 and limits._places == places


VISITORS = st.sampled_from(["10.0.0.1", "10.0.0.2", "10.0.0.3", "2001:db8::1", "2001:db8::2"])


@given(st.lists(st.tuples(VISITORS, st.floats(0.0, 0.5)), max_size=60))
def test_in_each_period_there_are_as_many_visits_as_allowed_and_none_that_was_refused_counts(visits):
    limits, now, admitted = VisitLimits(5, 3, 2.0), 0.0, []
    for address, later in visits:
        now += later
        machine, period = "one network" if ":" in address else address, now // 2.0
        present = [each for when, each in admitted if when == period]
        room = len(present) < 5 and present.count(machine) < 3
        assert limits.admit(address, now) is room
        admitted += [(period, machine)] * room


def test_a_new_connection_has_a_moment_but_for_those_of_a_machine_that_had_the_code():
    limits, ended = ConnectionLimits(2, 2, newest_first=True, grace_s=1.0), []
    for name in ("first", "second"):
        assert limits.enter("10.0.0.1", lambda name=name: ended.append(name), now=5.0)
    assert limits.enter("10.0.0.1", pytest.fail, now=5.9) is None
    assert limits.enter("10.0.0.2", pytest.fail, now=5.9) is None
    third = limits.enter("10.0.0.2", pytest.fail, now=6.0)
    third.kept = True
    limits.leave(third)
    assert limits.enter("10.0.0.3", pytest.fail, now=6.0) and ended == ["first"]
    assert limits.enter("10.0.0.4", pytest.fail, now=5.5) is None
    assert limits.enter("10.0.0.2", pytest.fail, now=5.5) and ended == ["first", "second"]
    for number in range(MAX_KEYS):
        limits.leave(Place(f"10.1.0.{number}", pytest.fail, 0.0, kept=True))
    assert limits.enter("10.0.0.2", pytest.fail, now=6.1) is None and len(limits._known) == MAX_KEYS


def test_who_gave_way_and_leaves_then_takes_nobodys_place():
    limits = ConnectionLimits(1, 1, newest_first=True)
    first = limits.enter("10.0.0.1", lambda: None)
    assert limits.enter("10.0.0.2", pytest.fail, kept=True)
    limits.leave(first)
    assert limits.enter("10.0.0.3", pytest.fail) is None


def test_a_machine_is_one_however_its_address_is_written():
    limits = ConnectionLimits(9, 1)

    def enters(address):
        return limits.enter(address, pytest.fail) is not None

    assert enters("10.0.0.1") and not enters("::ffff:10.0.0.1")
    assert enters("fe80::1%eth0") and not enters("fe80:0::1") and enters("fe80::2%eth0")
    assert enters("2001:db8::1") and not enters("2001:db8::2:3") and enters("2001:db8:0:1::1")


@given(st.lists(st.tuples(st.floats(0.0, 100.0), st.text(max_size=3), st.sampled_from([THERE, "10.0.0.7"]))))
def test_whatever_others_send_the_right_code_from_elsewhere_is_accepted_at_once(tries):
    code, now = AccessCode(CODE), 0.0
    for pause, text, address in tries:
        now += pause
        assert not code.accepts(text, address, now)
    assert code.wait(ELSEWHERE, now) == 0.0 and code.accepts(CODE, ELSEWHERE, now)


def test_each_further_guess_makes_its_address_wait_twice_as_long():
    code, now = AccessCode(CODE), 0.0
    for guess in range(12):
        wait = min(FIRST_WAIT_S * 2.0**guess, LONGEST_WAIT_S)
        assert not code.accepts(f"guess {guess}", THERE, now)
        assert code.wait(THERE, now) == wait
        assert not code.accepts(CODE, THERE, now + wait - 1e-3), "nothing is compared meanwhile"
        now += wait
    assert code.accepts(CODE, THERE, now), "it is slowed down, not shut out"
    assert not code.accepts("guess", THERE, now) and code.wait(THERE, now) == FIRST_WAIT_S


def test_the_same_wrong_code_again_is_no_further_guess():
    code = AccessCode(CODE)
    for now in range(0, 1000, 10):
        assert not code.accepts("as configured", THERE, now) and code.wait(THERE, now) == FIRST_WAIT_S


def test_wrong_codes_are_forgotten_after_a_while_and_fill_no_memory():
    code = AccessCode(CODE)
    for guess in range(8):
        code.accepts(f"{guess}", THERE, 1000.0 * guess)
    later = 7000.0 + LONGEST_WAIT_S + REMEMBERED_S + 1.0
    assert not code.accepts("8", THERE, later) and code.wait(THERE, later) == FIRST_WAIT_S
    for i in range(2 * MAX_ADDRESSES):
        code.accepts("x" * 9999, f"10.1.{i >> 8}.{i & 255}", later)
    assert len(code._wrong) == MAX_ADDRESSES


@pytest.mark.parametrize(
    ("address", "loopback"),
    [
        *(("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("::ffff:127.0.0.1", True)),
        *(("::ffff:10.0.0.1", False), ("10.0.0.1", False), ("fe80::1%eth0", False), ("", False), ("host", False)),
    ],
)
def test_loopback_addresses(address, loopback):
    assert is_loopback(address) == loopback


@pytest.mark.parametrize(
    ("host", "arrived_at", "own"),
    [
        *(("127.0.0.1:6437", "127.0.0.1", True), ("localhost", "127.0.0.1", True), ("[::1]:80", "::1", True)),
        *(("10.0.0.5:8443", "10.0.0.5", True), ("rig:8443", "10.0.0.5", True), ("RIG", "127.0.0.1", True)),
        *(("10.0.0.5", "::ffff:10.0.0.5", True), ("[fe80::1]:80", "fe80::1%eth0", True)),
        *(("evil.example", "127.0.0.1", False), ("evil.example:8443", "10.0.0.5", False), ("", "127.0.0.1", False)),
        *(("10.0.0.6", "10.0.0.5", False), ("localhost", "10.0.0.5", False), ("10.0.0.5", "127.0.0.1", False)),
        *(("evil@127.0.0.1", "127.0.0.1", False), ("127.0.0.1.evil.example", "127.0.0.1", False)),
        *(("[", "127.0.0.1", False), ("127.0.0.1/", "127.0.0.1", False), ("rig.evil.example", "10.0.0.5", False)),
    ],
)
def test_hosts_that_a_request_may_name(host, arrived_at, own):
    assert is_own_host(host, arrived_at, ("rig", "rig.local")) is own


@given(st.text(), st.sampled_from(["127.0.0.1", "10.0.0.5", "::1"]))
def test_any_host_gets_an_answer(host, arrived_at):
    assert is_own_host(host, arrived_at) in (True, False)
