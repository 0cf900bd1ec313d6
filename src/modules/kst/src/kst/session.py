"""Pairs replies with commands on a link that numbers neither.

The server's reader thread answers in order. Its main thread clears the shared command word after each answer, so a
main-thread command that comes too early is wiped without a reply (docs/handbook/wire-protocols.md, "Arm: Sunrise
Toolbox"). Therefore the session pauses after such an answer and sends a wiped command again. The final word of a motion
comes unasked and is not an answer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from kst import codec
from kst.codec import KstCommand, KstReply, ReplyKind, ServerThread
from kst.errors import ReplyTimeout, UnexpectedReply
from kst.transport import KstTransport

STILL_RAD = 5e-4  # joints that change less than this between two readings, `KstTiming.quiet` apart, stand still [rad]
MAX_FOREIGN = 20  # after more foreign lines than this before one answer, the peer is not a toolbox server
MAX_STRAY = 200  # after more stray lines than this, resynchronisation fails


@dataclass(frozen=True)
class KstTiming:
    """Waits [s] and tries."""

    connect_settle: float = 1.0  # after connecting, until the server's main thread has attached its own tool
    tool_settle: float = 0.4  # after the tool is attached
    reply: float = 1.0  # longest wait for an answer outside servo mode
    servo_reply: float = 0.2  # longest wait for the answer to a servo goal
    main_pause: float = 0.005  # after an answer of the main thread, which could wipe a further command
    servo_start: float = 0.3  # after its start, while the server overwrites the goal with the present joints
    servo_stop: float = 0.1  # after the stop of servo mode, until the main thread reads again
    rest: float = 0.5  # longest wait for the arm to stand still before servo mode stops
    quiet: float = 0.1  # silence after which no late answer of the main thread comes
    farewell: float = 0.2  # longest wait for the server's end of file after `end`
    tries: int = 3  # how often a main-thread command is sent at most


@dataclass
class LinkCounts:
    """Events since the link was opened."""

    sent: int = 0
    answered: int = 0
    missed: int = 0  # answers
    resent: int = 0  # commands that were wiped
    stray: int = 0  # replies that belonged to no command
    foreign: int = 0  # lines that were not replies


class KstSession:
    """Pairs the lines of one connection. All that talks to the server raises ConnectionLost on a lost link.

    Attributes:
        counts: events so far.
        round_trip: time from the sending of the last answered command to its answer [s]; None before the first.
        final: the final word of the motion, DONE or NAK; None before it comes.
        refused: an unasked `nak` came: the main thread gave up a motion and dropped the tool.
    """

    def __init__(self, transport: KstTransport, timing: KstTiming) -> None:
        self.transport = transport
        self.timing = timing
        self.counts = LinkCounts()
        self.round_trip: float | None = None
        self.final: ReplyKind | None = None
        self.refused = False
        self._awaits_final = False
        self._unanswered: KstCommand | None = None
        self._main_answered_at = -np.inf

    @property
    def in_step(self) -> bool:
        """Whether every command so far has its answer."""
        return self._unanswered is None

    def expect_final(self, expected: bool) -> None:
        """Sets whether a motion is about to start, whose final word will come unasked, or is over."""
        self._awaits_final = expected
        self.final = None

    def post(self, command: KstCommand) -> None:
        """Sends a command that has no answer."""
        self.poll()
        self._send(command)

    def poll(self) -> None:
        """Sorts the lines that have come unasked; does not wait."""
        for reply in self.transport.waiting():
            self._sort(reply)

    def wait_for_final(self, timeout: float) -> ReplyKind | None:
        """Returns the final word of the motion, or None if it does not come within `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while self.final is None:
            reply = self.transport.receive(deadline)
            if reply is not None:
                self._sort(reply)
            if reply is None or time.monotonic() > deadline:
                break
        return self.final

    def ask(self, command: KstCommand, timeout: float | None = None) -> KstReply:
        """Sends a command and returns its answer; for a command of the main thread that may be a `nak`.

        Raises:
            ReplyTimeout: no answer within `timeout` seconds (None: `KstTiming.reply`).
            UnexpectedReply: an answer that does not fit, or too many lines that are no replies.
            ConnectionLost: also if the pairing is unknown since an earlier missing answer and could not be found again.
        """
        timeout = self.timing.reply if timeout is None else timeout
        late = self.resynchronise()
        self.refused = self.refused or (late is not None and late.kind is ReplyKind.NAK)
        self.poll()
        sent_at = self._send(command)
        foreign, last = 0, ""
        while foreign <= MAX_FOREIGN:
            reply = self.transport.receive(sent_at + timeout)
            if reply is None:
                self._unanswered = command
                self.counts.missed += 1
                raise ReplyTimeout(f"`{command.word}` was not answered within {timeout:g} s", command=command.word)
            if command.accepts(reply):
                self._note_answer(command, sent_at)
                return reply
            if not self._sort(reply) and reply.kind is not ReplyKind.FOREIGN:
                self._unanswered = command
                raise UnexpectedReply(
                    f"`{command.word}` was answered by `{reply.text}` instead of {command.answer.value}: check the"
                    " version of the server",
                    command=command.word,
                    reply=reply.text,
                )
            foreign += reply.kind is ReplyKind.FOREIGN
            last = reply.text
        self._unanswered = command
        raise UnexpectedReply(
            f"{foreign} lines after `{command.word}` were not replies, the last `{last}`: another program listens"
            " there; check address and port",
            command=command.word,
            reply=last,
        )

    def ask_main(self, command: KstCommand, patience: float | None = None) -> KstReply:
        """Sends a command of the main thread, again if it was wiped, and returns its answer, which may be a `nak`.

        It sends again only while the arm stands still and the reader thread answers within `patience` seconds (None:
        `KstTiming.reply`).

        Raises:
            ReplyTimeout: the main thread stays silent while the reader thread answers, or the arm moves.
            UnexpectedReply: as in `ask`.
            ConnectionLost: the link is lost or silent.
        """
        for attempt in range(self.timing.tries):
            if attempt > 0:
                self.counts.resent += 1
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
                        f"`{command.word}` was not acknowledged and the arm moves; it was not sent again",
                        command=command.word,
                    ) from error
        raise ReplyTimeout(
            f"`{command.word}` was not answered in {self.timing.tries} tries though the server reads: its main thread"
            " is stuck or has ended; look at the smartPad and restart MatlabToolboxServer there",
            command=command.word,
        )

    def resynchronise(self, patience: float | None = None) -> KstReply | None:
        """Restores the pairing after a missing answer, and returns that answer if it came late.

        The reader thread, which answers in order, is asked for a reply of another kind than the missing one: what comes
            before it is late. For a command of the main thread a short silence follows. A probe without an answer:
            ConnectionLost.
        """
        missing = self._unanswered
        if missing is None:
            return None
        late = self._sort_out(self.transport.waiting(), missing)
        if late is not None:
            return late
        probe = codec.get_pin(codec.INPUT_PINS[0]) if missing.answer is ReplyKind.SEVEN else codec.JOINTS
        sent_at = self._send(probe)
        deadline = sent_at + (self.timing.reply if patience is None else patience)
        for _ in range(MAX_STRAY):
            reply = self.transport.receive(deadline)
            if reply is None:
                break
            if reply.kind is probe.answer:
                self._note_answer(probe, sent_at)
                if late is None and missing.thread is ServerThread.MAIN:
                    self.transport.pause(self.timing.quiet)
                    late = self._sort_out(self.transport.waiting(), missing)
                self._unanswered = None
                return late
            found = self._sort_out([reply], missing)
            late = late or found
        self.transport.give_up(
            f"the controller answers neither `{missing.word}` nor `{probe.word}`: its application has stopped"
        )
        return None

    def rest(self, longest: float) -> None:
        """Waits until the arm stands still, at most `longest` seconds; raises as `ask`."""
        deadline = time.monotonic() + longest
        while time.monotonic() < deadline and self._arm_moves():
            pass

    def farewell(self, stop_servo: bool) -> None:
        """Ends the server's application: stops servo mode on request, sends `end`, waits for the end of file."""
        if stop_servo:
            self._send(codec.STOP_SERVO)
            self.transport.receive(time.monotonic() + self.timing.servo_reply)
            self.transport.pause(self.timing.servo_stop)
        self._send(codec.END)
        deadline = time.monotonic() + self.timing.farewell
        while self.transport.receive(deadline) is not None and time.monotonic() < deadline:
            pass

    def _send(self, command: KstCommand) -> float:
        ready_at = self._main_answered_at + self.timing.main_pause
        if ready_at > time.monotonic():
            self.transport.pause(ready_at - time.monotonic())
        sent_at = time.monotonic()
        self.transport.send(command.line, self.timing.reply)
        self.counts.sent += 1
        return sent_at

    def _note_answer(self, command: KstCommand, sent_at: float | None = None) -> None:
        now = time.monotonic()
        self.counts.answered += 1
        if sent_at is not None:
            self.round_trip = now - sent_at
        if command.thread is ServerThread.MAIN:
            self._main_answered_at = now

    def _sort(self, reply: KstReply) -> bool:
        """Handles a reply that is not the awaited answer; returns whether it belongs to a motion or refuses one."""
        missing = self._unanswered
        if missing is not None and reply.kind is missing.answer:
            self._unanswered = None
        elif self._awaits_final and self.final is None and reply.kind in (ReplyKind.DONE, ReplyKind.NAK):
            self.final = reply.kind
            self._main_answered_at = time.monotonic()
            return True
        elif reply.kind is ReplyKind.NAK and not self.refused:
            self.refused = True
            self._main_answered_at = time.monotonic()
            return True
        foreign = reply.kind is ReplyKind.FOREIGN
        self.counts.foreign += foreign
        self.counts.stray += not foreign
        return False

    def _sort_out(self, replies: list[KstReply], missing: KstCommand) -> KstReply | None:
        """Sorts replies and returns the one among them that answers `missing`."""
        late = None
        for reply in replies:
            if missing.accepts(reply) and self._unanswered is missing:
                self._unanswered = None
                self.counts.stray += 1
                late = reply
            else:
                self._sort(reply)
        return late

    def _arm_moves(self) -> bool:
        before = np.array(self.ask(codec.JOINTS).numbers)
        self.transport.pause(self.timing.quiet)
        change = np.abs(np.array(self.ask(codec.JOINTS).numbers) - before)
        return not np.all(change <= STILL_RAD)
