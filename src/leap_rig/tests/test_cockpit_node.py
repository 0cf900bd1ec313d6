"""The node cockpit between its pages and the rig, whatever master and controller do. Server and scene are stand-ins."""

from __future__ import annotations

import os
import signal
import socket
from dataclasses import replace
from types import SimpleNamespace

import pytest

from common import clock

pytest.importorskip("rig_msgs.msg")
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import SetBool

from common.ros import sentence_writer
from kuka_control.model.switches import Switches, SwitchReply
from kuka_control.ros import emergency
from kuka_control.ros.services import Services
from leap_rig.cockpit.control import FRESH_S, HeldSwitches
from leap_rig.cockpit.messages import PageCommand
from leap_rig.cockpit.ros import cockpit_node
from leap_rig.cockpit.settings import CockpitConfig
from rig_msgs.msg import KukaStatus, OperatorInput, OperatorView
from rig_msgs.srv import ChooseArm

pytestmark = pytest.mark.ros
CONFIG = CockpitConfig("", "127.0.0.1", 0, "", "", "", "camera", "auto", False)


class Pages:
    """In the place of the server: what the pages are and hold, and what they get."""

    def __init__(self, page, scene, arms, obey, stop, tell_code, **_):
        self.obey, self.stop, self.tell_code = obey, stop, tell_code
        self.watched = self.scene_watched = self.live = False
        self.fingerprint, self.address = "", "http://127.0.0.1:1/"
        self.cameras, self.states, self.images = set(), [], []
        self.pictures = SimpleNamespace(watched=lambda camera: camera in self.cameras)
        self.switches = {arm: HeldSwitches() for arm in arms}

    def held(self):
        return self.switches

    def put_state(self, state):
        self.states.append((clock.monotonic(), state))

    def put_picture(self, camera, picture):
        self.images.append(camera)

    def close(self):
        pass

    @property
    def shown(self):
        """The newest state, which must be new."""
        at, state = self.states[-1]
        assert clock.monotonic() - at < 0.3
        return state

    @property
    def said(self):
        return [answer["text"] for answer in self.shown["answers"]]


class Scene:
    """In the place of the scene: takes everything, and keeps when it was drawn."""

    page, address = b"", ("127.0.0.1", 1)

    def __init__(self):
        self.drawn = -1.0

    def update(self, now):
        self.drawn = now

    def together(self):
        return clock.Lock()

    def __getattr__(self, name):
        return lambda *_: None


@pytest.fixture
def arms():
    """The parameter of the node; a test may have another one."""
    return ""


@pytest.fixture
def pages(virtual_graph, monkeypatch, arms):
    """The pages of a node that runs."""
    graph, made, scene = virtual_graph, [], Scene()

    def serve(*args, **more):
        made.append(Pages(*args, **more))
        return made[0]

    monkeypatch.setattr(cockpit_node, "SceneServer", lambda _: scene)
    monkeypatch.setattr(cockpit_node, "CockpitServer", serve)
    for arm in arms.split() or [""]:
        leap = {"engagement": "relative", "enabling": "device", "clutch": "none", "arm_choice": "service"}
        rospy.set_param(f"{arm}/leap".strip("/"), leap)

    def main():
        rospy.init_node("cockpit")
        cockpit_node.Cockpit(replace(CONFIG, arms=arms)).run()

    graph.start("cockpit", main)
    graph.wait_until(lambda: made, 10.0, "the server")
    made[0].scene, made[0].wait = scene, graph.wait_until
    return made[0]


@pytest.fixture
def controller(virtual_graph, monkeypatch):
    """A controller that runs, as a node."""

    def main():
        rospy.init_node("controller")
        Services(switches, pausable=True, guide=guide)
        status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
        while not rospy.is_shutdown():
            now = switches.now
            shown = {
                "control_on": now.control_on,
                "robot_abilities": node.abilities,
                "paused": now.paused,
                "guided": node.guided,
            }
            status.publish(KukaStatus(host=node.host, pid=node.number, mode="home", **shown))
            clock.sleep(0.05)

    def guide(on):
        node.guided = on
        return SwitchReply(True, "A hand may move the arm." if on else "Hand guiding has ended.")

    switches = Switches()
    switches.report("home", None)
    node = virtual_graph.start("controller", main)
    node.switches, node.host, node.number, node.abilities = switches, socket.gethostname(), 10**7, []
    node.guided = False
    monkeypatch.setattr(emergency, "_is_controller", lambda pid: pid == node.number)
    runs = lambda pid: pid == node.number and node.poll() is None  # noqa: E731
    monkeypatch.setattr(emergency, "_start_of", lambda pid: 0 if runs(pid) else None)
    monkeypatch.setattr(os, "kill", lambda pid, number: node.send_signal(number))
    return node


@pytest.fixture
def stand(monkeypatch):
    """Called with whether the node's own thread is to stand still."""
    step, stands = cockpit_node.Cockpit._step, []

    def wait(cockpit):
        while stands:
            clock.sleep(0.01)
        step(cockpit)

    def change(on):
        stands[:] = [1] * on
        clock.sleep(0.1)

    monkeypatch.setattr(cockpit_node.Cockpit, "_step", wait)
    return change


def open_page(pages):
    pages.watched = pages.live = True
    pages.wait(lambda: pages.states and pages.shown["arms"][""]["present"], 10.0, "the controller on the page")


def test_a_paused_terminal_stops_only_who_writes_on_it(pages, monkeypatch):
    written = []

    def write(sentence, **_):
        clock.sleep(1.0)
        if sentence == "lost":
            raise OSError("no space left on device")
        written.append(sentence)

    monkeypatch.setattr(sentence_writer, "print", write, raising=False)
    began = clock.monotonic()
    for sentence in ("first", "lost", "second"):
        pages.tell_code(sentence)
    assert clock.monotonic() == began and "first" not in written
    pages.wait(lambda: written[-2:] == ["first", "second"], 5.0, "the sentences")


def test_a_command_that_waited_too_long_in_the_node_is_not_obeyed(pages, controller, stand):
    open_page(pages)
    pages.obey(PageCommand("control", "", True))
    pages.wait(lambda: any("Control is on" in text for text in pages.said), 5.0, "control")
    stand(True)
    pages.obey(PageCommand("control", "", False))
    clock.sleep(FRESH_S + 0.1)
    stand(False)
    pages.wait(lambda: any("too old, and nothing was sent" in text for text in pages.said), 5.0, "the sentence")
    pages.obey(PageCommand("gripper", "", True))
    pages.wait(lambda: controller.switches.now.gripper_on, 5.0, "what is asked later")
    assert controller.switches.now.control_on


def test_a_page_pauses_a_motion_where_the_robot_can(pages, controller):
    open_page(pages)
    assert not pages.shown["arms"][""]["stops"]
    controller.abilities = ["stop"]
    controller.switches.report("homing", None, stops=True)
    pages.wait(lambda: pages.shown["arms"][""]["stops"], 5.0, "the button")
    for on in (True, False):
        pages.obey(PageCommand("pause", "", on))
        pages.wait(lambda on=on: pages.shown["arms"][""]["paused"] is on, 5.0, "the pause")
    pages.wait(lambda: any("The motion continues" in text for text in pages.said), 5.0, "the answer")


def test_a_page_lets_a_hand_guide_the_arm_where_the_robot_can(pages, controller):
    open_page(pages)
    assert not pages.shown["arms"][""]["guides"]
    controller.abilities = ["guide", "stop"]
    pages.wait(lambda: pages.shown["arms"][""]["guides"], 5.0, "the button")
    for on in (True, False):
        pages.obey(PageCommand("guide", "", on))
        pages.wait(lambda on=on: pages.shown["arms"][""]["guided"] is on, 5.0, "the guiding")
    pages.wait(lambda: any("Hand guiding has ended." in text for text in pages.said), 5.0, "the answer")


def test_a_page_lets_a_policy_run_and_stops_it_where_leap_kuka_can(pages, controller):
    asked = []
    rospy.Service("leap_kuka/run_policy", SetBool, lambda request: asked.append(request.data) or (True, "Answered."))
    rospy.set_param("leap/engagement", "absolute")
    open_page(pages)
    clock.sleep(2.0)
    assert not pages.shown["arms"][""]["policy"]
    rospy.set_param("leap/engagement", "relative")
    pages.wait(lambda: pages.shown["arms"][""]["policy"], 5.0, "the buttons")
    for on in (True, False):
        pages.obey(PageCommand("policy", "", on))
        pages.wait(lambda on=on: asked[-1:] == [on], 5.0, "the request")
    pages.wait(lambda: any("Answered." in text for text in pages.said), 5.0, "the answer")
    assert asked == [True, False]


def test_what_waits_in_the_node_when_a_page_stops_the_arm_is_dropped(pages, controller, stand):
    controller.host = "elsewhere"
    open_page(pages)
    stand(True)
    controller.send_signal(signal.SIGSTOP)
    pages.obey(PageCommand("control", "", True))
    pages.obey(PageCommand("gripper", "", True))
    pages.stop()
    stand(False)
    clock.sleep(1.0)
    controller.send_signal(signal.SIGCONT)
    clock.sleep(5.0)
    now = controller.switches.now
    assert controller.poll() is None and not now.control_on and not now.gripper_on
    assert any("on elsewhere did not confirm it" in text for text in pages.said)
    pages.obey(PageCommand("gripper", "", True))
    pages.wait(lambda: controller.switches.now.gripper_on, 5.0, "what is asked later")


def test_after_the_last_page_the_stop_still_knows_the_controller(pages, controller, virtual_graph):
    rows = rospy.Publisher("operator_view/rows", OperatorView, queue_size=1)
    open_page(pages)
    pages.wait(rows.get_num_connections, 5.0, "who looks at the rows")
    pages.watched = pages.live = False
    pages.wait(lambda: not rows.get_num_connections(), 5.0, "nobody to look at the rows")
    clock.sleep(5.0)
    controller.number += 1  # another process
    clock.sleep(5.0)
    controller.send_signal(signal.SIGSTOP)
    clock.sleep(5.0)
    pages.stop()
    pages.wait(lambda: controller.poll() is not None, 5.0, "the end of the controller")


def test_while_the_master_hangs_pages_have_the_state_hold_and_stop(pages, controller, virtual_graph):
    inputs = virtual_graph.record("leap_kuka/operator_input", OperatorInput)
    images = rospy.Publisher("camera/rgb/image_raw", Image, queue_size=1)
    open_page(pages)
    pages.wait(lambda: inputs, 5.0, "what the page holds")
    virtual_graph.master_hangs = True
    pages.cameras, pages.scene_watched = {"camera"}, True
    clock.sleep(3.0)
    assert pages.shown["arms"][""]["present"] and clock.monotonic() - pages.scene.drawn < 0.2
    for enable in (True, False):
        pages.switches[""] = HeldSwitches(enable=enable)
        clock.sleep(0.2)
        assert inputs[-1].enabled is enable
    pages.watched, pages.cameras = False, set()
    clock.sleep(1.0)
    pages.watched, pages.cameras = True, {"camera"}
    clock.sleep(1.0)
    controller.send_signal(signal.SIGSTOP)
    pages.stop()
    clock.sleep(1.0)
    assert controller.poll() is not None and any("was ended" in text for text in pages.said)
    assert not images.get_num_connections()
    virtual_graph.master_hangs = False
    pages.wait(images.get_num_connections, 10.0, "who looks at images")


@pytest.mark.parametrize("arms", ["left right"])
def test_a_page_chooses_the_arm_and_shows_the_choice_while_it_is_published(pages, virtual_graph):
    def main():
        rospy.init_node("arm_choice")
        chosen = rospy.Publisher("leap_kuka/chosen_arm", String, queue_size=1, latch=True)
        chosen.publish("left")

        def choose(request):
            chosen.publish(request.arm)
            return True, f"The hand steers {request.arm}."

        rospy.Service("leap_kuka/choose_arm", ChooseArm, choose)
        rospy.spin()

    def shows(chosen):
        choice = {"names": ["left", "right", "both"], "chosen": chosen}
        pages.wait(lambda: pages.states and pages.shown["choice"] == choice, 10.0, f"the choice {chosen!r}")

    node = virtual_graph.start("arm_choice", main)
    pages.watched = pages.live = True
    shows("left")
    pages.obey(PageCommand("choose", "", "right"))
    shows("right")
    pages.wait(lambda: "The hand steers right." in pages.said, 5.0, "the answer")
    node.send_signal(signal.SIGINT)
    shows("")


def test_who_follows_the_pages_survives_faults(pages, controller, monkeypatch):
    def names():
        raise OSError("no such folder")

    monkeypatch.setattr(cockpit_node, "known_names", names)
    monkeypatch.setattr(cockpit_node, "master_answers", lambda: 1 / 0)
    rospy.set_param("leap", "no mapping")
    pages.watched = pages.live = True
    clock.sleep(1.0)
    monkeypatch.setattr(cockpit_node, "master_answers", lambda: True)
    rows = rospy.Publisher("operator_view/rows", OperatorView, queue_size=1)
    pages.wait(rows.get_num_connections, 5.0, "who looks at the rows")
    assert pages.shown["arms"][""]["operators"] == [""]
