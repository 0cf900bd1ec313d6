"""One rig with a master of its own: reads numbers of rows, a line each, and writes verdicts as JSON lines.

`python -m campaign.worker VARIANT [FOLDER FOR TRACES]` within `unshare -rn`, where the kernel allows it: there no robot
can be reached. It ends at the end of its input, or after a row that leaves no rig behind.
"""

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
from pathlib import Path

import conftest as shared
from campaign import rows, trial
from campaign.clocks import clock_of
from campaign.network.cells import CELLS, SHORT, Cell
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
    entries = {str(number): entry for number, entry in {**rows.load(), **CELLS, **SHORT}.items()}
    kind, _, name = variant.partition("/")
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="campaign-"))
        wire = stack.enter_context(Wire(name)) if name else None
        clock = clock_of(kind, Path(folder))
        stack.enter_context(master(Path(folder), wire.far if wire and name == "ros" else "localhost"))
        stack.callback(clock.stop)
        clock.start()
        rig = RigUnderTest(shared, Path(folder, "rig"), wire, **trial.VARIANTS[kind])
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
            traceback.print_exc()
            print(rig.situation, file=sys.stderr)
            raise
        finally:
            rig.end()


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
    programs = shared.Processes(folder)
    try:
        programs.start("roscore", "-p", str(port), env={"ROS_MASTER_URI": f"http://localhost:{port}"})
        shared.wait_until(lambda: shared._master_answers(os.environ["ROS_MASTER_URI"]), 30.0, "the ROS master")
        rospy.init_node("campaign", anonymous=True, disable_signals=True)
        yield
    finally:
        rospy.signal_shutdown("the campaign is over")
        programs.end_all()


if __name__ == "__main__":
    main(sys.argv[1], *map(Path, sys.argv[2:]))
