"""Virtual time: real threads of which one runs at a time; time passes only while all of them wait, and then jumps.

Which of several ready threads runs next is drawn from the seed: one seed makes one run, bit for bit; other seeds try
other orders. A thread gives way only where it waits, and at some of its uses of locks, events and queues.
"""

from __future__ import annotations

import contextlib
import heapq
import random
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from itertools import count
from types import TracebackType
from typing import Any

from common import clock

START_S, WALL_S = 1000.0, 1.7e9
"""Virtual time at the beginning [s]: of monotonic(), and what time() is ahead of it."""
GIVES_WAY = 0.1
"""How often a thread gives way where it need not, such as between two locks."""
SPINS = 100_000
"""A thread that asks so often for the time, and never waits, waits for a time that cannot come."""
POLL_S, POLLS = 1.0, 60
"""A thread that has taken no processor time for so many looks in a row waits outside of this module [s]."""
UNWIND_S = 10.0
"""At the end, threads get so long to end [s, real]."""


class Stuck(AssertionError):
    """No thread can run, or one waits outside of virtual time; the text says which, and where."""


class Killed(BaseException):
    """Unwinds a thread that was killed, or whose scheduler has ended."""


class Task:
    """A thread's part in the schedule.

    Attributes:
        group: what it belongs to, such as a node; a thread's threads belong to the same.
        waits_for: what it waits for, in words; None while it is ready or runs.
    """

    def __init__(self, name: str, group: str) -> None:
        self.name, self.group = name, group
        self.waits_for: str | None = None
        self.turn = threading.Semaphore(0)  # released by whoever gives this thread its turn
        self.waits, self.notified, self.killed, self.ended = 0, False, False, False
        self.joiners: list[Task] = []
        self.thread: threading.Thread | None = None
        self.asked = 0  # for the time, since it waited


class Scheduler:
    """One virtual time and its threads.

    Attributes:
        now: virtual time [s].
        suspended: groups whose threads stand still.
        on_turn: called with the group of each thread that gets its turn.
        crashed: name and exception of each thread that an exception has ended.
        trace: time and thread of each turn, if it was asked for.
    """

    def __init__(self, seed: int = 0, trace: bool = False, in_place: dict[str, Any] | None = None) -> None:
        self._in_place = in_place or {}
        self.now = START_S
        self.suspended: set[str] = set()
        self.on_turn: Callable[[str], None] = lambda group: None
        self.crashed: list[tuple[str, BaseException]] = []
        self.trace: list[tuple[float, str]] | None = [] if trace else None
        self._random = random.Random(seed)
        self._ready: list[Task] = []
        self._deadlines: list[tuple[float, int, Task, int]] = []
        self._order, self._names = count(), count(1)
        self._tasks: list[Task] = []
        self._main = self._running = Task("main", "")
        self._fault: Stuck | None = None
        self._of_thread = threading.local()
        self._over = threading.Event()
        self._unwinding = False
        self._real: dict[str, Any] = {}

    def __enter__(self) -> Scheduler:
        if _Active.scheduler is not None:
            raise RuntimeError("a scheduler runs already")
        _Active.scheduler = self
        self._main.thread = threading.current_thread()
        self._tasks = [self._main]
        self._of_thread.task = self._main
        self._real = {name: getattr(clock, name) for name in clock.__all__}
        for name, own in self._in_place.items():
            setattr(clock, name, own)
        for name in ("monotonic", "monotonic_ns", "time", "time_ns", "sleep"):
            setattr(clock, name, getattr(self, name))
        threading.Thread(target=self._watch, name="watch", daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        try:
            left = self._unwind()
        finally:
            self._over.set()
            for name, real in self._real.items():
                setattr(clock, name, real)
            _Active.scheduler = None
        if left and error is None:
            raise Stuck(f"still there {UNWIND_S:g} s after the end: {'; '.join(map(self._described, left))}")

    # What common.clock offers.

    def monotonic(self) -> float:
        """Virtual time [s]."""
        task = self._current()
        task.asked += 1
        if task.asked > SPINS:
            task.asked = 0
            raise Stuck(f"{task.name} has asked {SPINS} times for the time without waiting")
        return self.now

    def monotonic_ns(self) -> int:
        """Virtual time [ns]."""
        return round(1e9 * self.monotonic())

    def time(self) -> float:
        """Virtual time [s], since 1970."""
        return WALL_S + self.monotonic()

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

        `what` says for what, if nobody comes.
        """
        task = self._current()
        task.waits += 1
        task.waits_for, task.notified, task.asked = what, False, 0
        waiters.append(task)
        if timeout is not None:
            heapq.heappush(self._deadlines, (self.now + max(timeout, 0.0), next(self._order), task, task.waits))
        try:
            self._give_turn(task)
        finally:
            if not task.notified and task in waiters:
                waiters.remove(task)
        return task.notified

    def notify(self, waiters: list[Task], number: int | None = None) -> None:
        """Makes `number` of the waiters ready, or all of them; which ones, is drawn."""
        number = len(waiters) if number is None else min(number, len(waiters))
        for _ in range(number):
            task = waiters.pop(self._random.randrange(len(waiters)))
            task.notified = True
            self._make_ready(task)

    def maybe_give_way(self) -> None:
        """Lets others run first, now and then."""
        task = self._current()
        if self._ready and self._random.random() < GIVES_WAY:
            self._make_ready(task)
            self._give_turn(task)

    def start(self, thread: threading.Thread) -> Task:
        """Takes a new thread in, which becomes ready."""
        task = Task(f"{thread.name} ({next(self._names)})", self._current().group)
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
        if error is not None and not isinstance(error, (Killed, SystemExit)):
            self.crashed.append((task.name, error))
        if not self._unwinding:
            self.notify(task.joiners)
            following = self._next()
            if following is not None:
                self._hand_over(following)

    # What a test does with groups.

    @contextlib.contextmanager
    def in_group(self, group: str) -> Iterator[None]:
        """Context in which this thread, and those that it makes, belong to the group."""
        task = self._current()
        before, task.group = task.group, group
        try:
            yield
        finally:
            task.group = before

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
        return self._of_thread.task

    @property
    def is_unwinding(self) -> bool:
        """Whether the thread that asks was killed."""
        return self._of_thread.task.killed

    def _current(self) -> Task:
        task = getattr(self._of_thread, "task", None)
        if task is None:
            raise RuntimeError(f"{threading.current_thread().name} was not made by common.clock: it has no turns")
        if task.killed:
            raise Killed
        return task

    def _make_ready(self, task: Task) -> None:
        if task not in self._ready:
            self._ready.append(task)
        task.waits_for = None
        task.waits += 1  # its deadline no longer counts

    def _next(self) -> Task | None:
        """Takes the thread whose turn it is; None if there is none, which is a fault of the main thread."""
        while True:
            ready = [task for task in self._ready if task.group not in self.suspended or task.killed]
            if ready:
                task = ready[self._random.randrange(len(ready))] if len(ready) > 1 else ready[0]
                self._ready.remove(task)
                return task
            if not self._pass_time():
                self._fail(Stuck(f"all wait for ever: {'; '.join(map(self._described, self._tasks))}"))
                return None

    def _pass_time(self) -> bool:
        """Jumps to the earliest deadline of a thread that may run; returns whether there was one."""
        held = []
        found = False
        while self._deadlines and not found:
            entry = heapq.heappop(self._deadlines)
            at, _, task, number = entry
            if task.ended or task.waits != number:
                continue
            if task.group in self.suspended and not task.killed:
                held.append(entry)
                continue
            self.now, found = max(self.now, at), True
            self._make_ready(task)
        while found and self._deadlines and self._deadlines[0][0] <= self.now:
            entry = heapq.heappop(self._deadlines)
            if entry[2].group in self.suspended:
                held.append(entry)
            elif not entry[2].ended and entry[2].waits == entry[3]:
                self._make_ready(entry[2])
        for entry in held:
            heapq.heappush(self._deadlines, entry)
        return found

    def _give_turn(self, task: Task) -> None:
        """Lets the next thread run, and returns when it is this one's turn again."""
        following = self._next()
        if following is task:
            self._note(task)
        else:
            if following is not None:
                self._hand_over(following)
            self._take_turn(task)
        self._raise_faults(task)

    def _hand_over(self, task: Task) -> None:
        self._running = task
        task.turn.release()

    def _take_turn(self, task: Task) -> None:
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
        self._fault = fault
        self._hand_over(self._main)

    def _described(self, task: Task) -> str:
        waits = f"waits for {task.waits_for}" if task.waits_for else "is ready" if task is not self._running else "runs"
        standing = ", suspended" if task.group in self.suspended else ""
        return f"{task.name} {waits}{standing}\n{_stack(task.thread)}"

    def _watch(self) -> None:
        """Names a thread that waits outside of virtual time; in real time, by looks, as this machine may pause."""
        idle, last = 0, (0.0, None)
        while not self._over.wait(POLL_S):
            task = self._running
            spent = (_processor_time(task.thread), task)
            idle = idle + 1 if spent == last else 0
            last = spent
            if idle >= POLLS and task is not self._main:
                self._fail(Stuck(f"waits outside of virtual time: {self._described(task)}"))
                return

    def _unwind(self) -> list[Task]:
        """Ends all other threads, one after the other; returns those that do not end."""
        self._unwinding = True
        others = [task for task in self._tasks if task is not self._main]
        for task in others:
            task.killed = True
        end = time.monotonic() + UNWIND_S
        for task in others:
            task.turn.release()
            threading.Thread.join(task.thread, max(end - time.monotonic(), 0.0))
        return [task for task in others if threading.Thread.is_alive(task.thread)]


class _Active:
    scheduler: Scheduler | None = None


def active() -> Scheduler:
    """The scheduler that runs.

    Raises:
        RuntimeError: none does.
    """
    if _Active.scheduler is None:
        raise RuntimeError("no scheduler runs: virtual time is over")
    return _Active.scheduler


def _stack(thread: threading.Thread | None) -> str:
    frame = sys._current_frames().get(thread.ident) if thread is not None else None
    return "" if frame is None else "".join(traceback.format_stack(frame))


def _processor_time(thread: threading.Thread | None) -> float:
    """What a thread has taken of a processor [s]; -1 if it is gone."""
    try:
        return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
    except (AttributeError, TypeError, OSError):
        return -1.0


def is_over() -> bool:
    """Whether no scheduler runs."""
    return _Active.scheduler is None
