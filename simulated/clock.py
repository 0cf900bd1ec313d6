"""What common.clock offers, in virtual time.

with virtual_time(seed=1) as scheduler:  # in place of the standard library, in common.clock
    ...                                  # this thread takes part, with all that it makes by common.clock"""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simulated.scheduler import Killed, Scheduler, Task, active


def virtual_time(seed: int = 0, trace: bool = False) -> Scheduler:
    """A context of virtual time; see Scheduler."""
    return Scheduler(seed, trace, _IN_PLACE)


def _site() -> str:
    """Where the caller of the caller stands, to name what it makes."""
    frame = sys._getframe(2)
    return f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"


class Thread(threading.Thread):
    """A thread that takes turns."""

    task: Task | None = None

    def start(self) -> None:
        """Makes it ready."""
        if self.task is not None:
            raise RuntimeError("threads can only be started once")
        scheduler = active()
        self.task, job = scheduler.start(self), self.run
        self.run = lambda: self._take_part(scheduler, job)  # type: ignore[method-assign]
        super().start()
        scheduler.maybe_give_way()

    def join(self, timeout: float | None = None) -> None:
        """Waits until it has ended."""
        if self.task is None:
            raise RuntimeError("cannot join thread before it is started")
        if threading.current_thread() is self:
            raise RuntimeError("cannot join current thread")
        if not self.task.ended:
            active().wait(self.task.joiners, timeout, f"the end of {self.task.name}")

    def is_alive(self) -> bool:
        """Whether it has been started and has not ended."""
        return self.task is not None and not self.task.ended

    def _take_part(self, scheduler: Scheduler, job: Callable[[], None]) -> None:
        failure: BaseException | None = None
        try:
            scheduler.first_turn(self.task)
            job()
        except (Killed, SystemExit):
            pass
        except BaseException as error:
            failure = error
            scheduler.on_crash(threading.ExceptHookArgs((type(error), error, error.__traceback__, self)))
        finally:
            scheduler.end(self.task, failure)


class Timer(Thread):
    """As threading.Timer."""

    def __init__(self, interval: float, function: Callable[..., object], args: Any = None, kwargs: Any = None) -> None:
        super().__init__()
        self.interval, self.function, self.args, self.kwargs = interval, function, args or [], kwargs or {}
        self.finished = Event()

    def cancel(self) -> None:
        """Stops it, if it has not begun."""
        self.finished.set()

    def run(self) -> None:
        """Waits, and calls the function."""
        if not self.finished.wait(self.interval):
            self.function(*self.args, **self.kwargs)
        self.finished.set()


class Lock:
    """As threading.Lock."""

    def __init__(self) -> None:
        self._owner: Task | None = None
        self._count = 0  # of an RLock
        self._waiters: list[Task] = []
        self._site = _site()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Takes it; returns whether it could."""
        scheduler = active()
        scheduler.maybe_give_way()
        if not self._wait(scheduler, None if timeout < 0.0 else timeout, blocking):
            return False
        self._owner = scheduler.current
        return True

    def release(self) -> None:
        """Gives it back."""
        scheduler = active()
        if self._owner is not scheduler.current and scheduler.is_unwinding:
            return  # it lost it where it waited
        if self._owner is None:
            raise RuntimeError("release unlocked lock")
        self._free(scheduler)
        scheduler.maybe_give_way()

    def _free(self, scheduler: Scheduler) -> None:
        self._owner = None
        scheduler.notify(self._waiters, 1)

    def locked(self) -> bool:
        """Whether somebody has it."""
        return self._owner is not None

    def _wait(self, scheduler: Scheduler, timeout: float | None, blocking: bool = True) -> bool:
        """Waits until nobody has it; returns whether that came in time."""
        deadline = None if timeout is None else scheduler.now + timeout
        while self._owner is not None:
            left = None if deadline is None else deadline - scheduler.now
            if not blocking or (left is not None and left <= 0.0):
                return False
            scheduler.wait(self._waiters, left, f"the lock of {self._site}, which {self._owner.name} has")
        return True

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class RLock(Lock):
    """As threading.RLock."""

    def __init__(self) -> None:
        super().__init__()
        self._site = _site()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Takes it once more, or for the first time; returns whether it could."""
        if self._owner is not None and self._owner is active().current:
            self._count += 1
            return True
        if not super().acquire(blocking, timeout):
            return False
        self._count = 1
        return True

    def release(self) -> None:
        """Gives it back once."""
        if self._owner is not active().current:
            if active().is_unwinding:
                return
            raise RuntimeError("cannot release un-acquired lock")
        self._count -= 1
        if self._count == 0:
            super().release()


class Condition:
    """As threading.Condition."""

    def __init__(self, lock: Lock | None = None) -> None:
        self._lock = RLock() if lock is None else lock
        self._waiters: list[Task] = []
        self._site = _site()
        self.acquire, self.release = self._lock.acquire, self._lock.release

    def __enter__(self) -> bool:
        return self._lock.__enter__()

    def __exit__(self, *_: object) -> None:
        self._lock.__exit__()

    def wait(self, timeout: float | None = None) -> bool:
        """Gives the lock back, waits for `notify`, and takes the lock; returns whether it was notified in time."""
        scheduler = active()
        if self._lock._owner is not scheduler.current:
            raise RuntimeError("cannot wait on un-acquired lock")
        count = self._lock._count
        self._lock._free(scheduler)
        notified = scheduler.wait(self._waiters, timeout, f"the condition of {self._site}")
        try:
            self._lock.acquire()
        except BaseException:
            scheduler.notify(self._waiters, int(notified))  # as it no longer comes to see why
            raise
        self._lock._count = count
        return notified

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        """Waits until the predicate is true; returns its last value."""
        scheduler = active()
        deadline = None if timeout is None else scheduler.now + timeout
        while not (result := predicate()):
            left = None if deadline is None else deadline - scheduler.now
            if left is not None and left <= 0.0:
                break
            self.wait(left)
        return result

    def notify(self, n: int | None = 1) -> None:
        """Wakes up to `n` of those that wait."""
        scheduler = active()
        if self._lock._owner is not scheduler.current:
            raise RuntimeError("cannot notify on un-acquired lock")
        scheduler.notify(self._waiters, n)

    def notify_all(self) -> None:
        """Wakes all that wait."""
        self.notify(None)

    notifyAll = notify_all  # actionlib's word for it


class Event:
    """As threading.Event."""

    def __init__(self) -> None:
        self._set = False
        self._waiters: list[Task] = []
        self._site = _site()

    def is_set(self) -> bool:
        """Whether it is set."""
        return self._set

    def set(self) -> None:
        """Sets it, and wakes all that wait."""
        self._set = True
        if self._waiters:
            active().notify(self._waiters)
            active().maybe_give_way()

    def clear(self) -> None:
        """Is no longer set."""
        self._set = False

    def wait(self, timeout: float | None = None) -> bool:
        """Waits until it is set; returns whether it is."""
        if self._set:
            active().maybe_give_way()
            return True
        return active().wait(self._waiters, timeout, f"the event of {self._site}")


class Queue(queue.Queue):
    """As queue.Queue."""

    def __init__(self, maxsize: int = 0) -> None:
        super().__init__(maxsize)
        self.mutex = Lock()  # type: ignore[assignment]
        self.not_empty, self.not_full = Condition(self.mutex), Condition(self.mutex)  # type: ignore[assignment, arg-type]
        self.all_tasks_done = Condition(self.mutex)  # type: ignore[assignment, arg-type]

    def put(self, item: Any, block: bool = True, timeout: float | None = None) -> None:
        """Waits for room, and puts it in; raises queue.Full if none comes in time."""
        with self.not_full:
            if self.maxsize > 0 and not self._comes(
                self.not_full, lambda: self._qsize() < self.maxsize, block, timeout
            ):
                raise queue.Full
            self._put(item)
            self.unfinished_tasks += 1
            self.not_empty.notify()

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        """Waits for an item, and takes it; raises queue.Empty if none comes in time."""
        with self.not_empty:
            if not self._comes(self.not_empty, lambda: self._qsize() > 0, block, timeout):
                raise queue.Empty
            item = self._get()
            self.not_full.notify()
            return item

    @staticmethod
    def _comes(condition: Any, what: Callable[[], bool], block: bool, timeout: float | None) -> bool:
        if timeout is not None and timeout < 0.0:
            raise ValueError("'timeout' must be a non-negative number")
        return what() if not block else bool(condition.wait_for(what, timeout))


class SimpleQueue(Queue):
    """As queue.SimpleQueue."""


_IN_PLACE = {own.__name__: own for own in (Condition, Event, Lock, Queue, RLock, SimpleQueue, Thread, Timer)}
