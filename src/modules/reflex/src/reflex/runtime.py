"""What a client runs on."""

from __future__ import annotations

import threading
from time import monotonic


class HandRuntime:
    """Time and threads of the standard library; in a simulation, something else with these names stands for it."""

    monotonic = staticmethod(monotonic)
    current_thread = staticmethod(threading.current_thread)
    Condition, Event, RLock, Thread = threading.Condition, threading.Event, threading.RLock, threading.Thread
