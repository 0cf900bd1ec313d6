"""How old an image is when a page shows it, by stages, beside a demo: JPEG to this machine, and WebRTC over a link of
20 +- 10 ms that loses 2 %. The images are 640 x 480 at 30 Hz, the page is the cockpit's without its scene, in Chromium;
each image says when it was taken, by a strip in the video or in the message before the JPEG."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from bench.bench_demo import end_demo, start_demo, wait_until_ready
from bench.measure import ROOT, SRC, BenchError, Goal, Row, row
from simulated.ports import free_port

RATE_HZ = 30.0
SETTLE_S = 6.0  # a video runs by then
LINK = {"delay": 0.02, "jitter": 0.01, "loss": 0.02}
GOALS = {"jpeg": Goal(45.0, 80.0), "webrtc": Goal(120.0, 200.0)}
FREEZE = Goal(None, 500.0)
LISTEN = """window.found = []; document.querySelector("#cameras canvas").addEventListener("picture", ({detail}) => {
  const {taken, received, decoded, now, came, ahead} = detail, sent = now ? now - ahead : received;
  requestAnimationFrame(() => found.push(
    [taken, came ? came - ahead : taken, sent, received, decoded, performance.now(), +("decoding" in detail)]));
}); 1"""


def rows(quick: bool) -> list[Row]:
    """Returns the ages and their stages [ms]. Raises BenchError: no browser, or nobody may make a network here."""
    seconds = 3.0 if quick else 30.0
    with contextlib.ExitStack() as stack:
        if not quick:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            log = Path(folder) / "demo.log"
            env = {
                **os.environ,
                "DISPLAY": "",
                "ROS_MASTER_URI": f"http://localhost:{free_port()}",
                "ROS_HOME": folder,
                "ROS_LOG_DIR": f"{folder}/log",
            }
            with open(log, "wb") as output:
                demo = start_demo(("--headless",), env, output)
            stack.callback(end_demo, demo)
            wait_until_ready(demo, log)
        found = {way: _measured(way, seconds) for way in GOALS}
    how = f"{seconds:g} s {'alone' if quick else 'beside a demo'}"
    table = []
    for way, times in found.items():
        taken, came, sent, received, decoded, shown, _ = times.T
        name = f"image by {way}"
        table += [
            row(f"{name}: taken to shown", shown - taken, "ms", how, GOALS[way]),
            row(f"{name}: between two", np.diff(shown), "ms", how, FREEZE),
            row(f"{name}: wait, encode, wire", received - came, "ms", how),
            row(f"{name}: decode", decoded - received, "ms", how),
            row(f"{name}: shown", shown - decoded, "ms", how),
        ]
        if way == "jpeg":
            table.append(row(f"{name}: wait, encode", sent - came, "ms", how))
    return table


def _measured(way: str, seconds: float) -> np.ndarray:
    """Returns of each shown image the times of its stages, shape (images, 7) [ms]: taken, came, sent, received,
    decoded, shown, and whether it was of a video."""
    from campaign.network.wire import in_own_network

    command = in_own_network([sys.executable, "-m", "bench.bench_pictures", way, str(seconds)])
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=seconds + 120.0)
    lines = result.stdout.strip().splitlines()
    if result.returncode or not lines:
        raise BenchError(f"No page showed images by {way}: {(result.stderr.strip().splitlines() or ['-'])[-1]}")
    times = np.array(json.loads(lines[-1]))
    if len(times) < 3 or not (times[:, -1] == (way == "webrtc")).all():
        raise BenchError(f"The page did not show its images by {way}.")
    return times


def main(way: str, seconds: float) -> None:
    """Serves images to a page and prints the times of its stages; in a network of its own."""
    from campaign.network.link import Link
    from campaign.network.wire import Wire
    from common import clock
    from leap_rig.cockpit.server import CockpitServer, ScenePage
    from simulated.chromium import browser
    from tools.own_network import bring_up
    from vision.stereo.transport import Picture

    def until(condition, patience=60.0, what="the page", poll=0.1):
        end = time.monotonic() + patience
        while not (found := condition()):
            if time.monotonic() > end:
                raise BenchError(f"waited for {what}")
            time.sleep(poll)
        return found

    rest = {"arms": {}, "cameras": ["camera"], "answer": {"number": 0, "text": ""}, "recording": "", "marks": False}
    end = threading.Event()

    def feed() -> None:
        noise = np.random.default_rng(0).integers(0, 12, (480, 640, 3), np.uint8)
        image = np.add.outer(np.arange(480), np.arange(640)).astype(np.uint8)[..., None] // 2 + noise
        due = time.monotonic()
        while not end.is_set():
            image = np.roll(image, 2, axis=1)
            now = clock.monotonic()
            server.put_picture("camera", Picture(image, now, now, {}))
            server.put_state({**rest, "only_view": False, "tutorial": {"runs": False, "text": ""}})
            due = max(due + 1.0 / RATE_HZ, time.monotonic() - 0.1)
            time.sleep(max(0.0, due - time.monotonic()))

    with contextlib.ExitStack() as stack:
        bring_up()
        folder, near, far = stack.enter_context(tempfile.TemporaryDirectory()), "127.0.0.1", "127.0.0.1"
        if way == "webrtc":
            wire = stack.enter_context(Wire("ros"))
            near, far = wire.near, wire.far
            wire.set(Link(**LINK))
        script = (SRC / "vision" / "web" / "pictures.js").read_bytes()
        server = CockpitServer(
            SRC / "leap_rig" / "web" / "cockpit.html", ScenePage(b"<!doctype html>", ("127.0.0.1", 9)), ("",),
            lambda _: None, lambda: None, lambda _: None, host=near, name=far, script=script,
        )  # fmt: skip
        stack.callback(server.close)
        feeder = threading.Thread(target=feed)
        feeder.start()
        stack.callback(feeder.join)
        stack.callback(end.set)
        page = stack.enter_context(browser(server.address.replace(near, far), Path(folder), until))
        until(lambda: page("typeof cameraViews === 'object' && !!cameraViews.camera && cameraViews.camera.shown > 0"))
        time.sleep(SETTLE_S)
        page(LISTEN)
        time.sleep(seconds)
        print(json.dumps(page("window.found")), flush=True)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main(sys.argv[1], float(sys.argv[2]))
