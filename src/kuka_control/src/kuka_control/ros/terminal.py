"""What a program says to, and hears from, a person at a terminal while the arm moves."""

from __future__ import annotations

import signal
import sys

from kuka_control.limits.joint_motion import Progress


class Interruption:
    """Within its context Ctrl-C and SIGTERM are noted in `asked` instead of breaking off what runs."""

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
    """One line that changes on a terminal; elsewhere a line for every tenth of the way."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._open = False
        self._tenths = -1

    def show(self, progress: Progress) -> None:
        """Shows the progress."""
        if self._live:
            print(f"\r{progress.bar()}", end="", flush=True)
            self._open = True
        elif int(10.0 * progress.share) > self._tenths:
            self._tenths = int(10.0 * progress.share)
            print(progress.bar())

    def end(self) -> None:
        """Leaves the line as it is; what is printed next starts a new one."""
        if self._open:
            print()
        self._open = False


def agrees(question: str) -> bool | None:
    """Returns whether the person says yes; None if the person interrupts."""
    try:
        return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        print()
        return False
    except KeyboardInterrupt:
        print()
        return None
