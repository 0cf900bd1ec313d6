"""Laws of the pairing under random schedules: answers late, lost or overtaken, servers that freeze; in simulated time.

The wire is that of the published server: two threads, each of which answers in its own order, on one TCP stream.
"""

from __future__ import annotations

import contextlib
import random

import numpy as np
import pytest
from simulated_wire import SimulatedWire

from kst.client import KstClient, KstMode
from kst.codec import Feedback, ToolTransform
from kst.errors import ConnectionLost, MotionInterrupted, MotionRefused, ReplyTimeout
from kst.limits import LBR_IIWA_LIMITS
from kst.session import ARRIVED_RAD, KstSession, KstTiming

TIMING = KstTiming(connect_settle=0.0, tool_settle=0.0)
PROBES = ("getPin3", "getJointsPositions")
TICK_S = 0.004
RANGES = np.full((7, 1), 10.0) * (-1.0, 1.0)
CLOCK = 1e-6  # joint 1 of the model turns so slowly [rad/s] that the arm stands still, but tells the time


class Server(SimulatedWire):
    """The published server with a clock of its own, as a transport.

    `busy`: time before a motion begins, with its acknowledgement, which answers of the reader thread overtake by
    `overtaken` [s] (None: it is lost); `final`: delay of the last word. `wiped`: starts that are wiped. `frozen`: spans
    of time in which it does nothing. `loss`: of answers of the reader thread. `meets`: the part of its way after which
    a guarded motion ends; 1: at its goal.
    """

    def __init__(self, rng, busy=0.0, overtaken=0.001, final=0.001, wiped=0, frozen=(), loss=0.0, duration=1.0):
        super().__init__()
        self.meets = 1.0
        self.rng, self.busy, self.overtaken, self.final, self.wiped = rng, busy, overtaken, final, wiped
        self.frozen = frozen
        self.loss, self.duration, self.lasts = loss, duration, duration
        self.refused, self.motions = [], 0
        self.start, self.goal, self.began = np.zeros(7), np.zeros(7), -np.inf
        self.servo = self.ended = False
        self._asked = np.zeros(7)

    def joints(self, now):
        part = np.clip((now - self.began) / max(self.lasts, 1e-9), 0.0, 1.0)
        return self.start + part * (self.goal - self.start)

    def alive_at(self, now):
        for begin, end in self.frozen:
            now = end if begin <= now < end else now
        return now

    def send(self, line, timeout):
        self.check()
        word, numbers = line.split("_")[0], [float(x) for x in line.split("_")[1:] if x.strip("extJ")]
        self.sent.append((self.now, word))
        now = self.alive_at(self.now + 0.0005)
        if word == "getJointsPositions" or word == "jpJP":
            text = "".join(f"{x!r}_" for x in (CLOCK * (now - 1000.0), *self.joints(now)[1:].tolist()))
            self._say(text, now, self.loss)
        elif word == "getPin3":
            self._say("1", now, self.loss)
        elif word == "jp":
            self._asked = np.array(numbers)
            self._say("done", now, self.loss)
        elif word in ("doPTPinJS", "doPTP!inJS"):
            self._move(now, self.meets if word == "doPTP!inJS" else 1.0)
        elif word == "Torques" and now > self.began + self.lasts:
            self._say("1.0_2.0_3.0_4.0_5.0_6.0_7.0_", now)
        elif word == "startDirectServoJoints":
            self.servo = True
            self._say("done", now)
        elif word == "stopDirectServoJoints":
            self.servo = False
            self._say("done", now)
        elif word == "end":
            self.ended = True
        elif now > self.began + self.lasts:
            self._say("done", now)

    def _move(self, now, part):
        if self.wiped > 0 or now < self.began + self.lasts:
            self.wiped -= 1
            return
        self.motions, self.lasts = self.motions + 1, part * self.duration
        begin = self.alive_at(now + self.busy)
        self.start, self.began = self.joints(now), begin
        self.goal = self.start + part * (self._asked - self.start)
        if self.overtaken is not None:
            self._say("done", begin + self.overtaken)
        last = "done" if part == 1.0 else "interrupted"
        self._say(last, self.alive_at(begin + max(self.lasts, self.overtaken or 0.0)) + self.final)

    def _say(self, text, at, loss=0.0):
        if self.rng.random() >= loss:
            self.put(text, at)


def connected(server):
    return KstClient(KstSession(server, TIMING), ToolTransform(np.eye(4)), LBR_IIWA_LIMITS)


def spans(rng, count, longest):
    begins = sorted(1000.0 + rng.uniform(0.0, 8.0) for _ in range(count))
    return [(begin, begin + rng.uniform(0.02, longest)) for begin in begins]


def goal_of(rng):
    return np.array([0.0, *(rng.uniform(-1.5, 1.5) for _ in range(6))])


def read(client, server):
    """Reads the joints, if they come; joint 1 of the model tells when they were measured: never before the question."""
    asked = server.now
    try:
        q = client.joints()
    except ReplyTimeout:
        return
    assert q[0] / CLOCK + 1000.0 >= asked - 1e-6, "an answer to an earlier question"


def run(client, server, goal, torques=None):
    """A motion as a controller runs it; returns whether it counts as ended at its goal, or as one that never began."""
    try:
        client.start_ptp_joints(goal, 0.2, torques)
    except (MotionRefused, ReplyTimeout):
        assert client.mode is KstMode.IDLE
        return False
    deadline = server.now + 30.0
    while True:
        assert server.now < deadline, "the motion has no end"
        server.pause(TICK_S)
        if client.silence(0.02):
            continue
        try:
            if client.ptp_arrived():
                return True
        except ReplyTimeout:
            continue
        except MotionRefused:
            assert client.mode is KstMode.IDLE
            return False
        read(client, server)


@pytest.mark.parametrize("seed", range(150))
def test_every_motion_is_counted_once_and_to_its_end(seed):
    """With acknowledgements that are late, lost or overtaken, starts that are wiped, and a server that freezes."""
    rng = random.Random(seed)
    busy, overtaken = rng.choice([0.0, rng.uniform(0.0, 0.9)]), rng.choice([0.001, None, rng.uniform(0.0, 0.3)])
    server = Server(rng, busy, overtaken, rng.choice([0.001, 0.05, 0.5]), rng.randrange(2))
    server.duration, server.frozen = rng.choice([0.15, 0.6, 3.0]), spans(rng, rng.randrange(3), 4.0)
    client = connected(server)
    ended = 0
    for _ in range(3):
        goal = goal_of(rng)
        if run(client, server, goal, rng.choice([None, RANGES])):
            ended += 1
            off = np.degrees(np.max(np.abs(server.joints(server.now) - goal)))
            assert off <= 0.1, f"a motion counts as ended {off:.1f} deg before its goal"
        assert server.now >= server.began + server.lasts, "a motion runs that counts as none"
    assert ended == server.motions


@pytest.mark.hazard(4)
@pytest.mark.parametrize("seed", range(150))
def test_a_motion_that_meets_something_is_interrupted_once_and_never_sent_again(seed):
    """With acknowledgements that are late, lost or overtaken, late last words, starts that are wiped, and freezes."""
    rng = random.Random(seed)
    busy, overtaken = rng.choice([0.0, rng.uniform(0.0, 0.9)]), rng.choice([0.001, None, rng.uniform(0.0, 0.3)])
    server = Server(rng, busy, overtaken, rng.choice([0.001, 0.05, 0.5]), rng.randrange(2))
    server.duration, server.frozen = rng.choice([0.15, 0.6, 3.0]), spans(rng, rng.randrange(3), 4.0)
    server.meets = rng.choice([0.0, 0.01, rng.uniform(0.1, 0.9)])
    client = connected(server)
    goal = goal_of(rng)
    try:
        assert not run(client, server, goal, RANGES), "a motion counts as ended at its goal"
    except MotionInterrupted:
        assert client.mode is KstMode.IDLE
    moved = np.max(np.abs(server.joints(server.now) - np.zeros(7))) > ARRIVED_RAD
    assert server.motions <= 1 or not moved, "an arm that met something was sent on"
    assert server.now >= server.began + server.lasts, "a motion runs that counts as none"
    server.meets, server.wiped, motions = 1.0, 0, server.motions
    server.pause(3.0)
    while client.silence(0.1):
        pass
    assert run(client, server, goal, RANGES) == (server.motions > motions), "the next one is paired"


@pytest.mark.parametrize("seed", range(50))
def test_no_answer_is_taken_for_another_and_nothing_but_probes_is_sent_into_a_silence(seed):
    rng = random.Random(seed)
    server = Server(rng, loss=rng.choice([0.0, 0.02, 0.3]), frozen=spans(rng, 2, 4.5))
    client = connected(server)
    client._mode = KstMode.SERVO
    while server.now < 1030.0:
        server.pause(TICK_S)
        before = len(server.sent)
        if client.silence(0.02):
            assert {word for _, word in server.sent[before:]} <= set(PROBES)
            continue
        asked = server.now
        try:
            q = client.servo(np.zeros(7), Feedback.JOINTS)
            assert q[0] / CLOCK + 1000.0 >= asked - 1e-6, "an answer to an earlier goal"
        except ReplyTimeout:
            assert client.silence(0.0) > 0.0
    assert client.counts.answered > 50


@pytest.mark.parametrize("seed", range(10))
def test_a_server_that_stays_silent_is_given_up_in_time_and_hears_the_farewell(seed):
    rng = random.Random(seed)
    begin = 1000.0 + rng.uniform(0.0, 2.0)
    server = Server(rng, frozen=[(begin, 2000.0)])
    client = connected(server)
    client._mode = KstMode.SERVO
    with pytest.raises(ConnectionLost):
        while server.now < 1020.0:
            server.pause(TICK_S)
            if client.silence(0.02) == 0.0:
                with contextlib.suppress(ReplyTimeout):
                    client.servo(np.zeros(7), Feedback.JOINTS)
    assert 9.5 < server.now - begin < 10.5
    closed_at = server.now
    client.close()
    assert [word for _, word in server.sent[-2:]] == ["stopDirectServoJoints", "end"]
    assert server.now - closed_at < 0.5
