"""Laws of streamed goals under any interleaving of goals, answers, delays, stalls, faults of the server and pauses.

All in simulated time. The numbers of an answer tell its goal and its kind.
"""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from simulated_wire import SimulatedWire

from kst.client import KstClient, KstMode
from kst.codec import Feedback, ToolTransform
from kst.errors import ConnectionLost, MotionRefused, ReplyTimeout, UnexpectedReply
from kst.limits import LBR_IIWA_LIMITS
from kst.session import LEAST_WINDOW_S, MAX_OPEN, KstSession, KstTiming

TIMING = KstTiming(connect_settle=0.0, tool_settle=0.0, servo_start=0.0)
PROBES = {"getPin3", "getJointsPositions"}
CODE = {"getJointsPositions": 1, "jpJP": 1, "jpExT": 2, "jpMT": 3}
STREAMED = [feedback for feedback in Feedback if feedback not in (Feedback.NOTHING, Feedback.STATE)]


class Server(SimulatedWire):
    """The reader thread of the server behind a wire, as a transport: it answers in order, after `delay` [s]."""

    def __init__(self):
        super().__init__()
        self.delay, self.drop, self._last = 0.0005, False, 0.0

    def say(self, text):
        self._last = max(self.now + self.delay, self._last)
        self.put(text, self._last)

    def send(self, line, timeout):
        self.check()
        word = line.split("_")[0]
        self.sent.append((self.now, word))
        n = len(self.sent)
        texts = {"jpEEfP": f"{n}_0_0_0_0_0_", "jpEEfFrelEEF": f"{n}_0_0_", "getPin3": "1"}
        if self.drop:
            self.drop = False
        elif word in CODE:
            self.say(f"{n}_{CODE[word]}_0_0_0_0_0_")
        elif word != "end":
            self.say(texts.get(word, "done"))


def a_client(server, timing=TIMING):
    client = KstClient(KstSession(server, timing), ToolTransform(np.eye(4)), LBR_IIWA_LIMITS)
    client._mode = KstMode.SERVO
    return client


@pytest.fixture
def server():
    return Server()


def used_to(server, delay):
    """A client on a link whose answers take so long [s]."""
    client, server.delay = a_client(server), delay
    client.stream(np.zeros(7))
    client.answers(0.1)
    return client


def test_goals_do_not_wait_for_their_answers_and_each_gets_its_own(server):
    client = used_to(server, 0.02)
    for _ in range(4):
        assert client.stream(np.zeros(7)) is Feedback.JOINTS
        server.now += 0.004
    assert client.open_goals == 4 and client.answers() == [] and client.silence(0.0) == 0.0
    server.now += 0.014
    assert [value[0] for _, value in client.answers()] == [2.0, 3.0, 4.0]
    assert [value[0] for _, value in client.answers(0.1)] == [5.0] and client.open_goals == 0
    assert client.counts.answered == client.counts.sent == 5


def test_between_joints_and_torques_an_acknowledgement_shows_a_lost_answer(server):
    client = used_to(server, 0.02)
    server.drop = True
    asked = [Feedback.JOINTS, Feedback.EXTERNAL_TORQUES, Feedback.EXTERNAL_TORQUES, Feedback.MEASURED_TORQUES]
    used = [client.stream(np.zeros(7), feedback) for feedback in asked]
    assert used == [Feedback.JOINTS, Feedback.DONE, Feedback.EXTERNAL_TORQUES, Feedback.DONE]
    ((feedback, error),) = client.answers(0.1)
    assert feedback is Feedback.JOINTS and isinstance(error, UnexpectedReply)
    assert client.silence(0.1) == 0.0 and client.counts.missed == 4, "the answers are sorted out"


def test_while_an_answer_is_overdue_no_numbers_are_asked_for(server):
    client = a_client(server)
    server.drop = True
    client.stream(np.zeros(7))
    server.now += 0.004
    assert client.stream(np.zeros(7)) is Feedback.DONE


def test_the_search_continues_until_the_last_late_answer(server):
    client = a_client(server)
    server.delay = 0.2
    for _ in range(3):
        client.stream(np.zeros(7), Feedback.DONE)
        server.now += 0.004
    server.now = 1000.0 + TIMING.servo_reply
    assert client.answers(0.001) == [] and client.open_goals == 0, "given up"
    server.now = 1000.201
    server.delay = 10.0
    assert client.silence(0.0) > 0.0 and client.counts.stray == 1
    server.now = 1000.209
    assert client.silence(0.0) > 0.0 and client.counts.stray == 3, "the probe is still to be answered"


def test_the_probe_after_joints_is_none_that_joints_answer(server):
    client = a_client(server)
    server.stalled_until = 1001.0
    client.stream(np.zeros(7), Feedback.JOINTS)
    server.now += 0.01
    client.stream(np.zeros(7), Feedback.DONE)
    server.now += TIMING.servo_reply
    assert client.silence(0.0) > 0.0
    assert server.sent[-1][1] == "getPin3"


def test_a_caller_that_looks_for_silence_itself_is_never_held_up(server):
    client = a_client(server)
    server.stalled_until = 1002.0
    client.stream(np.zeros(7))
    server.now += 0.05
    client.stream(np.zeros(7), wait=False)
    assert server.now == 1000.05 and client.open_goals == 2
    with pytest.raises(ReplyTimeout):
        client.stream(np.zeros(7))
    assert server.now < 1000.0 + TIMING.servo_reply + 0.01 and client.silence(0.0) > 0.0


def test_the_window_follows_the_usual_delay_up_to_its_bound(server):
    client = a_client(server)
    assert client._session.window == LEAST_WINDOW_S
    server.delay, sent = 0.04, 0
    for _ in range(200):
        if client.silence(0.02) == 0.0:
            client.stream(np.zeros(7))
            sent += 1
        client.answers()
        server.now += 0.004
    assert sent > 180 and client._session.window == pytest.approx(0.08, abs=0.01)
    server.delay = 0.0005
    for _ in range(400):
        assert client.silence(0.02) == 0.0
        client.stream(np.zeros(7))
        client.answers(0.001)
        server.now += 0.004
    assert client._session.window == LEAST_WINDOW_S
    server.stalled_until = server.now + 0.2
    begin = server.now
    while client.silence(0.0) == 0.0:
        client.stream(np.zeros(7))
        server.now += 0.004
    assert server.now - begin < LEAST_WINDOW_S + 0.004


class Stream(RuleBasedStateMachine):
    """A client that streams goals, and a list of what it asked and got."""

    @initialize(window=st.sampled_from([0.1, 0.1, 0.05, 0.0]))
    def connect(self, window):
        self.server = Server()
        self.timing = KstTiming(**{**vars(TIMING), "servo_window": window})
        self.client = a_client(self.server, self.timing)
        self.session = self.client._session
        self.asked = {}  # feedback of each line that was sent, by its number
        self.newest = 0  # the newest goal that was answered
        self.faults = 0  # lines that the server swallowed or added
        self.refused = False

    @rule(kinds=st.lists(st.sampled_from(STREAMED), min_size=1), period=st.sampled_from([0.0, 0.001, 0.004]))
    def goals(self, kinds, period):
        for feedback in kinds:
            silent = self.client.silence(0.0)
            before = list(self.session.open)
            oldest = before[0].sent_at if before else np.inf
            if silent:
                return
            assert not before or self.server.now - oldest < min(self.session.window, self.timing.servo_window)
            with contextlib.suppress(MotionRefused, ReplyTimeout):  # a refusal may meet a stall
                used = self.client.stream(np.zeros(7), feedback)
                assert used is feedback or (used is Feedback.DONE and before)
                self.asked[len(self.server.sent)] = used
            if self.client.mode is not KstMode.SERVO:
                self.client._mode = KstMode.SERVO
                self.session.arrived.clear()
            self.server.now += period

    @rule()
    def question(self):
        with contextlib.suppress(ReplyTimeout, MotionRefused, UnexpectedReply):
            before = len(self.server.sent)
            value = self.client.joints()
            assert value[1] == 1 and value[0] > before, "not the answer to this question"
        self.client._mode = KstMode.SERVO

    @rule(wait=st.sampled_from([0.0, 0.001, 0.02]))
    def take(self, wait):
        begin = self.server.now
        self.session.collect(begin + wait, every=wait > 0.0)
        goals = [goal for goal, _ in self.session.arrived]
        for goal, (feedback, value) in zip(goals, self.client.answers()):
            if isinstance(value, UnexpectedReply):
                assert self.faults, "no answer was wrong"
            elif feedback is Feedback.DONE:
                assert value is None
            else:
                number = round(value[0, 3] * 1000.0 if feedback is Feedback.POSE else value[0])
                assert self.asked[number] is feedback, "an answer was taken for one of another kind"
                assert number > self.newest, "answers are out of order"
                late = self.server.sent[number - 1][0] - goal.sent_at
                assert late == 0.0 if not self.faults else late >= 0.0, "not the answer to this goal"
                self.newest = number
        assert self.server.now <= begin + wait + 1e-9

    @rule(wait=st.sampled_from([0.001, 0.02, 0.1, 0.5, 1.5]))
    def idle(self, wait):
        self.server.now += wait

    @rule(delay=st.sampled_from([0.0002, 0.005, 0.03, 0.06, 0.2]))
    def other_delay(self, delay):
        self.server.delay = delay

    @rule(stall=st.sampled_from([0.05, 0.2, 0.7, 3.0]))
    def stall(self, stall):
        self.server.stalled_until = self.server.now + stall

    @precondition(lambda self: not self.session.open and self.session.in_step)
    @rule()
    def swallow(self):
        """The server swallows one answer of those that will be open together."""
        self.server.drop = True
        self.faults += 1

    @rule(line=st.sampled_from(["hello", "0.5_0.5_0.5_"]))
    def foreign_line(self, line):
        if not self.session.in_step or not self.session.open:  # else it could be taken for the answer it imitates
            return
        if line == "hello" or self.session.open[0].command.answer.value != "3 numbers":
            self.server.say("hello")
            self.faults += 1

    @precondition(lambda self: not self.refused)
    @rule()
    def refusal(self):
        """The main thread gives servo mode up; a second word of that kind would be a line that nobody asked for."""
        self.refused = True
        self.server.say("nak")

    @rule()
    def regained(self):
        """Whatever happened, the answers are found again, and nothing but probes is sent until then."""
        self.server.stalled_until = 0.0
        before = len(self.server.sent)
        for _ in range(100):
            silent = self.client.silence(0.05)
            if not silent:
                break
        assert not silent
        assert {word for _, word in self.server.sent[before:]} <= PROBES

    @invariant()
    def accounted(self):
        if not hasattr(self, "session"):
            return
        counts = self.session.counts
        assert len(self.session.open) <= MAX_OPEN
        assert self.session.window <= max(self.timing.servo_window, 0.0)
        open_probes = self.session._probes if not self.session.in_step else 0
        assert counts.sent >= counts.answered + len(self.session.open) + open_probes
        assert counts.missed + counts.answered + len(self.session.open) >= counts.sent - open_probes - self.faults - 2

    def teardown(self):
        if not hasattr(self, "session"):
            return
        self.server.stalled_until = 0.0
        self.client.close()
        with pytest.raises(ConnectionLost):
            self.client._mode = KstMode.SERVO
            self.client.stream(np.zeros(7))


Stream.TestCase.settings = settings(
    max_examples=300, stateful_step_count=30, deadline=None, suppress_health_check=list(HealthCheck)
)
TestStream = Stream.TestCase
