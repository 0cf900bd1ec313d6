"""Hands of a headset: placement, frames of messages, the code, and the conversation with a page that does anything."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from common import clock
from leap_motion.headset.hand_stream import HandStream
from leap_motion.headset.placement import FROM_XR, placement, xr_hand
from leap_motion.headset.transport import (
    MAX_MESSAGE_BYTES,
    MAX_WAITING,
    WAITING_OF_ADDRESS,
    HandsEndpoint,
    Scene,
)
from leap_motion.numbers import SETTLE_S
from leap_motion.service.access import CODE_DIGITS, CODE_S, KEY_S, MAX_GUESSES, MAX_KEYS, HeadsetAccess
from leap_motion.service.hand import KNUCKLES_MM, WRIST_MM
from leap_motion.service.socket_service import SocketService, listen
from simulated.wires import DELAY_S

SECRET_S, SILENCE_S, GONE_S, SEND_S = 5.0, 0.3, 10.0, 2.0
"""After which a page is gone that says no code; a silent one is away, and gone; one is that takes no answers."""
SOON_S = 10 * DELAY_S
AHEAD, BELOW, HEIGHT = 0.4, 0.35, 0.35
HERE = "10.0.0.5"
LEVEL = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]
CENTRE = np.array([0.0, HEIGHT, 0.0])
finite = st.floats(-5.0, 5.0)
headings = st.floats(-3.1, 3.1)


def flat_hand(palm, side="right", pinch=False):
    """Returns a level hand's 25 joints, shape (25, 3) [m], its palm at `palm` in axes like the Leap's [m]."""
    mirror = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    points = np.empty((25, 3))
    points[0] = WRIST_MM
    points[1:5] = KNUCKLES_MM[0] + np.outer([0.0, 40.0, 70.0, 90.0], [-0.6, 0.0, -0.8])
    for finger in range(1, 5):
        metacarpal = 0.2 * KNUCKLES_MM[finger] + 0.8 * WRIST_MM
        points[5 * finger] = metacarpal
        points[5 * finger + 1 : 5 * finger + 5] = KNUCKLES_MM[finger] - np.outer([0.0, 40.0, 63.0, 80.0], [0, 0, 1.0])
    if pinch:
        points[9] = points[4] + [5.0, 0.0, 0.0]
    return palm + 1e-3 * points * mirror


def rotated(points, heading):
    """Turns points about the vertical, to the left."""
    c, s = math.cos(heading), math.sin(heading)
    return points @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T


def head_at(position, heading):
    return [*position, 0.0, math.sin(heading / 2.0), 0.0, math.cos(heading / 2.0)]


class Person:
    """Sends messages to a stream, as a page does 72 times a second."""

    def __init__(self, head=LEVEL):
        self.stream = HandStream(AHEAD, BELOW)
        self.now, self.head, self.place, self.steers, self.height = 100.0, head, 1, False, HEIGHT

    def step(self, delay=0.0, dt=1.0 / 72.0, **hands):
        self.now += dt
        lists = {side: None if hand is None else np.ravel(hand).tolist() for side, hand in hands.items()}
        message = {"t": 1e3 * (self.now - 50.0), "place": self.place, "head": self.head, **lists}
        return self.stream.step(message, self.now + delay, self.height, self.steers)

    def settle(self, **hands):
        self.step(**hands)
        return self.step(dt=SETTLE_S + 0.01, **hands)

    def room(self, leap):
        """The points of the room that are at `leap` [m] in Leap axes."""
        placed = self.stream.placement
        return np.array(placed.origin) + rotated(np.asarray(leap), placed.heading)


class TestPlacement:
    @given(st.tuples(finite, finite, finite), headings, st.floats(-0.9, 0.9), st.floats(-0.5, 0.5))
    def test_the_box_is_before_the_person_and_level_however_the_head_is_tilted(self, position, heading, pitch, roll):
        yaw = np.array([0.0, math.sin(heading / 2), 0.0, math.cos(heading / 2)])
        nod = np.array([math.sin(pitch / 2), 0.0, 0.0, math.cos(pitch / 2)])
        tilt = np.array([0.0, 0.0, math.sin(roll / 2), math.cos(roll / 2)])
        head = np.concatenate([position, product(product(yaw, nod), tilt)])
        placed = placement(head, AHEAD, BELOW, HEIGHT)
        ahead = rotated(np.array([[0.0, -BELOW, -AHEAD]]), heading)[0]
        assert placed.to_leap((position + ahead)[None]) == pytest.approx(1e3 * CENTRE[None], abs=1e-6)
        right = np.array(position) + ahead + rotated(np.array([[0.1, 0.0, 0.0]]), heading)
        assert placed.to_leap(right) == pytest.approx(np.array([[100.0, 1e3 * HEIGHT, 0.0]]), abs=1e-6)

    @pytest.mark.parametrize(
        "head",
        [
            [0, 1.6, 0, math.sin(0.7), 0, 0, math.cos(0.7)],  # looks 80 deg up
            [0, 1.6, 0, 0, 0, 0, 0],
            [math.nan, 1.6, 0, 0, 0, 0, 1],
            [1e9, 1.6, 0, 0, 0, 0, 1],
        ],
    )
    def test_a_head_without_a_heading_places_nothing(self, head):
        with pytest.raises(ValueError):
            placement(np.array(head, dtype=float), AHEAD, BELOW, HEIGHT)

    @given(st.data())
    def test_anything_but_75_numbers_is_no_hand(self, data):
        value = data.draw(st.one_of(st.none(), st.booleans(), st.text(max_size=3), st.floats(), st.integers()))
        numbers = [0.1] * data.draw(st.sampled_from([0, 74, 75, 75, 75, 76]))
        good = len(numbers) == 75 and type(value) in (int, float) and abs(value) < 20.0
        if numbers:
            numbers[data.draw(st.integers(0, len(numbers) - 1))] = value
        assert (xr_hand(numbers) is not None) == good
        assert xr_hand(value) is None


def product(a, b):
    """The product of two quaternions x, y, z, w."""
    x, y, z, w = a
    return np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]]) @ b


class TestHandStream:
    @given(st.tuples(finite, finite, finite), headings, st.sampled_from(["left", "right"]))
    def test_a_hand_in_the_box_is_there_for_the_leap_wherever_the_person_looks(self, where, heading, side):
        person = Person(head_at(where, heading))
        person.settle()
        hand = person.room(flat_hand(CENTRE, side))
        (reported,) = person.step(**{side: hand}).hands
        assert reported.side == side
        assert reported.palm == pytest.approx(1e3 * CENTRE, abs=2.0)
        assert reported.normal == pytest.approx([0.0, -1.0, 0.0], abs=0.02)
        assert reported.direction == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
        assert reported.joints == pytest.approx(1e3 * flat_hand(CENTRE, side)[FROM_XR], abs=1e-6)
        assert all(reported.extended)

    def test_a_hand_that_is_missing_broken_or_jumps_is_not_the_same_hand(self):
        person = Person()
        person.settle()
        good = person.room(flat_hand(CENTRE))
        (hand,) = person.step(right=good).hands
        nan = good.copy()
        nan[13, 1] = math.nan
        for bad in (None, nan, good[:24], 0.0 * good, good + 30.0):
            assert person.step(right=bad).hands == ()
            (back,) = person.step(right=good).hands
            assert back.id > hand.id
            hand = back
        (jumped,) = person.step(right=good + np.array([0.1, 0.0, 0.0])).hands
        assert jumped.id > hand.id and np.linalg.norm(jumped.velocity) < 1.0

    @given(st.data())
    def test_garbage_is_refused_or_makes_no_hand_and_numbers_and_times_only_rise(self, data):
        person = Person()
        person.settle()
        good = person.room(flat_hand(CENTRE)).ravel().tolist()
        last_time, ids = -math.inf, {"left": 0, "right": 0}
        junk = st.one_of(
            st.none(), st.text(max_size=3), st.floats(), st.integers(), st.just(good), st.lists(st.floats())
        )
        for _ in range(5):
            person.now += 0.01
            message = {"t": 1e3 * (person.now - 50.0), "place": 1, "head": LEVEL, "right": good}
            message[data.draw(st.sampled_from(["t", "place", "head", "left", "right"]))] = data.draw(junk)
            with contextlib.suppress(ValueError):
                frame = person.stream.step(message, person.now, HEIGHT, False)
                if frame is None:
                    continue
                assert frame.time > last_time
                last_time = frame.time
                for hand in frame.hands:
                    assert hand.id >= ids[hand.side] and np.isfinite(hand.joints).all()
                    ids[hand.side] = hand.id

    def test_late_messages_and_floods_are_ignored(self):
        person = Person()
        person.settle()
        hand = person.room(flat_hand(CENTRE))
        assert person.step(right=hand) and person.step(right=hand, delay=0.05)
        assert person.step(right=hand, delay=0.2) is None
        assert person.step(right=hand)
        assert sum(person.step(right=hand, dt=0.001) is not None for _ in range(1000)) <= 210
        assert sum(person.step(right=hand, dt=0.01) is not None for _ in range(100)) == 100
        assert person.step(right=hand).rate == pytest.approx(100.0, rel=0.2)

    def test_a_connection_that_stays_late_does_not_become_the_present(self):
        person = Person()
        person.settle()
        hand = person.room(flat_hand(CENTRE))
        assert person.step(right=hand)
        assert not any(person.step(right=hand, dt=0.04, delay=0.3) for _ in range(500))
        assert "late" in person.stream.note
        assert person.step(right=hand).hands and not person.stream.note

    def test_a_page_whose_clock_is_slow_is_heard_for_an_hour(self):
        stream, heard = HandStream(AHEAD, BELOW), 0
        for i in range(3600):
            words = {"t": 1e3 * i * (1.0 - 5e-4), "place": 1, "head": LEVEL}
            heard += stream.step(words, 100.0 + i, HEIGHT, False) is not None
        assert heard == 3600

    def test_after_an_interruption_the_clock_may_have_stopped_and_hands_are_new(self):
        person = Person()
        person.settle()
        hand = person.room(flat_hand(CENTRE))
        (before,) = person.step(right=hand).hands
        person.stream.interrupt()
        (after,) = person.step(right=hand, delay=3.0).hands
        assert after.id > before.id

    def test_the_box_is_placed_anew_when_the_page_or_the_box_demands_it_and_then_there_are_no_hands_for_a_while(self):
        person = Person()
        assert person.step().hands == () and person.stream.placement.heading == 0.0
        person.settle()
        hand = person.room(flat_hand(CENTRE))
        (before,) = person.step(right=hand).hands
        for change in ({"place": 2}, {"height": 0.4}):
            vars(person).update(change, head=head_at([0.0, 1.6, 0.0], person.stream.placement.heading + 0.01))
            assert person.step(right=hand).hands == ()
            (after,) = person.settle(right=hand).hands
            assert after.id > before.id
            before = after
        assert person.stream.placement.heading == pytest.approx(0.02)

    def test_who_looks_up_is_warned_and_has_no_hands(self):
        person = Person()
        person.settle()
        hand = person.room(flat_hand(CENTRE))
        person.head, person.place = [0, 1.6, 0, math.sin(0.7), 0, 0, math.cos(0.7)], 2
        assert person.settle(right=hand).hands == () and "straight ahead" in person.stream.note
        person.head = LEVEL
        assert person.settle(right=hand).hands and not person.stream.note

    @pytest.mark.parametrize("steers", [False, True])
    def test_both_hands_pinched_for_a_second_place_the_box_unless_a_hand_steers(self, steers):
        person = Person()
        person.settle()
        aside = {"left": np.array([-0.2, 0.0, 0.0]), "right": np.array([0.2, 0.0, 0.0])}
        hands = {side: person.room(flat_hand(CENTRE + x, side, pinch=True)) for side, x in aside.items()}
        person.steers, person.head = steers, head_at([0.0, 1.6, 0.0], 0.3)
        for _ in range(60):
            assert len(person.step(**hands).hands) == 2
        frames = [person.step(**hands) for _ in range(30)]
        assert any(not frame.hands for frame in frames) is not steers
        assert person.stream.placement.heading == pytest.approx(0.0 if steers else 0.3)


class TestAccess:
    def test_a_code_is_good_once_and_its_key_while_it_is_used_also_while_its_address_waits(self):
        access = HeadsetAccess()
        code = access.code
        key = access.admit(code, HERE, 0.0)
        assert key and access.code != code
        assert access.admit(code, HERE, 0.0) is None and access.admit(key, HERE, 0.0) == key
        assert access.admit(access.code, HERE, 0.9) is None
        assert access.admit(access.code, HERE, 1.0) not in (None, key)

    def test_a_key_that_nobody_uses_ends_and_one_that_is_used_does_not(self):
        access = HeadsetAccess()
        left, used = (access.admit(access.code, HERE, 0.0) for _ in range(2))
        ticket = access.ticket
        for now in (0.9 * KEY_S, 1.8 * KEY_S):
            access.use(used, now)
        assert access.admit(left, HERE, 1.8 * KEY_S) is None
        assert access.admit(used, HERE, 2.7 * KEY_S) == used
        access.use(left, 2.7 * KEY_S)
        assert access.admit(left, HERE, 2.7 * KEY_S + 400.0) is None
        assert access.has_ticket(ticket)
        assert access.admit(used, HERE, 3.8 * KEY_S) is None and not access.has_ticket(ticket)

    def test_of_too_many_keys_that_ends_which_was_not_used_for_longest(self):
        access = HeadsetAccess()
        keys = [access.admit(access.code, HERE, float(now)) for now in range(MAX_KEYS)]
        access.use(keys[0], 100.0)
        last = access.admit(access.code, HERE, 101.0)
        assert access.admit(keys[1], HERE, 102.0) is None
        assert all(access.admit(key, HERE, 103.0) == key for key in (keys[0], *keys[2:], last))

    def test_after_many_wrong_codes_from_everywhere_there_is_a_new_one_but_not_under_the_hands_of_who_types_it(self):
        access = HeadsetAccess()
        key, code, now = access.admit(access.code, HERE, 0.0), access.code, CODE_S
        assert access.sentence("page") == f"The code for the next page is {code}."
        for number in range(MAX_GUESSES - 1):
            assert access.admit(f"guess {number}", f"10.0.1.{number}", now) is None
        assert access.admit("guess 0", "10.0.1.0", now + 9.0) is None and access.code == code, "the same is no guess"
        assert access.admit("another", "10.0.2.1", now) is None and access.code != code
        assert access.admit(key, HERE, now) == key
        former, code = code, access.code
        assert access.sentence("page") == f"There were 20 wrong codes, so the code for the next page is {code}."
        for number in range(2 * MAX_GUESSES):
            assert access.admit(f"guess {number}", f"10.0.3.{number}", now + CODE_S - 1.0) is None
        assert access.code == code
        assert access.admit("guess", "10.0.4.1", now + CODE_S) is None and access.code != code
        assert access.admit(former, "10.0.4.2", now + CODE_S) is None
        last = access.code
        assert access.admit(code, "10.0.4.3", now + CODE_S), "who typed it is not shut out"
        for used in (code, last):
            assert access.admit(used, "10.0.4.4", now + 2 * CODE_S) is None
            now += CODE_S
        assert access.admit(access.code, "10.0.5.1", now), "nor who reads the next one"
        assert access.sentence("page") == f"The code for the next page is {access.code}."

    def test_the_ticket_is_the_end_of_an_address_and_no_key(self):
        access = HeadsetAccess()
        assert access.has_ticket(f"/state?ticket={access.ticket}")
        for path in ("", "/", "/state", access.ticket[1:], f"{access.ticket}x", "\ud800" * 30):
            assert not access.has_ticket(path)
        assert access.admit(access.ticket, HERE, 0.0) is None and not HeadsetAccess().has_ticket(access.ticket)

    @given(st.one_of(st.none(), st.text(), st.integers(), st.lists(st.integers())))
    def test_nothing_else_is_admitted(self, secret):
        access = HeadsetAccess()
        if secret != access.code:
            assert access.admit(secret, HERE, 0.0) is None


class Server(SocketService):
    """Serves an endpoint as the node does."""

    max_message_bytes, write_limit = MAX_MESSAGE_BYTES, 1

    def __init__(self, endpoint):
        super().__init__()
        listener = listen("127.0.0.1", 0)
        self.port = listener.getsockname()[1]
        self._open(listener)
        self._endpoint = endpoint
        clock.Thread(target=self.run, daemon=True).start()

    async def _meet(self, connection, request):
        return None

    async def _converse(self, connection):
        await self._endpoint.converse(connection, lambda: self._keep(connection))


class Rig:
    """An endpoint on a port of its own, and what it passed on."""

    def __init__(self):
        self.frames, self.plugs, self.said, self.plugged_at = [], [], [], 0.0
        stream = HandStream(AHEAD, BELOW)
        self.endpoint = HandsEndpoint(stream, self, lambda: Scene(HEIGHT, False, {"box": [1]}), self.said.append)
        self.server = Server(self.endpoint)
        self.address = f"ws://127.0.0.1:{self.server.port}/"

    offer = property(lambda self: self.frames.append)

    attached = property(lambda self: self.plugs[-1])

    def plug(self, attached):
        self.plugged_at = clock.monotonic()
        self.plugs.append(attached)

    @property
    def code(self):
        return [s for s in self.said if "code for" in s][-1].rstrip(".")[-CODE_DIGITS:]


@pytest.fixture
def rig(wires):
    made = Rig()
    yield made
    made.server.stop()


def ask(connection, message):
    connection.send(message if isinstance(message, (str, bytes)) else json.dumps(message))
    return json.loads(connection.recv(timeout=1.0))


def open_page(rig):
    return connect(rig.address, compression=None, close_timeout=1.0)


def seat(rig, secret=None):
    connection = open_page(rig)
    return connection, ask(connection, {"secret": secret or rig.code})


def leave(rig, connection):
    connection.close()
    clock.sleep(SOON_S)
    assert not rig.endpoint.driven and rig.attached is False


def wrong_code(rig):
    return "0" * CODE_DIGITS if rig.code != "0" * CODE_DIGITS else "1" * CODE_DIGITS


def message(t, hand=None):
    return {"t": t, "place": 1, "head": LEVEL, "left": None, "right": hand and np.ravel(hand).tolist()}


class TestConversation:
    def test_hands_become_frames_until_the_headset_is_taken_off_or_falls_silent(self, rig):
        connection, said = seat(rig)
        assert said["drives"] and rig.attached is False
        for i in range(5):
            answer = ask(connection, message(10.0 * i))
            assert answer["leap"] == pytest.approx([0.0, 0.9, -0.4, 0.0]) and answer["box"] == [1]
            clock.sleep(0.01)
        assert rig.plugs == [False, True] and rig.endpoint.driven and len(rig.frames) == 5
        ask(connection, {"away": True})
        assert rig.attached is False
        ask(connection, message(500.0))
        assert rig.attached is True
        heard = clock.monotonic() - DELAY_S
        clock.sleep(1.0)
        assert rig.attached is False and rig.plugged_at - heard == pytest.approx(SILENCE_S, abs=1e-5)
        ask(connection, message(600.0))
        assert rig.attached is True
        leave(rig, connection)

    def test_who_sends_no_code_or_says_nothing_more_is_gone_after_a_while(self, rig):
        mute = open_page(rig)
        begun = clock.monotonic()
        with pytest.raises(ConnectionClosed):
            mute.recv(timeout=60.0)
        assert clock.monotonic() - begun == pytest.approx(SECRET_S, abs=SOON_S)
        silent, _ = seat(rig)
        begun = clock.monotonic()
        with pytest.raises(ConnectionClosed):
            silent.recv(timeout=60.0)
        looks = math.ceil(GONE_S / SILENCE_S)
        assert clock.monotonic() - begun == pytest.approx(looks * SILENCE_S, abs=SOON_S)
        assert not rig.endpoint.driven

    def test_a_page_that_takes_no_answers_is_gone(self, rig, wires):
        connection, _ = seat(rig)
        wires.connections[-1].down.room = 100
        begun = clock.monotonic()
        for i in range(3):
            connection.send(json.dumps(message(10.0 * i)))
        clock.sleep(begun + SEND_S - clock.monotonic())
        assert rig.endpoint.driven
        clock.sleep(SOON_S)
        assert not rig.endpoint.driven and rig.attached is False

    def test_who_has_no_code_gets_nothing_and_is_named(self, rig):
        for secret in (wrong_code(rig), None, 5, "", "\ud800", "x" * 9999):
            with open_page(rig) as connection:
                assert "refused" in ask(connection, {"secret": secret})
                with pytest.raises(ConnectionClosed):
                    ask(connection, message(0.0))
            clock.sleep(100.0)
        assert not rig.endpoint.driven and not rig.frames and "127.0.0.1" in rig.said[-1]

    def test_wrong_codes_make_their_address_wait_and_no_other(self, rig, wires):
        wires.client_address = "10.0.0.66"
        begun = clock.monotonic()
        tries, told = 0, []
        while clock.monotonic() - begun < 3600.0:
            with open_page(rig) as stranger:
                told.append(ask(stranger, {"secret": f"{tries:06d}"})["refused"])
            tries += 1
            clock.sleep(10.0)
        compared = [text for text in told if "try again" not in text]
        assert 15 < len(compared) < 25 and len(told) > 300
        new = [text for text in rig.said if text.startswith("There were 20 wrong codes, so the code for the next")]
        assert len(new) == len(compared) // MAX_GUESSES
        assert len(rig.said) == 1 + len(compared) + len(new), "each wrong code is said, and nothing else"
        assert "try again in" in seat(rig)[1]["refused"], "the right one from there has to wait"
        wires.client_address = "10.0.0.7"
        connection, said = seat(rig)
        assert said["drives"]
        connection.close()

    def test_a_second_headset_is_refused_and_may_come_when_the_first_has_left(self, rig):
        first, said = seat(rig)
        second, refused = seat(rig)
        assert said["drives"] and "Another headset" in refused["refused"] and refused["key"] != said["key"]
        assert ask(first, message(0.0))
        second.close()
        leave(rig, first)
        third, said = seat(rig, refused["key"])
        assert said["drives"]
        third.close()

    def test_a_headset_that_drives_uses_its_key(self, rig):
        page, said = seat(rig)
        rig.endpoint.access._keys[said["key"]] = -math.inf
        ask(page, message(0.0))
        assert rig.endpoint.access._keys[said["key"]] == pytest.approx(clock.monotonic(), abs=SOON_S)
        leave(rig, page)

    def test_another_headset_gets_a_box_of_its_own_though_its_page_counts_alike(self, rig):
        first, said = seat(rig)
        assert ask(first, message(0.0))["leap"] == pytest.approx([0.0, 0.9, -0.4, 0.0])
        leave(rig, first)
        second, _ = seat(rig)
        turned = {**message(0.0), "head": head_at([0.0, 1.6, 0.0], math.pi / 2)}
        assert ask(second, turned)["leap"] == pytest.approx([-0.4, 0.9, 0.0, math.pi / 2])
        leave(rig, second)
        third, _ = seat(rig, said["key"])  # the first one after its pause
        assert ask(third, message(0.0))["leap"] == pytest.approx([0.0, 0.9, -0.4, 0.0])
        leave(rig, third)
        fourth, _ = seat(rig, said["key"])  # its connection was lost: the box stays
        assert ask(fourth, turned)["leap"] == pytest.approx([0.0, 0.9, -0.4, 0.0])
        fourth.close()

    def test_the_same_page_takes_its_seat_again_before_its_old_connection_is_known_to_be_lost(self, rig):
        first, said = seat(rig)
        ask(first, message(0.0))
        second, again = seat(rig, said["key"])
        assert again["drives"]
        with pytest.raises(ConnectionClosed):
            first.recv(timeout=SOON_S)
        assert ask(second, message(0.0)) and rig.attached
        second.close()

    @pytest.mark.parametrize(
        "garbage",
        ["", "{", "[]", "5", b"\xff\xfe", "[" * 5000, '{"t": NaN, "place": 1}', "{}", '{"t": 1e400}', "x" * 20000],
    )
    def test_garbage_ends_the_drive_and_the_tracker_is_unplugged(self, rig, garbage):
        connection, _ = seat(rig)
        ask(connection, message(0.0))
        with pytest.raises(ConnectionClosed):
            ask(connection, garbage)
        clock.sleep(SOON_S)
        assert not rig.endpoint.driven and rig.attached is False

    def test_a_page_that_is_gone_before_its_answer_leaves_the_seat_free(self, rig):
        class Gone:
            """A connection that is lost once the code was sent."""

            remote_address = "127.0.0.1", 5
            transport = SimpleNamespace(get_extra_info=lambda _: None)

            async def recv(self):
                return json.dumps({"secret": rig.code})

            async def send(self, text):
                raise ConnectionClosed(None, None)

        asyncio.run(rig.endpoint.converse(Gone(), lambda: None))
        assert not rig.endpoint.driven
        connection, said = seat(rig)
        assert said.get("drives")
        connection.close()

    def test_of_too_many_pages_without_a_code_the_oldest_gives_way_and_who_drives_does_not(self, rig, wires):
        def gone(page):
            clock.sleep(SOON_S)
            try:
                page.recv(timeout=0.0)
            except TimeoutError:
                return False
            except ConnectionClosed:
                return True

        driver, _ = seat(rig)
        waiting = []
        for machine in range(MAX_WAITING // WAITING_OF_ADDRESS):
            wires.client_address = f"10.0.0.{machine}"
            waiting += [open_page(rig) for _ in range(WAITING_OF_ADDRESS)]
        assert not any(gone(page) for page in waiting)
        of_the_last = open_page(rig)
        assert [gone(page) for page in waiting] == [*[False] * (MAX_WAITING - WAITING_OF_ADDRESS), True, False]
        wires.client_address = "10.0.0.99"
        with open_page(rig) as later:
            assert [gone(page) for page in waiting[:2]] == [True, False] and not gone(of_the_last)
            assert "Another headset" in ask(later, {"secret": rig.code})["refused"]
        assert ask(driver, message(0.0))["leap"]
