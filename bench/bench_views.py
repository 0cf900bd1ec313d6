"""What a view of the demo costs: cores of the rig's programs and of the viewer, delay from frame to goal, and how often
the tracker's stream was lost, with no view, with the cockpit's page closed, with a page that takes everything and draws
nothing, as one on another computer, with a page that Chromium draws by software on the same cores, and with RViz, also
drawn by software."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.bench_demo import END_S, cpu_times, end_demo, last_line, start_demo, wait_until_ready
from bench.measure import BenchError, Goal, Row, number
from simulated.ports import free_port

STEERING_S = 4.0  # by then the arm is at home and has picked up the hand [s]
SETTLE_S = 4.0  # a page has been built by then
SIZE = "1280,800"
NONE, CLOSED, ELSEWHERE, CHROMIUM, RVIZ = "none", "page closed", "page elsewhere", "Chromium here", "RViz"
DEMOS = {"none": (NONE,), "browser": (CLOSED, ELSEWHERE, CHROMIUM), "rviz": (RVIZ,)}
"""The viewers of each demo, by its argument `view`."""
VIEWERS = ("rviz", "Xvfb", "chromium")  # programs that draw
DELAY_GOAL = Goal(None, 12.0)
MORE = {ELSEWHERE: (CLOSED, 0.15)}
"""Of how many cores more than with another viewer of the same demo the rig's programs may take."""
COCKPIT, CLOSED_GOAL = "cockpit_node.py", Goal(0.02)  # while no page is open it alone costs

OBSERVER = (
    sys.executable,
    "-c",
    """if True:
    import json, sys, rospy
    from common import clock
    from common.reasons import ReasonCode
    from leap_rig.report.recorder import Recorder
    from leap_rig.report.ros.listener import RigListener
    rospy.init_node("bench_views", anonymous=True)
    recorder = Recorder()
    listener = RigListener(recorder)
    while not recorder.frames:
        clock.sleep(0.1)
    print("ready", flush=True)
    while sys.stdin.readline():  # a window begins
        recorder.start(clock.monotonic())
        sys.stdin.readline()
        received, sent = recorder.stage_times["received"], recorder.stage_times["kuka_control"]
        lost = sum(ReasonCode.TRACKER_SILENT in stream.codes for stream in recorder.streams)
        print(json.dumps([[sent[s] - received[s] for s in sent if s in received], lost]), flush=True)
    """,
)


@dataclass
class Watched:
    """All windows of one viewer: their length [s], CPU time of each program [s], delays from frame to goal [s], and how
    often the stream was lost."""

    length: float = 0.0
    used: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    delays: list[float] = field(default_factory=list)
    lost: int = 0

    def cores(self, drawing: bool) -> float:
        """How many cores the programs took that draw, or the others."""
        return sum(used for name, used in self.used.items() if (name in VIEWERS) is drawing) / self.length


def rows(quick: bool) -> list[Row]:
    """Returns the rows of each view. Raises BenchError: a demo did not run."""
    missing = [program for program in ("chromium", "Xvfb", "rviz") if not shutil.which(program)]
    if missing:
        raise BenchError(f"Views are compared where there are chromium, Xvfb and rviz: no {' and '.join(missing)}.")
    rounds, window_s = (1, 4.0) if quick else (3, 15.0)
    watched: dict[str, Watched] = defaultdict(Watched)
    for view, viewers in DEMOS.items():
        _run(view, viewers, rounds, window_s, watched)
    table = []
    for viewer, seen in watched.items():
        how = f"{rounds} windows of {window_s:g} s"
        p50, p99 = (1e3 * np.percentile(seen.delays, (50, 99))).tolist() if seen.delays else (None, None)
        table += [
            number(f"{viewer}: rig", seen.cores(False), "cores", how),
            number(f"{viewer}: viewer", seen.cores(True), "cores", how),
            Row(f"{viewer}: frame to goal", p50, p99, "ms", f"{len(seen.delays)} frames in {how}", DELAY_GOAL),
            # Where the arm followed nothing there was no stream to lose.
            Row(f"{viewer}: streams lost", float(seen.lost) if p50 or seen.lost else None, None, "", how, Goal(0.0)),
        ]
    alone = watched[CLOSED].used[COCKPIT] / watched[CLOSED].length
    table.append(number(f"{CLOSED}: {COCKPIT}", alone, "cores", "closed", CLOSED_GOAL))
    for viewer, (than, most) in MORE.items():
        more = watched[viewer].cores(False) - watched[than].cores(False)
        table.append(number(f"{viewer}: more than {than}", more, "cores", "difference of the above", Goal(most)))
        programs = {name for name in watched[viewer].used if name not in VIEWERS}
        rates = {p: [watched[v].used[p] / watched[v].length for v in (viewer, than)] for p in programs}
        for name, (with_it, without) in sorted(rates.items(), key=lambda item: item[1][1] - item[1][0]):
            if with_it - without > 0.005:
                table.append(number(f"  {name}"[:38], with_it - without, "cores", f"of it {name}"))
    return table


def _run(view: str, viewers: tuple[str, ...], rounds: int, window_s: float, watched: Mapping[str, Watched]) -> None:
    """Runs a demo and watches each viewer in turn, `rounds` times."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        log, env = folder / "demo.log", {**os.environ, "DISPLAY": "", "ROS_HOME": name, "ROS_LOG_DIR": f"{name}/log"}
        env["ROS_MASTER_URI"] = f"http://localhost:{free_port()}"
        pids = []
        if view == "rviz":
            server, env["DISPLAY"] = stack.enter_context(_screen(log))
            pids.append(server)
        port = free_port()
        arguments = ("--view", view, "--", "gui:=false", "camera:=true", "operator_view:=true", f"cockpit_port:={port}")
        with open(log, "wb") as output:
            demo = start_demo(arguments, env, output)
        stack.callback(end_demo, demo)
        wait_until_ready(demo, log)
        observer = subprocess.Popen(OBSERVER, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        stack.callback(observer.kill)
        if observer.stdout is None or not observer.stdout.readline():
            raise BenchError("The delays of the demo are not heard.")
        time.sleep(STEERING_S)
        for number_of_round in range(rounds):
            for viewer in viewers:
                page = f"http://127.0.0.1:{port}/"
                with _viewer(viewer, page, folder / f"{number_of_round}") as pid:
                    time.sleep(SETTLE_S)
                    _watch([demo.pid, *pids, *pid], observer, window_s, watched[viewer])
        if demo.poll() is not None:
            raise BenchError(f"The demo did not run to its end: {last_line(log)}")


def _watch(pids: list[int], observer: subprocess.Popen, window_s: float, watched: Watched) -> None:
    assert observer.stdin is not None and observer.stdout is not None
    print("begin", file=observer.stdin, flush=True)
    before, began = [cpu_times(pid) for pid in pids], time.monotonic()
    time.sleep(window_s)
    after = [cpu_times(pid) for pid in pids]
    watched.length += time.monotonic() - began
    print("end", file=observer.stdin, flush=True)
    for old, new in zip(before, after):
        for process, used in new.items():
            watched.used[process[1]] += used - old.get(process, 0.0)
    delays, lost = json.loads(observer.stdout.readline())
    watched.delays += delays
    watched.lost += lost


@contextlib.contextmanager
def _viewer(viewer: str, address: str, folder: Path) -> Iterator[list[int]]:
    """Looks at the page; yields the processes that draw."""
    if viewer == ELSEWHERE:
        with _everything(address):
            yield []
    elif viewer == CHROMIUM:
        from simulated.chromium import browser

        folder.mkdir()
        with browser(address, folder, _wait_until, SIZE) as evaluate:

            def shows_the_scene() -> bool:
                with urllib.request.urlopen(f"http://{evaluate.devtools}/json") as answer:
                    return any(target["type"] == "iframe" for target in json.load(answer))

            _wait_until(lambda: evaluate("typeof state === 'object' && state !== null"), END_S, "its state")
            _wait_until(shows_the_scene, END_S, "its scene")
            yield [evaluate.pid]
    else:
        yield []


@contextlib.contextmanager
def _everything(address: str) -> Iterator[None]:
    """A page that takes everything, and draws nothing."""
    import msgspec
    from viser._messages import ViewerCameraMessage
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import ClientConnection, connect

    camera = ViewerCameraMessage(
        wxyz=(1.0, 0.0, 0.0, 0.0), position=(2.0, 0.0, 0.5), fov=0.8, near=0.1, far=9.0, image_height=600,
        image_width=800, look_at=(0.0, 0.0, 0.0), up_direction=(0.0, 0.0, 1.0),
    ).as_serializable_dict([])  # fmt: skip
    wire = address.replace("http", "ws").rstrip("/")
    with connect(f"{wire}/state") as state:
        scene = next(filter(None, (json.loads(text).get("scene") for text in state)))
    first = {scene: msgspec.msgpack.encode(camera), "/pictures": "{}"}

    def take(path: str, connection: ClientConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            if path in first:
                connection.send(first[path])
            for data in connection:
                if path == "/pictures" and (isinstance(data, bytes) or not json.loads(data).get("picture")):
                    connection.send("{}")

    with contextlib.ExitStack() as stack:
        for path in ("/state", "/pictures", scene):
            subprotocols = ["viser-v1.1.1"] if path == scene else None
            connection = stack.enter_context(
                connect(wire + path, subprotocols=subprotocols, max_size=None, close_timeout=2.0)
            )
            threading.Thread(target=take, args=(path, connection), daemon=True).start()
        yield


@contextlib.contextmanager
def _screen(log: Path) -> Iterator[tuple[int, str]]:
    command = ("Xvfb", "-displayfd", "1", "-screen", "0", "1280x800x24", "-noreset", "-nolisten", "tcp")
    with open(log.with_name("screen.log"), "wb") as said:
        server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, text=True)
    try:
        assert server.stdout is not None
        yield server.pid, f":{server.stdout.readline().strip()}"
    finally:
        server.kill()
        server.wait()


def _wait_until(condition: Callable, seconds: float, what: str):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > deadline:
            raise BenchError(f"The browser did not show the page: waited for {what}.")
        time.sleep(0.1)
    return found
