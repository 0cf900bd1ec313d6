"""Virtual time: real threads of which one runs at a time; time passes only while all of them wait, and then jumps.
Which of several ready threads runs next is drawn from the seed: one seed makes one run, bit for bit; other seeds try
other orders. A thread gives way only where it waits, and at some of its uses of locks, events and queues."""

from __future__ import annotations

import contextlib
import ctypes
import heapq
import random
import re
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any

from common import clock

_set_handler = signal.signal  # a graph puts its own in place

START_S, WALL_S = 1000.0, 1.7e9
"""Virtual time at the beginning [s]: of monotonic(), and what time() is ahead of it."""
GIVES_WAY = 0.1
"""How often a thread gives way where it need not, such as between two locks."""
SPINS = 100_000
"""A thread that asks for the time so often without waiting never stops; nor do so many turns without time passing."""
POLL_S, POLLS, LAST_POLLS = 1.0, 60, 10
"""A thread that sleeps at so many looks in a row waits outside of this module; fewer of them at the end [s, real]."""
SIGNAL = signal.SIGUSR2
"""Wakes the main thread where it waits outside."""


class Stuck(AssertionError):
    """No thread can run, or one waits outside of virtual time; the text says which, and where."""


class Killed(BaseException):
    """Unwinds a thread that was killed, or whose scheduler has ended."""


class Task:
    """A thread's part in the schedule.

    Attributes:
        group: what it belongs to, such as a node; a thread's threads belong to the same.
        waits_for: what it waits for, in words; None while it is ready or runs."""

    def __init__(self, name: str, group: str) -> None:
        self.name, self.group = name, group
        self.waits_for: str | None = None
        self.turn = threading.Lock()  # released by whoever gives this thread its turn
        self.turn.acquire()
        self.waits = 0  # so many times it has begun to: a deadline of a wait before counts no longer
        self.notified = False
        self.alone = False  # it was notified in place of the others: if torn, it passes that on
        self.torn = False  # out of its last wait, by an exception
        self.killed = self.ended = False
        self.visits = False  # a group that is not its own
        self.joiners: list[Task] = []
        self.thread: threading.Thread | None = None
        self.asked = 0  # for the time, since it waited


class Scheduler:
    """One virtual time and its threads.

    Attributes:
        now: virtual time [s].
        suspended: groups whose threads stand still.
        on_turn: called with the group of each thread that gets its turn.
        on_crash: called with what threading.excepthook takes, by each thread that an exception ends.
        crashed: name and exception of each thread that an exception has ended.
        trace: time and thread of each turn, if it was asked for.
        ahead: by how much the wall clock of a group is ahead [s]."""

    def __init__(self, seed: int = 0, trace: bool = False, in_place: dict[str, Any] | None = None) -> None:
        self._in_place = in_place or {}
        self.now = START_S
        self.suspended: set[str] = set()
        self.on_turn: Callable[[str], None] = lambda group: None
        self.on_crash: Callable[[Any], None] = lambda args: threading.excepthook(args)
        self.ahead: Callable[[str], float] = lambda group: 0.0
        self.crashed: list[tuple[str, BaseException]] = []
        self.trace: list[tuple[float, str]] | None = [] if trace else None
        self._random = random.Random(seed)
        self._ready: list[Task] = []
        self._deadlines: list[tuple[float, int, Task, int]] = []
        self._order, self._names = count(), count(1)
        self._tasks: list[Task] = []
        self._main = self._running = Task("main", "")
        self._fault: Stuck | None = None
        self._turns = 0  # since time has passed
        self._of_thread = threading.local()
        self._over = threading.Event()
        self._unwinding = False
        self._real: dict[str, Any] = {}
        self._handler: Any = None

    def __enter__(self) -> Scheduler:
        if _Active.scheduler is not None or self._over.is_set():
            raise RuntimeError("a scheduler runs already, or this one has run")
        _Active.scheduler = self
        self._main.thread = threading.current_thread()
        self._tasks = [self._main]
        self._of_thread.task = self._main
        self._real = {name: getattr(clock, name) for name in clock.__all__}
        for name, own in self._in_place.items():
            setattr(clock, name, own)
        for name in ("monotonic", "monotonic_ns", "time", "time_ns", "sleep"):
            setattr(clock, name, getattr(self, name))
        if self._main.thread is threading.main_thread():
            self._handler = _set_handler(SIGNAL, lambda *_: self._raise_faults(self._running))
        threading.Thread(target=self._watch, name="watch", daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        try:
            left = self._unwind()
        finally:
            self._over.set()
            if self._main.thread is threading.main_thread():
                _set_handler(SIGNAL, self._handler or signal.SIG_DFL)
            for name, real in self._real.items():
                setattr(clock, name, real)
            _Active.scheduler = None
        if left and error is None:
            raise Stuck(f"still there after the end: {'; '.join(map(self._described, left))}")

    # What common.clock offers.

    def monotonic(self) -> float:
        """Virtual time [s]."""
        task = self._current()
        task.asked += 1
        if task.asked > SPINS:
            task.asked = 0
            fault = Stuck(f"has asked {SPINS} times for the time without waiting: {self._described(task)}")
            if task is self._main:
                raise fault
            self._fail(fault)
            self._take_turn(task)
        return self.now

    def monotonic_ns(self) -> int:
        """Virtual time [ns]."""
        return round(1e9 * self.monotonic())

    def time(self) -> float:
        """Virtual time [s], since 1970."""
        return WALL_S + self.monotonic() + self.ahead(self.current.group)

    def time_ns(self) -> int:
        """Virtual time [ns], since 1970."""
        return round(1e9 * self.time())

    def sleep(self, seconds: float) -> None:
        """Waits; with 0 only gives way."""
        if not seconds >= 0.0:
            raise ValueError("sleep length must be non-negative")
        self.wait([], seconds, f"sleep({seconds:g})")

    # What waits.

    def wait(self, waiters: list[Task], timeout: float | None, what: str) -> bool:
        """Waits until it is taken from `waiters` by `notify`; returns whether it was, before `timeout` [s] had passed.
        `what` says for what, if nobody comes."""
        task = self._current()
        task.waits += 1
        task.waits_for, task.notified, task.torn, task.asked = what, False, False, 0
        waiters.append(task)
        if timeout is not None:
            heapq.heappush(self._deadlines, (self.now + max(timeout, 0.0), next(self._order), task, task.waits))
        try:
            self._give_turn(task)
        finally:
            if not task.notified and task in waiters:
                waiters.remove(task)
            if task.torn and task.notified and task.alone:
                self.notify(waiters, 1)
        return task.notified

    def notify(self, waiters: list[Task], number: int | None = None) -> None:
        """Makes `number` of the waiters ready, or all of them; which ones, is drawn, suspended ones last."""
        for _ in range(len(waiters) if number is None else min(number, len(waiters))):
            task = self._drawn_of([each for each in waiters if each.group not in self.suspended] or waiters)
            waiters.remove(task)
            task.notified, task.alone = True, number is not None
            self._make_ready(task)

    def maybe_give_way(self) -> None:
        """Lets other threads run first now and then; a thread that unwinds keeps its turn."""
        task = self.current
        if task.killed or task.torn or task.visits:
            return
        if self._ready and self._random.random() < GIVES_WAY:
            self._make_ready(task)
            self._give_turn(task)

    def start(self, thread: threading.Thread) -> Task:
        """Takes a new thread in, which becomes ready."""
        name = re.sub(r"^Thread-\d+", "thread", thread.name)  # Python's count continues in the next run
        task = Task(f"{name} ({next(self._names)})", self._current().group)
        task.thread = thread
        self._tasks.append(task)
        self._make_ready(task)
        return task

    def first_turn(self, task: Task) -> None:
        """Called by a new thread: waits for its first turn."""
        self._of_thread.task = task
        self._take_turn(task)

    def end(self, task: Task, error: BaseException | None) -> None:
        """Called by a thread as its last act."""
        task.ended = True
        self._tasks.remove(task)
        if error is not None:
            self.crashed.append((task.name, error))
        if not self._unwinding:
            self.notify(task.joiners)
            following = self._next()
            if following is not None:
                self._hand_over(following)

    # What a test does with groups.

    @contextlib.contextmanager
    def in_group(self, group: str) -> Iterator[None]:
        """Context in which this thread, and those that it makes, belong to the group. It keeps its turn as long as it
        need not wait: what becomes of the group must not become of it."""
        task = self._current()
        before, visited = task.group, task.visits
        task.group, task.visits = group, True
        self.on_turn(group)
        try:
            yield
        finally:
            task.group, task.visits = before, visited
            self.on_turn(before)

    def kill(self, group: str) -> None:
        """Unwinds all threads of a group, also suspended ones, at once but for the one that asks."""
        self.suspended.discard(group)
        for task in [task for task in self._tasks if task.group == group and task is not self._current()]:
            task.killed = True
            self._make_ready(task)
        while any(task.group == group and task.killed and not task.ended for task in self._tasks):
            self.sleep(0.0)

    def drawn(self, most: float) -> float:
        """A time from 0 to `most` [s], drawn from the seed."""
        return self._random.uniform(0.0, most)

    # Turns.

    @property
    def current(self) -> Task:
        """The thread that asks; one that ends, too."""
        task = getattr(self._of_thread, "task", None)
        if task is None:
            raise RuntimeError(f"{threading.current_thread().name} was not made by common.clock: it has no turns")
        return task

    @property
    def is_unwinding(self) -> bool:
        """Whether the thread that asks was killed, or an exception took it out of its last wait."""
        return self.current.killed or self.current.torn

    def _current(self) -> Task:
        task = self.current
        if task.killed:
            raise Killed
        return task

    def _make_ready(self, task: Task) -> None:
        if task not in self._ready:
            self._ready.append(task)
        task.waits_for = None

    def _drawn_of(self, tasks: list[Task]) -> Task:
        return tasks[self._random.randrange(len(tasks))] if len(tasks) > 1 else tasks[0]

    def _next(self) -> Task | None:
        """Takes the thread that runs next; None if no thread can: then the main thread has a fault to raise."""
        self._turns += 1
        while True:
            ready = [task for task in self._ready if task.group not in self.suspended]
            if ready and self._turns <= SPINS:
                task = self._drawn_of(ready)
                self._ready.remove(task)
                return task
            if ready or not self._pass_time():
                why = f"time has not passed for {SPINS} turns" if ready else "all wait for ever"
                failed = [f"\n{name} has ended by {error!r}" for name, error in self.crashed]
                waits = "; ".join(map(self._waits, self._tasks))
                stacks = "".join(f"\n\n{task.name}:\n{_stack(task.thread)}" for task in self._tasks)
                self._fail(Stuck(f"{why}: {waits}{''.join(failed)}{stacks}"))
                return None

    def _pass_time(self) -> bool:
        """Jumps to the earliest deadline of a thread that may run; returns whether there was one."""
        held, found = [], False
        while self._deadlines and (not found or self._deadlines[0][0] <= self.now):
            entry = heapq.heappop(self._deadlines)
            at, _, task, number = entry
            if task.ended or task.waits != number:
                continue
            if task.group in self.suspended:
                held.append(entry)
                continue
            self.now, found, self._turns = max(self.now, at), True, 0 if at > self.now else self._turns
            self._make_ready(task)
        for entry in held:
            heapq.heappush(self._deadlines, entry)
        return found

    def _give_turn(self, task: Task) -> None:
        """Lets the next thread run, and returns when it is this one's turn again."""
        try:
            following = self._next()
            if following is task:
                self._note(task)
                return
            if following is not None:
                self._hand_over(following)
            self._take_turn(task)
        except BaseException as error:
            task.torn = True
            if task is self._main and not isinstance(error, Stuck):  # Ctrl-C, or pytest's time is up: others may run
                self._unwind()
            raise

    def _hand_over(self, task: Task) -> None:
        self._running = task
        with contextlib.suppress(RuntimeError):  # it has been woken twice, as after a fault
            task.turn.release()

    def _take_turn(self, task: Task) -> None:
        if task is self._main:
            while not task.turn.acquire(timeout=POLL_S):
                pass  # a signal that came just before would not wake it
        else:
            task.turn.acquire()
        self._note(task)
        self._raise_faults(task)

    def _note(self, task: Task) -> None:
        self._running = task
        self.on_turn(task.group)
        if self.trace is not None:
            self.trace.append((self.now, task.name))

    def _raise_faults(self, task: Task) -> None:
        if task is self._main and self._fault is not None:
            fault, self._fault = self._fault, None
            raise fault
        if task.killed:
            raise Killed

    def _fail(self, fault: Stuck) -> None:
        """Gives the main thread its turn, which raises the fault."""
        self._fault, self._turns = fault, 0
        if self._main in self._ready:
            self._ready.remove(self._main)
        self._hand_over(self._main)

    def _described(self, task: Task) -> str:
        return f"{self._waits(task)}\n{_stack(task.thread)}"

    def _waits(self, task: Task) -> str:
        waits = f"waits for {task.waits_for}" if task.waits_for else "is ready" if task is not self._running else "runs"
        standing = ", suspended" if task.group in self.suspended else ""
        return f"{task.name} {waits}{standing}"

    def _watch(self) -> None:
        """Names a thread that waits outside of virtual time."""
        looks = _Looks()
        while not self._over.wait(POLL_S):
            task = self._running
            if looks.at(task.thread) >= POLLS:
                fault = Stuck(f"waits outside of virtual time: {self._described(task)}")
                if task is not self._main:
                    self._fail(fault)
                elif self._main.thread is threading.main_thread():
                    self._fault = fault
                    signal.pthread_kill(self._main.thread.ident, SIGNAL)

    def _unwind(self) -> list[Task]:
        """Ends all other threads, one after the other; returns those that do not end."""
        self._unwinding = True
        others = sorted((task for task in self._tasks if task is not self._main), key=lambda t: t is not self._running)
        for task in others:
            task.killed = True
        for task in others:
            looks = _Looks()
            self._hand_over(task)
            for number in range(POLLS):
                if not threading.Thread.is_alive(task.thread) or looks.at(task.thread) >= LAST_POLLS:
                    break
                if number >= LAST_POLLS:  # it may compute for ever
                    ctypes.pythonapi.PyThreadState_SetAsyncExc(
                        ctypes.c_ulong(task.thread.ident), ctypes.py_object(Killed)
                    )
                threading.Thread.join(task.thread, POLL_S)
        self._note(self._main)
        left = [task for task in others if threading.Thread.is_alive(task.thread)]
        self._unwinding = bool(left)
        self._ready.clear()
        self._main.turn.acquire(blocking=False)  # another may have given it one more turn
        return left


class _Looks:
    """Counts the looks in a row at which a thread slept, and had not woken since the one before. It is no clock that
    counts: this process may be stopped, and starved, for any time."""

    def __init__(self) -> None:
        self._last: tuple[threading.Thread | None, int] | None = None
        self._idle = 0

    def at(self, thread: threading.Thread | None) -> int:
        """Takes one more look; returns how many."""
        state, slept = _state(thread)
        self._idle = self._idle + 1 if (thread, slept) == self._last and state == "S" else 0
        self._last = thread, slept
        return self._idle


def _state(thread: threading.Thread | None) -> tuple[str, int]:
    """Whether a thread sleeps, "S", and how often it has slept (proc(5)); of one that is gone, "S" and -1."""
    try:
        status = Path(f"/proc/self/task/{thread.native_id}/status").read_text()
    except (AttributeError, OSError):
        return "S", -1
    fields = dict(line.split(":", 1) for line in status.splitlines())
    return fields["State"].split()[0], int(fields["voluntary_ctxt_switches"])


class _Active:
    scheduler: Scheduler | None = None


def active() -> Scheduler:
    """The scheduler that runs. Raises RuntimeError: none does."""
    if _Active.scheduler is None:
        raise RuntimeError("no scheduler runs: virtual time is over")
    return _Active.scheduler


def _stack(thread: threading.Thread | None) -> str:
    frame = sys._current_frames().get(thread.ident) if thread is not None else None
    return "" if frame is None else "".join(traceback.format_stack(frame))


def is_over() -> bool:
    """Whether no scheduler runs."""
    return _Active.scheduler is None
