"""Walks through pages of the handbook as their reader does: runs the blocks of each section, in order.

`python -m tools.handbook.walk FOLDER PAGE...` runs what is not marked as for elsewhere, with `--beside-rig` what is
marked `running rig`, beside one demo for all pages. Each page has a folder in FOLDER, where its files stay.
The commands are taken as they stand, so they use the usual ports: `unshare -rn` before all this gives them a network
of their own, in which there is no robot either.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from tools.handbook.pages import BESIDE_RIG, ROOT, UNTIL_CTRL_C, Block, blocks
from tools.handbook.terminal import ENDED, Terminal
from tools.own_network import bring_up

RIG = f'make demo HEADLESS=1 ARGS="overrides:={ROOT}/campaign/rig.yaml"'
"""With lower rates: the commands of the pages need a processor beside it."""
RIG_CODES = (*ENDED, 1, 2)
"""The exit code is 1, of make 2, where the commands left no chance that the arm follows."""

MAKE, MADE = re.compile("^make ", re.MULTILINE), "make --old-file=build/.ready "
"""The workspace counts as set up: where a manifest is newer, this is not the place to install packages."""


class Walk:
    """Runs blocks in one folder.

    Attributes:
        faults: what was wrong, a paragraph for each, which ends with the fault."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self.faults: list[str] = []
        self._folder = folder
        self._environment = environment
        self._numbers = itertools.count()
        self._open: list[tuple[str, Terminal]] = []

    def section(self, found: Iterable[Block]) -> None:
        """Runs the blocks of a section; what runs until Ctrl-C runs on beside the blocks after it."""
        for block in found:
            commands = [block.text]
            if block.language == "python":
                program = self._folder / f"program_{next(self._numbers)}.py"
                program.write_text(block.text)
                commands = [f"exec python {program}"]
            elif UNTIL_CTRL_C in block.marks:
                commands = block.commands
            for number, command in enumerate(commands):
                if UNTIL_CTRL_C not in block.marks:
                    terminal = self._terminal(command)
                    self._judge(block.where, command, terminal, terminal.end())
                    continue
                if number:  # each line of a block takes the place of the one before
                    self.interrupt()
                self.start(block.where, command)
        while self._open:
            self.interrupt()

    def start(self, where: str, command: str) -> None:
        """Starts what runs until Ctrl-C, and waits until it is ready."""
        terminal = self._terminal(command)
        fault = terminal.start()
        self._judge(where, f"{command}: start", terminal, fault)
        if not fault:
            self._open.append((where, terminal))

    def interrupt(self, codes: tuple[int, ...] = ENDED) -> None:
        """Ends by Ctrl-C what was started last."""
        if self._open:
            where, terminal = self._open.pop()
            self._judge(where, f"{terminal.command}: Ctrl-C", terminal, terminal.interrupt(codes))

    def _terminal(self, command: str) -> Terminal:
        log = self._folder / f"{next(self._numbers)}.log"
        return Terminal(MAKE.sub(MADE, command), self._folder, log, self._environment)

    def _judge(self, where: str, what: str, terminal: Terminal, fault: str) -> None:
        print(f"{time.strftime('%H:%M:%S')} {'FAULT' if fault else 'good'} {where}: {what.splitlines()[0]}", flush=True)
        if fault:
            self.faults.append(f"{terminal.output[-4000:]}\n{where}: {what}: {fault}")


def folder_of(page: Path, folder: Path) -> Path:
    """Returns a folder for what the commands of a page write, which looks like the project's."""
    return project_in(folder / page.relative_to(ROOT).with_suffix("").as_posix().replace("/", "_"))


def project_in(found: Path) -> Path:
    """Makes a folder that looks like the project's, unless it is there, and returns it."""
    if not found.is_dir():
        found.mkdir(parents=True)
        for entry in ROOT.iterdir():
            (found / entry.name).symlink_to(entry)
    return found


def walk(page: Path, folder: Path, environment: dict[str, str]) -> list[str]:
    """Runs what a page shows without a rig; returns the faults."""
    steps = Walk(folder_of(page, folder), environment)
    here = [block for block in blocks(page) if not block.why_not and BESIDE_RIG not in block.marks]
    for _, section in itertools.groupby(here, key=lambda block: block.section):
        steps.section(section)
    return steps.faults


def walk_beside_rig(pages: list[Path], folder: Path, environment: dict[str, str]) -> list[str]:
    """Runs what the pages show beside a running rig, on one demo; returns the faults."""
    rig = Walk(project_in(folder / "rig"), environment)
    rig.start("the rig", RIG)
    faults = []
    for page in pages if not rig.faults else ():
        # What yields to the arm would take minutes to start beside it on a small machine.
        steps = Walk(folder_of(page, folder), {**environment, "LEAP_RIG_NICENESS": "0"})
        here = [block for block in blocks(page) if not block.why_not and BESIDE_RIG in block.marks]
        for _, section in itertools.groupby(here, key=lambda block: block.section):
            steps.section(section)
        faults += steps.faults
    rig.interrupt(RIG_CODES)
    return rig.faults + faults


@contextlib.contextmanager
def screen(size: tuple[int, int] = (1280, 1024)) -> Iterator[str]:
    """Gives a screen without a monitor; yields its DISPLAY."""
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", f"{size[0]}x{size[1]}x24", "-noreset"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        assert server.stdout is not None
        try:
            yield f":{server.stdout.readline().strip()}"
        finally:
            server.terminate()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.handbook.walk", description=__doc__.splitlines()[0])
    parser.add_argument("--beside-rig", action="store_true", help="run what is marked so, beside one demo")
    parser.add_argument("folder", type=Path, help="where the pages have their folders")
    parser.add_argument("pages", type=Path, nargs="+")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # else what starts here may not hear Ctrl-C
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("interrupted"))  # so that the screen ends, too
    bring_up()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    home = {name: str(folder) for name in ("HOME", "ROS_HOME")}
    with screen() as display:
        environment = {
            **home,
            "DISPLAY": display,
            "ROS_MASTER_URI": "http://localhost:11311",
            "ROS_HOSTNAME": "localhost",
            "ROS_LOG_DIR": str(folder / "log"),
        }
        pages = [page.resolve() for page in options.pages]
        if options.beside_rig:
            faults = walk_beside_rig(pages, folder, environment)
        else:
            faults = [fault for page in pages for fault in walk(page, folder, environment)]
    sys.exit("\n".join(faults) or 0)


if __name__ == "__main__":
    main()
