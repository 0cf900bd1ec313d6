"""The node cockpit: serves the page that shows the whole rig and commands it. It subscribes only while a page is open;
what the operator holds on the page goes out on leap_kuka/operator_input, where silence is a release."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from time import strftime
from typing import Any

import cv2
import numpy as np
import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String

from common import clock
from common.errors import DeviceError
from common.ros.images import colour_from_image
from common.ros.node import repeat
from common.ros.on_demand import OnDemand
from common.ros.params import private_config
from common.ros.raw_tf import publisher_of
from common.ros.sentence_writer import SentenceWriter
from common.ros.service_calls import MasterLost, ServiceFailed, ask_master, call, master_answers
from kuka_control.ros.controller_link import CALL_TIMEOUT_S, ControllerLink, PanelUpdate
from leap_hand.ros.operators import known_names
from leap_kuka.arm_choice import BOTH
from leap_kuka.config import DEVICE, NONE, SERVICE
from leap_kuka.numbers import LEFT_S
from leap_kuka.ros.arm_choice_node import CHOSEN_ARM
from leap_motion.service.access import is_loopback
from leap_motion.service.certificate import CertificateError, own_certificate
from leap_rig.cockpit.control import FRESH_S, DeviceReports, HeldSwitches
from leap_rig.cockpit.messages import (
    CHOOSE,
    CONTROL,
    EXIT,
    GRIPPER,
    GUIDE,
    MARK,
    OPERATOR,
    PAUSE,
    POLICY,
    RECORD,
    SCALING,
    TUTORIAL,
    PageCommand,
)
from leap_rig.cockpit.ros.scene_feed import SceneFeed
from leap_rig.cockpit.scene import SceneServer
from leap_rig.cockpit.server import CockpitServer, ScenePage
from leap_rig.cockpit.settings import CockpitConfig
from leap_rig.recording.topics import EPISODE_MARK
from rig_msgs.msg import OperatorInput
from rig_msgs.srv import ChooseArm, ChooseOperator
from vision.stereo import webrtc
from vision.stereo.transport import JPEG, Picture

PERIOD_S = 0.05
STATE_PERIOD_S = FOLLOW_S = 0.2
IMAGE = "rgb/image_raw"
SOURCE = "cockpit"


class ChildProgram:
    """A program of this package that the cockpit starts and ends; `line` is what it wrote last."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self._ending = False
        self.line = ""
        self.ended: clock.SimpleQueue[int] = clock.SimpleQueue()  # exit codes

    @property
    def runs(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def start(self, name: str, *arguments: str) -> None:
        """Starts the program beside this one; rosrun would search for it. Raises OSError."""
        self._ending, self.line = False, ""
        self._process = subprocess.Popen(
            (str(Path(sys.argv[0]).with_name(name)), *arguments),
            **{"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True},
        )
        clock.Thread(target=self._read, args=(self._process,), name=name, daemon=True).start()

    def stop(self) -> None:
        """Asks it to end, once it has written a line: it handles that then, and completes what it has."""
        self._ending = True
        if self._process is not None and self.runs and self.line:
            self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """Ends it, and gives it a moment to complete what it has."""
        patience_s = 3.0
        if self._process is not None and self.runs:
            self._process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(patience_s)

    def _read(self, process: subprocess.Popen) -> None:
        for line in process.stdout or ():
            first, self.line = not self.line, line.strip() or self.line
            if first and self.line and self._ending:
                self.stop()
        self.ended.put(process.wait())


def _ask(
    answers: clock.SimpleQueue[tuple[bool, str]],
    service: str,
    kind: Any,
    name: str,
    taken: Callable[[], None] = lambda: None,
) -> None:
    """Calls a service with a name in a thread of its own, `taken` if it succeeds; the answer goes into the queue."""

    def ask() -> None:
        try:
            answer = call(service, kind, name, timeout=CALL_TIMEOUT_S)
        except ServiceFailed as error:
            answers.put((False, f"Not confirmed: {error}."))
            return
        if answer.success:
            taken()
        answers.put((answer.success, answer.message))

    clock.Thread(target=ask, name=service, daemon=True).start()


class ArmLink:
    """One arm: the link to its controller, and the operator's switches of the page."""

    def __init__(self, arm: str) -> None:
        self._of = f"{arm}/" if arm else ""
        self.link = ControllerLink(arm, rows=False)  # all the time: a stop needs to know the controller before it hangs
        topic = f"{self._of}leap_kuka/operator_input"
        self._publisher = rospy.Publisher(topic, OperatorInput, queue_size=10, tcp_nodelay=True)
        self._listen = OnDemand(
            lambda: [rospy.Subscriber(topic, OperatorInput, self._take_input, queue_size=10, tcp_nodelay=True)]
        )
        self._reports = DeviceReports()
        self._other, self._other_at = "", -math.inf  # a program that reports the operator's device, and when
        self._leap: dict[str, Any] = {}
        self.chosen_by_service = False  # whether a request chooses which arm the hand steers
        self._operator, self._operators = "", [""]
        self.answers: clock.SimpleQueue[tuple[bool, str]] = clock.SimpleQueue()

    def watch(self, watched: bool) -> None:
        """Listens while somebody watches; raises MasterLost."""
        self.link.watch_rows(watched)
        if watched:
            leap = self._parameter("leap")
            leap = leap if isinstance(leap, dict) else {}
            self._leap = {name: leap.get(name, NONE) for name in ("engagement", "enabling", "clutch")}
            self.chosen_by_service = leap.get("arm_choice") == SERVICE
            self._operator = str(self._parameter("leap_hand_node/operator") or "")
            with contextlib.suppress(OSError):  # the folder cannot be read
                self._operators = ["", *known_names()]
        self._listen(watched and DEVICE in self._leap.values())

    def _parameter(self, name: str) -> Any:
        return ask_master("getParam", rospy.resolve_name(self._of + name))

    def _take_input(self, message: OperatorInput) -> None:
        program = publisher_of(message)
        if program != rospy.get_name():
            self._other, self._other_at = program, clock.monotonic()

    @property
    def _device(self) -> str:
        """The other program that reports the operator's device, or an empty text. All programs that report must enable,
        and any of them clutches. So the page reports nothing beside a pedal, which would lose its effect."""
        return self._other if clock.monotonic() - self._other_at <= LEFT_S else ""

    def hold(self, held: HeldSwitches, live: bool) -> None:
        """Reports what the page holds, where a device enables or clutches and no other program reports one."""
        if DEVICE not in self._leap.values() or self._device:
            return
        if self._reports.due(held.enable, held.clutch, live, clock.monotonic()):
            header = Header(0, rospy.Time.now(), "")
            self._publisher.publish(OperatorInput(header, SOURCE, held.enable, held.clutch))

    def ask_operator(self, name: str) -> None:
        """Asks leap_hand for another person's mapping, in a thread of its own."""

        def taken() -> None:
            self._operator = name

        _ask(self.answers, f"{self._of}leap_hand/choose_operator", ChooseOperator, name, taken)

    def shown(self, update: PanelUpdate, held: HeldSwitches) -> dict[str, Any]:
        """Returns what the page shows of the arm."""
        return {
            **vars(update.state),
            "tone": update.state.tone.value,
            "age": update.status_age,
            "rows": [{**vars(row), "tone": row.tone.value} for row in update.rows],
            "leap": self._leap,
            "device": self._device,
            "held": {"enable": held.enable, "clutch": held.clutch, "stuck": held.stuck},
            "operator": self._operator,
            "operators": self._operators,
        }


class Cockpit:
    """Connects the server with the rig."""

    def __init__(self, config: CockpitConfig) -> None:
        names = tuple(config.arms.split()) or ("",)
        self._arms = {arm: ArmLink(arm) for arm in names}
        self._scene = SceneServer(len(names))
        self._feed = SceneFeed(self._scene, names)
        self._commands: clock.SimpleQueue[tuple[float, PageCommand]] = clock.SimpleQueue()  # and when it came
        self._recorder, self._tutor = ChildProgram(), ChildProgram()
        self._recording, self._tutorial, self._number = "", "", 0
        self._chosen, self._chooses = "", False  # the arm that the hand steers, and whether a node chooses
        self._choices: clock.SimpleQueue[tuple[bool, str]] = clock.SimpleQueue()  # what became of requests for another
        self._answers: dict[str, dict[str, Any]] = {}  # the newest of each arm, and of none
        self._marks = rospy.Publisher(EPISODE_MARK, String, queue_size=10)
        self._listen = OnDemand(
            lambda: [rospy.Subscriber("leap_rig/tutorial", DiagnosticStatus, self._take_tutorial, queue_size=5)]
        )
        self._choice = OnDemand(lambda: [rospy.Subscriber(CHOSEN_ARM, String, self._take_choice, queue_size=5)])
        self._looks = {camera: OnDemand(functools.partial(self._images, camera)) for camera in config.cameras.split()}
        self._only_view, self._image_came = config.only_view, False
        self._next_state, self._asking, self._stopped = 0.0, clock.Lock(), -math.inf
        self._watched = False
        terminal = SentenceWriter()
        try:
            certificate = None
            if not is_loopback(config.host):
                certificate = own_certificate(Path(rospkg.get_ros_home()) / "leap_rig" / "headset")
            self._server = CockpitServer(
                Path(config.page or f"{rospkg.RosPack().get_path('leap_rig')}/web/cockpit.html"),
                ScenePage(self._scene.page, self._scene.address),
                names,
                lambda command: self._commands.put((clock.monotonic(), command)),
                self._stop,
                terminal.show,
                host=config.host,
                port=config.port,
                name=config.name,
                certificate=certificate,
                script=(Path(rospkg.RosPack().get_path("vision")) / "web" / "pictures.js").read_bytes(),
                cameras=list(self._looks),
                way=config.video,
                public=config.public,
            )
        except (CertificateError, OSError, OverflowError) as error:
            fault = f"Cannot serve the cockpit on {config.host}:{config.port}: {error}"
            raise DeviceError(f"{fault.rstrip('.')}. Check the page, or choose another port.") from error
        # Beside what answers the pages: rospy waits for a master that hangs.
        repeat(self._follow, FOLLOW_S, "topics")
        terminal.show(f"The cockpit is at {self._server.address}")
        if config.video != JPEG and not is_loopback(config.host) and webrtc.missing():
            rospy.logwarn("%s", webrtc.missing())
        if self._server.fingerprint:
            rospy.loginfo("The fingerprint (SHA-256) of its certificate is %s", self._server.fingerprint)

    def run(self) -> None:
        idle_s = 0.2
        try:
            while not rospy.is_shutdown():
                self._step()
                clock.sleep(PERIOD_S if self._server.watched else idle_s)
        finally:
            self._server.close()
            self._scene.close()
            for program in (self._recorder, self._tutor):
                program.close()

    def _step(self) -> None:
        server, now = self._server, clock.monotonic()
        (self._feed.start if server.scene_watched else self._feed.stop)()
        self._scene.inset = self._image_came and any(map(server.pictures.watched, self._looks))
        while not self._commands.empty():
            came, command = self._commands.get()
            if clock.monotonic() - came <= FRESH_S:
                self._obey(command, came)
            else:
                self._say("The rig was busy: what was asked is too old, and nothing was sent.", "warning", command.arm)
        held, live = server.held(), server.live
        for name, arm in self._arms.items():
            arm.hold(held[name], live)
        if server.watched and now >= self._next_state:
            self._next_state = now + STATE_PERIOD_S
            server.put_state(self._state(held))

    def _follow(self) -> None:
        """Subscribes to what somebody looks at, while the master answers. A defect must not end the thread."""
        try:
            self._subscribe()
        except Exception as error:
            if rospy.core.is_shutdown_requested():  # the topics are closed
                return
            rospy.logerr_throttle(10.0, f"The cockpit cannot follow what its pages look at: {error!r}")

    def _subscribe(self) -> None:
        self._chooses = any(subscriber.get_num_connections() for subscriber in self._choice.subscribers)
        server, watched = self._server, self._server.watched
        looks = [(look, server.pictures.watched(camera)) for camera, look in self._looks.items()]
        changes = [(look, wanted) for look, wanted in looks if wanted is not bool(look.subscribers)]
        if (watched is self._watched and not changes) or not master_answers():
            return
        for look, wanted in changes:
            look(wanted)
        if watched is not self._watched:
            with contextlib.suppress(MasterLost):
                for arm in self._arms.values():
                    arm.watch(watched)
                self._listen(watched)
                self._choice(watched)
                self._watched = watched

    def _state(self, held: Mapping[str, HeldSwitches]) -> dict[str, Any]:
        updates = {name: arm.link.refresh() for name, arm in self._arms.items()}
        for name, update in updates.items():
            for text, tone in update.answers:
                self._say(text, tone.value, name)
        for name, answers in [("", self._choices), *((name, arm.answers) for name, arm in self._arms.items())]:
            while not answers.empty():
                taken, text = answers.get()
                self._say(text, "normal" if taken else "warning", name)
        for program, sentence in ((self._recorder, self._recorder.line), (self._tutor, "The tutorial has ended.")):
            while not program.ended.empty():
                failed = program.ended.get() != 0
                self._say(program.line if failed else sentence, "warning" if failed else "normal")
        return {
            "arms": {name: arm.shown(updates[name], held[name]) for name, arm in self._arms.items()},
            "choice": {"names": [*self._arms, BOTH], "chosen": self._chosen if self._chooses else ""}
            if len(self._arms) > 1 and all(arm.chosen_by_service for arm in self._arms.values())
            else None,
            "cameras": list(self._looks),
            "only_view": self._only_view,
            "answers": sorted(self._answers.values(), key=lambda answer: answer["number"]),
            "recording": f"{self._recording}: {self._recorder.line.partition(' | ')[0] or 'it starts'}"
            if self._recorder.runs
            else "",
            "marks": self._marks.get_num_connections() > 0,
            "tutorial": {"runs": self._tutor.runs, "text": self._tutorial},
        }

    def _stop(self) -> None:
        """The Emergency Stop, of all arms; called beside this node's own thread. What was asked before is dropped."""
        with self._asking:
            self._stopped = clock.monotonic()
            for arm in self._arms.values():
                arm.link.ask_emergency()

    def _obey(self, command: PageCommand, came: float) -> None:
        with self._asking:  # a stop comes before or after it
            if came <= self._stopped:
                return
            if command.name in (CONTROL, PAUSE, GUIDE, GRIPPER, POLICY, SCALING, EXIT):
                self._ask_controller(self._arms[command.arm].link, command)
                return
        if command.name == RECORD:
            self._record(command.value)
        elif command.name == MARK:
            self._mark(*command.value)
        elif command.name == TUTORIAL:
            self._teach(command.value)
        elif command.name == OPERATOR:
            self._arms[command.arm].ask_operator(command.value)
        elif command.name == CHOOSE:
            _ask(self._choices, "leap_kuka/choose_arm", ChooseArm, command.value)

    @staticmethod
    def _ask_controller(link: ControllerLink, command: PageCommand) -> None:
        if command.name == EXIT:
            link.ask_exit()
        else:
            asks = {
                **{CONTROL: link.ask_control, PAUSE: link.ask_pause, GUIDE: link.ask_guide},
                **{GRIPPER: link.ask_gripper, POLICY: link.ask_policy, SCALING: link.ask_scaling},
            }
            asks[command.name](command.value)

    def _record(self, on: bool) -> None:
        if on and not self._recorder.runs:
            self._recording = strftime("cockpit-%Y%m%d-%H%M%S")
            self._start(self._recorder, "record.py", self._recording)
        elif not on:
            self._recorder.stop()

    def _start(self, program: ChildProgram, *command: str) -> None:
        if "" not in self._arms:
            self._say("Recordings and the tutorial are for one arm only.", "warning")
            return
        try:
            program.start(*command)
        except OSError as error:
            self._say(f"{command[0]} cannot be started: {error.strerror}.", "warning")

    def _mark(self, mark: str, text: str) -> None:
        if self._marks.get_num_connections() == 0:
            self._say("Nobody records: no episode was marked.", "warning")
            return
        self._marks.publish(String(json.dumps({"mark": mark, "text": text})))
        self._say(f"Marked in the recording: {mark}{f', {text}' if text else ''}.")

    def _teach(self, on: bool) -> None:
        if on and self._tutorial and not self._tutor.runs:
            self._say("The tutorial runs already: it was started with the rig.", "warning")
        elif on and not self._tutor.runs:
            self._start(self._tutor, "tutorial.py", "_window:=false")
        elif not on:
            self._tutor.stop()

    def _say(self, text: str, tone: str = "normal", arm: str = "") -> None:
        """Shows a sentence on all pages, beside what was said of other arms a moment ago: of one stop both answer."""
        moment_s, now = 10.0, clock.monotonic()
        self._number += 1
        self._answers = {of: answer for of, answer in self._answers.items() if now - answer["at"] < moment_s}
        of = f"{arm}: " if arm else ""
        self._answers[arm] = {"number": self._number, "text": of + text, "tone": tone, "at": now}

    def _take_tutorial(self, message: DiagnosticStatus) -> None:
        self._tutorial = message.message

    def _take_choice(self, message: String) -> None:
        self._chosen = message.data

    def _images(self, camera: str) -> list[rospy.Subscriber]:
        # Room for several images: rospy drops all but the newest only among those that it has read.
        options = {"callback_args": camera, "queue_size": 1, "buff_size": 2**24, "tcp_nodelay": True}
        return [rospy.Subscriber(f"{camera}/{IMAGE}", Image, self._take_image, **options)]

    def _take_image(self, message: Image, camera: str) -> None:
        came = clock.monotonic()
        age = max(0.0, (rospy.Time.now() - message.header.stamp).to_sec())
        with contextlib.suppress(ValueError):  # of an encoding that is no colour
            image = np.ascontiguousarray(colour_from_image(message))
            self._server.put_picture(camera, Picture(image, came - age, came, {}))
            self._image_came = True


def main() -> None:
    cv2.setNumThreads(1)
    Cockpit(private_config(CockpitConfig)).run()
