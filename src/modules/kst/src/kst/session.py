"""Pairs replies with commands on a link that numbers neither.

The server's reader thread answers in order. Its main thread clears the shared command word after each answer, so a
command for it that comes too early is wiped without a reply (docs/handbook/wire-protocols.md, "Arm: Sunrise Toolbox"):
the session pauses after such an answer and sends a wiped command again. The final word of a motion comes unasked.

After a missing answer nothing is sent but probes: questions to the reader thread that ask for a reply of another kind.
What comes before the answer to a probe is late. A server that answers no probe for `KstTiming.silence` is given up.

Servo goals may be streamed; each answer belongs to the oldest goal that is open. The window bounds the age of that one:
what a stalled link holds back reaches the arm in one go, and the arm jumps by as much. It follows the link's usual
delay."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kst import codec
from kst.codec import KstCommand, KstReply, ReplyKind, ServerThread
from kst.errors import ReplyTimeout, UnexpectedReply
from kst.transport import KstTransport

PIN = codec.get_pin(codec.INPUT_PINS[0])  # a probe
ARRIVED_RAD = float(np.radians(0.1))  # an arm with no joint farther from the goal than this has arrived [rad]
STILL_RAD = 5e-4  # joints that change less than this between two readings, `KstTiming.quiet` apart, stand still [rad]
MAX_OPEN = 100  # more streamed goals than this are never open
LEAST_WINDOW_S = 0.024  # a shorter one would keep TCP from noticing at once, by later packets, that one was lost [s]
_FINAL = (ReplyKind.DONE, ReplyKind.NAK, ReplyKind.INTERRUPTED, ReplyKind.STOPPED)


@dataclass(frozen=True)
class KstTiming:
    """Waits [s] and tries."""

    connect_settle: float = 1.0  # after connecting, until the server's main thread has attached its own tool
    tool_settle: float = 0.4  # after the tool is attached
    reply: float = 1.0  # longest wait for an answer outside servo mode
    servo_reply: float = 0.16  # longest wait for the answer to a servo goal, which takes a few milliseconds
    servo_window: float = 0.1  # no goal is streamed while an older one is open than this; 0: one goal at a time
    main_pause: float = 0.005  # after an answer of the main thread, which could wipe a further command
    servo_start: float = 0.3  # after its start, while the server overwrites the goal with the present joints
    servo_stop: float = 0.1  # after the stop of servo mode, until the main thread reads again
    rest: float = 0.5  # longest wait for the arm to stand still before servo mode stops
    quiet: float = 0.1  # silence after which no late answer of the main thread comes
    probe: float = 1.0  # time between two probes of a silent server
    silence: float = 10.0  # a server that answers nothing for this long is given up
    farewell: float = 0.2  # longest wait for the end of servo mode, and for the server's end of file after `end`
    tries: int = 3  # how often a main-thread command is sent at most


@dataclass
class LinkCounts:
    sent: int = 0
    answered: int = 0
    missed: int = 0  # answers
    resent: int = 0  # commands that were wiped
    stray: int = 0  # replies that belonged to no command
    foreign: int = 0  # lines that were not replies


class StreamedGoal(NamedTuple):
    """A command of the reader thread that was sent without waiting for its answer."""

    command: KstCommand
    sent_at: float  # monotonic [s]


class KstSession:
    """Pairs the lines of one connection. All that talks to the server raises ConnectionLost on a lost link.

    Attributes:
        monotonic: the transport's time [s].
        round_trip: time from the sending of the last answered command to its answer [s]; None before the first.
        open: the streamed goals whose answers have not come, the oldest first.
        arrived: the streamed goals with their answers, as they came, until somebody takes them. An answer that does not
            fit its goal is there too; then the pairing is to be restored.
        usual: the longest time that an answer took lately [s].
        final: the final word of the motion, DONE, NAK, INTERRUPTED or STOPPED; None before it comes.
        stopped_by: what stopped it, in the words of the robot application.
        refused: an unasked `nak` came: the main thread gave up a motion and dropped the tool.
        doubt: only the joints can tell the state of the motion, because the acknowledgement of its start is missing: it
            may have been wiped, or a `done` came that is the late acknowledgement or the final word."""

    def __init__(self, transport: KstTransport, timing: KstTiming) -> None:
        self.transport = transport
        self.monotonic = transport.monotonic
        self.timing = timing
        self.counts = LinkCounts()
        self.round_trip: float | None = None
        self.open: deque[StreamedGoal] = deque()
        self.arrived: deque[tuple[StreamedGoal, KstReply]] = deque()
        self.usual = 0.0
        self._widened_at = -np.inf
        self.final: ReplyKind | None = None
        self.stopped_by = ""
        self.refused = self.doubt = False
        self._awaits_final = self._unacknowledged = False
        self._unanswered: KstCommand | None = None
        self._before: deque[KstCommand] = deque()  # further ones, sent before it, whose answers are missing too
        self._late: KstReply | None = None  # its answer, if that came late
        self._probe_lost = False  # whether the missing answer is that to a probe
        self._probe = codec.JOINTS
        self._probes = 0  # sent in this search and not answered
        self._strays = 0  # lines in this search that nobody asked for
        self._asked_at = self._probed_at = self._heard_at = 0.0
        self._main_answered_at = -np.inf

    @property
    def in_step(self) -> bool:
        """Whether no answer is missing; those to streamed goals may still come in time."""
        return self._unanswered is None

    @property
    def silent(self) -> float:
        """Time since the command was sent whose answer is missing [s]; 0 if none is."""
        return 0.0 if self.in_step else self.monotonic() - self._asked_at

    def expect_final(self, expected: bool) -> None:
        """Sets whether a motion is about to start, whose final word will come unasked, or is over."""
        self._awaits_final = expected
        self._unacknowledged = self.doubt = False
        self.final = None

    @property
    def acknowledged(self) -> bool:
        """Whether a `done` came since the start of the motion."""
        return not self._unacknowledged

    def expect_second_word(self) -> None:
        """Ends a motion whose one `done` was its late acknowledgement or its final word: a second one is sorted out."""
        self.expect_final(False)
        self._search(codec.START_PTP, self.monotonic())

    @property
    def window(self) -> float:
        """No goal is streamed while an older one is open than this [s]."""
        return min(max(2.0 * self.usual, LEAST_WINDOW_S), self.timing.servo_window)

    @property
    def has_room(self) -> bool:
        if not self.open:
            return self.in_step
        return len(self.open) < MAX_OPEN and self.monotonic() - self.open[0].sent_at < self.window

    def stream(self, command: KstCommand, wait: bool = True) -> None:
        """Sends a command of the reader thread; its answer will be in `arrived`. May `wait` while the window is
        full. Raises ReplyTimeout: an earlier answer is missing, and this command was not sent; ConnectionLost: as in
        `ask`."""
        if not self.open:
            self.poll()
        elif wait and not self.has_room:
            self.collect(self.open[0].sent_at + self.timing.servo_reply)
        if self._unanswered is not None:
            self._heed(self.resynchronise(0.0))
        self.open.append(StreamedGoal(command, self._send(command)))

    def collect(self, deadline: float, every: bool = False) -> None:
        """Takes the answers to streamed goals that have come. Waits until `deadline`, in seconds of `monotonic`, for
        room in the window, or for `every` answer."""
        self.poll()
        while self.open and (every or not self.has_room):
            missing_at = self.open[0].sent_at + self.timing.servo_reply
            reply = self.transport.receive(min(deadline, missing_at))
            if reply is not None:
                self._take(reply)
            elif self.monotonic() >= missing_at:
                self._lose_open()
            elif self.monotonic() >= deadline:
                return

    def post(self, command: KstCommand) -> None:
        self.poll()
        self._send(command)

    def poll(self) -> None:
        """Sorts the lines that have come unasked; does not wait."""
        for reply in self.transport.waiting():
            self._take(reply)

    def wait_for_word(self, deadline: float) -> None:
        """Waits until `deadline`, in seconds of `monotonic`, and for a short while at most, for the next line."""
        if self.final is None:
            reply = self.transport.receive(min(deadline, self.monotonic() + self.timing.quiet))
            if reply is not None:
                self._sort(reply)

    def ask(self, command: KstCommand, timeout: float | None = None) -> KstReply:
        """Sends a command and returns its answer; for a command of the main thread that may be a `nak`. Raises
        ReplyTimeout: no answer within `timeout` seconds (None: `KstTiming.reply`); or an earlier answer is still
        missing, and this command was not sent; UnexpectedReply: an answer that does not fit, or too many lines that
        are no replies; ConnectionLost: also if the server answers nothing for `KstTiming.silence`."""
        max_foreign = 20  # after more foreign lines than this before one answer, the peer is not a toolbox server
        timeout = self.timing.reply if timeout is None else timeout
        if self.open:
            self.collect(self.open[-1].sent_at + self.timing.servo_reply, every=True)
        if self._unanswered is not None:
            self._heed(self.resynchronise())
        self.poll()
        sent_at = self._send(command)
        foreign, last = 0, ""
        while foreign <= max_foreign:
            reply = self.transport.receive(sent_at + timeout)
            if reply is None:
                self._search(command, sent_at)
                self.counts.missed += 1
                raise ReplyTimeout(f"`{command.word}` was not answered within {timeout:g} s", command=command.word)
            if command.accepts(reply):
                self._note_answer(command, sent_at)
                return reply
            if not self._sort(reply) and reply.kind is not ReplyKind.FOREIGN:
                self._search(command, sent_at)
                raise self.unexpected(command, reply)
            foreign += reply.kind is ReplyKind.FOREIGN
            last = reply.text
        self._search(command, sent_at)
        raise UnexpectedReply(
            f"{foreign} lines after `{command.word}` were not replies, the last `{last}`: another program listens"
            " there; check address and port",
            command=command.word,
            reply=last,
        )

    @staticmethod
    def unexpected(command: KstCommand, reply: KstReply) -> UnexpectedReply:
        return UnexpectedReply(
            f"`{command.word}` was answered by `{reply.text}` instead of {command.answer.value}: check the"
            " version of the server",
            command=command.word,
            reply=reply.text,
        )

    def ask_main(
        self,
        command: KstCommand,
        patience: float | None = None,
        goal: np.ndarray | None = None,
        start: np.ndarray | None = None,
    ) -> KstReply:
        """Sends a command of the main thread, again if it was wiped, and returns its answer, which may be a `nak`.

        It sends again only while the arm stands still, away from the `goal` of the command and at its `start`, shape
        (7,) each [rad], if they are given, and the reader thread answers within `patience` seconds (None:
        `KstTiming.reply`).

        Raises:
            ReplyTimeout: the main thread stays silent while the reader thread answers; or the arm moves or is at the
                goal (`pending`); or the server answers nothing, then the link is not `in_step`.
            UnexpectedReply: as in `ask`.
            ConnectionLost: the link is lost or silent."""
        for attempt in range(self.timing.tries):
            self._heed(self.resynchronise(patience))
            if attempt > 0:
                self.counts.resent += 1
            try:
                return self.ask(command)
            except ReplyTimeout as error:
                late = self.resynchronise(patience)
                if late is not None:
                    self._note_answer(command)
                    return late
                moves = self.arm_moves()
                left = start is not None and not self.arm_is_at(start)
                if self.final is ReplyKind.INTERRUPTED or moves or left or (goal is not None and self.arm_is_at(goal)):
                    self.doubt = self.acknowledged or not moves
                    raise ReplyTimeout(
                        f"`{command.word}` was not acknowledged and the arm moves; it was not sent again",
                        command=command.word,
                        pending=True,
                    ) from error
                self._unacknowledged = self.doubt = False
        raise ReplyTimeout(
            f"`{command.word}` was not answered in {self.timing.tries} tries though the server reads: its main thread"
            f" is stuck or has ended; look at the smartPad and restart {self.transport.program} there",
            command=command.word,
        )

    def resynchronise(self, patience: float | None = None) -> KstReply | None:
        """Restores the pairing after a missing answer, and returns that answer if it came late. Raises ReplyTimeout:
        the server answers nothing within `patience` seconds (None: `KstTiming.reply`); ConnectionLost: as in
        `settle`."""
        if not self.settle(self.monotonic() + (self.timing.reply if patience is None else patience)):
            raise ReplyTimeout(f"the controller has answered nothing for {self.silent:.1f} s; nothing was sent")
        late, self._late = self._late, None
        return late

    def settle(self, deadline: float) -> bool:
        """Looks for the missing answer until `deadline`, in seconds of `monotonic`; returns whether all came.
        Several calls may continue one search. It ends when every probe is answered. If one of them stays unanswered
        while another one was, it is lost; it becomes the missing answer, and a probe of another kind follows. An
        answer of the main thread may also come after that to the probe, within `KstTiming.quiet`. Raises
        ConnectionLost: the server has answered nothing for `KstTiming.silence`, or much that nobody asked for."""
        max_stray = 200  # after more stray lines than this during a search for a missing answer, the link is given up
        if self._unanswered is not None:
            self.poll()
        while self._unanswered is not None:
            now, missing, quiet_at = self.monotonic(), self._unanswered, self._heard_at + self.timing.quiet
            if self._heard_at >= self._probed_at:
                if self._probes == 0 and (missing.thread is ServerThread.READER or self._late or now >= quiet_at):
                    self._end_search()
                    continue
                if now >= quiet_at:
                    self._end_search()
                    self._search(self._probe, now, probe_lost=True)
                    continue
                due = quiet_at
            else:
                if now >= self._asked_at + self.timing.silence or self._strays > max_stray:
                    self.transport.give_up(
                        f"the controller has answered neither `{missing.word}` nor a probe for"
                        f" {now - self._asked_at:.1f} s: its application has stopped"
                    )
                if now >= self._probed_at + self.timing.probe:
                    self._probed_at = self._send(self._probe)
                    self._probes += 1
                due = self._probed_at + self.timing.probe
            if now >= deadline:
                return False
            reply = self.transport.receive(min(deadline, due))
            if reply is not None:
                self._sort(reply)
        return True

    def rest(self, longest: float) -> None:
        """Waits until the arm stands still, at most `longest` seconds; raises as `ask`."""
        deadline = self.monotonic() + longest
        while self.monotonic() < deadline and self.arm_moves(self.timing.servo_reply):
            pass

    def arm_moves(self, timeout: float | None = None) -> bool:
        """Returns whether two readings of the joints differ; raises as `ask`."""
        before = np.array(self.ask(codec.JOINTS, timeout).numbers)
        self.transport.pause(self.timing.quiet)
        change = np.abs(np.array(self.ask(codec.JOINTS, timeout).numbers) - before)
        return not np.all(change <= STILL_RAD)

    def arm_is_at(self, goal: np.ndarray) -> bool:
        """Returns whether every joint is at the goal, shape (7,) [rad]; raises as `ask`."""
        return bool(np.max(np.abs(np.array(self.ask(codec.JOINTS).numbers) - goal)) <= ARRIVED_RAD)

    def farewell(self, stop_servo: bool) -> None:
        """Ends the server's application: stops servo mode on request, sends `end`, waits for the end of file. It
        also speaks to a server that is silent: the published one is deaf once its client has gone without a word."""
        self.transport.reopen()
        heard = self.in_step
        if stop_servo:
            self._send(codec.STOP_SERVO)
            if heard:
                self.transport.receive(self.monotonic() + self.timing.farewell)
                self.transport.pause(self.timing.servo_stop)
        self._send(codec.END)
        self.transport.end_writing()
        deadline = self.monotonic() + self.timing.farewell
        while self.transport.receive(deadline) is not None and self.monotonic() < deadline:
            pass

    def _send(self, command: KstCommand) -> float:
        sent_at = self.monotonic()
        ready_at = self._main_answered_at + self.timing.main_pause
        if ready_at > sent_at:
            self.transport.pause(ready_at - sent_at)
            sent_at = self.monotonic()
        self.transport.send(command.line, self.timing.reply)
        self.counts.sent += 1
        return sent_at

    def _note_answer(self, command: KstCommand, sent_at: float | None = None) -> None:
        now = self.monotonic()
        self.counts.answered += 1
        if sent_at is not None:
            self.round_trip = now - sent_at
        if command.thread is ServerThread.MAIN:
            self._main_answered_at = now

    def _take(self, reply: KstReply) -> None:
        """Handles a line that came while nobody waited for it."""
        if not self.open:
            self._sort(reply)
        elif self.open[0].command.accepts(reply):
            goal = self.open.popleft()
            self._note_answer(goal.command, goal.sent_at)
            self._learn(goal.sent_at)
            self.arrived.append((goal, reply))
        elif not self._sort(reply):
            self.arrived.append((self.open[0], reply))
            self._lose_open()

    def _learn(self, sent_at: float) -> None:
        """Adapts the usual delay to the last answer. It grows to the present window at most, once in that time."""
        forgotten = 1.0 / 64.0  # of a delay that was longer than the present ones, with each answer
        assert self.round_trip is not None, "an answer has just come"
        if self.round_trip <= self.usual:
            self.usual += forgotten * (self.round_trip - self.usual)
        elif sent_at >= self._widened_at:
            self.usual = min(self.round_trip, self.window)
            self._widened_at = sent_at + self.round_trip

    def _lose_open(self) -> None:
        """Begins the search for the answers to all open goals."""
        self.counts.missed += len(self.open)
        asked_at = self.open[0].sent_at
        commands = [goal.command for goal in self.open]
        self.open.clear()
        self._search(commands.pop(), asked_at)
        self._before.extend(commands)
        self._probe = PIN  # no goal is answered by it

    def _heed(self, late: KstReply | None) -> None:
        self.refused |= late is not None and late.kind is ReplyKind.NAK and not self._awaits_final

    def _search(self, missing: KstCommand, asked_at: float, probe_lost: bool = False) -> None:
        if not probe_lost:
            self._late = None
        self._unanswered, self._asked_at, self._probe_lost = missing, asked_at, probe_lost
        self._before.clear()
        self._probe = PIN if missing.answer is ReplyKind.SEVEN else codec.JOINTS
        self._probes = self._strays = 0
        self._probed_at, self._heard_at = asked_at - self.timing.probe, -np.inf  # a probe is due, none is answered

    def _end_search(self) -> None:
        missing, self._unanswered = self._unanswered, None
        if (
            self._late is None
            and missing is not None
            and missing.starts_motion
            and self._awaits_final
            and self.final is None
        ):
            self._unacknowledged = self.doubt = True

    def _sort(self, reply: KstReply) -> bool:
        """Handles a reply that is not the awaited answer; returns whether it belongs to a motion or refuses one."""
        now, missing = self.monotonic(), self._unanswered
        if missing is not None and self._probes > 0 and reply.kind is self._probe.answer:
            self._probes -= 1
            self._before.clear()
            self._heard_at = now
            self._note_answer(self._probe)
            return False
        awaited = missing is not None and self._late is None and not self._probe_lost and not self._before
        if self._before and self._before[0].accepts(reply):
            self._before.popleft()
        elif missing is not None and awaited and missing.accepts(reply):
            self._late = reply
            if missing.starts_motion and self._awaits_final:
                self.final = ReplyKind.NAK if reply.kind is ReplyKind.NAK else None
                self.doubt = True
            if self._probes == 0:
                self._end_search()
        elif self._awaits_final and self.final is None and reply.kind in _FINAL:
            self._main_answered_at = now
            if self._unacknowledged and reply.kind is ReplyKind.DONE:
                self._unacknowledged, self.doubt = False, True
            else:
                self.final = reply.kind
                self.stopped_by = reply.reason if reply.kind is ReplyKind.STOPPED else ""
            return True
        elif reply.kind is ReplyKind.NAK and not self.refused:
            self.refused = True
            self._main_answered_at = now
            return True
        foreign = reply.kind is ReplyKind.FOREIGN
        self._strays += 1
        self.counts.foreign += foreign
        self.counts.stray += not foreign
        return False
