"""Time, and what waits for it: the standard library's. A simulation may put its own in place of these names. Used as a
module, `clock.monotonic()`: a name that is imported from here would stay the standard library's."""

from queue import Empty, Full, Queue, SimpleQueue
from threading import Condition, Event, Lock, RLock, Thread, Timer, current_thread
from time import monotonic, monotonic_ns, sleep, time, time_ns

__all__ = [
    "Condition", "Empty", "Event", "Full", "Lock", "Queue", "RLock", "SimpleQueue", "Thread", "Timer",
    "current_thread", "monotonic", "monotonic_ns", "sleep", "time", "time_ns",
]  # fmt: skip
