"""The node cockpit: serves the page that shows the whole rig and commands it. It subscribes only while a page is open;
what the operator holds on the page goes out on leap_kuka/operator_input, where silence is a release."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
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
from common.ros.on_demand import OnDemand
from common.ros.params import private_config
from kuka_control.ros.controller_link import ControllerLink, PanelUpdate
from leap_kuka.config import DEVICE, NONE
from leap_motion.service.access import is_loopback
from leap_motion.service.certificate import CertificateError, own_certificate
from leap_rig.cockpit.messages import CONTROL, EXIT, GRIPPER, MARK, RECORD, SCALING, TUTORIAL, PageCommand
from leap_rig.cockpit.ros.scene_feed import SceneFeed
from leap_rig.cockpit.scene import SceneServer
from leap_rig.cockpit.server import CockpitServer, ScenePage
from leap_rig.cockpit.settings import CockpitConfig
from rig_msgs.msg import OperatorInput
from vision.stereo.transport import Picture

PERIOD_S = 0.05
STATE_PERIOD_S = 0.2
MARK_TOPIC = "cockpit/episode_mark"
IMAGE = "camera/rgb/image_raw"
SOURCE = "cockpit"


class ChildProgram:
    """A program of this workspace that the cockpit starts and ends."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None

    @property
    def runs(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def started(self) -> bool:
        return self._process is not None

    def start(self, *command: str) -> None:
        self._process = subprocess.Popen(("rosrun", "leap_rig", *command), stdin=subprocess.DEVNULL)

    def stop(self) -> None:
        """Asks it to end; it may take a moment to write what it has."""
        if self._process is not None and self.runs:
            self._process.send_signal(signal.SIGINT)


class ArmLink:
    """One arm: the link to its controller while a page is open, and the operator's switches of the page."""

    def __init__(self, arm: str) -> None:
        self._arm, self._of = arm, f"{arm}/" if arm else ""
        self._link: ControllerLink | None = None
        self._lock = clock.Lock()
        self._publisher = rospy.Publisher(
            f"{self._of}leap_kuka/operator_input", OperatorInput, queue_size=10, tcp_nodelay=True
        )
        self._used, self._sent, self._sent_at = False, (False, False), 0.0
        self._enabling, self._clutch, self._operator = NONE, NONE, ""

    @property
    def link(self) -> ControllerLink:
        """The link, which is made where there is none: the Emergency Stop needs one even then."""
        with self._lock:
            if self._link is None:
                self._link = ControllerLink(self._arm)
            return self._link

    def watch(self, watched: bool) -> None:
        if watched and self._link is None:
            self._enabling = rospy.get_param(f"{self._of}leap/enabling", NONE)
            self._clutch = rospy.get_param(f"{self._of}leap/clutch", NONE)
            self._operator = str(rospy.get_param(f"{self._of}leap_hand_node/operator", ""))
            self.link.refresh()
        elif not watched:
            with self._lock:
                link, self._link = self._link, None
            if link is not None:
                link.close()

    def hold(self, enable: bool, clutch: bool, controlled: bool) -> None:
        """Publishes what the page holds, from its first press until nobody has control and no clutch is pressed."""
        period_s = 0.1
        self._used = (self._used and (controlled or clutch)) or enable or clutch
        now = clock.monotonic()
        if not self._used or ((enable, clutch) == self._sent and now - self._sent_at < period_s):
            return
        self._sent, self._sent_at = (enable, clutch), now
        self._publisher.publish(OperatorInput(Header(0, rospy.Time.now(), ""), SOURCE, enable, clutch))

    def shown(self, update: PanelUpdate, held: tuple[bool, bool]) -> dict[str, Any]:
        """Returns what the page shows of the arm."""
        return {
            **asdict(update.state),
            "tone": update.state.tone.value,
            "age": update.status_age,
            "rows": [{**asdict(row), "tone": row.tone.value} for row in update.rows],
            "enabling": self._enabling == DEVICE,
            "clutch": self._clutch == DEVICE,
            "held": {"enable": held[0], "clutch": held[1]},
            "operator": self._operator,
        }


class Cockpit:
    """Connects the server with the rig."""

    def __init__(self, config: CockpitConfig) -> None:
        names = tuple(config.arms.split()) or ("",)
        self._arms = {arm: ArmLink(arm) for arm in names}
        self._scene = SceneServer()
        self._feed = SceneFeed(self._scene, names)
        self._commands: clock.SimpleQueue[PageCommand] = clock.SimpleQueue()
        self._recorder, self._tutor = ChildProgram(), ChildProgram()
        self._recording, self._tutorial, self._number = "", "", 0
        self._answer: dict[str, Any] = {"number": 0, "text": "", "tone": "normal"}
        self._marks = rospy.Publisher(MARK_TOPIC, String, queue_size=10)
        self._listen = OnDemand(
            lambda: [rospy.Subscriber("leap_rig/tutorial", DiagnosticStatus, self._take_tutorial, queue_size=5)]
        )
        self._look = OnDemand(
            lambda: [rospy.Subscriber(IMAGE, Image, self._take_image, queue_size=1, buff_size=4 * 2**20)]
        )
        self._watched, self._next_state = False, 0.0
        try:
            certificate = None
            if not is_loopback(config.host):
                certificate = own_certificate(Path(rospkg.get_ros_home()) / "leap_rig" / "headset")
            self._server = CockpitServer(
                Path(config.page),
                ScenePage(self._scene.page, self._scene.address),
                names,
                self._commands.put,
                self._stop,
                show,
                host=config.host,
                port=config.port,
                name=config.name,
                certificate=certificate,
            )
        except (CertificateError, OSError, OverflowError) as error:
            fault = f"Cannot serve the cockpit on {config.host}:{config.port}: {error}"
            raise DeviceError(f"{fault.rstrip('.')}. Check the page, or choose another port.") from error
        show(f"The cockpit is at {self._server.address}")
        if self._server.fingerprint:
            rospy.loginfo("The fingerprint (SHA-256) of its certificate is %s", self._server.fingerprint)

    def run(self) -> None:
        idle_s = 0.2
        try:
            while not rospy.is_shutdown():
                self._step()
                clock.sleep(PERIOD_S if self._watched else idle_s)
        finally:
            self._server.close()
            self._scene.close()
            for program in (self._recorder, self._tutor):
                program.stop()

    def _step(self) -> None:
        server, now = self._server, clock.monotonic()
        self._watch(server.watched)
        (self._feed.start if server.scene_watched else self._feed.stop)()
        self._look(server.pictures.watched)
        while not self._commands.empty():
            self._obey(self._commands.get())
        held = server.held()
        for name, arm in self._arms.items():
            arm.hold(*held[name], server.controlled)
        if self._watched and now >= self._next_state:
            self._next_state = now + STATE_PERIOD_S
            server.put_state(self._state(held))

    def _watch(self, watched: bool) -> None:
        if watched is not self._watched:
            self._watched = watched
            for arm in self._arms.values():
                arm.watch(watched)
            self._listen(watched)

    def _state(self, held: Mapping[str, tuple[bool, bool]]) -> dict[str, Any]:
        updates = {name: arm.link.refresh() for name, arm in self._arms.items()}
        for name, update in updates.items():
            for text, tone in update.answers:
                self._say(f"{name}: {text}" if name else text, tone.value)
        return {
            "arms": {name: arm.shown(updates[name], held[name]) for name, arm in self._arms.items()},
            "answer": self._answer,
            "recording": self._recording if self._recorder.runs else "",
            "tutorial": {"runs": self._tutor.runs, "text": self._tutorial},
        }

    def _stop(self) -> None:
        """The Emergency Stop, of all arms; called beside this node's own thread."""
        for arm in self._arms.values():
            arm.link.ask_emergency()

    def _obey(self, command: PageCommand) -> None:
        link = self._arms[command.arm].link if command.arm in self._arms else None
        if command.name == RECORD:
            self._record(command.value)
        elif command.name == MARK:
            self._mark(command.value)
        elif command.name == TUTORIAL:
            self._teach(command.value)
        elif link is not None:
            asks = {CONTROL: link.ask_control, GRIPPER: link.ask_gripper, SCALING: link.ask_scaling}
            if command.name == EXIT:
                link.ask_exit()
            else:
                asks[command.name](command.value)

    def _record(self, on: bool) -> None:
        if on and not self._recorder.runs:
            self._recording = strftime("cockpit-%Y%m%d-%H%M%S")
            self._recorder.start("record.py", self._recording, "--topic", f"/{MARK_TOPIC}")
            self._say(f"The recording {self._recording} starts.")
        elif not on and self._recorder.runs:
            self._recorder.stop()
            self._say(f"The recording {self._recording} is complete.")

    def _mark(self, mark: str) -> None:
        if not self._recorder.runs:
            self._say("Nothing is recorded: no episode was marked.", "warning")
            return
        self._marks.publish(String(mark))
        self._say(f"Marked in the recording: {mark}.")

    def _teach(self, on: bool) -> None:
        if on and self._tutorial and not self._tutor.started:
            self._say("The tutorial runs already: it was started with the rig.", "warning")
        elif on and not self._tutor.runs:
            self._tutor.start("tutorial.py", "_window:=false")
            self._say("The tutorial starts.")
        elif not on:
            self._tutor.stop()

    def _say(self, text: str, tone: str = "normal") -> None:
        self._number += 1
        self._answer = {"number": self._number, "text": text, "tone": tone}

    def _take_tutorial(self, message: DiagnosticStatus) -> None:
        self._tutorial = message.message

    def _take_image(self, message: Image) -> None:
        quality = 80
        with contextlib.suppress(ValueError):  # of an encoding that is no colour
            image = np.ascontiguousarray(colour_from_image(message)[..., ::-1])
            _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
            self._server.put_picture(
                Picture({"age": (rospy.Time.now() - message.header.stamp).to_sec()}, jpeg.tobytes())
            )


def show(sentence: str) -> None:
    """Writes on the terminal alone: what is logged goes to /rosout, and so into recordings."""
    print(sentence, file=sys.stderr, flush=True)


def main() -> None:
    cv2.setNumThreads(1)
    Cockpit(private_config(CockpitConfig)).run()
