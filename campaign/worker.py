"""One rig with a master of its own: reads numbers of rows, a line each, and writes verdicts as JSON lines.
`python -m campaign.worker VARIANT [FOLDER FOR TRACES]` within `unshare -rn`, where the kernel allows it: there no robot
can be reached. It ends at the end of its input, or after a row that leaves no rig behind."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import signal
import sys
import tempfile
import time
import traceback
import xmlrpc.client
from pathlib import Path

import conftest as shared
from campaign import rows, trial
from campaign.clocks import clock_of
from campaign.network.cells import CELLS, Cell
from campaign.network.measure import run_cell
from campaign.network.wire import Wire
from campaign.rig import RigUnderTest
from tools.own_network import bring_up


def main(variant: str, traces: Path | None = None) -> None:
    """Runs rows until the input ends."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("interrupted"))
    output = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever else prints does not disturb the verdicts
    with contextlib.suppress(OSError):
        bring_up()
    entries = {str(number): entry for number, entry in {**rows.load(), **CELLS}.items()}
    kind, _, name = variant.partition("/")
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="campaign-"))
        wire = stack.enter_context(Wire(name)) if name else None
        clock = clock_of(kind, Path(folder))
        core = stack.enter_context(master(Path(folder), wire.far if wire and name == "ros" else "localhost"))
        stack.callback(clock.stop)
        clock.start()
        rig = RigUnderTest(shared, Path(folder, "rig"), wire, core, **trial.VARIANTS[kind])
        rig.clock = clock
        try:
            Path(folder, "rig").mkdir()
            rig.bring_up()
            print("ready", file=output, flush=True)
            for line in sys.stdin:
                entry = entries[line.strip()]
                began = time.monotonic()
                rig.calm()
                print("at rest", file=output, flush=True)
                verdict = run_cell(rig, entry) if isinstance(entry, Cell) else trial.run(rig, entry, traces)
                seconds = time.monotonic() - began
                print(json.dumps({**dataclasses.asdict(verdict), "seconds": seconds}), file=output, flush=True)
                if entry.spoils:
                    break
        except BaseException:
            for number in (signal.SIGINT, signal.SIGTERM):  # a second one would leave nodes behind
                signal.signal(number, signal.SIG_IGN)
            traceback.print_exc()
            print(rig.situation, file=sys.stderr)
            raise
        finally:
            rig.end()


class Core:
    """The ROS master on a port of its own, which a row may kill and start again."""

    def __init__(self, folder: Path, port: int) -> None:
        self._programs = shared.Processes(folder)
        self._port, self._uri = port, f"http://localhost:{port}"

    def start(self) -> None:
        """Starts roscore and waits until the master answers."""
        self._roscore = self._programs.start("roscore", "-p", str(self._port), env={"ROS_MASTER_URI": self._uri})
        shared.wait_until(lambda: shared._master_answers(self._uri), 30.0, "the ROS master")

    def kill(self) -> None:
        """Kills roscore, the master and rosout, which say goodbye to nobody."""
        master = xmlrpc.client.ServerProxy(self._uri)
        rosout = xmlrpc.client.ServerProxy(master.lookupNode("/campaign", "/rosout")[2])
        for pid in (self._roscore.pid, rosout.getPid("/campaign")[2], master.getPid("/campaign")[2]):
            os.kill(pid, signal.SIGKILL)
        self._roscore.wait(5.0)

    @contextlib.contextmanager
    def hanging(self):
        """Lets the master stand still for a while."""
        pid = xmlrpc.client.ServerProxy(self._uri).getPid("/campaign")[2]
        shared.suspend(pid)
        try:
            yield
        finally:
            os.kill(pid, signal.SIGCONT)

    def end(self) -> None:
        """Ends whatever of it runs."""
        self._programs.end_all()


@contextlib.contextmanager
def master(folder: Path, address: str):
    """Starts a ROS master on a free port; this process is a node of it. All nodes meet under the address."""
    import rospy

    port = shared.free_port()
    os.environ.update(
        ROS_MASTER_URI=f"http://{address}:{port}",
        ROS_HOME=str(folder),
        ROS_LOG_DIR=str(folder / "log"),
        ROS_HOSTNAME=address,
        LEAP_RIG_NICENESS="0",
    )
    core = Core(folder, port)
    try:
        core.start()
        rospy.init_node("campaign", anonymous=True, disable_signals=True)
        yield core
    finally:
        rospy.signal_shutdown("the campaign is over")
        core.end()


if __name__ == "__main__":
    main(sys.argv[1], *map(Path, sys.argv[2:]))
