"""What a client runs on."""

from __future__ import annotations

import threading
from time import monotonic, time


class LeapRuntime:
    """Time and threads of the standard library; in a simulation, something else with these names stands for it."""

    monotonic, time = staticmethod(monotonic), staticmethod(time)
    current_thread = staticmethod(threading.current_thread)
    Condition, Event, Thread = threading.Condition, threading.Event, threading.Thread
