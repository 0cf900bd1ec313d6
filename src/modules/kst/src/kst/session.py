"""Question and answer with a server that numbers neither: which reply belongs to which command.

The server's reader thread answers in order. Its main thread clears the shared command word after each answer, so a
main-thread command that comes too early is wiped without a reply (reference: kst.md, 0 and 3.2): hence the pause after
its answers and the guarded resending. The final word of a motion comes unasked and is kept apart from the answers.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from kst import codec
from kst.codec import Command, Kind, Reply, Thread
from kst.errors import ProtocolError, ReplyTimeout
from kst.transport import Transport

STILL_RAD = 5e-4
"""Joints that change less than this between two looks, `Timing.quiet` apart, count as standing."""

MAX_FOREIGN = 20
"""Lines that are no replies while one answer is awaited; more, and something else is talking."""

MAX_STRAY = 200
"""Lines thrown away while the pairing is sought again; more, and it is given up."""


@dataclass(frozen=True)
class Timing:
    """How long to wait for what; all in seconds but `tries`.

    Attributes:
        connect_settle: after connecting, until the server's main thread has attached its own tool.
        tool_settle: after the tool is attached.
        reply: longest wait for an answer outside the servo mode.
        servo_reply: longest wait for the answer to a servo goal.
        main_pause: after an answer of the main thread, during which a further command could be wiped.
        servo_start: after the start of the servo mode, while the server overwrites the goal with the present joints.
        servo_stop: after the stop of the servo mode, until the main thread listens again.
        rest: longest wait for the arm to stand before the servo mode is stopped.
        quiet: silence that shows that no late answer of the main thread is on its way.
        farewell: longest wait for the server's end of file after `end`.
        tries: how often a main-thread command is sent at most.
    """

    connect_settle: float = 1.0
    tool_settle: float = 0.4
    reply: float = 1.0
    servo_reply: float = 0.2
    main_pause: float = 0.005
    servo_start: float = 0.3
    servo_stop: float = 0.1
    rest: float = 0.5
    quiet: float = 0.1
    farewell: float = 0.2
    tries: int = 3


@dataclass(frozen=True)
class Counts:
    """What happened on the link since it was opened: commands sent and answered, answers missed, commands sent again
    after they were wiped, lines that belonged to no question, lines that were no replies at all."""

    sent: int = 0
    answered: int = 0
    missed: int = 0
    resent: int = 0
    stray: int = 0
    foreign: int = 0


class Session:
    """Pairs the lines of one connection.

    Attributes:
        counts: what happened so far.
        round_trip: time from the sending of the last answered command to its answer [s]; None before the first.
        final: the final word of the motion, `Kind.DONE` or `Kind.NAK`; None while it has not come.
        refused: an unasked `nak` came: the main thread gave something up and dropped the tool.
    """

    def __init__(self, transport: Transport, timing: Timing) -> None:
        self.transport = transport
        self.timing = timing
        self.counts = Counts()
        self.round_trip: float | None = None
        self.final: Kind | None = None
        self.refused = False
        self._awaits_final = False
        self._unanswered: Command | None = None
        self._main_answered_at = -np.inf

    @property
    def in_step(self) -> bool:
        """Whether every question so far has its answer."""
        return self._unanswered is None

    def expect_final(self, expected: bool) -> None:
        """Says whether a motion is about to run, whose final word will come unasked, or is over."""
        self._awaits_final = expected
        self.final = None

    def tell(self, command: Command) -> None:
        """Sends a command that has no answer.

        Raises:
            ConnectionLost: the link is lost.
        """
        self.look()
        self._send(command)

    def look(self) -> None:
        """Takes in what has come unasked; does not wait.

        Raises:
            ConnectionLost: the link is lost.
        """
        for reply in self.transport.waiting():
            self._sort(reply)

    def wait_for_final(self, timeout: float) -> Kind | None:
        """Returns the final word of the motion; None when it does not come within `timeout` seconds.

        Raises:
            ConnectionLost: the link is lost.
        """
        deadline = time.monotonic() + timeout
        while self.final is None:
            reply = self.transport.receive(deadline)
            if reply is None:
                break
            self._sort(reply)
            if time.monotonic() > deadline:
                break
        return self.final

    def ask(self, command: Command, timeout: float | None = None) -> Reply:
        """Sends a command and returns its answer; for a command of the main thread that may be a `nak`.

        Raises:
            ReplyTimeout: no answer within `timeout` seconds (None: `Timing.reply`).
            ProtocolError: an answer that does not fit, or too many lines that are no replies.
            ConnectionLost: the link is lost, or an earlier missing answer left the pairing unknown and it could not
                be found again.
        """
        timeout = self.timing.reply if timeout is None else timeout
        late = self.resynchronise()
        self.refused = self.refused or (late is not None and late.kind is Kind.NAK)
        self.look()
        sent_at = self._send(command)
        foreign, last = 0, ""
        while foreign <= MAX_FOREIGN:
            reply = self.transport.receive(sent_at + timeout)
            if reply is None:
                self._unanswered = command
                self._count(missed=1)
                raise ReplyTimeout(f"`{command.word}` was not answered within {timeout:g} s")
            if reply.kind is command.answer or (reply.kind is Kind.NAK and command.thread is Thread.MAIN):
                self._note_answer(command, sent_at)
                return reply
            if not self._sort(reply) and reply.kind is not Kind.FOREIGN:
                self._unanswered = command
                raise ProtocolError(
                    f"`{command.word}` was answered by `{reply.text}` instead of {command.answer.value}:"
                    f" the server is of another version, or answers got mixed up"
                )
            foreign += reply.kind is Kind.FOREIGN
            last = reply.text
        self._unanswered = command
        raise ProtocolError(
            f"`{command.word}` met {foreign} lines that are no replies, the last `{last}`:"
            f" is something else than the toolbox server listening there?"
        )

    def ask_main(self, command: Command, patience: float | None = None) -> Reply:
        """Sends a command of the main thread, again if it was wiped, and returns its answer, which may be a `nak`.

        Before it sends again it makes sure that the reader thread still answers and that the arm stands.

        Args:
            command: what to ask.
            patience: how long to wait for the reader thread where the main thread is silent [s] (None: `Timing.reply`).

        Raises:
            ReplyTimeout: the main thread stays silent while the reader thread answers, or the arm moves.
            ProtocolError: as in `ask`.
            ConnectionLost: the link is lost or silent.
        """
        for attempt in range(self.timing.tries):
            if attempt > 0:
                self._count(resent=1)
            try:
                return self.ask(command)
            except ReplyTimeout as error:
                late = self.resynchronise(patience)
                if late is not None:
                    self._note_answer(command)
                    return late
                if self._arm_moves():
                    self._unanswered = command
                    raise ReplyTimeout(
                        f"`{command.word}` was not acknowledged and the arm moves; it was not sent again"
                    ) from error
        raise ReplyTimeout(
            f"`{command.word}` was not answered in {self.timing.tries} tries though the server reads: its main thread"
            f" is stuck or has ended; look at the pad and restart MatlabToolboxServer there"
        )

    def resynchronise(self, patience: float | None = None) -> Reply | None:
        """Finds the pairing again after a missing answer, and returns that answer if it came late.

        A probe of another kind than the missing answer is asked of the reader thread, which answers in order: what
        comes before its answer is late. For a command of the main thread a short silence follows.

        Raises:
            ConnectionLost: the probe is not answered either.
        """
        missing = self._unanswered
        if missing is None:
            return None
        late = self._sort_out(self.transport.waiting(), missing)
        if late is not None:
            return late
        probe = codec.get_pin(codec.INPUT_PINS[0]) if missing.answer is Kind.SEVEN else codec.JOINTS
        sent_at = self._send(probe)
        deadline = sent_at + (self.timing.reply if patience is None else patience)
        for _ in range(MAX_STRAY):
            reply = self.transport.receive(deadline)
            if reply is None:
                break
            if reply.kind is probe.answer:
                self._note_answer(probe, sent_at)
                if late is None and missing.thread is Thread.MAIN:
                    self.transport.pause(self.timing.quiet)
                    late = self._sort_out(self.transport.waiting(), missing)
                self._unanswered = None
                return late
            found = self._sort_out([reply], missing)
            late = late or found
        self.transport.give_up(
            f"the controller answers neither `{missing.word}` nor `{probe.word}`: its application is stopped or deaf"
        )
        return None

    def rest(self, longest: float) -> None:
        """Waits until the arm stands, at most `longest` seconds.

        Raises:
            ReplyTimeout, ProtocolError, ConnectionLost: as in `ask`.
        """
        deadline = time.monotonic() + longest
        while time.monotonic() < deadline and self._arm_moves():
            pass

    def farewell(self, stop_servo: bool) -> None:
        """Ends the server's application: stops the servo mode if it may run, sends `end`, awaits the end of file.

        Raises:
            ConnectionLost: the link is lost; after the server's end of file that is the good end.
        """
        if stop_servo:
            self._send(codec.STOP_SERVO)
            self.transport.receive(time.monotonic() + self.timing.servo_reply)
            self.transport.pause(self.timing.servo_stop)
        self._send(codec.END)
        deadline = time.monotonic() + self.timing.farewell
        while self.transport.receive(deadline) is not None and time.monotonic() < deadline:
            pass

    def _send(self, command: Command) -> float:
        ready_at = self._main_answered_at + self.timing.main_pause
        if ready_at > time.monotonic():
            self.transport.pause(ready_at - time.monotonic())
        sent_at = time.monotonic()
        self.transport.send(command.line, self.timing.reply)
        self._count(sent=1)
        return sent_at

    def _note_answer(self, command: Command, sent_at: float | None = None) -> None:
        now = time.monotonic()
        self._count(answered=1)
        if sent_at is not None:
            self.round_trip = now - sent_at
        if command.thread is Thread.MAIN:
            self._main_answered_at = now

    def _sort(self, reply: Reply) -> bool:
        """Puts a reply that is not the awaited answer in its place; returns whether it has one."""
        missing = self._unanswered
        if missing is not None and reply.kind is missing.answer:
            self._unanswered = None
        elif self._awaits_final and self.final is None and reply.kind in (Kind.DONE, Kind.NAK):
            self.final = reply.kind
            self._main_answered_at = time.monotonic()
            return True
        elif reply.kind is Kind.NAK and not self.refused:
            self.refused = True
            self._main_answered_at = time.monotonic()
            return True
        if reply.kind is Kind.FOREIGN:
            self._count(foreign=1)
        else:
            self._count(stray=1)
        return False

    def _sort_out(self, replies: list[Reply], missing: Command) -> Reply | None:
        """Sorts replies and returns the one among them that answers `missing`."""
        late = None
        for reply in replies:
            expected = reply.kind is missing.answer or (reply.kind is Kind.NAK and missing.thread is Thread.MAIN)
            if expected and self._unanswered is missing:
                self._unanswered = None
                self._count(stray=1)
                late = reply
            else:
                self._sort(reply)
        return late

    def _arm_moves(self) -> bool:
        before = np.array(self.ask(codec.JOINTS).numbers)
        self.transport.pause(self.timing.quiet)
        change = np.abs(np.array(self.ask(codec.JOINTS).numbers) - before)
        return not np.all(change <= STILL_RAD)

    def _count(self, **more: int) -> None:
        self.counts = replace(self.counts, **{name: getattr(self.counts, name) + n for name, n in more.items()})
