"""What relay and rig send each other before a connection passes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_rig.relay import greeting
from leap_rig.relay.greeting import MAC, NONCE, RUN, RelayFault

KEY, OTHER = b"k" * 32, b"o" * 32
RELAY, RIG, PROCESS = b"\x01" * NONCE, b"\x02" * NONCE, b"\x03" * RUN


def greet(relay_key: bytes, rig_key: bytes) -> bytes:
    """Both sides to the end; returns the run that the relay saw."""
    answer, due = greeting.answer(rig_key, greeting.challenge(RELAY), PROCESS, RIG)
    run, proof = greeting.proof(relay_key, answer, RELAY)
    greeting.check_proof(proof, due)
    return run


def test_bytes_on_the_wire():
    challenge = greeting.challenge(RELAY)
    answer, due = greeting.answer(KEY, challenge, PROCESS, RIG)
    assert challenge.hex() == "6c6561702d7269672072656c617920310a" + "01" * 32
    assert answer.hex() == "03" * 16 + "02" * 32 + "b9e20398cf880bf15f729ef016e7b526b46233437118f289901c20de37ba315c"
    assert due.hex() == "bb098240cc9bb6550e703ea309965cddff1e596b6923461e96b72fac00d531aa"
    assert greeting.opening(b"\x0a\x0b\x0c", "cockpit").hex() == "0a0b0c636f636b706974"


def test_who_has_the_key_is_let_in():
    assert greet(KEY, KEY) == PROCESS


def test_no_message_holds_the_key():
    answer, due = greeting.answer(KEY, greeting.challenge(RELAY), PROCESS, RIG)
    assert KEY not in answer + due + greeting.challenge(RELAY)


def test_another_key_is_refused_on_both_sides():
    with pytest.raises(RelayFault, match="another key"):
        greet(KEY, OTHER)
    answer, due = greeting.answer(KEY, greeting.challenge(RELAY), PROCESS, RIG)
    forged = greeting.answer(OTHER, greeting.challenge(RELAY), PROCESS, RIG)[1]
    with pytest.raises(RelayFault, match="another key"):
        greeting.check_proof(forged, due)


def test_an_answer_is_good_for_its_challenge_alone():
    answer, _ = greeting.answer(KEY, greeting.challenge(RELAY), PROCESS, RIG)
    with pytest.raises(RelayFault):
        greeting.proof(KEY, answer, b"\x09" * NONCE)


def test_what_one_side_proves_is_no_proof_of_the_other():
    answer, due = greeting.answer(KEY, greeting.challenge(RELAY), PROCESS, RIG)
    with pytest.raises(RelayFault):
        greeting.check_proof(answer[-MAC:], due)
    with pytest.raises(RelayFault):
        greeting.proof(KEY, PROCESS + RIG + due, RELAY)


@given(st.integers(0, RUN + NONCE + MAC - 1), st.integers(0, 7))
def test_each_changed_bit_of_an_answer_is_refused(byte, bit):
    answer = bytearray(greeting.answer(KEY, greeting.challenge(RELAY), PROCESS, RIG)[0])
    answer[byte] ^= 1 << bit
    with pytest.raises(RelayFault):
        greeting.proof(KEY, bytes(answer), RELAY)


@given(st.one_of(st.binary(max_size=200), st.text(max_size=99), st.none()))
def test_what_is_no_message_is_refused(message):
    due = greeting.answer(KEY, greeting.challenge(RELAY), PROCESS, RIG)[1]
    for read in (
        lambda: greeting.answer(KEY, message, PROCESS, RIG),
        lambda: greeting.proof(KEY, message, RELAY),
        lambda: greeting.check_proof(message, due),
    ):
        with pytest.raises(RelayFault):
            read()


@given(st.binary(min_size=3, max_size=3), st.from_regex(r"[a-z][a-z0-9-]{0,30}", fullmatch=True))
def test_an_opening_is_read_as_it_was_written(visitor, page):
    assert greeting.read_opening(greeting.opening(visitor, page)) == (visitor, page)


@pytest.mark.parametrize(
    "message", [b"", b"abc", b"abcCockpit", b"abc../x", b"abcpage\n", b"abc" + b"a" * 32, "abcpage"]
)
def test_what_opens_no_page_is_refused(message):
    with pytest.raises(RelayFault):
        greeting.read_opening(message)


@given(st.binary(min_size=3, max_size=3))
def test_each_browser_is_an_address_of_this_machine_but_never_its_own(visitor):
    first, second, third, fourth = map(int, greeting.local_address(visitor).split("."))
    assert first == 127 and 128 <= second <= 255 and 0 <= third <= 255 and 1 <= fourth <= 254
