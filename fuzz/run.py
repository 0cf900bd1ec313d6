#!/usr/bin/env python3
"""`make fuzz MINUTES=60`: runs every target in turn, counts, and writes what it finds.

Each target has a process of its own, so a crash is a finding too, and so is memory that grows. A finding is a file in
build/fuzz with the input, the traceback, and the line for tests/test_fuzz.py. The engine is hypothesis', which shrinks
an input and keeps it in .hypothesis, so the next run begins with it. Exit code 1 if anything was found.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.extend([str(ROOT), *(str(setup.parent / "src") for setup in sorted(ROOT.glob("src/**/setup.py")))])

import hypothesis  # noqa: E402 - needs the path above
import numpy as np  # noqa: E402
from hypothesis.database import DirectoryBasedExampleDatabase  # noqa: E402

from campaign.growth import growth  # noqa: E402
from fuzz.targets import TARGETS, Target  # noqa: E402
from tools.options import new_folder, number  # noqa: E402

INTERRUPTED = 130  # exit code after Ctrl-C or SIGTERM
MINUTES = number(0.01, 100_000.0)
BATCH = 400
REPORT_S = 2.0
LEAK_MIB_H = 300.0
"""A process that grows faster leaks: a kilobyte an example would be ten times as much; hypothesis itself grows less."""

LEAK_RUN_S = 120.0
HANGS_S = 600.0  # a worker says something every REPORT_S; one that is silent for so long hangs in an input
MAX_FINDINGS = 20  # of one target; then it is broken and not worth more time


class Unexpected(Exception):
    """What a target must not do."""


def checked(target: Target, known: dict[str, str]) -> Callable[[Any], None]:
    """Returns the function that takes an input and raises Unexpected for a finding that is not `known` by its place."""

    def take(given: Any) -> None:
        try:
            target.take(given)
        except target.declared:
            pass
        except Exception as error:
            place = signature(error)
            if place not in known:
                raise Unexpected(place) from error

    return take


def signature(error: BaseException) -> str:
    """Returns the kind of an error, and the last line of this project that it went through."""
    frames = [
        f for f in traceback.extract_tb(error.__traceback__) if str(ROOT) in f.filename and ".venv" not in f.filename
    ]
    place = f"{Path(frames[-1].filename).relative_to(ROOT)}:{frames[-1].lineno}" if frames else "elsewhere"
    return f"{type(error).__name__} at {place}"


def run_batch(
    target: Target,
    take: Callable[[Any], None],
    examples: int,
    seed: int | None,
    inputs: Any,
    store: bool = True,
    smallest: bool = True,
) -> tuple[Any, Unexpected] | None:
    """Runs examples of a target; returns the smallest input of a finding with its error, None without one.

    `seed` None: any; `store`: begin with what was found before, and keep what is found; `smallest`: shrink it.
    """
    last: list[Any] = [None]

    def test(given: Any) -> None:
        last[0] = given
        take(given)

    skipped = {hypothesis.Phase.explain} | (set() if smallest else {hypothesis.Phase.shrink})
    database = DirectoryBasedExampleDatabase(ROOT / ".hypothesis" / "fuzz") if store else None
    test.__name__ = test.__qualname__ = target.name
    settings = hypothesis.settings(
        max_examples=examples, deadline=None, database=database,
        suppress_health_check=list(hypothesis.HealthCheck), verbosity=hypothesis.Verbosity.quiet,
        report_multiple_bugs=False,
        phases=[phase for phase in hypothesis.Phase if phase not in skipped],
    )  # fmt: skip
    try:
        run = settings(hypothesis.given(inputs)(test))
        (run if seed is None else hypothesis.seed(seed)(run))()
    except Unexpected as error:
        return last[0], error
    return None


def write_finding(folder: Path, target: Target, given: Any, error: BaseException) -> Path:
    """Writes a finding; returns its file."""
    cause = error.__cause__ or error
    place = str(error)
    path = folder / f"{target.name}-{hashlib.sha256(place.encode()).hexdigest()[:8]}.txt"
    trace = "".join(traceback.format_exception(type(cause), cause, cause.__traceback__))
    path.write_text(
        f"{target.name}: {place}\n\nA line for REGRESSIONS of tests/test_fuzz.py:\n\n"
        f'    ("{target.name}", {given!r}),\n\n{trace}'
    )
    return path


def worker(name: str, seconds: float, seed: int, folder: Path) -> None:
    """Fuzzes one target for a processor time [s]; prints a line of JSON every REPORT_S."""
    target, known, samples = TARGETS[name], {}, []
    inputs, check = target.inputs(), checked(target, known)
    began, used, said, examples = time.monotonic(), time.process_time(), 0.0, 0
    batch = max(5, int(BATCH / target.cost))
    with open(folder / f"{name}.last", "wb", buffering=0) as last:

        def take(given: Any) -> None:
            nonlocal examples, said
            examples += 1
            os.ftruncate(last.fileno(), 0)
            os.pwrite(last.fileno(), repr(given).encode("utf-8", "backslashreplace"), 0)
            check(given)
            now = time.monotonic() - began
            if now > said + REPORT_S:
                said = now
                samples.append((now / 3600.0, _rss()))
                print(json.dumps({"examples": examples, "rss": samples[-1][1]}), flush=True)

        while time.process_time() - used < seconds and len(known) < MAX_FINDINGS:
            found = run_batch(target, take, batch, seed, inputs)
            seed += 1
            if found is not None:
                given, error = found
                known[str(error)] = ""
                print(
                    json.dumps({"finding": str(error), "file": str(write_finding(folder, target, given, error))}),
                    flush=True,
                )
    leak = growth(*np.array(samples).T) if time.monotonic() - began > LEAK_RUN_S and samples else None
    if leak is not None and leak.verdict(LEAK_MIB_H) == "grows":
        print(json.dumps({"finding": f"memory grows by {leak.slope:.0f} MiB/h", "file": ""}), flush=True)
    print(json.dumps({"examples": examples, "rss": _rss(), "end": True}), flush=True)


def _rss() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def fuzz(names: list[str], seconds: float, seed: int, folder: Path, results: dict[str, dict]) -> None:
    """Runs the targets one after the other, each for its share of the time; counts and findings go to `results`."""
    for name in names:
        share, began = seconds / len(names), time.monotonic()
        result = results[name] = {"examples": 0, "rss": 0.0, "findings": [], "seconds": 0.0}
        command = [
            sys.executable,
            "-m",
            "fuzz.run",
            "--worker",
            name,
            "--seconds",
            str(share),
            "--seed",
            str(seed),
            "--out",
            str(folder),
        ]
        log = folder / f"{name}.log"
        with open(log, "wb") as errors:
            process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True)
            try:
                ended = _follow(process, name, result, results, began)
            finally:
                process.kill()
                process.wait()
        if not ended:
            last, dead = folder / f"{name}.last", folder / f"{name}-died.txt"
            given = last.read_text() if last.exists() else ""
            dead.write_text(f"{name}: the process died, or hung; the last input:\n\n{given}\n\n{log.read_text()}")
            result["findings"].append(f"the process died, see {dead}")
            print(f"\n{name}: the process died, see {dead}")


def _follow(process: subprocess.Popen, name: str, result: dict, results: dict[str, dict], began: float) -> bool:
    """Shows what a worker says, and kills one that hangs; returns whether it came to its end."""
    watch = threading.Timer(HANGS_S, process.kill)
    watch.start()
    try:
        for line in process.stdout or ():
            watch.cancel()
            if _shown(json.loads(line), name, result, results, began):
                return True
            watch = threading.Timer(HANGS_S, process.kill)
            watch.start()
        return False
    finally:
        watch.cancel()


def _shown(said: dict, name: str, result: dict, results: dict[str, dict], began: float) -> bool:
    """Shows a line of a worker; returns whether it is its last."""
    if "finding" in said:
        result["findings"].append(said["finding"])
        print(f"\n{name}: {said['finding']} {said['file']}")
        return False
    result.update(examples=said["examples"], rss=said["rss"], seconds=round(time.monotonic() - began, 1))
    total = sum(r["examples"] for r in results.values())
    found = sum(len(r["findings"]) for r in results.values())
    text = f"{name:18} {said['examples']:9d} examples, {said['rss']:4.0f} MiB"
    text += f" | all: {total} examples, {found} findings"
    print(f"\r\x1b[K{text}" if sys.stdout.isatty() else "", end="", flush=True)
    return bool(said.get("end"))


def main(argv: list[str] | None = None) -> int:
    """Fuzzes; returns 1 if something was found."""
    parser = argparse.ArgumentParser(prog="fuzz", description="Input that nobody meant, for every parser and border.")
    parser.add_argument("--minutes", type=MINUTES, default=60.0, help="of processor time, all targets together")
    parser.add_argument("--only", nargs="*", choices=TARGETS, default=[], metavar="TARGET", help=", ".join(TARGETS))
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--out", type=new_folder, default=str(ROOT / "build" / "fuzz"))
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.worker:
        worker(options.worker, options.seconds, options.seed, options.out)
        return 0
    names = options.only or [name for name, t in TARGETS.items() if not t.ros or "ROS_PACKAGE_PATH" in os.environ]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    results: dict[str, dict] = {}
    interrupted = False
    try:
        fuzz(names, 60.0 * options.minutes, options.seed, options.out, results)
    except KeyboardInterrupt:
        interrupted = True
        print("\nInterrupted; this is what there is:")
    print(f"\n{'target':18} {'examples':>9} {'seconds':>8} {'MiB':>5}  findings")
    for name, r in results.items():
        print(f"{name:18} {r['examples']:9d} {r['seconds']:8.0f} {r['rss']:5.0f}  {len(r['findings'])}")
    (options.out / "fuzz.json").write_text(json.dumps({"seed": options.seed, "targets": results}, indent=1) + "\n")
    return INTERRUPTED if interrupted else int(any(r["findings"] for r in results.values()))


if __name__ == "__main__":
    sys.exit(main())
