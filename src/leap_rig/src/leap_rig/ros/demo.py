"""`make demo`: starts the rig, shows its state, stops it in order, and prints a report. The exit code is 0 if the arm
followed, the hand moved and no node died; 1 if not; 2 if the rig did not start.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import rosgraph
import roslaunch
import roslib
import rospkg
from roslaunch.pmon import ProcessListener

from common import clock
from common.errors import RigError
from common.modes import FOLLOWS_TOOL
from common.ros import master
from common.ros.node import check_folder, end_closed_servers, join
from common.ros.service_calls import ServiceFailed, call
from common.screen import has_graphics_card, no_screen
from kuka_msgs.srv import exitApp
from leap_hand.ros.operators import known_file
from leap_rig.report.processor import ProcessorLoad
from leap_rig.report.ros.live_status import CLEAR_LINE, COMPLAINT, LiveStatus

if TYPE_CHECKING:
    from leap_rig.report.ros.listener import RigListener

CONTROLLER, RECORDER, CAMERA = "kuka_real_time_node", "recorder", "camera/"
WINDOWS = ("rviz", "kuka_panel", "cockpit")  # no motion depends on one, and whoever looks on may close it
NO_TRACKER = "none"  # a node of the user's own moves the arm
SCENARIOS = ("pick_cup", "assisted_grasp", "wall", "clutch", "two_hands", "episodes", "policy", "two_cups", "hand_over")
OF_ONE_ARM = {
    "tracker": "leap", "world": "true", "recording": "", "offset": "0 0 0", "rounds": "1", "seed": "0", "policy": "",
    "takes_over": "once",
    "mounting": "",
    "dh_parameters": "", "guard_obstacles": "", "hand_args": "", "camera_device": "0", "video": "", "language": "",
    "camera_fault": "", "camera_rate": "3.0", "web_host": "127.0.0.1",
    "web_port": "8443",
    "web_public": "",
    **dict.fromkeys(
        ("grasping", "camera", "operator_input", "marker_ring", "lift_workspace", "sounds", "tutorial"), "false"
    ),
}  # fmt: skip
"""What demo.launch takes for one arm only, and the only value that it may have with robots:=2."""
RVIZ, BROWSER, NO_VIEW = "rviz", "browser", "none"
VIEWS = (RVIZ, BROWSER, "both", NO_VIEW)
TRACKERS = ("leap", "webcam", "headset", NO_TRACKER)
SCENE, YAML, VIDEO = "scene", ".yaml", "video"
ONE_ARM, TWO_ARMS = ("",), ("left", "right")
"""The namespaces of the arms; an only arm has none."""
OF_TWO_ARMS = ("two_cups", "hand_over")
"""Scenarios for robots:=2; the others are for one arm."""


def parse_arguments(argv: list[str]) -> argparse.Namespace:
    """Returns the arguments of the command line; what follows `--` goes to the launch file."""
    parser = argparse.ArgumentParser(prog="demo.py", description="The whole simulated rig.")
    parser.add_argument("--headless", action="store_true", help="start nothing that needs a screen")
    parser.add_argument("--duration", type=float, metavar="S", help="exit this long after the arm is at home")
    parser.add_argument("--recording", type=Path, metavar="FILE", help="play this recording of Leap frames")
    parser.add_argument("--offset", type=float, nargs=3, metavar=("X", "Y", "Z"), help="shift the recording, mm")
    parser.add_argument("--record", type=Path, metavar="FILE", help="film the simulated world: .mp4, or .png")
    scenarios = f"what the simulated operator does: {' or '.join(SCENARIOS)}"
    parser.add_argument("--scenario", metavar="NAME", help=scenarios)
    parser.add_argument(
        "--tracker",
        choices=TRACKERS,
        help="what sees the hand: the simulated Leap, your webcam, a headset, or none: your own node moves the arm",
    )
    parser.add_argument(
        "--view", choices=VIEWS, help="of the whole rig; by default RViz where a graphics card draws, else the browser"
    )
    parser.add_argument("--tutorial", action="store_true", help="lead a visitor through the first minutes")
    parser.add_argument("--language", choices=("de", "en"), help="of the tutorial; by default as LANG says")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the summary there as JSON")
    parser.add_argument("launch", nargs="*", metavar="NAME:=VALUE", help="arguments of demo.launch")
    arguments = parser.parse_args(argv)
    if arguments.recording is not None and not arguments.recording.is_file():
        parser.error(f"the recording {arguments.recording} is not a file")
    if arguments.record is not None and arguments.record.suffix not in (".mp4", ".png"):
        parser.error(f"the film {arguments.record} must end with .mp4, or with .png for a sheet of pictures")
    for file in (arguments.record, arguments.report):
        if file is not None and not file.resolve().parent.is_dir():
            parser.error(f"{file} cannot be written: the folder {file.resolve().parent} does not exist")
        if file is not None and file.is_dir():
            parser.error(f"{file} cannot be written: it is a folder")
    if arguments.duration is not None and not 0.0 < arguments.duration < 1e6:
        parser.error(f"the duration {arguments.duration} must be a positive number of seconds")
    for item in (item for item in arguments.launch if ":=" not in item):
        parser.error(f"{item!r} is not of the form name:=value")
    if "sim:=false" in [item.lower() for item in arguments.launch]:
        parser.error("the demo is the simulated rig; the real one is started by `roslaunch leap_rig demo sim:=false`")
    given = _given(arguments)
    scenario, scene = given.get("scenario"), Path(given.get(SCENE, ""))
    if arguments.offset is not None and not given.get("recording"):
        parser.error("the offset shifts a recording, and none is given")
    if arguments.offset is not None and not all(map(math.isfinite, arguments.offset)):
        parser.error(f"the offset {' '.join(map(str, arguments.offset))} must be three finite numbers")
    if scenario and scenario not in SCENARIOS:
        parser.error(f"there is no scenario {scenario!r}; known are {' and '.join(SCENARIOS)}")
    if scenario and arguments.tutorial:
        parser.error(f"the scenario {scenario} and the tutorial exclude each other: each of them leads the operator")
    if scenario and given.get("recording"):
        parser.error(f"the scenario {scenario} and a recording exclude each other: each of them moves the hand")
    tracker = given.get("tracker", "leap")
    if tracker not in TRACKERS:
        parser.error(f"there is no tracker {tracker!r}; known are {' and '.join(TRACKERS)}")
    if tracker == NO_TRACKER and (scenario or given.get("recording") or arguments.tutorial):
        parser.error("without a tracker no hand is seen, but a scenario, recording or tutorial needs one")
    if tracker != "leap" and (scenario or given.get("recording")):
        parser.error(f"the tracker {tracker} sees your own hand; a scenario or recording moves the simulated one")
    for fault in _faults_of_two_arms(given):
        parser.error(fault)
    if given.get(VIDEO) and not Path(given[VIDEO]).is_file():
        parser.error(f"the video {given[VIDEO]} is not a file")
    if scene.suffix == YAML and not scene.is_file():
        parser.error(f"the scene {scene} is not a file")
    if given.get("operator"):
        try:
            known_file(given["operator"])
        except RigError as error:
            parser.error(str(error))
    return arguments


def _given(arguments: argparse.Namespace) -> dict[str, str]:
    """Returns the arguments of the launch file by their names; a later one wins, as in roslaunch."""
    return dict(item.split(":=", 1) for item in launch_arguments(arguments, screen=False))


def _faults_of_two_arms(given: Mapping[str, str]) -> list[str]:
    robots, scenario = given.get("robots", "1"), given.get("scenario", "")
    if robots not in ("1", "2"):
        return [f"robots is {robots!r}, but must be 1 or 2"]
    if robots == "1":
        return [f"the scenario {scenario} needs two arms: robots:=2"] if scenario in OF_TWO_ARMS else []
    if scenario and scenario not in OF_TWO_ARMS:
        return [f"the scenario {scenario} is for one arm; for two arms there is {' and '.join(OF_TWO_ARMS)}"]
    return [
        f"robots:=2 does not go with {name}:={given[name]}"
        for name, value in OF_ONE_ARM.items()
        if given.get(name, value).lower() != value
    ]


def launch_arguments(arguments: argparse.Namespace, screen: bool, view: str = NO_VIEW) -> list[str]:
    """Returns the arguments of demo.launch; a scene's file has its absolute path, as nodes run in another folder."""
    launch = [f"view:={view}", f"gui:={str(screen).lower()}", "one_process:=true"]
    if arguments.recording is not None:
        launch.append(f"recording:={arguments.recording.resolve()}")
    if arguments.offset is not None:
        launch.append("offset:={} {} {}".format(*arguments.offset))
    if arguments.record is not None:
        launch.append(f"record:={arguments.record.resolve()}")
    if arguments.scenario is not None:
        launch.append(f"scenario:={arguments.scenario}")
    if arguments.tracker is not None:
        launch.append(f"tracker:={arguments.tracker}")
    if arguments.tutorial:
        launch.append("tutorial:=true")
    if arguments.language is not None:
        launch.append(f"language:={arguments.language}")
    for item in arguments.launch:
        name, _, value = item.partition(":=")
        is_file = (name == SCENE and value.endswith(YAML)) or (name == VIDEO and value)
        launch.append(f"{name}:={Path(value).resolve()}" if is_file else item)
    return launch


class Deaths(ProcessListener):
    """Records the processes that exit during the run: `sentences` about the nodes that the rig needs, `remarks` about
    the others. Nodes in `expected` may exit; `ended` are all that exited. Names are those in the demo's namespace."""

    def __init__(self) -> None:
        self._namespace = rosgraph.names.get_ros_namespace()[1:]
        self.sentences: list[str] = []
        self.remarks: list[str] = []
        self.expected = {"viewer"}
        self.ended: set[str] = set()

    def take_early(self, monitor) -> None:
        """Adds the processes that exited before roslaunch had its listeners."""
        for name, _ in monitor.get_process_names_with_spawn_count()[1]:
            self.process_died(name, None)

    def process_died(self, process_name: str, exit_code: int | None) -> None:
        """Adds a process; called by roslaunch."""
        node = process_name.rsplit("-", 1)[0]
        node = node[len(self._namespace) :] if node.startswith(self._namespace) else node
        self.ended.add(node)
        if node in self.expected:
            return
        how = "while the rig started" if exit_code is None else f"with exit code {exit_code}"
        if node == RECORDER:
            self.remarks.append(f"The film is incomplete: {node} ended {how}.")
        elif node.startswith(CAMERA):
            self.remarks.append(f"The rig continued without its camera: {node} ended {how}.")
        elif node in WINDOWS:
            self.remarks.append(f"The rig continued without a window: {node} ended {how}.")
        else:
            self.sentences.append(f"{node} ended {how}")


def refuse_second_rig() -> None:
    """Raises RigError if a rig runs on this master: nodes of the same name would end each other."""
    if not rosgraph.is_master_online():
        return
    publishers, subscribers, services = rosgraph.Master("/demo").getSystemState()
    nodes = {node for _, names in publishers + subscribers + services for node in names}
    if any(node.split("/")[-1] == CONTROLLER for node in nodes):
        raise RigError(f"A rig already runs on {rosgraph.get_master_uri()}. Stop it first: Ctrl-C in its terminal.")


def has_screen(arguments: argparse.Namespace) -> bool:
    """Returns whether windows can be opened, and says so if they are wanted and cannot."""
    if arguments.headless:
        return False
    fault = no_screen()
    if fault:
        print(f"{fault[0].upper()}{fault[1:]}: RViz and the control panel are not started.")
    return not fault


def view_of(arguments: argparse.Namespace, screen: bool) -> str:
    """Returns where the rig is shown: as was asked, else RViz if a graphics card draws it, else a page."""
    if arguments.view is not None:
        return arguments.view
    if arguments.headless:
        return NO_VIEW
    return RVIZ if screen and has_graphics_card() else BROWSER


def refuse_without_logs() -> None:
    """Raises RigError if the logs find no place: ROS' own programs print tracebacks then, and some of them end."""
    least_free = 20_000_000  # for the logs of a short run [bytes]
    folder = master.check_log_folder()
    free = shutil.disk_usage(folder).free
    if free < least_free:
        left = f"{free / 1e6:.0f} MB left"
        raise RigError(f"The folder of the logs {folder} has {left}: free some, as by `rosclean purge`.")


def end_in_order(deaths: Deaths, arms: Sequence[str] = ONE_ARM) -> None:
    """Sends all arms to their zero position and waits for the controllers to end."""
    exit_timeout_s = 60.0
    waiting = []
    for of in [f"{arm}/" if arm else "" for arm in arms]:
        controller = of + CONTROLLER
        deaths.expected.add(controller)
        try:
            call(f"{of}kuka/exit_app", exitApp, timeout=exit_timeout_s)
        except ServiceFailed as error:
            deaths.sentences.append(f"{controller} did not accept the request to exit: {error}")
        else:
            waiting.append(controller)
    deadline = clock.monotonic() + exit_timeout_s
    while not deaths.ended.issuperset(waiting) and clock.monotonic() < deadline:
        clock.sleep(0.1)
    for controller in waiting:
        if controller not in deaths.ended:
            deaths.sentences.append(f"{controller} did not end within {exit_timeout_s:.0f} s after exit_app")


class Interrupts:
    """Turns Ctrl-C, a closed terminal and SIGTERM into KeyboardInterrupt, but not while nodes start or stop. Without
    this, roslaunch would stop the nodes and swallow the interrupt, and the demo would continue without a rig. In the
    background, where a shell ignores SIGINT, Python would raise nothing. An interrupt between the start of a process
    and roslaunch's record of it would leave the process behind, so interrupts wait until `heed` is called."""

    def __init__(self) -> None:
        self._came, self._waits = False, True
        roslib.set_interactive(True)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._interrupt)

    def _interrupt(self, _signal, _frame) -> None:
        self._came = True
        if not self._waits:
            self._waits = True  # the first one stops the rig; another one would only cut off the report
            raise KeyboardInterrupt

    def heed(self) -> None:
        """Raises KeyboardInterrupt if an interrupt waits; else the next one is raised at once."""
        self._waits = self._came
        if self._came:
            raise KeyboardInterrupt

    def ignore(self) -> None:
        """Ignores further interrupts: a second Ctrl-C while the nodes stop would leave some of them behind."""
        self._waits = True


def run(arguments: argparse.Namespace) -> int:
    tutorial_s = 120.0  # longest time of a tutorial that the simulated operator plays
    master.check_surroundings()
    refuse_second_rig()
    refuse_without_logs()
    screen = has_screen(arguments)
    launch_file = Path(rospkg.RosPack().get_path("leap_rig")) / "launch" / "demo.launch"
    deaths = Deaths()
    os.environ["ROSCONSOLE_FORMAT"] = (CLEAR_LINE if sys.stdout.isatty() else "") + COMPLAINT
    uuid = roslaunch.rlutil.get_or_generate_uuid(None, False)
    files = [(str(launch_file), launch_arguments(arguments, screen, view_of(arguments, screen)))]
    options = {"process_listeners": [deaths], "show_summary": False, "force_log": True, "sigint_timeout": 5.0}
    parent = roslaunch.parent.ROSLaunchParent(uuid, files, **options)
    interrupts, status = Interrupts(), LiveStatus()
    print("Starting the rig. Ctrl-C stops it. ROS tools work in a second terminal after `source devel/setup.bash`.")
    try:
        parent.start(auto_terminate=False)
        interrupts.heed()
        deaths.take_early(parent.pm)
        # Imported while the nodes start, which would wait for them otherwise.
        from leap_rig.report.recorder import Recorder
        from leap_rig.report.report import TUTORIAL
        from leap_rig.report.report_of_arms import as_text, summarise
        from leap_rig.report.ros.listener import RigListener

        join("demo", argv=[])  # name:=value is for the launch file
        arms = TWO_ARMS if _given(arguments).get("robots") == "2" else ONE_ARM
        teleoperated = _given(arguments).get("tracker") != NO_TRACKER
        recorders = {arm: Recorder(teleoperated) for arm in arms}
        if arguments.tutorial:  # until its node reports
            recorders[""].set_scenario({"scenario": TUTORIAL, "step": "begin", "failure": ""})
        listeners = {arm: RigListener(recorder, arm) for arm, recorder in recorders.items()}
        limit = tutorial_s if arguments.tutorial and not screen else None
        ended = wait_for_end(listeners, deaths, status, arguments.duration or limit, arguments.tutorial and screen)
        for listener in listeners.values():
            listener.stop()
        summary_time = clock.monotonic()
        if ended in ("duration", "scenario"):
            why = "The time is up" if ended == "duration" else "The scenario is over"
            what = "the arm goes" if len(arms) == 1 else "the arms go"
            status.say(f"{why}: {what} to the zero position.")
            end_in_order(deaths, arms)
    finally:
        interrupts.ignore()
        with contextlib.suppress(OSError):  # the terminal may be closed
            status.finish()
        parent.shutdown()
    summary = summarise(recorders, summary_time, deaths.sentences, deaths.remarks)
    print(as_text(summary))
    if arguments.report is not None:
        try:
            arguments.report.write_text(json.dumps(summary, indent=2) + "\n")
        except OSError as error:
            raise RigError(f"The report could not be written to {arguments.report}: {error.strerror}.") from error
    return 1 if summary["faults"] else 0


def wait_for_end(
    listeners: Mapping[str, RigListener], deaths: Deaths, status: LiveStatus, duration: float | None, visitor: bool
) -> str:
    """Shows the state until the run ends; returns "duration", "scenario", "death" (of a node) or "interrupt". A
    `visitor` may stay when the tutorial is over. Raises RigError if an arm is not at home after 90 s."""
    ready_timeout_s = 90.0
    from leap_rig.report.report import TUTORIAL  # as late as in `run`

    first = next(iter(listeners.values()))
    try:
        deadline = clock.monotonic() + ready_timeout_s
        while late := [arm for arm, listener in listeners.items() if listener.mode not in FOLLOWS_TOOL]:
            if deaths.sentences:
                return "death"
            if clock.monotonic() > deadline:
                which = f"The arm {' and '.join(late)}".rstrip()
                raise RigError(f"{which} did not reach its home position within {ready_timeout_s:.0f} s.")
            status.update(listeners, "starting")
            clock.sleep(0.1)
        begin = clock.monotonic()
        status.say(f"Ready after {begin - status.started:.1f} s.")
        for listener in listeners.values():
            listener.recorder.start(begin)
        processor = ProcessorLoad()
        while not deaths.sentences:
            now = clock.monotonic()
            elapsed, load = now - begin, processor.sample(now)
            if load is not None:
                for listener in listeners.values():
                    listener.recorder.loads.append((now, load))
            if duration is not None and elapsed >= duration:
                return "duration"
            while first.sentences:
                status.say(first.sentences.popleft())
            tutorial = (first.recorder.scenario or {}).get("scenario") == TUTORIAL
            if all(listener.recorder.scenario_over for listener in listeners.values()) and (
                not visitor if tutorial else duration is None
            ):
                return "scenario"
            status.update(listeners, f"{elapsed:.0f} s")
            clock.sleep(0.1)
        return "death"
    except KeyboardInterrupt:
        return "interrupt"


def main() -> None:
    end_closed_servers()
    try:
        check_folder()
        sys.exit(run(parse_arguments(sys.argv[1:])))
    except KeyboardInterrupt:
        print("demo: interrupted", file=sys.stderr)
    except (RigError, roslaunch.RLException, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
    sys.exit(2)
