"""A controller on the simulated robot over bad links: far, jittery, lossy, stalled; all in simulated time."""

from __future__ import annotations

import math
import random
from collections import deque

import pytest
from test_freezes import Bench, Wire

from kst.codec import parse_reply
from kst.session import LEAST_WINDOW_S, KstTiming
from kuka_control.loop.commands import Servo

RTO_S = 0.2  # TCP repeats a lost packet after this time [s],
FAST = 3  # or, if so many later ones arrive, at once
NAMED_WITHIN_S = 0.2


class Way:
    """One direction of a TCP stream: lines arrive in order after `delay` +- `jitter` [s].

    A line is lost with the probability `loss`; `repaired` says whether later ones betray that, as they do in TCP, or
    the stream stalls for RTO_S in any case.
    """

    def __init__(self, rng, delay, jitter=0.0, loss=0.0, repaired=True):
        self._rng, self._delay, self._jitter, self._loss, self._repaired = rng, delay, jitter, loss, repaired
        self._lines, self._arrived, self._later = deque(), 0.0, 0
        self.stalls = []

    def put(self, now, line):
        delay = self._delay + self._rng.uniform(-self._jitter, self._jitter)
        again = 0.0
        lost = [entry for entry in self._lines if entry[1]]
        if lost:
            self._later += 1
            if self._repaired and self._later == FAST:
                lost[0][1] = min(lost[0][1], now + 3.0 * delay)
        elif self._rng.random() < self._loss:
            again, self._later = now + RTO_S + delay, 0
        self._lines.append([now + delay, again, line])

    def due(self):
        """When the next line arrives."""
        if not self._lines:
            return math.inf
        due = max(*self._lines[0][:2], self._arrived)
        for begin, end in self.stalls:
            due = end if begin <= due < end else due
        return due

    def take(self, now):
        """The lines that have arrived."""
        lines = []
        while self.due() <= now:
            self._arrived = self.due()
            lines.append(self._lines.popleft()[2])
        return lines


class BadWire(Wire):
    """Lines and answers on their ways. With `nagle` the server holds answers back until the last ones are confirmed."""

    def __init__(self, nagle=False):
        super().__init__([])
        self.up = self.down = None
        self._nagle, self._held, self._confirmed = nagle, [], 0.0
        self.goals = []

    def worsen(self, seed, **way):
        self.up, self.down = Way(random.Random(seed), **way), Way(random.Random(seed + 1), **way)

    def _run(self, now):
        if self.up is None:
            super()._run(now)
            return
        for line in self._in:
            self.up.put(self.now, line)
            if line.startswith("jp"):
                self.goals.append(self.now)
        self._in.clear()
        while True:
            lines = self.up.take(self.now)
            texts = [*(self.application.receive(line, self.now) for line in lines), self.application.advance(self.now)]
            self._held += [line for text in texts for line in text.split("\n") if line]
            if self._held and (not self._nagle or self.now >= self._confirmed):
                for line in self._held:
                    self.down.put(self.now, line)
                self._held.clear()
                self._confirmed = self.down.due() + self.up._delay
            self._out += [parse_reply(line.encode()) for line in self.down.take(self.now)]
            if self.now >= now:
                return
            self.now = max(self.now + 1e-5, min(now, self.now + 0.001, self.up.due(), self.down.due()))

    def send(self, line, timeout):
        self._check()
        self.sent.append(line.split("_")[0] if line.endswith("_") else line)
        self._in.append(line)
        self._run(self.now if self.up else self.now + 0.0005)

    def receive(self, deadline):
        self._check()
        while not self._out:
            if self.now >= deadline:
                return None
            self._run(min(deadline, self.now + 0.001))
        return self._out.pop(0)


class Following(Bench):
    """A controller at the pace of its node that follows a hand; the link worsens when it does."""

    def follow(self, seconds):
        wire, steps = self.wire, []
        end = wire.now + seconds
        while wire.now < end:
            begun = wire.now
            before = len(wire.goals)
            step = self.controller.cycle(self.inputs(), wire.now)
            steps.append((begun, step, len(wire.goals) - before))
            wire.pause(max(begun + 0.004 - wire.now, 0.0))
        return steps


@pytest.fixture
def following():
    def follow(nagle=False):
        bench = Following(BadWire(nagle))
        bench.run(1012.0, "servo")
        return bench

    return follow


LINKS = {
    "1 % loss": {"delay": 0.0005, "jitter": 0.0002, "loss": 0.01},
    "20 +- 10 ms": {"delay": 0.02, "jitter": 0.01},
    "both": {"delay": 0.02, "jitter": 0.01, "loss": 0.01},
}


@pytest.mark.parametrize("link", LINKS)
def test_goals_keep_their_pace_on_a_bad_link_hold_in_a_stall_and_brake(following, link):
    bench = following(nagle=link == "20 +- 10 ms")
    wire = bench.wire
    wire.worsen(0, **LINKS[link])
    steps = bench.follow(3.0)
    assert sum(sent for _, _, sent in steps) > 0.9 * 750
    assert not any("lost" in event.sentence for _, step, _ in steps for event in step.events)

    wire.up._loss = wire.down._loss = 0.0
    for stall in (0.3, 0.8):
        steps += bench.follow(1.0)
        steps += stalled(bench, stall)
    assert {step.mode for _, step, _ in steps} == {"servo"} and wire.arm.stops == 0

    bench.control_on = False
    steps = bench.follow(1.0)
    assert any(isinstance(step.command, Servo) for _, step, _ in steps), "it brakes by goals"
    assert steps[-1][1].mode != "servo" and wire.arm.stops == 0


def stalled(bench, stall):
    """Stalls the link: the goals hold within the window, the loss is named in time, and then the goals go on."""
    wire, begin, holds = bench.wire, bench.wire.now, bench.controller.holds
    usual = bench.client._session.usual
    wire.up.stalls = wire.down.stalls = [(begin, begin + stall)]
    steps = bench.follow(stall)
    window = min(max(2.0 * usual, LEAST_WINDOW_S), KstTiming().servo_window)
    assert max(wire.goals) < begin + window + 0.005, "goals were sent into the stall"
    (named,) = [at for at, step, _ in steps if any("lost for the moment" in event.sentence for event in step.events)]
    assert named - begin < NAMED_WITHIN_S + usual
    before = len(wire.goals)
    steps += bench.follow(1.0)
    assert len(wire.goals) - before > 200 and bench.controller.holds == holds + 1
    return steps


def test_a_link_that_stalls_with_every_loss_is_slow_but_safe(following):
    bench = following()
    bench.wire.worsen(0, delay=0.0005, loss=0.01, repaired=False)
    steps = bench.follow(4.0)
    assert len(bench.wire.goals) > 250 and bench.controller.holds > 2
    assert {step.mode for _, step, _ in steps} == {"servo"} and bench.wire.arm.stops == 0
