"""`make demo`: starts the rig, shows live what it does, ends it in order, and reports.

The exit code is 0 if the arm followed, the hand moved and no node died; 1 if not; 2 if the rig could not be started.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import time
from pathlib import Path

import rosgraph
import roslaunch
import roslib
import rospkg
import rospy
from roslaunch.pmon import ProcessListener

from common.errors import RigError
from common.ros.service_calls import ServiceFailed, call
from kuka_msgs.srv import exitApp
from leap_rig.recorder import Recorder
from leap_rig.report import as_text, summarise
from leap_rig.ros.listener import RigListener
from leap_rig.ros.live_status import CLEAR_LINE, COMPLAINT, LiveStatus

CONTROLLER, RECORDER, CAMERA = "kuka_real_time_node", "recorder", "camera/"
READY_TIMEOUT_S = 90.0
EXIT_TIMEOUT_S = 60.0
AT_HOME_OR_LATER = ("home", "pick_up", "servo")
SCENARIOS = ("pick_cup", "assisted_grasp")
SCENE, YAML = "scene", ".yaml"


def parse_arguments(argv: list[str]) -> argparse.Namespace:
    """Returns the arguments of the command line; what follows `--` goes to the launch file."""
    parser = argparse.ArgumentParser(prog="demo.py", description="The whole simulated rig.")
    parser.add_argument("--headless", action="store_true", help="start nothing that needs a screen")
    parser.add_argument("--duration", type=float, metavar="S", help="end by itself so long after the arm is at home")
    parser.add_argument("--recording", type=Path, metavar="FILE", help="play this recording of Leap frames")
    parser.add_argument("--offset", type=float, nargs=3, metavar=("X", "Y", "Z"), help="shift the recording, mm")
    parser.add_argument("--record", type=Path, metavar="FILE", help="film the simulated world: .mp4, or .png")
    parser.add_argument("--scenario", metavar="NAME", help=f"what the simulated person does: {' or '.join(SCENARIOS)}")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the summary there as JSON")
    parser.add_argument("launch", nargs="*", metavar="NAME:=VALUE", help="arguments of demo.launch")
    arguments = parser.parse_args(argv)
    if arguments.recording is not None and not arguments.recording.is_file():
        parser.error(f"the recording {arguments.recording} is not a file")
    if arguments.record is not None and arguments.record.suffix not in (".mp4", ".png"):
        parser.error(f"the film {arguments.record} must end with .mp4, or with .png for a sheet of pictures")
    for file in (arguments.record, arguments.report):
        if file is not None and not file.resolve().parent.is_dir():
            parser.error(f"{file} cannot be written: there is no folder {file.resolve().parent}")
    if arguments.duration is not None and not 0.0 < arguments.duration < 1e6:
        parser.error(f"the duration {arguments.duration} must be a positive number of seconds")
    for item in arguments.launch:
        if ":=" not in item:
            parser.error(f"{item!r} is not of the form name:=value")
    if "sim:=false" in [item.lower() for item in arguments.launch]:
        parser.error("the demo is the simulated rig; the real one is started by `roslaunch leap_rig demo sim:=false`")
    given = _given(arguments)
    scenario, scene = given.get("scenario"), Path(given.get(SCENE, ""))
    if scenario and scenario not in SCENARIOS:
        parser.error(f"there is no scenario {scenario!r}; known are {' and '.join(SCENARIOS)}")
    if scenario and given.get("recording"):
        parser.error(f"the scenario {scenario} and a recording exclude each other: either is what the hand does")
    if scene.suffix == YAML and not scene.is_file():
        parser.error(f"the scene {scene} is not a file")
    return arguments


def _given(arguments: argparse.Namespace) -> dict[str, str]:
    """Returns what the arguments mean for the launch file; a later one wins, as there."""
    return dict(item.split(":=", 1) for item in launch_arguments(arguments, screen=False))


def launch_arguments(arguments: argparse.Namespace, screen: bool) -> list[str]:
    """Returns what demo.launch is given."""
    launch = [f"rviz:={str(screen).lower()}", f"gui:={str(screen).lower()}"]
    if arguments.recording is not None:
        launch.append(f"recording:={arguments.recording.resolve()}")
    if arguments.offset is not None:
        launch.append("offset:={} {} {}".format(*arguments.offset))
    if arguments.record is not None:
        launch.append(f"record:={arguments.record.resolve()}")
    if arguments.scenario is not None:
        launch.append(f"scenario:={arguments.scenario}")
    return launch + [_with_whole_path(item) for item in arguments.launch]


def _with_whole_path(item: str) -> str:
    """Returns an argument of the launch file; a scene's file by its absolute path, as nodes run in another folder."""
    name, _, value = item.partition(":=")
    return f"{name}:={Path(value).resolve()}" if name == SCENE and value.endswith(YAML) else item


class Deaths(ProcessListener):
    """Names the processes that ended without being asked to.

    Attributes:
        sentences: of those that the rig needs.
        remarks: of those that it can do without.
        expected: names of those whose end is nothing to speak of.
        ended: names of all.
    """

    def __init__(self) -> None:
        self.sentences: list[str] = []
        self.remarks: list[str] = []
        self.expected = {"viewer"}
        self.ended: set[str] = set()

    def take_early(self, monitor) -> None:
        """Takes the processes that ended before roslaunch told its listeners."""
        for name, _ in monitor.get_process_names_with_spawn_count()[1]:
            self.process_died(name, None)

    def process_died(self, process_name: str, exit_code: int | None) -> None:
        """Called by roslaunch: a process ended."""
        node = process_name.rsplit("-", 1)[0]
        self.ended.add(node)
        if node in self.expected:
            return
        how = "while the rig started" if exit_code is None else f"with exit code {exit_code}"
        if node == RECORDER:
            self.remarks.append(f"The film was not taken to the end: {node} ended {how}.")
        elif node.startswith(CAMERA):
            self.remarks.append(f"The rig went on without its camera: {node} ended {how}.")
        else:
            self.sentences.append(f"{node} ended {how}")


def refuse_second_rig() -> None:
    """Refuses to start where a rig runs already: nodes of the same name would end each other.

    Raises:
        RigError: the master knows a controller.
    """
    if not rosgraph.is_master_online():
        return
    publishers, subscribers, services = rosgraph.Master("/demo").getSystemState()
    nodes = {node for _, names in publishers + subscribers + services for node in names}
    if f"/{CONTROLLER}" in nodes:
        raise RigError(f"A rig runs already on {os.environ['ROS_MASTER_URI']}: end it first (Ctrl-C in its terminal).")


def wait_until_ready(listener: RigListener, deaths: Deaths, show: LiveStatus) -> bool:
    """Waits until the arm is at home; returns False if a node died instead.

    Raises:
        RigError: it took too long.
    """
    deadline = time.monotonic() + READY_TIMEOUT_S
    while listener.mode not in AT_HOME_OR_LATER:
        if deaths.sentences:
            return False
        if time.monotonic() > deadline:
            raise RigError(f"The arm did not reach its home position within {READY_TIMEOUT_S:.0f} s.")
        show.update(listener, "starting")
        time.sleep(0.1)
    return True


def end_in_order(deaths: Deaths) -> None:
    """Sends the arm to its zero position and waits for the controller to end."""
    deaths.expected.add(CONTROLLER)
    try:
        call("kuka/exit_app", exitApp, timeout=EXIT_TIMEOUT_S)
    except ServiceFailed as error:
        print(f"The controller did not take the request to exit: {error}.")
        return
    deadline = time.monotonic() + EXIT_TIMEOUT_S
    while CONTROLLER not in deaths.ended and time.monotonic() < deadline:
        time.sleep(0.1)
    if CONTROLLER not in deaths.ended:
        deaths.sentences.append(f"{CONTROLLER} did not end within {EXIT_TIMEOUT_S:.0f} s after exit_app")


class Interrupts:
    """Turns Ctrl-C, a closed terminal and SIGTERM into KeyboardInterrupt, but not while nodes are started or ended.

    Left to itself roslaunch would end the nodes and swallow the interrupt, and the demo would go on without a rig; and
    Python raises none in the background, where a shell has SIGINT ignored. One between the start of a process and
    roslaunch's note of it would leave that process behind, so until `heed` is called it only waits.
    """

    def __init__(self) -> None:
        self._came, self._waits = False, True
        roslib.set_interactive(True)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._interrupt)

    def _interrupt(self, _signal, _frame) -> None:
        self._came = True
        if not self._waits:
            raise KeyboardInterrupt

    def heed(self) -> None:
        """Raises KeyboardInterrupt if there was one already, and from now on at once."""
        self._waits = False
        if self._came:
            raise KeyboardInterrupt

    def ignore(self) -> None:
        """Lets no further one disturb: a second Ctrl-C while the nodes end would leave some of them behind."""
        self._waits = True


def run(arguments: argparse.Namespace) -> int:
    """Runs the demo and returns its exit code."""
    refuse_second_rig()
    screen = not arguments.headless and bool(os.environ.get("DISPLAY"))
    if not arguments.headless and not screen:
        print("No screen found (DISPLAY is not set), so RViz and the panel are left out.")
    launch_file = Path(rospkg.RosPack().get_path("leap_rig")) / "launch" / "demo.launch"
    deaths = Deaths()
    os.environ["ROSCONSOLE_FORMAT"] = (CLEAR_LINE if sys.stdout.isatty() else "") + COMPLAINT
    uuid = roslaunch.rlutil.get_or_generate_uuid(None, False)
    parent = roslaunch.parent.ROSLaunchParent(
        uuid,
        [(str(launch_file), launch_arguments(arguments, screen))],
        process_listeners=[deaths],
        show_summary=False,
        force_log=True,
        sigint_timeout=5.0,
    )
    interrupts = Interrupts()
    recorder = Recorder()
    status = LiveStatus()
    print(
        "Starting the rig. Ctrl-C ends it; in a second terminal, after `source devel/setup.bash`, all ROS tools work."
    )
    try:
        parent.start(auto_terminate=False)
        interrupts.heed()
        deaths.take_early(parent.pm)
        rospy.init_node("demo", argv=[], disable_signals=True)  # name:=value is for the launch file
        listener = RigListener(recorder)
        ended = wait_for_end(listener, deaths, status, arguments.duration)
        listener.stop()
        summary_time = time.monotonic()
        if ended in ("duration", "scenario"):
            why = "The time is up" if ended == "duration" else "The scenario is over"
            status.say(f"{why}: the arm goes to the zero position.")
            end_in_order(deaths)
    finally:
        interrupts.ignore()
        with contextlib.suppress(OSError):  # the terminal may be closed
            status.finish()
        parent.shutdown()
    summary = summarise(recorder, summary_time, deaths.sentences, deaths.remarks)
    print(as_text(summary))
    if arguments.report is not None:
        try:
            arguments.report.write_text(json.dumps(summary, indent=2) + "\n")
        except OSError as error:
            raise RigError(f"The report could not be written to {arguments.report}: {error.strerror}.") from error
    return 1 if summary["faults"] else 0


def wait_for_end(listener: RigListener, deaths: Deaths, status: LiveStatus, duration: float | None) -> str:
    """Shows the rig until it ends; returns why.

    That is "duration", "scenario" (over, or given up), "death" of a node, or "person" (Ctrl-C).
    """
    try:
        if not wait_until_ready(listener, deaths, status):
            return "death"
        begin = time.monotonic()
        listener.recorder.start(begin)
        while not deaths.sentences:
            elapsed = time.monotonic() - begin
            if duration is not None and elapsed >= duration:
                return "duration"
            if duration is None and listener.recorder.scenario_over:
                return "scenario"
            status.update(listener, f"{elapsed:.0f} s")
            time.sleep(0.1)
        return "death"
    except KeyboardInterrupt:
        return "person"


def main() -> None:
    """Runs the demo with the arguments of the command line."""
    arguments = parse_arguments(sys.argv[1:])
    try:
        code = run(arguments)
    except KeyboardInterrupt:
        print("demo: interrupted", file=sys.stderr)
        code = 2
    except (RigError, roslaunch.RLException, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        code = 2
    sys.exit(code)
