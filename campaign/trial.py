"""One row of the campaign: what its function uses to provoke the fault, and the register of all rows.

    @row(1, "Arm TCP reset by peer", "D", within=1.5, named_by="connection", operator=True)
    def reset(trial):
        trial.follow()
        trial.fault("arm", "cut", duration=1.0)
        trial.stays_away(3.0)
        trial.recovers()

The function provokes and waits; what the arm does meanwhile is judged afterwards from the trace (campaign.judge).
Between two rows the rig comes to rest (`RigUnderTest.calm`), so a row leaves nothing to tidy up but what it did beside
the control ports. What cannot be provoked here is a row with `instead`: a sentence that says why, and
what stands for it."""

from __future__ import annotations

import contextlib
import json
import re
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from campaign.judge import Evidence, Expected, Limits, Verdict, judge
from campaign.network.link import Link
from common import clock

SHIFTED, SIMULATED = "shifted", "simulated"  # clocks of a rig
VARIANTS: dict[str, dict[str, str]] = {
    "shipped": {},
    "seeing": {"world": "true"},
    SHIFTED: {},
    SIMULATED: {},
    "deaf": {"robot_args": "--deaf-after-lost-client"},
    "watched": {"robot_server": "leap_rig", "robot_args": "--tool-weight"},
}
"""The rigs that rows run on, as arguments of rig.launch, all with the parameters as shipped: with objects, a camera and
the nodes that propose grasps, with another clock (campaign.clocks), with a server that is deaf after it has lost its
client, as the published one is, or with the robot application, which watches its client and weighs the tool.

Behind a slash a variant names a wire, such as "shipped/arm": its link may become bad, see Trial.link.
"""

STOOD_S, CREEPS = 0.2, 0.03
"""An arm that rests so long has stopped [s], one that turns back on its way rests for less; in servo mode it creeps to
its goal, its fastest joint below this speed [rad/s]."""


@dataclass(frozen=True)
class Row:
    """A row of the catalogue."""

    number: int
    fault: str
    expected: Expected
    provoke: Callable[[Trial], None]
    variant: str = "shipped"
    instead: str = ""  # why the fault itself cannot be provoked here, and what stands for it
    dangerous: str = ""  # why it is among the most dangerous ones
    spoils: bool = False  # whether the rig is of no use afterwards
    argued: str = ""  # page of docs/decisions which says why the reaction differs from the catalogue's
    real: str = ""  # what of the operating system it needs; else it runs in virtual time, too (simulated.rig)
    hazards: tuple[int, ...] = ()  # lines of the safety case whose measures it shows


ROWS: dict[int, Row] = {}


def row(
    number: int,
    fault: str,
    reactions: str,
    within: float = 2.0,
    named_by: str = "",
    operator: bool = False,
    still: bool = False,
    limits: Limits | None = None,
    **others: Any,
) -> Callable[[Callable[[Trial], None]], Callable[[Trial], None]]:
    """Registers the function that provokes a row; see Row and campaign.judge.Expected."""

    def register(provoke: Callable[[Trial], None]) -> Callable[[Trial], None]:
        assert number not in ROWS, f"row {number} exists twice"
        expected = Expected(reactions, within, named_by, operator, still, limits or Limits())
        ROWS[number] = Row(number, fault, expected, provoke, **others)
        return provoke

    return register


@dataclass
class Trial:
    """What a row does to the rig, and when.

    Attributes:
        rig: the running rig (campaign.rig.RigUnderTest).
        killed: names of the nodes that the row itself ends."""

    rig: Any
    killed: set[str] = field(default_factory=set)
    _fault: float | None = None
    _mended: float | None = None
    _operator: float | None = None
    _failed: list[str] = field(default_factory=list)

    def follow(self, sway: bool = True) -> None:
        """Lets the arm follow a hand: one that moves for ever, or one that stands still."""
        self.rig.follow(right=-0.06)
        if sway:
            self.rig.hand.sway(1.0, right=0.06)
            self.rig.wait(lambda: self.rig.arm.now.tool_speed > 0.05, "the arm to move")

    def fault(self, device: str, name: str, value: float | None = None, duration: float | None = None) -> None:
        """Switches a fault of docs/faults.md on, at the device "arm", "leap" or "hand"."""
        options = {"value": value, "duration": duration}
        began = self.begins()
        ask = self.rig.devices()[device].ask
        ask("fault", name=name, **{key: number for key, number in options.items() if number is not None})
        if duration is not None:
            self._mended = began + duration

    def mend(self, device: str, name: str) -> None:
        """Switches a fault off."""
        self.rig.devices()[device].ask("fault", name=name, on=False)
        self.ends()

    def link(self, **fields: Any) -> dict[str, int]:
        """Makes the link of the rig's wire bad, see campaign.network.link.Link; without fields it is good again.
        Returns how many packets came and how many were lost on it since the change before."""
        counts = self.rig.wire.set(Link(**fields))
        if fields:
            self.begins()
        else:
            self.ends()
        return counts

    def begins(self, at: float | None = None) -> float:
        """Notes that the fault begins now, or began `at`, unless it began before; returns when it began [s]."""
        self._fault = self._fault or at or clock.monotonic()
        return self._fault

    def ends(self) -> None:
        """Notes that the fault has ended."""
        self._mended = clock.monotonic()

    def signal(self, node: str, number: signal.Signals) -> None:
        """Sends a signal to a node; the fault begins."""
        self.killed.add(f"/{node}")
        self.begins()
        self.rig.signal(node, number)

    @contextlib.contextmanager
    def controller(self, **parameters: Any) -> Iterator[None]:
        """Starts the controller anew with changed parameters under kuka/; afterwards they are as before."""
        before = self.rig.parameters(*parameters)
        self._restart_controller(**parameters)
        try:
            yield
        finally:
            self._restart_controller(**before)

    def _restart_controller(self, **parameters: Any) -> None:
        rig, node = self.rig, "kuka_real_time_node"
        self.killed.add(f"/{node}")
        if rig.pid(node) is not None:
            rig.signal(node, signal.SIGINT)
            rig.exit_code(node)
        rig.start(node, **parameters)
        rig.wait_for_mode("home")

    def says(self, pattern: str, timeout: float = 5.0) -> None:
        """Waits until somebody says what a regular expression describes, after the fault."""

        def said() -> bool:
            return any(re.search(pattern, text) for when, _, text in list(self.rig.said) if when >= self._fault)

        self.rig.wait(said, f"a message with /{pattern}/", timeout)

    def reads(self, pattern: str, timeout: float = 5.0) -> str:
        """Waits until the rig's log says what a regular expression describes, since the rig was at rest; returns the
        line. For programs that say so on their terminal alone, and while no node passes the log on."""
        find = re.compile(rf".*(?:{pattern}).*").search
        line = self.rig.wait(lambda: find(self.rig.log_since_calm), f"a line with /{pattern}/ in the log", timeout)[0]
        self.rig.hear("log", line.strip())
        return line

    def part(self, name: str, expected: Expected) -> None:
        """Judges what was seen since the fault as one of the row's parts; the next fault begins the next part."""
        for fault in judge(expected, replace(self.evidence([]), failed=[])).faults:
            self.fail(f"{name}: {fault}")
        self._fault = self._mended = self._operator = None

    def stays_away(self, seconds: float) -> None:
        """Lets time pass on the arm's clock, in which nothing may follow the hand; the judge looks at it."""
        self.rig.watch(seconds)

    def stands(self, within: float) -> None:
        """Waits until the arm stands after the fault, for the first time; notes whether it did so in time [s]. What may
        come then, a motion home or the next hand, is no matter here."""
        found: list[float] = []

        def rested() -> bool:
            steps = [step for step in list(self.rig.arm.steps) if step[0] >= self._fault]
            moving = [step[0] for step in steps if max(map(abs, step[8:15])) > CREEPS]
            pairs = zip([self._fault, *moving], [*moving, self.rig.arm.now.time])
            found[:] = [before - self._fault for before, after in pairs if after - before > STOOD_S][:1]
            return bool(found)

        self.rig.wait(rested, "the arm to stand")
        self.check(f"the arm stands within {within:g} s", found[0] <= within, f"only after {found[0]:.2f} s")

    def operator(self) -> None:
        """Notes that the operator acts from now on."""
        self._operator = self._operator or clock.monotonic()

    def recovers(self) -> None:
        """Switches control off and on and brings a hand in, and waits until the arm follows it again."""
        self.operator()
        rig = self.rig
        rig.hand.hide()
        rig.wait(lambda: rig.control(False).success and rig.control(True).success, "control to be on again", 20.0)
        rig.wait_for_mode("home")
        rig.modes.clear()
        rig.engage(right=-0.04)

    def check(self, what: str, good: bool, detail: object = "") -> None:
        """Notes a condition of this row alone, as a sentence of what is to be; a false one fails the row."""
        if not good:
            text = str(detail)
            self.fail(f"not so: {what} ({text})" if text else f"not so: {what}")

    def fail(self, what: str) -> None:
        """Notes what went wrong."""
        self._failed.append(what)

    def call(self, name: str, kind: Any, *values: Any) -> Any:
        """Calls a service and takes note of its answer."""
        answer = self.rig.call(name, kind, *values)
        self.rig.hear(name, answer.message)
        return answer

    def evidence(self, died: list[str]) -> Evidence:
        """Returns what was seen up to now."""
        arm = self.rig.arm
        steps = np.array(list(arm.steps)) if arm.steps else np.zeros((0, 16))
        now = clock.monotonic()
        return Evidence(
            steps=steps,
            fault=self._fault or now,
            end=now,
            heard=arm.heard,
            mended=self._mended,
            operator=self._operator,
            said=list(self.rig.said),
            statuses=list(self.rig.statuses),
            entered=list(self.rig.entered),
            events=list(arm.events),
            died=died,
            failed=list(self._failed),
            exact=self.rig.exact,
        )


def run(rig: Any, entry: Row, traces: Path | None = None) -> Verdict:
    """Runs a row on a rig at rest and judges it; stores what was seen in the folder `traces`."""
    trial = Trial(rig)
    before = rig.pids()
    try:
        entry.provoke(trial)
    except (pytest.fail.Exception, AssertionError) as failure:
        trial.fail(str(getattr(failure, "msg", failure)).strip())
    if trial._fault is None:
        trial.fail("the row provoked nothing")
    died = [name for name, pid in before.items() if name not in trial.killed and not rig.runs(pid)]
    seen = trial.evidence(died)
    if traces is not None:
        (traces / f"row_{entry.number}.json").write_text(json.dumps({**vars(seen), "steps": seen.steps.tolist()}))
    return judge(entry.expected, seen)


def runs(pid: int) -> bool:
    """Returns whether a process runs; one that has ended and waits for its parent does not."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return psutil.Process(pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    return False
