"""The program record_episodes.py: one episode after the other, each a recording of its own with a label.

Marks come by keys and pedals that act as keys, by the services episodes/begin, success, failure, discard and again
(std_srvs/Trigger), from the cockpit, and by a fist of the second hand. Out: `episodes/state`
(diagnostic_msgs/DiagnosticStatus, latched), sounds, and a line on the terminal.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import select
import signal
import sys
import termios
import tty
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse

from common import clock
from common.command_line import real, whole
from common.errors import RigError
from common.robot_hand import HAND
from common.ros.node import join, run_program
from common.ros.raw_tf import data_of
from common.ros.service_calls import call
from kuka_control.ros.parameter_server import master_of_this_graph
from leap_motion.msg import Human
from leap_rig.operator.cues import Beep
from leap_rig.operator.ros.speaker import Speaker
from leap_rig.recording import session as episodes
from leap_rig.recording.criterion import SeenObject, SuccessJudge, SuccessRule
from leap_rig.recording.fist_sign import FistSign
from leap_rig.recording.recording_files import RecordingFault, RecordingWriter, folder_of
from leap_rig.recording.ros.record_program import Inbox, add_content, store, subscribe, writer_of
from leap_rig.recording.session import EpisodeChange, EpisodeFault, EpisodeLabel, EpisodeSession
from leap_rig.recording.topics import EPISODE_MARK
from leap_rig.report.ros.live_status import CLEAR_LINE
from reflex_msgs.msg import Hand
from rig_msgs.msg import ObjectStates

POLL_S, FLUSH_S, LINE_S = 0.05, 0.4, 1.0
NEXT = " "  # begins an episode, or ends it well
KEYS = {"f": episodes.FAILURE, "d": episodes.DISCARD, "r": episodes.AGAIN, "s": episodes.SUCCESS, "b": episodes.BEGIN}
QUIT = "q"
SERVICE_S = 10.0


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("record_episodes", lambda: record(options), "Interrupted before anything was recorded.")


def record(options: argparse.Namespace) -> int:
    """Records episodes until the session ends; returns the exit code."""
    folder = folder_of(options.session)
    join("leap_rig_episodes")
    recorder = EpisodeRecorder(folder, options)
    interrupted = clock.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: interrupted.set())
    with _keys() as key:
        return recorder.run(interrupted, key)


class EpisodeRecorder:
    """Records the episodes of one session."""

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        self._folder, self._options = folder, options
        self._session = EpisodeSession(episodes.next_number(folder), options.countdown, options.longest)
        self._lock = clock.Lock()
        self._waiting: list[EpisodeChange] = []  # changes that the main loop has not done yet
        self._judge = SuccessJudge(options.success, options.thing)
        self._inbox = Inbox()
        self._writer: RecordingWriter | None = None
        self._counts = Counter(episodes.read_label(one).outcome for one in episodes.episode_folders(folder))
        self._speaker, self._sign = Speaker(), FistSign()
        self._note = ""  # that came with a mark of the episode
        self._said, self._began, self._next_flush, self._next_line = "", 0.0, 0.0, 0.0
        self._publisher = rospy.Publisher("episodes/state", DiagnosticStatus, queue_size=10, latch=True)
        subscribe(self._inbox, options)
        _listen("simulation/object_states", ObjectStates, self._take_objects)
        _listen(HAND.state, Hand, self._take_hand)
        _listen(EPISODE_MARK, String, self._take_mark)
        if options.gesture:
            _listen("leap_motion/leap_device", Human, self._take_human)
        for mark in episodes.MARKS:
            rospy.Service(f"episodes/{mark}", Trigger, lambda _, mark=mark: TriggerResponse(*self._serve(mark)))
        self._say("Ready: space or episodes/begin begins an episode.")

    def run(self, interrupted: clock.Event, key: Callable[[], str]) -> int:
        """Records until `interrupted`, or the key that ends it; `key` returns what was typed, or nothing."""
        code = 0
        try:
            while not interrupted.wait(POLL_S) and not rospy.is_shutdown():
                typed = key()
                if typed == QUIT:
                    break
                self._typed(typed)
                self._advance()
        except (OSError, RecordingFault) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error).rstrip(".")
            print(f"\nrecord_episodes: {reason}, so the session ends; the rig runs on.", file=sys.stderr)
            code = 1
        with self._lock:
            self._waiting.extend(self._session.close())
        with contextlib.suppress(OSError) if code else contextlib.nullcontext():
            self._do()
        counts = ", ".join(f"{count} {outcome or 'without a label'}" for outcome, count in sorted(self._counts.items()))
        print(f"{CLEAR_LINE if sys.stdout.isatty() else ''}{self._folder}: {counts or 'no episode'}.")
        return code

    def mark(self, mark: str) -> str:
        """Takes a mark and returns what it does; raises EpisodeFault if it fits to nothing."""
        with self._lock:
            changes = self._session.mark(mark, clock.monotonic())
            self._waiting.extend(changes)
            return _sentence(changes[0]) if changes else "The countdown is stopped."

    def _serve(self, mark: str) -> tuple[bool, str]:
        try:
            return True, self.mark(mark)
        except EpisodeFault as fault:
            return False, str(fault)

    def _next(self) -> str:
        return episodes.SUCCESS if self._session.running else episodes.BEGIN

    def _typed(self, typed: str) -> None:
        for letter in typed:
            if letter == NEXT or letter in KEYS:
                self._try(KEYS.get(letter) or self._next())

    def _try(self, mark: str) -> None:
        _, said = self._serve(mark)
        self._say(said)

    def _take_mark(self, message: String) -> None:
        try:
            said = json.loads(message.data)
            mark, note = str(said["mark"]), str(said["text"])
        except (KeyError, TypeError, ValueError):
            self._say(f"The cockpit's mark is {message.data[:60]!r}, which says nothing.")
            return
        with self._lock:
            self._note = note or self._note
        self._try(mark)

    def _take_human(self, message: Human) -> None:
        hand = message.left_hand if self._options.gesture == "left" else message.right_hand
        seen = hand.is_present and message.left_hand.is_present and message.right_hand.is_present
        if self._sign.step(hand.grab_strength if seen else math.nan, clock.monotonic()):
            self._try(self._next())

    def _take_objects(self, message: ObjectStates) -> None:
        seen = [
            SeenObject(
                o.name, o.pose.position.x, o.pose.position.y, o.clearance, o.speed,
                any(name.startswith("reflex/") for name in o.touches),
            )
            for o in message.objects
        ]  # fmt: skip
        with self._lock:
            self._judge.objects(seen)

    def _take_hand(self, message: Hand) -> None:
        with self._lock:
            self._judge.fingers(sum(any(finger.contact) for finger in message.finger))

    def _advance(self) -> None:
        now = clock.monotonic()
        with self._lock:
            self._waiting.extend(self._session.step(now))
        self._do()
        if self._writer is None:
            self._inbox.take()
        elif now >= self._next_flush:
            self._next_flush = now + FLUSH_S
            store(self._inbox, self._writer)
        if now >= self._next_line and sys.stdout.isatty():
            self._next_line = now + LINE_S
            print(f"{CLEAR_LINE}{self._line(now)}", end="", flush=True)

    def _line(self, now: float) -> str:
        counts = ", ".join(f"{count} {outcome or 'no label'}" for outcome, count in sorted(self._counts.items()))
        running = f"{now - self._began:.0f} s | " if self._writer is not None else ""
        keys = "space success, f failure, d discard, r again" if self._writer is not None else "space begins"
        return f"{self._said} {running}{counts or 'no episode'} | {keys}, q ends"

    def _do(self) -> None:
        """Does what has changed; raises OSError or RecordingFault of the disk."""
        with self._lock:
            changes, self._waiting = self._waiting, []
        for change in changes:
            if change.what == episodes.COUNTED:
                self._count(change.number)
            elif change.what == episodes.BEGUN:
                self._begin(change.number)
            elif change.what == episodes.ENDED:
                self._end(change)
            else:
                self._label(change)
            self._say(_sentence(change))

    def _count(self, left: int) -> None:
        self._speaker.play(Beep.COUNT)
        if not self._options.reset or left != self._options.countdown:
            return
        try:
            answer = call("simulation/reset", Trigger, timeout=SERVICE_S)
            refused = "" if answer.success else answer.message
        except RigError as fault:
            refused = str(fault)
        if refused:
            self._say(f"The objects stay where they are: {refused}")

    def _begin(self, number: int) -> None:
        latched, folder = self._inbox.take_latched(), episodes.episode_folder(self._folder, number)
        self._writer = writer_of(folder, self._options, master_of_this_graph().getParam("/"), self._inbox.now)
        self._began = clock.monotonic()
        with self._lock:
            self._judge = SuccessJudge(self._options.success, self._options.thing)
        unfinished = EpisodeLabel(episodes.UNFINISHED, task=self._options.task, operator=self._options.operator)
        episodes.write_label(folder, unfinished)
        for message in latched:
            self._writer.add(message)
        self._speaker.play(Beep.BEGIN)

    def _end(self, change: EpisodeChange) -> None:
        writer, self._writer = self._writer, None
        if writer is None:  # its beginning failed
            return
        folder, ended_by = episodes.episode_folder(self._folder, change.number), change.outcome or "the session's end"
        try:
            store(self._inbox, writer)
        except OSError:
            writer.close(self._inbox.now, "a full disk", dict(self._inbox.dropped))
            raise
        writer.close(self._inbox.now, ended_by, dict(self._inbox.dropped))
        with self._lock:
            measured, why = self._judge.verdict()
            note, self._note = self._note, ""
        label = EpisodeLabel(change.outcome, measured, why, self._options.task, self._options.operator, note)
        episodes.write_label(folder, label)
        self._counts[label.outcome] += 1
        self._speaker.play(Beep.END)

    def _label(self, change: EpisodeChange) -> None:
        folder = episodes.episode_folder(self._folder, change.number)
        self._counts[episodes.read_label(folder).outcome] -= 1
        self._counts[episodes.relabel(folder, change.outcome).outcome] += 1
        self._counts = +self._counts

    def _say(self, sentence: str) -> None:
        self._said = sentence
        values = {"episode": self._session.number, "running": self._writer is not None, **self._counts}
        texts = [KeyValue(name or "no label", str(value)) for name, value in values.items()]
        self._publisher.publish(DiagnosticStatus(DiagnosticStatus.OK, "episodes", sentence, "", texts))
        if not sys.stdout.isatty():
            print(sentence, flush=True)


def _listen(topic: str, kind: type, take: Callable[[Any], None]) -> None:
    """Subscribes as the recorder does: of a topic rospy gives all subscribers of a process the class of the first."""
    rospy.Subscriber(topic, rospy.AnyMsg, lambda message: take(kind().deserialize(data_of(message))), queue_size=10)


def _sentence(change: EpisodeChange) -> str:
    if change.what == episodes.COUNTED:
        return f"Begins in {change.number} s." if change.number else "Begins now."
    said = change.outcome or "without a label"
    what = {episodes.BEGUN: "runs", episodes.ENDED: f"has ended: {said}", episodes.LABELLED: f"is labelled {said}"}
    return f"Episode {change.number} {what[change.what]}."


@contextlib.contextmanager
def _keys() -> Iterator[Callable[[], str]]:
    """Lets what is typed be read at once; nothing where there is no terminal."""
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield lambda: sys.stdin.read(1) if select.select([sys.stdin], [], [], 0.0)[0] else ""
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def _rule(text: str) -> SuccessRule:
    try:
        return SuccessRule.parse(text)
    except EpisodeFault as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="record_episodes.py", description=__doc__.partition("\n")[0])
    parser.add_argument(
        "session", help="folder of the episodes, in ~/.ros/leap_rig/recordings; or a path, with a slash"
    )
    parser.add_argument("--task", required=True, help="what is done, in a sentence")
    parser.add_argument("--operator", default="", help="who steers; a number is enough")
    parser.add_argument("--countdown", type=whole(0, 60), default=3, help="before each episode [s], default 3")
    longest = "an episode ends by itself then [s], default 120"
    parser.add_argument("--longest", type=real(0.0, 3600.0, open_low=True), default=120.0, help=longest)
    parser.add_argument(
        "--success", type=_rule, default="", help="held, lifted, or placed:X,Y,WITHIN: labels by itself"
    )
    parser.add_argument("--thing", default="", help="the only object that counts for that")
    reset = "simulated: put the objects back before each episode, at random where the scene has a scatter"
    parser.add_argument("--reset", action="store_true", help=reset)
    parser.add_argument(
        "--gesture", choices=("left", "right"), help="a fist of this hand for 1 s acts as the space key"
    )
    add_content(parser)
    return parser
