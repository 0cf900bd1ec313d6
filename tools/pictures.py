"""Makes the pictures of the handbook with the project's own programs: `make docs-pictures`, or some by name.

python -m tools.pictures workspace panel
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Callable

import cv2
from PIL import Image

from leap_motion.registration import SHEET
from rig_simulation.control_port import ControlClient
from simulated.chromium import browser
from simulated.ports import free_port, ports_of_a_rig
from tools.handbook.walk import screen
from tools.reference.sources import ROOT

PICTURES = ROOT / "docs" / "pictures"
PARAMETERS = ROOT / "src" / "kuka_control" / "config" / "kuka_params_rt.yaml"
WIDTH, COLOURS = 1200, 128
"""Largest width [px] and number of colours: more is not visible on the pages."""
SHEETS, SHEET_WIDTH = ("pick-cup.png", "assisted_grasp.png", "hand-over.png"), 1920
"""Contact sheets and their width [px], at which their text can be read."""

FILM_OPTIONS = ("--view", "118", "-16", "1.35", "--size", "800", "500", "--rate", "15")
FILM_WIDTH, FILM_SPEED, FILM_FRAME_MS, FILM_QUALITY = 760, 2.0, 60, 60
"""Of the animated image: width [px], times real time, duration of a frame [ms], and WebP quality."""

SCREEN = (1400, 900)
VIEW = (384, 82, 1284, 830)
"""Area of the screen in which RViz shows the rig: left, top, right, bottom [px]."""

HANDS = (366, 64, 1184, 650)
"""The same of the visualizer's RViz."""
RVIZ_S, SETTLED_S = 25.0, 5.0
"""Time until RViz has its window, and until it has drawn what changed, on a slow machine [s]."""

PANEL = (568, 412)
FOLLOWING_S = 45.0
"""Time after the demo's start at which its arm follows a hand even on a slow machine [s]."""

WORKSPACES = {
    "workspace.png": {},
    "workspace-wide.png": {"center_line": "[1, 0, 0]", "opening_angle": "120.0"},
    "workspace-behind.png": {"center_line": "[-1, 0, 0]"},
    "workspace-home-pos.png": {"home_pos": "[-45, 20, 0, -100, 0, 40, 0]", "use_home_pos": "true"},
}
"""Changes to the shipped parameters."""


def workspace() -> None:
    """The workspace, the home position, and how much of it the arm reaches."""
    for name, changes in WORKSPACES.items():
        text = PARAMETERS.read_text()
        for key, value in changes.items():
            text = re.sub(rf"^{key}: .*?(?=  +#)", f"{key}: {value}", text, flags=re.MULTILINE)
        with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
            file.write(text)
            file.flush()
            _run(
                "rosrun", "kuka_control", "workspace_plotter.py", "--params", file.name, "--save", str(PICTURES / name)
            )


def panel() -> None:
    """The control panel at home with control off, and while the arm follows a hand."""
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    from python_qt_binding.QtGui import QPainter, QPixmap
    from python_qt_binding.QtWidgets import QApplication

    from kuka_control.gui.panel import ControlPanel
    from kuka_control.gui.panel_state import ControllerStatus, panel_state

    application = QApplication([])
    shown = []
    for status in (
        ControllerStatus(0.0, False, False, 1.0, "home", "The arm is at home."),
        ControllerStatus(0.0, True, True, 0.7, "servo", "The arm follows the desired tool frame in servo mode."),
    ):
        window = ControlPanel()
        window.show_state(panel_state(status, 0.0))
        window.show()
        application.processEvents()
        shown.append(window.grab().copy(0, 0, *PANEL))
    both = QPixmap(sum(picture.width() for picture in shown), shown[0].height())
    painter = QPainter(both)
    for i, picture in enumerate(shown):
        painter.drawPixmap(i * shown[0].width(), 0, picture)
    painter.end()
    both.save(str(PICTURES / "panel.png"))


def tracker_sheet() -> None:
    """The sheet for the registration of a tracker, on A4 in real size."""
    width, height = 297.0, 210.0
    shapes = [
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
        '<rect x="108.5" y="90" width="80" height="30" rx="4"/><path d="M148.5 128 v20 m-5 -7 l5 7 l5 -7"/>',
        '<path d="M98.5 185 h100 m0 -3 v6 m-100 0 v-6"/>',
    ]
    texts = [(148.5, 107.0, "tracker"), (148.5, 156.0, "the person"), (148.5, 192.0, "100 mm")]
    for i, (name, (x, z)) in enumerate(SHEET.items(), start=1):
        x, y = 0.5 * width + 1e3 * x, 0.5 * height + 1e3 * z
        shapes.append(f'<path d="M{x - 8:g} {y:g} h16 M{x:g} {y - 8:g} v16"/>')
        shapes += [f'<circle cx="{x:g}" cy="{y:g}" r="{r}"/>' for r in (15, 20, 25, 30, 35)]
        texts.append((x, y + (42 if z < 0.0 else -38), f"{i} {name}"))
    written = [f'<text x="{x:g}" y="{y:g}" text-anchor="middle">{text}</text>' for x, y, text in texts]
    (PICTURES / "tracker-sheet.svg").write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n<g fill="none" stroke="black" stroke-width="0.3">\n'
        + "\n".join(shapes)
        + '\n</g>\n<g font-family="sans-serif" font-size="5">\n'
        + "\n".join(written)
        + "\n</g>\n</svg>\n"
    )


def rig() -> None:
    """The demo in RViz while the arm follows a hand."""
    with _stage() as (start, environment):
        start("rosrun", "leap_rig", "demo.py", "--", "gui:=false", *_ports())
        time.sleep(FOLLOWING_S)
        _take(PICTURES / "rig.png", environment, VIEW)


def cockpit() -> None:
    """The cockpit's page while the arm follows a hand."""
    port, quality = free_port(), 80
    command = ("rosrun", "leap_rig", "demo.py", "--view", "browser", "--", "gui:=false", "camera:=true")
    follows = (
        "typeof state === 'object' && state !== null && sceneSays === '' && !cameraViews.camera.old"
        " && state.arms[''].tone === 'normal' && state.arms[''].status_line.startsWith('servo')"
    )
    with _started(*command, f"cockpit_port:={port}", *_ports(), DISPLAY=""), tempfile.TemporaryDirectory() as folder:
        address, file = f"http://127.0.0.1:{port}/", Path(folder) / "cockpit.png"
        _wait_until(lambda: _answers(port), 2.0 * FOLLOWING_S, "the cockpit")
        with browser(address, Path(folder), _wait_until, "1280,943") as evaluate:
            time.sleep(FOLLOWING_S)
            _wait_until(lambda: evaluate(follows), 4.0 * FOLLOWING_S, "an arm that follows")
            evaluate.picture(file)
        Image.open(file).convert("RGB").save(PICTURES / "cockpit.webp", quality=quality, method=6)


def film() -> None:
    """The rig at work: the simulated operator picks up a cup, as an animated image."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "film.mp4"
        _record("pick_cup", recording, FILM_OPTIONS)
        _animate(recording, PICTURES / "film.webp", begin_s=10.0)


def pick_cup() -> None:
    """The simulated operator picks up a cup and puts it down."""
    _sheet("pick_cup", SHEETS[0])


def assisted_grasp() -> None:
    """The simulated operator corrects a grasp that the network proposes."""
    _sheet("assisted_grasp", SHEETS[1], ("--view", "165", "-20", "1.25"))


def hand_over() -> None:
    """The simulated operator hands a box from one arm to the other."""
    _sheet("hand_over", SHEETS[2], robots=2)


def grasping() -> None:
    """What the network sees and proposes in two scenes."""
    for scene in ("cup", "objects"):
        with _grasps(scene) as master:
            file = PICTURES / f"grasping_{scene}.png"
            _run("rosrun", "grasping", "grasp_picture.py", str(file), ROS_MASTER_URI=master)


def tag_pose() -> None:
    """Poses of the single tag by colour alone and with depth."""
    with tempfile.TemporaryDirectory() as folder:
        _run("rosrun", "vision", "evaluate_tag_pose.py", "--panel", "single", "--output", folder)
        shutil.copy(Path(folder) / "tag_pose_1.png", PICTURES / "tag-pose-single.png")


def parts() -> None:
    """Renderings of the printed parts by `make cad`, copied because the site does not include their folder."""
    for name, copy in (("connectors.png", "connectors.png"), ("panel.png", "panel-on-arm.png")):
        shutil.copy(ROOT / "cad" / "assembly" / name, PICTURES / copy)


def calibration() -> None:
    """RViz after a calibration: the cloud of the calibrated camera lies on the arm's model."""
    with tempfile.TemporaryDirectory() as folder, _stage() as (start, environment):
        robot, world = _world(start, "--scene", "cup", "--panel", "bundle")
        camera = ("sim:=true", f"port:={world}", "control_port:=0", f"folder:={folder}", "rviz:=true")
        start("roslaunch", "vision", "camera_apriltag.launch", *camera)
        joints = ("preshape_1", "preshape_2", *(f"{k}_joint_{i}" for k in ("proximal", "distal") for i in (1, 2, 3)))
        names = ", ".join(f"reflex/{joint}" for joint in joints)
        hand = f"{{header: auto, name: [{names}], position: {[0.0] * len(joints)}}}"
        start("rostopic", "pub", "-s", "-r", "10", "joint_states", "sensor_msgs/JointState", hand)
        time.sleep(RVIZ_S)
        _run("rosparam", "set", "camera_calibration/views/count", "10", **environment)
        options = ("--ip", "127.0.0.1", "--port", robot, "--velocity", "0.5", "--yes")
        _run("rosrun", "vision", "calibrate_camera.py", *options, **environment)
        start("roslaunch", "vision", "register_rgbd.launch", "camera:=false", "rviz:=false")
        time.sleep(2.0 * RVIZ_S)  # RViz draws a cloud less than once a second without a graphics card
        _take(PICTURES / "calibration-rviz.png", environment)


def headset() -> None:
    """The view for the headset: each eye its own, with the lenses undone."""
    with _stage((1920, 1080)) as (start, environment):
        _, world = _world(start, "--scene", "objects")
        camera = ("sim:=true", f"port:={world}", "control_port:=0", "output:=screen")
        start("roslaunch", "vision", "camera_oculus.launch", *camera)
        time.sleep(RVIZ_S)
        _take(PICTURES / "headset-stereo.png", environment)


def plots() -> None:
    """Joint axes, paths of the tool, and what the Leap sees."""
    from tools.handbook_plots import PLOTS

    for name, plot in PLOTS.items():
        plot(PICTURES / name)


def visualizer() -> None:
    """Both hands as the tracker sees them, in RViz."""
    port, control = free_port(), free_port()
    with _stage() as (start, environment):
        leapd = ("--port", str(port), "--control-port", str(control), "--guided")
        start("rosrun", "rig_simulation", "leapd.py", *leapd)
        start("roslaunch", "leap_motion", "visualization.launch", f"port:={port}")
        time.sleep(RVIZ_S)
        with ControlClient("127.0.0.1", control) as service:
            service.ask("show", right=0.1, up=-0.08)
            service.ask("second", curl=1.0)
        time.sleep(SETTLED_S)
        _take(PICTURES / "visualizer.png", environment, HANDS)


def curves() -> None:
    """Training curves of the shipped GG-CNN2 weights."""
    from grasping.lab.programs.runs import plot

    with (ROOT / "src" / "grasping" / "weights" / "ggcnn2_reflex_curves.csv").open(newline="") as file:
        plot(list(csv.DictReader(file)), PICTURES / "ggcnn2_reflex_curves.png")


def filters() -> None:
    """The filters of the hand: lag against tremor."""
    from bench.bench_filter import plot

    plot(PICTURES / "hand-filter.png")


def compliance() -> None:
    """A stiff and a soft arm at a wall and at a ring."""
    from bench.bench_compliance import plot

    plot(PICTURES / "compliance.png")


MAKERS = {
    maker.__name__: maker
    for maker in (
        workspace,
        tracker_sheet,
        panel,
        rig,
        cockpit,
        film,
        pick_cup,
        assisted_grasp,
        hand_over,
        grasping,
        tag_pose,
        parts,
        calibration,
        headset,
        plots,
        visualizer,
        compliance,
        curves,
        filters,
    )
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.pictures", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help=f"names of pictures: {', '.join(MAKERS)}; default: all")
    options = parser.parse_args()
    for name in (name for name in options.names if name not in MAKERS):
        parser.error(f"there is no picture {name}; there are {', '.join(MAKERS)}")
    before = {file: file.stat().st_mtime for file in PICTURES.glob("*.png")}
    for name in options.names or MAKERS:
        print(f"pictures: {name}", flush=True)
        MAKERS[name]()
    for file in PICTURES.glob("*.png"):
        if file.stat().st_mtime != before.get(file):
            _shrink(file)


def _take(file: Path, environment: dict[str, str], area: tuple[int, int, int, int] | None = None) -> None:
    """Writes what is on a screen, or in an area of it: left, top, right, bottom."""
    shoot = "import sys; from python_qt_binding.QtWidgets import QApplication as A; a = A([]); "
    shoot += "a.primaryScreen().grabWindow(0).save(sys.argv[1])"
    _run(sys.executable, "-c", shoot, str(file), **environment)
    if area:
        picture = Image.open(file)
        picture.crop(area).save(file)


def _shrink(file: Path) -> None:
    picture = Image.open(file).convert("RGB")
    width = SHEET_WIDTH if file.name in SHEETS else WIDTH
    picture.thumbnail((width, width), Image.Resampling.LANCZOS)
    picture.quantize(COLOURS, kmeans=1, dither=Image.Dither.NONE).save(file, optimize=True)


def _ports() -> list[str]:
    return [f"{name}:={port}" for name, port in ports_of_a_rig().items()]


def _wait_until(condition: Callable, seconds: float, what: str) -> Any:
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"No picture: waited for {what}.")
        time.sleep(0.1)
    return found


def _answers(port: int) -> bool:
    """Whether a program listens on a port of this machine."""
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) == 0


def _run(*command: str, **environment: str) -> None:
    subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, **environment})


def _sheet(scenario: str, name: str, options: Sequence[str] = (), robots: int = 1) -> None:
    """Writes a contact sheet of a scenario that succeeded; otherwise the previous one stays."""
    with tempfile.TemporaryDirectory() as folder:
        sheet = Path(folder) / name
        _record(scenario, sheet, options, robots)
        shutil.copy(sheet, PICTURES / name)


def _record(scenario: str, file: Path, options: Sequence[str] = (), robots: int = 1) -> None:
    """Runs a scenario of the demo and films it. Raises CalledProcessError: the scenario failed."""
    ports = _ports()
    world = next(port.split(":=")[1] for port in ports if port.startswith("world_port"))
    recorder = ("rosrun", "rig_simulation", "record.py", str(file), "--port", world, "--wait", "120", *options)
    with _started(*recorder):
        _run(
            "rosrun", "leap_rig", "demo.py", "--headless", "--scenario", scenario, "--", f"robots:={robots}", *ports,
            ROS_MASTER_URI=f"http://localhost:{free_port()}",
        )  # fmt: skip


def _animate(recording: Path, file: Path, begin_s: float = 0.0, end_s: float = math.inf) -> None:
    """Converts a part of a film into an animated image that plays FILM_SPEED times as fast."""
    film = cv2.VideoCapture(str(recording))
    step = FILM_SPEED * FILM_FRAME_MS * 1e-3
    frames, due = [], begin_s
    while (read := film.read())[0]:
        now = film.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        if due <= now <= end_s:
            size = (FILM_WIDTH, round(FILM_WIDTH * read[1].shape[0] / read[1].shape[1]))
            frames.append(Image.fromarray(cv2.resize(read[1], size, interpolation=cv2.INTER_AREA)[..., ::-1]))
            due += step
    frames[0].save(
        file, save_all=True, append_images=frames[1:], duration=FILM_FRAME_MS, loop=0, quality=FILM_QUALITY, method=6
    )


@contextlib.contextmanager
def _started(*command: str, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """Runs a program on a ROS master of its own, unless one is named, and interrupts it like Ctrl-C."""
    master = f"http://localhost:{free_port()}"
    program = subprocess.Popen(command, env={**os.environ, "ROS_MASTER_URI": master, **environment}, cwd=ROOT)
    try:
        yield program
    finally:
        program.send_signal(signal.SIGINT)
        program.wait(90.0)


@contextlib.contextmanager
def _grasps(scene: str) -> Iterator[str]:
    """Runs the simulated world, its camera and the network; yields the address of their ROS master."""
    world, *others = (str(free_port()) for _ in range(5))
    options = ("--port", "--control-port", "--hand-port", "--hand-control-port")
    ports = (word for pair in zip(options, others) for word in pair)
    options_of_launch = ("sim:=true", f"port:={world}", "control_port:=0", "image_view:=false", "node:=true")
    launch = ("roslaunch", "grasping", "grasping.launch", *options_of_launch)
    truth = ("rosrun", "rig_simulation", "camera_truth_node.py", f"_port:={world}")
    master = f"http://localhost:{free_port()}"
    with _started(
        "rosrun", "rig_simulation", "world.py", "--scene", scene, "--seed", "1", "--world-port", world, *ports
    ), _started(*launch, ROS_MASTER_URI=master), _started(*truth, ROS_MASTER_URI=master):
        yield master


Start = Callable[..., None]
"""Starts a program that ends with the stage."""


@contextlib.contextmanager
def _stage(size: tuple[int, int] = SCREEN) -> Iterator[tuple[Start, dict[str, str]]]:
    """Runs a ROS master and a virtual display; yields what starts a program there, and the environment of it."""
    port = free_port()
    with contextlib.ExitStack() as running:
        display = running.enter_context(screen(size))
        environment = {"ROS_MASTER_URI": f"http://localhost:{port}", "DISPLAY": display, "QT_QPA_PLATFORM": "xcb"}
        environment.update(LIBGL_ALWAYS_SOFTWARE="1", QT_X11_NO_MITSHM="1")

        def start(*command: str) -> None:
            running.enter_context(_started(*command, **environment))

        start("roscore", "-p", str(port))
        _run("bash", "-c", "until rosparam get /rosdistro; do sleep 0.5; done", **environment)
        yield start, environment


def _world(start: Start, *options: str) -> tuple[str, str]:
    """Starts the simulated world; returns the ports of its arm and of its pictures."""
    names = ("--port", "--control-port", "--hand-port", "--hand-control-port", "--world-port")
    ports = [str(free_port()) for _ in names]
    start("rosrun", "rig_simulation", "world.py", *options, *(word for pair in zip(names, ports) for word in pair))
    return ports[0], ports[-1]


if __name__ == "__main__":
    main()
