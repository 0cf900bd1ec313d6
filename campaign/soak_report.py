"""What an endurance run's file says: does anything grow, and its judgement as text, JSON and curves. The run itself is
campaign/soak.py; how to read the result: docs/handbook/endurance.md."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np

from bench.measure import aligned
from campaign.growth import growth
from common.errors import RigError

BOUNDS = {
    "rss": (
        5.0,
        "MiB",
        "ten hours in the laboratory then cost a process 50 MiB; less is the allocator's noise",
    ),
    "pss": (5.0, "MiB", "as rss; pages that processes share count by their fraction"),
    "threads": (1.0, "", "a listener and a fault come every minute: what each of them leaks is sixty an hour"),
    "sockets": (1.0, "", "as threads"),
    "files": (1.0, "", "as threads; all open files, sockets too"),
    "delay": (0.5, "ms", "median of frame to goal; at this rate it would double in five hours"),
    "log": (100.0, "MiB", "a laboratory day then fills 1 GiB of the disk"),
}
"""The largest growth an hour of each measure, its unit, and why."""
WORKS_H = 0.15  # so long after the start the arm has followed a hand, and a device has failed [h]
OF_A_PROCESS = ("rss", "pss", "threads", "sockets", "files")


def read(path: Path) -> list[dict]:
    """Returns the records of a run; a line that kill -9 cut off is left out. RigError: the file is not of a run."""
    records = []
    for line in path.read_bytes().splitlines():
        with contextlib.suppress(ValueError, RecursionError):
            records.append(json.loads(line))
    try:
        times = [float(record["t"]) for record in records if "processes" in record]
        if times and np.all(np.diff(times) > 0.0):
            judge(records)
            return records
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        pass
    raise RigError(f"{path} holds no samples of an endurance run, or was changed since: judge its data as written.")


def series(records: list[dict]) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
    """Returns times [h] and values of each measure by process; the rig's own are those of the process "rig"."""
    curves: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for record in (r for r in records if "processes" in r):
        hours = record["t"] / 3600.0
        for name, process in record["processes"].items():
            for measure in OF_A_PROCESS:
                curves.setdefault((name, measure), []).append((hours, process[measure]))
        total = sum(process["pss"] for process in record["processes"].values())
        for measure, value in (("pss", total), ("log", record["log"]), ("delay", record["delay"].get("p50", np.nan))):
            curves.setdefault(("rig", measure), []).append((hours, value))
    return {key: tuple(np.array(curve).T) for key, curve in curves.items()}


def judge(records: list[dict]) -> dict:
    """Returns the judgement: a row for each process and measure, the findings, and what happened."""
    rows, idle = [], []
    for (name, measure), (hours, values) in series(records).items():
        found = growth(hours, values)
        if found is None:
            idle += [f"{name}: {measure} was never measured"] * (not np.isfinite(values).any())
        else:
            bound = BOUNDS[measure][0] * (3 if (name, measure) == ("rig", "pss") else 1)
            rows.append({
                "process": name, "measure": measure, **found._asdict(), "bound": bound, "verdict": found.verdict(bound),
            })  # fmt: skip
    samples = [r for r in records if "processes" in r]
    faults = [r["fault"].rsplit(" ", 2)[0] for r in records if "fault" in r]
    hours = samples[-1]["t"] / 3600.0
    streams, servo, per_s = samples[-1]["streams"], samples[-1]["servo"], float(np.mean([r["goals"] for r in samples]))
    # A rig that does nothing grows nowhere.
    idle += ["the arm followed no hand"] * (hours > WORKS_H and not (streams and servo and per_s))
    idle += ["no fault was provoked"] * (hours > WORKS_H and not faults)
    return {
        "hours": hours,
        "streams": streams,
        "servo": servo,
        "goals": per_s * samples[-1]["t"],
        "faults": len(faults),
        "different_faults": len(set(faults)),
        "listeners": sum("listener" in r for r in records),
        "findings": [*idle, *(f"{r['t']:.0f} s: {r['finding']}" for r in records if "finding" in r)],
        "rows": rows,
    }


def as_text(result: dict) -> str:
    """Returns the judgement for a terminal: what grows or is unclear, then the largest growth of each measure."""
    lines = [
        f"{result['hours']:.2f} h: {result['goals']:.0f} goals, {result['streams']} streams, "
        f"servo mode {result['servo']} times, {result['faults']} faults ({result['different_faults']} different), "
        f"{result['listeners']} listeners"
    ]
    shown = [row for row in result["rows"] if row["verdict"] != "steady"]
    for measure in BOUNDS:
        rows = [row for row in result["rows"] if row["measure"] == measure and row["verdict"] == "steady"]
        shown += sorted(rows, key=lambda row: -row["slope"])[:1]
    table = [("process", "measure", "level", "growth/h", "99 % interval", "bound", "verdict")] + [
        (
            r["process"], r["measure"], f"{r['level']:.4g} {BOUNDS[r['measure']][1]}".strip(), f"{r['slope']:+.2f}",
            f"{r['low']:+.2f} to {r['high']:+.2f}", f"{r['bound']:g}", r["verdict"],
        )
        for r in shown
    ]  # fmt: skip
    counts = {v: sum(r["verdict"] == v for r in result["rows"]) for v in ("steady", "unclear", "grows")}
    lines += aligned(table, right=(2, 3, 4, 5))
    lines.append(", ".join(f"{count} {verdict}" for verdict, count in counts.items()) + " of all curves")
    lines += [f"finding, {text}" for text in result["findings"]] or ["no finding: nothing died, every recovery worked"]
    return "\n".join(lines)


def draw(records: list[dict], path: Path) -> None:
    """Draws the curves: memory, threads and files of each process against its start, and the delay."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    curves = series(records)
    faults = [record["t"] / 3600.0 for record in records if "fault" in record]
    figure, axes = plt.subplots(2, 2, figsize=(11, 6.5), sharex=True, layout="constrained")
    for axis, measure, label in zip(
        axes.flat, ("pss", "threads", "files"), ("memory (PSS) [MiB]", "threads", "open files")
    ):
        names = [name for name, m in curves if m == measure and name != "rig"]
        last = {name: curves[name, measure][1][-1] - curves[name, measure][1][0] for name in names}
        for name in sorted(names, key=lambda name: -abs(last[name])):
            hours, values = curves[name, measure]
            named = list(sorted(last, key=lambda n: -abs(last[n]))).index(name) < 6
            axis.plot(hours, values - values[0], lw=1.0, label=name if named else None, alpha=1.0 if named else 0.4)
        axis.set_title(f"{label}, change since the start", fontsize=10)
        axis.legend(fontsize=7)
    axis = axes.flat[3]
    axis.plot(*curves["rig", "delay"], lw=1.0)
    axis.set_title("frame to goal on the arm's wire, median [ms]", fontsize=10)
    axis.set_yscale("log")
    for axis in axes.flat:
        axis.grid(alpha=0.3)
        axis.plot(faults, np.zeros(len(faults)), "|", color="tab:red", transform=axis.get_xaxis_transform())
    for axis in axes[1]:
        axis.set_xlabel("time [h]; red: faults")
    figure.savefig(path, dpi=80)
    plt.close(figure)


def check_name(path: Path) -> None:
    """Raises RigError if the judgement or the picture of a run would replace its data."""
    if path.suffix in (".json", ".png"):
        raise RigError(f"{path} is no name for data: the judgement is the .json beside them, the picture the .png.")


def report(path: Path) -> int:
    """Writes the JSON and the picture of a run beside its data, prints the judgement; returns the exit code. RigError:
    the run is too short to judge anything, or the file is not of a run."""
    check_name(path)
    records = read(path)
    result = judge(records)
    if not result["rows"]:
        raise RigError(
            f"{path} is too short to judge: it spans {60.0 * result['hours']:.1f} minutes, and 3 are needed."
        )
    path.with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
    draw(records, path.with_suffix(".png"))
    print(as_text(result))
    print(f"data: {path}, judgement: {path.with_suffix('.json')}, picture: {path.with_suffix('.png')}")
    return 1 if result["findings"] or any(row["verdict"] == "grows" for row in result["rows"]) else 0
