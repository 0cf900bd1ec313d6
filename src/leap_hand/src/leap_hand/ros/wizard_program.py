"""The program hand_wizard: measures a person's hand over the Leap and stores the finger mapping under a name."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import rospkg
import rospy
import yaml
from diagnostic_msgs.msg import DiagnosticArray

from common import clock
from common.config import parse
from common.errors import RigError
from common.ros.files import read_yaml, write_whole
from common.ros.node import join, run_program
from common.simulated import SIMULATED
from leap_hand.config import HandConfig
from leap_hand.hand_wizard import HandWizard, WizardStep, as_yaml
from leap_hand.numbers import HINT_S
from leap_hand.ros.operators import known_file, operator_file
from leap_motion.frames import TrackingFrame
from leap_motion.ros.tracking import subscribe
from rig_msgs.msg import KukaStatus

NODE = "hand_wizard"


class WizardRefused(RigError):
    """Nothing was stored."""


def main() -> None:
    """Runs the program and exits the process: 0 stored, 1 refused, 130 interrupted."""
    arguments = sys.argv[1:] if "--check" in sys.argv else rospy.myargv()[1:]
    parser = argparse.ArgumentParser(prog=f"{NODE}.py", description="Measures a hand for the finger mapping.")
    parser.add_argument("name", help="of the person: letters, digits, - and _; later operator:=NAME")
    parser.add_argument("--force", action="store_true", help="replace the person's file without a question")
    parser.add_argument("--timeout", type=float, default=60.0, metavar="S", help="give up after this time, 60 s")
    parser.add_argument("--check", action="store_true", help="print the name if its file is good; measure nothing")
    options = parser.parse_args(arguments)
    run_program(NODE, lambda: _run(options), "Interrupted; nothing was stored.")


def _run(options: argparse.Namespace) -> None:
    shipped = Path(rospkg.RosPack().get_path("leap_hand")) / "config" / "leap_hand.yaml"
    default = yaml.safe_load(shipped.read_text(encoding="utf-8"))
    if options.check:
        known = known_file(options.name)
        stored = read_yaml(known) or {}
        parse(HandConfig, {**default, **stored} if isinstance(stored, dict) else stored, f"{known}: ")
        print(known.stem, end="")
        return
    path = operator_file(options.name)
    if path.exists() and not options.force:
        _ask(f"{path} exists. Replace it? [y/N] ")
    wizard = HandWizard(parse(HandConfig, default, "leap_hand/"))
    join(NODE, anonymous=True)
    simulated = _measure(wizard, options.timeout)
    calibration = wizard.result()
    parse(HandConfig, {**default, **calibration.values}, "leap_hand/")
    for remark in calibration.remarks:
        print(remark)
    try:
        write_whole(path, as_yaml(options.name, calibration, simulated))
    except OSError as error:
        raise WizardRefused(f"{path} could not be written: {error.strerror}.") from error
    print(f"Stored in {path}. Start the rig with operator:={options.name}.")


def _measure(wizard: HandWizard, timeout: float) -> bool | None:
    """Leads the person until the wizard is done; returns whether the tracker is simulated, None if its driver does
    not say. Raises WizardRefused."""
    frames: clock.Queue[TrackingFrame] = clock.Queue(maxsize=100)
    statuses: list[KukaStatus] = []

    def put(frame: TrackingFrame, _) -> None:
        if not frames.full():
            frames.put_nowait(frame)

    tracker: dict[str, str] = {}

    def hear(array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name == "leap_motion":
                tracker.update({value.key: value.value for value in status.values})

    rospy.Subscriber("/diagnostics", DiagnosticArray, hear)
    rospy.Subscriber("kuka/status", KukaStatus, lambda status: statuses.__setitem__(slice(None), [status]))
    subscribe(put)
    terminal, deadline = _Terminal(), clock.monotonic() + timeout
    while True:
        try:
            step = wizard.step(frames.get(timeout=0.1), clock.monotonic())
        except clock.Empty:
            step = wizard.look(clock.monotonic())
        if statuses and statuses[0].control_on:
            raise WizardRefused("The arm would follow the hand: switch kuka/kuka_control off. Nothing was stored.")
        terminal.say(step, clock.monotonic())
        if step.done:
            return {"true": True, "false": False}.get(tracker.get(SIMULATED, ""))
        if wizard.failed:
            raise WizardRefused(f"{wizard.failed} Nothing was stored.")
        if clock.monotonic() > deadline:
            raise WizardRefused(f"Not finished after {timeout:g} s; nothing was stored. {step.hint}".strip())


class _Terminal:
    """Prints each instruction once, and hints now and then."""

    def __init__(self) -> None:
        self._progress = -1.0
        self._instruction = ""
        self._hint = ""
        self._said = clock.monotonic()

    def say(self, step: WizardStep, now: float) -> None:
        if step.done or (step.instruction, step.progress) != (self._instruction, self._progress):
            print("Thank you, that is all." if step.done else f"{100 * step.progress:3.0f} %  {step.instruction}")
            self._instruction, self._progress, self._hint, self._said = step.instruction, step.progress, "", now
        elif step.hint and now - self._said > (HINT_S if step.hint == self._hint else HINT_S / 3.0):
            print(f"       {step.hint}")
            self._hint, self._said = step.hint, now


def _ask(question: str) -> None:
    if not sys.stdin.isatty():
        raise WizardRefused(f"{question.partition('?')[0].rpartition('. ')[0]}; --force replaces it.")
    if input(question).strip().lower() not in ("y", "yes"):
        raise WizardRefused("Cancelled; nothing was stored.")
