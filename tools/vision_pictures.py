"""The pictures of vision for the handbook, from the simulation, without a screen: python -m tools.vision_pictures.

It starts a ROS master, a screen in memory (Xvfb) and the simulated world of its own, and ends them again.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rosgraph
import rospy
from PIL import Image as Picture
from python_qt_binding.QtGui import QImage
from python_qt_binding.QtWidgets import QApplication
from sensor_msgs.msg import Image, JointState, PointCloud2
from websockets.sync.client import connect

from common.errors import DeviceError
from common.ports import free_port

NAME = "vision_pictures"
WIDTH, COLOURS = 1000, 112
"""Of a picture; few colours keep the files small in spite of the camera's noise."""
SCREEN = (1920, 1080)
START_S, CALIBRATION_S, END_S = 90.0, 900.0, 20.0
VIEWS = 10
RVIZ_S, WINDOW_S = 40.0, 6.0
"""RViz draws a cloud less than once a second without a graphics card."""


class ProgramGroup:
    """The programs that were started; all end with it.

    Args:
        folder: for their logs.

    Attributes:
        log: what the newest program said.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.log = folder
        self._programs: list[subprocess.Popen] = []

    def start(self, *command: str) -> subprocess.Popen:
        """Starts a program in a process group of its own."""
        self.log = self.folder / f"{len(list(self.folder.iterdir()))}_{Path(command[0]).name}.log"
        with self.log.open("wb") as log:
            program = subprocess.Popen(
                list(command), stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        self._programs.append(program)
        return program

    def end(self, keep: int = 0) -> None:
        """Ends all but the first programs, the newest first."""
        while len(self._programs) > keep:
            program = self._programs.pop()
            for number, wait in ((signal.SIGINT, END_S), (signal.SIGKILL, END_S)):
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(program.pid, number)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    program.wait(wait)
                    break


def main(arguments: list[str] | None = None) -> int:
    """Takes the pictures; returns the exit code."""
    parser = argparse.ArgumentParser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the pictures go")
    parser.add_argument("--only", choices=TAKEN, help="only these")
    options = parser.parse_args(arguments)
    try:
        options.folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=NAME) as folder:
            stage = ProgramGroup(Path(folder))
            try:
                _prepare(stage)
                for name, take in TAKEN.items():
                    if options.only in (None, name):
                        take(stage, options.folder)
                        stage.end(keep=2)
            finally:
                stage.end()
    except (DeviceError, OSError, rospy.ROSException) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1
    return 0


def _prepare(stage: ProgramGroup) -> None:
    port = free_port()
    os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1", ROS_LOG_DIR=str(stage.folder))
    os.environ.pop("ROS_NAMESPACE", None)  # it has a graph of its own
    os.environ.update(LIBGL_ALWAYS_SOFTWARE="1", QT_X11_NO_MITSHM="1", QT_QPA_PLATFORM="xcb")
    stage.start("roscore", "-p", str(port))
    os.environ["DISPLAY"] = _screen(stage)
    _wait(rosgraph.is_master_online, START_S, "the ROS master")
    rospy.init_node(NAME, disable_signals=True)


def _screen(stage: ProgramGroup) -> str:
    number = stage.folder / "display"
    width, height = SCREEN
    server = f'exec Xvfb -displayfd 3 -screen 0 {width}x{height}x24 +extension GLX 3>"{number}"'
    stage.start("bash", "-c", server)
    return ":" + _wait(lambda: number.exists() and number.read_text().strip(), START_S, "Xvfb")


def _world(stage: ProgramGroup, *options: str) -> tuple[str, str]:
    """Returns the ports of arm and world."""
    ports = [str(free_port()) for _ in range(5)]
    names = ("--port", "--control-port", "--hand-port", "--hand-control-port", "--world-port")
    stage.start(
        "rosrun", "rig_simulation", "world.py", *options, *(word for pair in zip(names, ports) for word in pair)
    )
    return ports[0], ports[4]


def _calibration(stage: ProgramGroup, folder: Path) -> None:
    """RViz after a calibration: the cloud of the calibrated camera lies on the arm's model."""
    robot, world = _world(stage, "--scene", "cup", "--panel", "bundle")
    store = stage.folder / "store"
    arguments = ("sim:=true", f"port:={world}", "control_port:=0", f"folder:={store}", "rviz:=true")
    stage.start("roslaunch", "vision", "camera_apriltag.launch", *arguments)
    rospy.wait_for_message("tag_detections_image", Image, START_S)
    rospy.set_param("camera_calibration/views/count", VIEWS)
    fingers = rospy.Publisher("joint_states", JointState, queue_size=1)
    timer = rospy.Timer(rospy.Duration(0.1), lambda _: fingers.publish(_open_hand()))
    options = ("--ip", "127.0.0.1", "--port", robot, "--velocity", "0.5", "--yes")
    program = stage.start("rosrun", "vision", "calibrate_camera.py", *options)
    if program.wait(CALIBRATION_S) != 0:
        raise DeviceError(f"The calibration failed: {stage.log.read_text().splitlines()[-1]}")
    stage.start("roslaunch", "vision", "register_rgbd.launch", "camera:=false", "rviz:=false")
    rospy.wait_for_message("camera/depth_registered/points", PointCloud2, START_S)
    time.sleep(RVIZ_S)
    _shoot(folder / "calibration-rviz.png", (0, 0, 1400, 900))
    timer.shutdown()


def _open_hand() -> JointState:
    """Returns the joints of the hand, which no driver tells here."""
    names = ["preshape_1", "preshape_2", *(f"{kind}_joint_{i}" for kind in ("proximal", "distal") for i in (1, 2, 3))]
    message = JointState(name=[f"reflex/{name}" for name in names], position=[0.0] * len(names))
    message.header.stamp = rospy.Time.now()
    return message


def _headset(stage: ProgramGroup, folder: Path) -> None:
    """The view for the headset: as in 2019, and each eye its own with the lenses undone."""
    _, world = _world(stage, "--scene", "objects")
    common = ("sim:=true", f"port:={world}", "control_port:=0", "output:=screen")
    for name, arguments in (
        ("headset-2019.png", ("depth:=false", "lens:=none")),
        ("headset-stereo.png", ()),
    ):
        stage.start("roslaunch", "vision", "camera_oculus.launch", *common, *arguments)
        rospy.wait_for_message("stereo_view/image", Image, START_S)
        time.sleep(WINDOW_S)
        _shoot(folder / name)
        stage.end(keep=3)


def _page(stage: ProgramGroup, folder: Path) -> None:
    """The view for the headset as a page."""
    file = folder / "headset-page.png"
    browser = shutil.which("chromium")
    if browser is None:
        print(f"{NAME}: {file.name} is left out: there is no chromium.")
        return
    _, world = _world(stage, "--scene", "objects")
    port = free_port()
    arguments = ("sim:=true", f"port:={world}", "control_port:=0", "window:=false", "web:=true", f"web_port:={port}")
    stage.start("roslaunch", "vision", "camera_oculus.launch", *arguments)
    profile = stage.folder / "browser"
    words = (
        "--headless",
        "--no-sandbox",
        "--remote-debugging-port=0",
        f"--user-data-dir={profile}",
        "--window-size=1280,600",
    )
    stage.start(browser, *words, f"http://127.0.0.1:{port}/")
    active = profile / "DevToolsActivePort"
    control = _wait(lambda: active.exists() and active.read_text().split(), START_S, "Chromium")[0]
    with connect(_wait(lambda: _address(control), START_S, "the page"), max_size=None) as connection:

        def ask(method: str, **parameters: Any) -> dict:
            connection.send(json.dumps({"id": 1, "method": method, "params": parameters}))
            return json.loads(connection.recv(timeout=START_S)).get("result", {})

        shown = {"expression": "window.shown > 20", "returnByValue": True}
        _wait(lambda: ask("Runtime.evaluate", **shown).get("result", {}).get("value"), START_S, "The page's picture")
        shot = _wait(lambda: ask("Page.captureScreenshot").get("data"), START_S, "The page's screenshot")
    _write(file, np.asarray(Picture.open(io.BytesIO(base64.b64decode(shot))).convert("RGB")))


def _address(port: str) -> str | None:
    """Returns where the browser's page is controlled, None while it is not open."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=START_S) as answer:
        pages = [page for page in json.load(answer) if page["type"] == "page" and page["url"].startswith("http")]
    return pages[0]["webSocketDebuggerUrl"] if pages else None


TAKEN = {"calibration": _calibration, "headset": _headset, "page": _page}
"""What each part of the program takes."""


def _shoot(file: Path, area: tuple[int, int, int, int] | None = None) -> None:
    """Writes what is on the screen, or in an area of it: left, top, width, height."""
    application = QApplication.instance() or QApplication([NAME])
    image = application.primaryScreen().grabWindow(0, *(area or (0, 0, -1, -1))).toImage()
    image = image.convertToFormat(QImage.Format_RGB888)
    data = np.frombuffer(image.constBits().asarray(image.sizeInBytes()), np.uint8)
    rows = data.reshape(image.height(), image.bytesPerLine())[:, : 3 * image.width()]
    _write(file, rows.reshape(image.height(), image.width(), 3))


def _write(file: Path, pixels: np.ndarray) -> None:
    height, width = pixels.shape[:2]
    small = Picture.fromarray(pixels).resize((WIDTH, round(WIDTH * height / width)), Picture.Resampling.LANCZOS)
    small.quantize(COLOURS, kmeans=1, dither=Picture.Dither.NONE).save(file, optimize=True)
    print(f"{NAME}: {file}, {file.stat().st_size / 1000:.0f} kB")


def _wait(condition: Callable[[], Any], timeout: float, what: str) -> Any:
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        found = condition()
        if found:
            return found
        time.sleep(0.2)
    raise DeviceError(f"{what} did not come within {timeout:g} s.")


if __name__ == "__main__":
    sys.exit(main())
