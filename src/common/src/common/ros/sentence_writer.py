"""Sentences that wait for nobody."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable

from common import clock


def _on_terminal(sentence: str) -> None:
    """Writes on the terminal alone: what is logged goes to /rosout, and so into recordings, and `make demo` keeps what
    nodes write to standard output in files."""
    print(sentence, file=sys.stderr, flush=True)


class SentenceWriter:
    """Writes sentences in a thread of its own: a paused terminal (Ctrl-S) stops who writes."""

    def __init__(self, write: Callable[[str], None] = _on_terminal) -> None:
        self._write = write
        self._sentences: clock.SimpleQueue[str] = clock.SimpleQueue()
        clock.Thread(target=self._run, name="terminal", daemon=True).start()

    def show(self, sentence: str) -> None:
        self._sentences.put(sentence)

    def _run(self) -> None:
        while True:
            sentence = self._sentences.get()
            with contextlib.suppress(OSError):  # a full disk, or a terminal that is gone
                self._write(sentence)
