"""Each program in surroundings that somebody has by mistake: it works, or says in a sentence why not, and exits.

`make test` tries each program in one of them, `make test-long` in all.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
WORKS_S, LIMIT_S = 6.0, 90.0
"""What still runs after this time works; what cannot work may need the other one for its end, on a busy machine."""
NOBODY, NAMELESS = 65534, 54321
BROKEN = re.compile(r"Traceback \(most recent call last\)|Reinstalling the application|Aborted|core dumped|\bnan nan\b")
ROS, CLOCK, WINDOW = "ros", "clock", "window"
"""What a program needs: a ROS master, its time, a screen."""
NODE, ALONE = (ROS, CLOCK), ()


@dataclass(frozen=True)
class Program:
    """A program with arguments that let it begin; `{images}` and the like are inputs, see `inputs`."""

    script: str
    arguments: tuple[str, ...] = ()
    needs: tuple[str, ...] = NODE

    @property
    def name(self) -> str:
        package, script = self.script.split("/")
        return f"{package}-{script[:-3]}"

    @property
    def path(self) -> Path:
        package, script = self.script.split("/")
        return next(path for path in ROOT.glob(f"src/**/{package}/scripts/{script}"))


PROGRAMS = [
    Program("apriltag_ros/apriltag_ros_continuous_node.py"),
    Program("apriltag_ros/apriltag_ros_single_image_server_node.py"),
    Program("grasping/collect.py"),
    Program("grasping/collect_shown_grasp.py", ("cup",)),
    Program("grasping/dataset_info.py", ("{images}",), ALONE),
    Program("grasping/depth_images.py", ("{images}/none.bag", "{new}/images"), ALONE),
    Program("grasping/evaluate_grasps.py", ("{new}/results",), ALONE),
    Program("grasping/evaluate_poses.py", ("{new}/results", "{images}/none.pt"), ALONE),
    Program("grasping/evaluate_refinement.py", ("{images}", "{new}/results", "{images}/none.pt"), ALONE),
    Program("grasping/find_grasps.py", ("{images}", "{images}/none.pt"), ALONE),
    Program("grasping/ggcnn.py"),
    Program("grasping/grasp_execution.py"),
    Program("grasping/grasp_picture.py", ("{new}/grasp.png",)),
    Program("grasping/image_viewer.py", (), (*NODE, WINDOW)),
    Program("grasping/import_grasps.py", ("{images}", "{new}/shards"), ALONE),
    Program("grasping/label_grasps.py", ("{images}",), (WINDOW,)),
    Program("grasping/label_poses.py", ("{new}/labels", "--scenes", "1", "--most", "1", "--draws", "1"), ALONE),
    Program("grasping/make_attempts.py", ("{new}/attempts", "{images}/none.pt"), ALONE),
    Program("grasping/make_dataset.py", ("{new}/shards", "--scenes", "1", "--processes", "1"), ALONE),
    Program("grasping/make_episodes.py", ("{new}/episodes", "{images}/none.pt"), ALONE),
    Program("grasping/person_study.py", ("analyse", "{images}/none.csv", "{new}/study"), ALONE),
    Program("grasping/train_ggcnn.py", ("{images}", "{new}/run"), ALONE),
    Program("grasping/train_lifts.py", ("{images}", "{new}/run"), ALONE),
    Program("grasping/train_refinement.py", ("{images}", "{new}/run", "--lifts", "{images}/none.pt"), ALONE),
    Program("kuka_control/gui.py", (), (WINDOW,)),
    Program("kuka_control/move.py", ("home",)),
    Program("kuka_control/ptp_controller.py"),
    Program("kuka_control/real_time_controller.py"),
    Program("kuka_control/simple_controller.py", ("--list",), ALONE),
    Program("kuka_control/teach.py", ("list",), ALONE),
    Program("kuka_control/workspace_plotter.py", ("--samples", "3", "--attitudes", "1"), (WINDOW,)),
    Program("leap_hand/hand_wizard.py", ("somebody",)),
    Program("leap_hand/leap_hand_node.py"),
    Program("leap_kuka/arm_choice_node.py"),
    Program("leap_kuka/leap_kuka_node.py"),
    Program("leap_kuka/operator_input_node.py"),
    Program("leap_motion/leap_driver.py", ("_port:=1",)),
    Program("leap_motion/register_tracker.py", ("desk", "--port", "1"), ALONE),
    Program("leap_motion/visualizer.py"),
    Program("leap_motion/webcam_leapd.py", ("--video", "{images}/none.avi", "--port", "0"), (WINDOW,)),
    Program("leap_rig/cockpit_node.py", ("_port:=0", f"_page:={ROOT}/src/leap_rig/web/cockpit.html")),
    Program("leap_rig/dataset_report.py", ("{images}/none", "--page", "{new}/page.html"), ALONE),
    Program("leap_rig/demo.py", ("--recording", "{images}/none.json",), ALONE),
    Program("leap_rig/export_recording.py", ("--mcap", "{new}/run.mcap", "{images}/none"), ALONE),
    Program("leap_rig/leap_teleop.py"),
    Program("leap_rig/lerobot_server.py"),
    Program("leap_rig/misplaced_arguments.py", ("1",), ALONE),
    Program("leap_rig/operator_view_node.py"),
    Program("leap_rig/record.py", ("run", "--seconds", "1")),
    Program("leap_rig/record_episodes.py", ("run", "--task", "x")),
    Program("leap_rig/relay.py", ("serve", "--port", "0", "--key", "{images}/none", "--page", "cockpit=1"), ALONE),
    Program("leap_rig/replay.py", ("{images}/none", "--view"), ALONE),
    Program("leap_rig/ros2_bridge.py"),
    Program("leap_rig/run_policy.py", ("{images}/none",), ALONE),
    Program("leap_rig/train_policy.py", ("{images}/none", "--out", "{new}/policy.pt"), ALONE),
    Program("leap_rig/tutorial.py"),
    Program("reflex/reflex_takktile_driver.py"),
    Program("rig_simulation/camera_node.py"),
    Program("rig_simulation/camera_truth_node.py"),
    Program("rig_simulation/leapd.py", ("--port", "0", "--control-port", "0"), ALONE),
    Program("rig_simulation/lift_grasps.py", ("{images}/none.json",), ALONE),
    Program("rig_simulation/operator_node.py"),
    Program("rig_simulation/panel_pictures.py", ("--rgb", "{images}/no.yaml", "--depth", "{images}/no.yaml", "{new}/p"),
            ALONE),
    Program("rig_simulation/record.py", ("{new}/film.mp4", "--port", "1", "--wait", "1"), ALONE),
    Program("rig_simulation/reflex_hand.py", ("--port", "0", "--control-port", "0"), ALONE),
    Program("rig_simulation/simulation_node.py"),
    Program("rig_simulation/sunrise_controller.py", ("--port", "0", "--control-port", "0"), ALONE),
    Program("rig_simulation/viewer.py", ("--port", "1", "--wait", "1"), (WINDOW,)),
    Program("rig_simulation/world.py", ("--port", "0", "--control-port", "0", "--hand-port", "0", "--hand-control-port",
            "0", "--world-port", "0"), ALONE),
    Program("vision/calibrate_camera.py", ("--again", "{images}/none.yaml", "--yes")),
    Program("vision/camera_frames_node.py"),
    Program("vision/camera_place_node.py"),
    Program("vision/camera_watchdog_node.py"),
    Program("vision/evaluate_calibration.py", ("--draws", "1"), ALONE),
    Program("vision/evaluate_tag_pose.py", ("--output", "{new}/results", "--pictures", "1"), ALONE),
    Program("vision/plane_pose_node.py"),
    Program("vision/register_arms.py", ("--output", "{new}/arms.yaml", "left={images}", "right={images}"), ALONE),
    Program("vision/register_rgbd_node.py"),
    Program("vision/register_rgbd_start.py", ("--nodelets", "false")),
    Program("vision/stereo_view_node.py", (), (*NODE, WINDOW)),
    Program("vision/stereo_web_node.py"),
    Program("vision/xtion_node.py"),
]  # fmt: skip


@dataclass(frozen=True)
class Surroundings:
    """What surrounds a program.

    Attributes:
        changes: of the environment; `{port}` and the like are what `inputs` has; None removes a variable.
        fails: what a program must need that it cannot work here; empty: all may work.
        says: what the reason then names.
        folder: the current one; one that is not absolute is below a folder of the program, which has the home, too.
        encoding: of the terminal.
    """

    name: str
    changes: dict[str, str | None] = field(default_factory=dict)
    fails: str = ""
    says: str = ""
    folder: str = "home"
    user: int = 0
    encoding: str = "utf-8"


LOCALE = {"LANG": None, "LC_ALL": None, "LC_NUMERIC": None, "LANGUAGE": None}
SCREEN = {"QT_QPA_PLATFORM": None, "DISPLAY": None, "WAYLAND_DISPLAY": None, "XDG_SESSION_TYPE": None}
ALL = [
    Surroundings("namespace", {"ROS_NAMESPACE": "/lab1/left/"}),
    Surroundings("illegal_namespace", {"ROS_NAMESPACE": "lab 1"}, ROS, "lab 1"),
    Surroundings("master_without_scheme", {"ROS_MASTER_URI": "localhost:11311"}, ROS, "ROS_MASTER_URI"),
    Surroundings("master_without_port", {"ROS_MASTER_URI": "http://localhost"}, ROS, "ROS_MASTER_URI"),
    Surroundings("master_with_words", {"ROS_MASTER_URI": "http://localhost:eleven/"}, ROS, "ROS_MASTER_URI"),
    Surroundings("master_empty", {"ROS_MASTER_URI": ""}, ROS, "ROS_MASTER_URI"),
    Surroundings("master_absent", {"ROS_MASTER_URI": "http://127.0.0.1:1"}, ROS, "http://127.0.0.1:1"),
    Surroundings("master_silent", {"ROS_MASTER_URI": "http://127.0.0.1:{silent}"}, ROS, "http://127.0.0.1:"),
    Surroundings("master_foreign", {"ROS_MASTER_URI": "http://127.0.0.1:{web}"}, ROS, "http://127.0.0.1:"),
    Surroundings("master_unresolved", {"ROS_MASTER_URI": "http://no-such.invalid:11311"}, ROS, "no-such.invalid"),
    Surroundings("host_unresolved", {"ROS_HOSTNAME": "no-such.invalid", "ROS_IP": None}, ROS, "ROS_HOSTNAME"),
    Surroundings("ip_elsewhere", {"ROS_HOSTNAME": None, "ROS_IP": "192.0.2.7"}, ROS, "ROS_IP"),
    Surroundings("ip_malformed", {"ROS_HOSTNAME": None, "ROS_IP": "999.1.1.1"}, ROS, "ROS_IP"),
    Surroundings("no_clock", {"ROS_MASTER_URI": "{timeless}"}, CLOCK, "use_sim_time"),
    Surroundings("no_screen", SCREEN, WINDOW, "DISPLAY"),
    Surroundings("dead_screen", {**SCREEN, "DISPLAY": ":77"}, WINDOW, ":77"),
    Surroundings("silent_screen", {**SCREEN, "DISPLAY": "127.0.0.1:{silent_screen}"}, WINDOW, "127.0.0.1:"),
    Surroundings("odd_screen", {**SCREEN, "DISPLAY": "nonsense"}, WINDOW, "nonsense"),
    Surroundings("odd_platform", {**SCREEN, "QT_QPA_PLATFORM": "nonsense"}, WINDOW, "nonsense|DISPLAY"),
    Surroundings("dead_wayland", {**SCREEN, "WAYLAND_DISPLAY": "nosuch"}, WINDOW, "DISPLAY"),
    Surroundings("wayland_platform", {**SCREEN, "WAYLAND_DISPLAY": "nosuch", "QT_QPA_PLATFORM": "wayland"}, WINDOW,
                 "wayland|WAYLAND|DISPLAY"),
    Surroundings("read_only_home", {"HOME": "/proc/no/home", "ROS_HOME": None, "ROS_LOG_DIR": None}, folder="/proc"),
    Surroundings("home_is_a_file", {"HOME": "{file}", "ROS_HOME": None, "ROS_LOG_DIR": None}),
    Surroundings("no_home", {"HOME": None, "ROS_HOME": None, "ROS_LOG_DIR": None}, user=NAMELESS),
    Surroundings("log_folder_is_a_file", {"ROS_LOG_DIR": "{file}"}),
    Surroundings("no_log_folder", {"ROS_LOG_DIR": "/proc/no/log"}),
    Surroundings("new_log_folder", {"ROS_LOG_DIR": "{home}/a/b c/ö"}),
    Surroundings("plain_c", {**LOCALE, "LC_ALL": "C"}),
    Surroundings("absent_locale", {**LOCALE, "LANG": "xx_YY.UTF-8"}),
    Surroundings("decimal_comma", {**LOCALE, "LC_ALL": "de_DE.UTF-8", "LOCPATH": "{locales}"}),
    Surroundings("ascii_terminal", folder="-ä b", encoding="ascii"),
    Surroundings("odd_zone", {"TZ": "no/such zone"}),
    Surroundings("summer_time", {"TZ": "CET-1CEST"}),
    Surroundings("odd_folder", {}, folder="-ä b"),
    Surroundings("deleted_folder", {}, folder="gone"),
    Surroundings("another_user", {"HOME": "{home}"}, user=NOBODY),
]  # fmt: skip


class Silence:
    """Listens on a port and answers with this, or not at all."""

    def __init__(self, answer: bytes = b"", port: int = 0) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port = self._listener.getsockname()[1]
        self._answer, self._open = answer, []
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self._open.append(connection)
            if self._answer:
                connection.recv(4096)
                connection.sendall(self._answer)
                connection.close()

    def close(self) -> None:
        self._listener.close()


def silent_screen() -> tuple[Silence, int]:
    """Returns what listens where an X server of some number would, and the number."""
    for number in range(50, 200):
        try:
            return Silence(port=6000 + number), number
        except OSError:
            continue
    pytest.skip("no port of an X server is free")


@pytest.fixture(scope="module")
def inputs(ros_master) -> Iterator[dict[str, str]]:
    """What the placeholders of programs and surroundings stand for."""
    folder = Path(tempfile.mkdtemp(prefix="surroundings"))  # which every user may read, unlike pytest's
    folder.chmod(0o755)
    silent, web = Silence(), Silence(b"HTTP/1.1 404 Not Found\r\nContent-Length: 2\r\n\r\nno")
    screen, number = silent_screen()
    port = free_port()
    with subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL, cwd=folder) as timeless:  # fmt: skip
        try:
            uri = f"http://127.0.0.1:{port}"
            wait_for_master(uri)
            (folder / "images").mkdir()
            np.save(folder / "images" / "a.npy", np.full((480, 640), 0.7, np.float32))
            (folder / "file").touch()
            (folder / "locales").mkdir()
            subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / "locales" / "de_DE.UTF-8")],
                           check=False, capture_output=True)  # fmt: skip
            yield {
                "root": str(folder), "images": str(folder / "images"), "file": str(folder / "file"),
                "locales": str(folder / "locales"), "silent": str(silent.port), "web": str(web.port),
                "silent_screen": str(number), "timeless": uri,
            }  # fmt: skip
        finally:
            timeless.send_signal(signal.SIGINT)
            for each in (silent, web, screen):
                each.close()
    shutil.rmtree(folder)


def free_port() -> int:
    from simulated.ports import free_port

    return free_port()


def wait_for_master(uri: str) -> None:
    import xmlrpc.client

    from common import clock

    master = xmlrpc.client.ServerProxy(uri)
    while True:
        try:
            master.setParam("/test", "/use_sim_time", True)
            return
        except OSError:
            clock.sleep(0.05)


def job(program: Program, around: Surroundings, inputs: dict[str, str]) -> dict:
    """Returns what forked_programs.py needs."""
    root = Path(inputs["root"])
    own = Path(tempfile.mkdtemp("", f"{around.name} {program.name}{around.folder.strip('/')} ", root))
    own.chmod(0o755)
    (own / "home").mkdir()
    folder = Path(around.folder) if around.folder.startswith("/") else own / around.folder
    folder.mkdir(exist_ok=True)
    (own / "log").touch()
    (own / "log").chmod(0o666)
    writable = around.name not in ("another_user", "no_home", "read_only_home", "home_is_a_file")
    names = {**inputs, "home": str(own / "home"), "new": "." if writable else "/proc/no"}
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("LC_", "LANG", "PYTEST"))}
    environment.update(
        HOME=names["home"], ROS_HOME=names["home"], ROS_LOG_DIR=f"{names['home']}/log", LANG="C.UTF-8",
        QT_QPA_PLATFORM="offscreen", ROS_NAMESPACE=f"of_{program.path.stem}", PYTHONDONTWRITEBYTECODE="1",
    )  # fmt: skip
    for name, value in around.changes.items():
        if value is None:
            environment.pop(name, None)
        else:
            environment[name] = value.format(**names)
    fails = around.fails in program.needs
    return {
        "script": str(program.path), "arguments": [word.format(**names) for word in program.arguments],
        "environment": environment, "folder": str(folder), "log": str(own / "log"),
        "encoding": around.encoding, "user": around.user if os.geteuid() == 0 else 0,
        "seconds": LIMIT_S if fails else WORKS_S,
    }  # fmt: skip


def fault(program: Program, around: Surroundings, code: int | None, said: str) -> str:
    """Returns what is wrong with the end of a program, a clause; empty: nothing."""
    if broken := BROKEN.search(said):
        return f"it said {broken.group()!r}"
    if code is not None and code < 0:
        return f"signal {-code} ended it"
    if around.fails in program.needs:
        if code is None:
            return "it waits for ever"
        if code == 0:
            return "its exit code is 0"
        if not re.search(around.says, said):
            return f"the reason does not name {around.says!r}"
    if code and not said.strip():
        return f"it exited with {code} without a word"
    return ""


def wrong_ends(pairs: list[tuple[Program, Surroundings]], inputs: dict[str, str], *options: str) -> list[str]:
    """Runs the programs and returns what is wrong."""
    jobs = [job(program, around, inputs) for program, around in pairs]
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "forked_programs.py"), *options], input=json.dumps(jobs), text=True,
        stdout=subprocess.PIPE, env={**os.environ, "PYTHONUNBUFFERED": "1"}, check=True,
    )  # fmt: skip
    wrong = []
    for (program, around), each, code in zip(pairs, jobs, json.loads(done.stdout)):
        said = Path(each["log"]).read_text(errors="replace")
        if found := fault(program, around, code, said):
            wrong.append(f"{program.script} in {around.name}: {found} ({code})\n{said[-1500:]}")
        elif os.environ.get("SHOW"):
            print(f"== {program.script} in {around.name} {code}\n{said[-600:]}")
    return wrong


def test_all_programs_are_here():
    scripts = {f"{path.parts[-3]}/{path.name}" for path in ROOT.glob("src/**/scripts/*.py")}
    assert scripts == {program.script for program in PROGRAMS}


@pytest.mark.ros
@pytest.mark.real
def test_each_program_in_one(inputs):
    """In one that it cannot work in, if there is one, such that each surrounding has a program."""
    tried = dict.fromkeys((around.name for around in ALL), 0)
    pairs = []
    for program in PROGRAMS:
        needs = {WINDOW} if WINDOW in program.needs else set(program.needs) or {""}
        fitting = [around for around in ALL if around.fails in needs]
        around = min(fitting, key=lambda around: tried[around.name])
        tried[around.name] += 1
        pairs.append((program, around))
    assert all(tried.values())
    wrong = wrong_ends(pairs, inputs)
    assert not wrong, "\n\n".join(wrong)


@pytest.mark.ros
@pytest.mark.long
@pytest.mark.parametrize("around", ALL, ids=lambda around: around.name)
def test_each_program_in_all(inputs, around):
    wrong = wrong_ends([(program, around) for program in PROGRAMS], inputs, "--bare")
    assert not wrong, "\n\n".join(wrong)
