"""Dialogue with the operator at a terminal while the arm moves."""

from __future__ import annotations

import math
import signal
import sys

from kst import PtpProgress

BAR_CHARACTERS = 30


class Interruption:
    """Within its context Ctrl-C and SIGTERM set `asked` instead of interrupting the program."""

    def __enter__(self) -> Interruption:
        self.asked = False
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: object) -> None:
        self.asked = True


class ProgressLine:
    """One line that changes on a terminal; elsewhere a line for every tenth of the motion."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._open = False
        self._tenths = -1

    def show(self, progress: PtpProgress) -> None:
        """Shows the progress."""
        if self._live:
            print(f"\r{progress_bar(progress)}", end="", flush=True)
            self._open = True
        elif int(10.0 * progress.fraction) > self._tenths:
            self._tenths = int(10.0 * progress.fraction)
            print(progress_bar(progress))

    def end(self) -> None:
        """Leaves the line as it is; what is printed next starts a new one."""
        if self._open:
            print()
        self._open = False


def progress_bar(progress: PtpProgress) -> str:
    """Returns a line with a bar and the remaining step."""
    filled = int(progress.fraction * BAR_CHARACTERS)
    remaining = f"{math.degrees(progress.remaining):6.1f} deg left (joint {progress.joint})"
    return f"[{'#' * filled}{'.' * (BAR_CHARACTERS - filled)}] {100.0 * progress.fraction:3.0f} %  {remaining}"


def agrees(question: str) -> bool | None:
    """Returns whether the operator agrees; None after Ctrl-C."""
    try:
        return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        print()
        return False
    except KeyboardInterrupt:
        print()
        return None
