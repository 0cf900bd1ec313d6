"""`make campaign`: provokes the rows on rigs of their own, side by side, and judges what the arm did.

Prints a line as each row ends, and a table at the end; `--json` stores the results, `--page` the handbook's page.
With `--virtual` each row runs in virtual time, to the last bit the same each time; `--page` then stores the reaction
times, which are exact. The exit code is 0 if no row failed.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import contextlib
import json
import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import conftest  # noqa: F401 - sets the path of the packages
from campaign import page, rows
from campaign.network.wire import in_own_network
from campaign.trial import Row
from tools.options import is_written, new_file, number

ROOT = Path(__file__).parents[1]
RESULTS, PAGE = ROOT / "docs" / "campaign.json", ROOT / "docs" / "reference" / "campaign.md"
TIMES = ROOT / "docs" / "campaign-times.json"  # reaction times in virtual time
START_S, ROW_S = 240.0, 180.0
"""Longest waits [s], for a rig and for a row, on a busy machine."""
INTERRUPTED = 130  # exit code after Ctrl-C or SIGTERM


class Rig:
    """A worker: a rig in a process and, where the kernel allows it, in a network of its own."""

    def __init__(self, variant: str, traces: Path | None) -> None:
        self.variant = variant
        alone = subprocess.run(in_own_network(["true"]), capture_output=True).returncode == 0
        worker = [sys.executable, "-m", "campaign.worker", variant, *([str(traces)] if traces else [])]
        command = in_own_network(worker) if alone else worker
        log = ROOT / "build" / f"campaign-{os.getpid()}-{id(self)}.log"
        self._log = log.open("w+")
        # In a session of its own: the Ctrl-C of a terminal would end it, and `stop` then interrupt its end.
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, text=True,
            start_new_session=True,
        )  # fmt: skip
        self._lines: queue.Queue[str] = queue.Queue()
        self._started = False
        threading.Thread(target=self._read, daemon=True).start()

    def judge(self, entry: Row) -> dict:
        """Runs a row and returns its verdict, a failure if the worker dies of it. Raises OSError: the row did not
        begin, because the row before has left no sound rig."""
        if not self._started and self._line(START_S) != "ready":
            self._process.terminate()
            raise OSError(f"the rig did not start; {self._end_of_log()}")
        self._started = True
        began = time.monotonic()
        self._process.stdin.write(f"{entry.number}\n")
        self._process.stdin.flush()
        if self._line(ROW_S) != "at rest":
            raise OSError(f"the rig did not come to rest; {self._end_of_log()}")
        try:
            return json.loads(self._line(ROW_S))
        except (OSError, ValueError):
            fault = f"the row never ended; {self._end_of_log()}"
            return {"result": "failed", "faults": [fault], "seconds": time.monotonic() - began}

    @property
    def usable(self) -> bool:
        """Whether another row can run on it."""
        return self._process.poll() is None

    def stop(self) -> None:
        """Ends it in the midst of a row, which another thread waits for."""
        with contextlib.suppress(ProcessLookupError):
            self._process.terminate()

    def close(self) -> None:
        """Ends it."""
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(60.0)
        except subprocess.TimeoutExpired:
            self._process.terminate()
            self._process.wait(60.0)
        self._log.close()
        os.unlink(self._log.name)

    def _read(self) -> None:
        for line in self._process.stdout:
            self._lines.put(line.strip())
        self._lines.put("")

    def _line(self, timeout: float) -> str:
        try:
            line = self._lines.get(timeout=timeout)
        except queue.Empty:
            return ""
        if not line:  # the worker has ended: there is nothing to wait for any more
            self._lines.put("")
        return line

    def _end_of_log(self) -> str:
        self._log.flush()
        return f"the end of its log: {Path(self._log.name).read_text()[-2000:]}"


class KeptRig:
    """A rig that is kept for rows of the same variant until one spoils it; else a new one is made."""

    def __init__(self, traces: Path | None = None) -> None:
        self.traces = traces
        self._rig: Rig | None = None
        self._stopped = False

    @property
    def variant(self) -> str | None:
        """The variant of the rig that runs, None if none does."""
        return self._rig.variant if self._rig else None

    def judge(self, entry: Row) -> dict:
        """Runs a row and returns its verdict; a rig that does not come up is a failure of the row."""
        while True:
            if self._rig is not None and (self._rig.variant != entry.variant or not self._rig.usable):
                self.close()
            used = self._rig is not None
            try:
                self._rig = self._rig or Rig(entry.variant, self.traces)
                if self._stopped:
                    self._rig.stop()
                result = self._rig.judge(entry)
            except OSError as error:
                self.close()
                if used and not self._stopped:  # the row before may have left it so, and this one has not begun
                    continue
                return {"result": "failed", "faults": [str(error)], "seconds": 0.0}
            if entry.spoils:
                self.close()
            return result

    def stop(self) -> None:
        """Ends the rig in the midst of a row; called by another thread than `judge`."""
        self._stopped = True
        if (rig := self._rig) is not None:
            rig.stop()

    def close(self) -> None:
        """Ends the rig, if there is one."""
        if self._rig is not None:
            self._rig.close()
        self._rig = None


class Campaign:
    """Runs rows on some rigs at once."""

    def __init__(self, entries: list[Row], rigs: int, tell) -> None:
        self._waiting = sorted(entries, key=lambda entry: (entry.spoils, entry.variant, entry.number))
        self._rigs = [KeptRig() for _ in range(min(rigs, len(entries)))]
        self._tell = tell
        self._lock = threading.Lock()
        self.results: dict[int, dict] = {}

    def run(self) -> dict[int, dict]:
        """Returns the results by number. KeyboardInterrupt, or what `tell` raises, ends the rigs first."""
        with concurrent.futures.ThreadPoolExecutor(len(self._rigs)) as threads:
            working = [threads.submit(self._work, rig) for rig in self._rigs]
            try:
                for thread in concurrent.futures.as_completed(working):
                    thread.result()
            except BaseException:
                with self._lock:
                    self._waiting.clear()
                    self._tell = lambda *_: None  # the rows that are cut off now say nothing
                for rig in self._rigs:
                    rig.stop()
                raise
        return dict(sorted(self.results.items()))

    def _next(self, variant: str | None) -> Row | None:
        with self._lock:
            fitting = [entry for entry in self._waiting if entry.variant == variant] or self._waiting
            if not fitting:
                return None
            entry = fitting[0]
            self._waiting.remove(entry)
            return entry

    def _work(self, rig: KeptRig) -> None:
        try:
            while (entry := self._next(rig.variant)) is not None:
                result = rig.judge(entry)
                with self._lock:
                    self.results[entry.number] = result
                    self._tell(entry, result, len(self.results))
        finally:
            rig.close()


def main(argv: list[str] | None = None) -> int:
    """Runs the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m campaign.run", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="numbers of rows, such as 14,33 or 1-15; or `dangerous`")
    parser.add_argument("--rigs", type=number(1, 16, int), default=2, help="how many rigs run at once")
    parser.add_argument("--json", type=new_file, help="file for the results")
    parser.add_argument("--page", action="store_true", help="store the results and make the handbook's page from them")
    parser.add_argument("--render", action="store_true", help="only make the page from the stored results")
    parser.add_argument("--virtual", action="store_true", help="run in virtual time, row by row")
    options = parser.parse_args(argv)
    if options.render:
        store({})
        return 0
    entries = chosen(rows.load(), options.only)
    if options.virtual:
        return in_virtual_time(entries, options.page)
    results = ran(entries, options.rigs, page.line)
    if results is None:
        return INTERRUPTED
    print("\n" + page.table({entry.number: entry for entry in entries}, results))
    named = {str(number): result for number, result in results.items()}
    if options.page:
        store(named)
    return exit_code(results, options.json, page.as_json(named))


def ran(
    entries: list, rigs: int, line: Callable[[Any, dict], str], take: Callable[[Any, dict], None] = lambda *_: None
):
    """Runs rows on so many rigs, prints a line as each ends and hands its result to `take`; returns the results by
    number, None after Ctrl-C or SIGTERM."""
    began = time.monotonic()

    def tell(entry: Row, result: dict, done: int) -> None:
        print(f"[{done}/{len(entries)}, {time.monotonic() - began:4.0f} s] {line(entry, result)}", flush=True)
        take(entry, result)

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return Campaign(entries, rigs, tell).run()
    except KeyboardInterrupt:
        print("\nInterrupted; no rig runs any more.")
        return None


def exit_code(results: dict[Any, dict], file: Path | None, text: str) -> int:
    """Writes results to a file, if one is named; returns 1 if that or one of them failed."""
    kept = file is None or is_written(file, text)
    return int(not kept or any(result["result"] == "failed" for result in results.values()))


def in_virtual_time(entries: list[Row], stores: bool) -> int:
    """Runs rows in virtual time; returns the exit code."""
    from campaign.virtual import judged

    failed = False
    for entry in entries:
        if entry.real:
            print(f"{entry.number:>10} runs on the real rig only: {entry.real}", flush=True)
            continue
        verdict = judged(entry)
        failed |= verdict.result != "passed"
        print(page.line(entry, vars(verdict)), flush=True)
        if stores:
            store({}, {str(entry.number): verdict.reaction_s})
    return int(failed)


def store(results: dict[str, dict], virtual: dict[str, float | None] | None = None) -> None:
    """Adds results, and reaction times in virtual time [s], to the stored ones; makes the handbook's page from all."""
    stored = {**json.loads(RESULTS.read_text()), **results}
    times = {**json.loads(TIMES.read_text()), **(virtual or {})}
    RESULTS.write_text(page.as_json(stored))
    TIMES.write_text(page.times_as_json(times))
    read_again = json.loads(RESULTS.read_text()), json.loads(TIMES.read_text())  # 0.6153 is 0.615, which shows as 0.61
    PAGE.write_text(page.page(rows.load(), *read_again))


def chosen(entries: dict[int, Row], only: str) -> list[Row]:
    """Returns the rows that `only` names: numbers and ranges, `dangerous`, or all if it is empty."""
    if not only:
        return list(entries.values())
    if only == "dangerous":
        return [entry for entry in entries.values() if entry.dangerous]
    numbers: set[int] = set()
    for part in only.replace(",", " ").split() or [""]:
        found = re.fullmatch(r"(\d{1,3})(?:-(\d{1,3}))?", part, re.ASCII)
        named = range(int(found[1]), int(found[2] or found[1]) + 1) if found else range(0)
        if not named:
            raise SystemExit(f"{part!r} names no rows; numbers such as 14,33 or 1-15 do, or `dangerous`.")
        numbers |= set(named)
    missing = numbers - set(entries)
    if missing:
        raise SystemExit(f"There is no row {', '.join(map(str, sorted(missing)))}.")
    return [entries[number] for number in sorted(numbers)]


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
