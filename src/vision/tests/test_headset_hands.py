"""Hands from the headset to the desired tool: socket, bridge, driver, rig in virtual time; the page in a browser."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from depth_scene import load
from stereo_camera import REMAPS, Camera
from websockets.sync.client import connect

from common import clock
from common.frames import TOOL_DESIRED
from leap_motion.headset.placement import FROM_XR
from leap_motion.service.access import FIRST_WAIT_S
from rig_simulation.operator.hand_model import HandModel, HandPose, fingers_for
from simulated.chromium import browser

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from common.ros import sentence_writer
from leap_motion.msg import Human
from vision.ros.stereo import headset_hands
from vision.stereo.view import WebConfig

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
PAGE = str(HERE.parent / "web" / "headset.html")
ARM = {"center_line": [1, 0, 0], "z_lower_limit": 0.2, "tool_length": 0.106, "ws_center": [0.5, 0, 0.4]}
RATE_HZ = 60


@pytest.fixture(scope="session")
def iwer():
    """The source of Meta's headset emulation, in the version and with the checksum of package-lock.json."""
    folder = ROOT / "build" / "iwer"
    script = folder / "node_modules" / "iwer" / "build" / "iwer.min.js"
    if not script.is_file():
        if not shutil.which("npm"):
            pytest.skip("the emulated headset is fetched by npm, which is not installed")
        shutil.copytree(HERE / "iwer", folder, dirs_exist_ok=True)
        command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120.0)
        if done.returncode:
            pytest.skip(f"npm does not fetch the emulated headset: {done.stderr.strip()[-300:]}")
    return script.read_text()


def recording(centre):
    """Returns frames of 75 numbers [m], to be played again and again: an open hand of the simulated operator comes in
    from the right to `centre`, in Leap axes [mm], stays, moves 80 mm to the left and back, and leaves.
    """
    model, frames = HandModel(), []
    offsets = [np.full(RATE_HZ // 2, 250.0), np.linspace(250.0, 0.0, 2 * RATE_HZ), np.zeros(RATE_HZ)]
    offsets += [40.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 3 * RATE_HZ)) - 40.0, np.linspace(0.0, 250.0, 2 * RATE_HZ)]
    for offset in np.concatenate(offsets):
        flexion, spread = fingers_for(0.05)
        hand = model.place(HandPose(centre + np.array([offset, 0.0, 0.0]), 0.0, 0.0, 0.0, flexion, spread))
        points = np.empty((25, 3))
        points[0] = hand.wrist
        points[FROM_XR] = hand.joints
        frames.append(np.round(1e-3 * points, 5).ravel().tolist())
    return frames


EMULATION = """
window.device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({forceInstall: true});
device.primaryInputMode = "hand";
device.hands.left.connected = false;
XRFrame.prototype.getJointPose = (joint, space) => {
  const number = Math.floor((performance.now() - started) * RATE / 1000);
  const frame = recorded[Math.max(0, number) % recorded.length];
  const names = [...device.hands.right.inputSource.hand.keys()], i = 3 * names.indexOf(joint.jointName);
  return {transform: {position: {x: frame[i] + origin[0], y: frame[i + 1] + origin[1], z: frame[i + 2] + origin[2]}}};
};
offer();
"""


def emulate(evaluate, wait_until, iwer, frames, origin):
    """Puts the emulated headset into the page, whose hand waits for its `started`."""
    wait_until(lambda: evaluate("typeof offer === 'function'"), 60.0, "the page")
    evaluate(iwer + "\n; 0")
    evaluate(f"window.recorded = {frames}; window.origin = {origin}; window.RATE = {RATE_HZ}; 0")
    evaluate("window.started = performance.now() + 1e9; 0")
    evaluate(EMULATION + "; 0")
    wait_until(lambda: not evaluate("code.hidden"), 60.0, "the field for the code")
    wait_until(lambda: not evaluate("document.getElementById('vr').disabled"), 60.0, "the button")


def start_rig(ros, port, wait_until, **more):
    """Starts page, bridge, driver and teleoperation; returns the node of the page, and what it said after words."""
    shipped = yaml.safe_load((HERE.parents[1] / "leap_kuka" / "config" / "leap_params.yaml").read_text())
    rospy.set_param("leap", {**shipped, "z_clearance": shipped["z_clearance"] + 0.05})  # higher than the page assumes
    rospy.set_param("kuka", {"robot": "LBR7R800", **ARM})
    web = {"host": "127.0.0.1", "port": 0, "page": PAGE, "certificate": "", "key": "", "hands": True, "leap_port": port,
           **more}  # fmt: skip
    rospy.set_param("stereo_web", {"view": {**load("stereo_view.yaml"), "lens": "none"}, "web": web})
    node = ros.run("vision", "stereo_web_node.py", *REMAPS)
    ros.run("leap_motion", "leap_driver.py", f"_port:={port}")
    ros.run("leap_kuka", "leap_kuka_node.py")

    def said(words):
        assert node.poll() is None, node.log_path.read_text()
        parts = node.log_path.read_text().split(words)
        return parts[-1].split("\x1b")[0].split()[0].rstrip(".") if len(parts) > 1 else None

    wait_until(lambda: said("The view is at "), 30.0, "the address of the page")
    return node, said


class Rig:
    """What the test sees of the rig."""

    def __init__(self, ros):
        self.boxes = ros.record("leap_kuka/interaction_box", MarkerArray)
        self.humans = ros.record("leap_motion/leap_device", Human)
        self.stream = ros.record("leap_kuka/stream", DiagnosticStatus)
        self._tf = ros.record("/tf", TFMessage)

    def moved(self):
        """How far the desired tool has moved across the box so far [m]."""
        found = [t.transform.translation.x for m in self._tf for t in m.transforms if t.child_frame_id == TOOL_DESIRED]
        return np.ptp(found or [0.0])

    def silent(self):
        """Whether no frame of the tracker has come for a while."""
        return (rospy.Time.now() - self.humans[-1].header.stamp).to_sec() > 0.5

    def runs(self):
        return bool(self.stream) and any(v.key == "state" and v.value == "running" for v in self.stream[-1].values)


class Page:
    """As the page: sends a message for each frame of the headset while it `plays`, and keeps the newest answer."""

    def __init__(self, address, origin, frames):
        self._socket, self._begun = connect(address.replace("http", "ws") + "hands"), clock.monotonic()
        self._frames = [(np.reshape(frame, (25, 3)) + origin).ravel().tolist() for frame in frames]
        self.plays, self.answer = False, {}

    def says(self, **message):
        self._socket.send(json.dumps(message))
        return json.loads(self._socket.recv(timeout=1.0))

    def play(self):
        self.plays = True
        clock.Thread(target=self._play, daemon=True).start()

    def _play(self):
        for frame in itertools.cycle(self._frames):
            if not self.plays:
                return
            now = 1e3 * (clock.monotonic() - self._begun)
            head = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]
            self.answer = self.says(t=now, place=1, head=head, left=None, right=frame)
            clock.sleep(1.0 / RATE_HZ)

    def close(self):
        self._socket.close()


@pytest.mark.hazard(20)
def test_a_hand_in_the_headset_moves_the_desired_tool_until_the_headset_is_taken_off(virtual_graph, monkeypatch):
    plain = SimpleNamespace(server=lambda: None, fingerprint=lambda: "")  # websockets' client has no TLS on wires
    monkeypatch.setattr("vision.ros.stereo.web_node.own_certificate", lambda _: plain)
    rig = Rig(virtual_graph)
    node, said = start_rig(virtual_graph, 6437, virtual_graph.wait_until)
    box = rig.boxes.wait(1, 3.0)[0].markers[0].pose.position
    origin = [0.0, 1.6 - 0.35 - box.y, -0.4]
    address, frames = said("The view is at "), recording(np.array([0.0, 1e3 * box.y, 0.0]))
    wrong = "00000000" if said("next headset is ") != "00000000" else "00000001"
    stranger = Page(address, origin, frames)
    assert "not the code" in stranger.says(secret=wrong)["refused"]
    clock.sleep(FIRST_WAIT_S)
    (driver,) = (each for each in virtual_graph.nodes if each.name == "/leap_driver")
    assert not rig.humans and "not plugged in" in driver.log
    page = Page(address, origin, frames)
    assert page.says(secret=said("next headset is "))["drives"]
    page.play()
    clock.sleep(3.5)  # in which the hand comes to rest in the box
    assert page.answer["leap"] == pytest.approx([*origin, 0.0], abs=1e-3) and page.answer["note"] == ""
    assert rig.humans[-1].right_hand.is_present and rig.runs()
    before = rig.moved()
    clock.sleep(3.0)
    assert rig.moved() > before + 0.05 and rig.runs() and len(page.answer["tool"]) == 7
    page.plays = False
    clock.sleep(0.1)
    page.says(away=True)
    clock.sleep(0.2)
    assert not rig.runs()
    count = len(rig.humans)
    clock.sleep(0.3)
    assert len(rig.humans) == count
    page.play()
    clock.sleep(1.0)
    assert len(rig.humans) > count + 40
    page.plays = False  # silent, as a page without focus
    clock.sleep(0.5)
    count = len(rig.humans)
    clock.sleep(0.5)
    assert len(rig.humans) == count
    page.close()
    clock.sleep(0.1)
    assert "No headset drives" in node.log


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("chromium"), reason="chromium is not installed")
@pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
def test_in_a_browser_the_page_sends_hands_until_the_headset_is_taken_off(ros, free_port, wait_until, tmp_path, iwer):
    rig = Rig(ros)
    node, said = start_rig(ros, free_port(), wait_until)
    address = said("The view is at ")
    assert address.startswith("https://127.0.0.1:")
    box = rig.boxes.wait(1, 30.0)[0].markers[0].pose.position
    origin = [0.0, 1.6 - 0.35 - box.y, -0.4]
    frames = json.dumps(recording(np.array([0.0, 1e3 * box.y, 0.0])))
    with browser(address, tmp_path, wait_until, size="320,240") as evaluate:
        emulate(evaluate, wait_until, iwer, frames, origin)

        def enter(code):
            evaluate(f"code.value = {json.dumps(code)}; document.getElementById('vr').click(); 0")

        wrong = "00000000" if said("next headset is ") != "00000000" else "00000001"
        enter(wrong)
        wait_until(lambda: "not the code" in evaluate("drives.textContent"), 30.0, "the refusal")
        wait_until(lambda: evaluate("window.painted > 2"), 30.0, "the view of a page that does not drive")
        assert not any(human.nr_of_hands for human in rig.humans)
        evaluate("drive.session.end(); 0")
        clock.sleep(FIRST_WAIT_S)  # after a wrong code
        enter(said("next headset is "))
        wait_until(lambda: evaluate("!!drive.scene.leap"), 30.0, "the placement")
        assert evaluate("drive.scene.leap") == pytest.approx([*origin, 0.0], abs=1e-3)
        evaluate("view.socket.close(); 0")
        kept = "view.socket.readyState === 1 && view.socket.url.endsWith('&ticket=' + sessionStorage.getItem('ticket'))"
        wait_until(lambda: evaluate(kept), 30.0, "the images again, with the ticket")
        evaluate("window.started = performance.now(); 0")
        wait_until(lambda: any(human.right_hand.is_present for human in rig.humans[-5:]), 30.0, "the hand")
        wait_until(rig.runs, 30.0, "the stream")
        wait_until(lambda: rig.moved() > 0.05, 30.0, "the desired tool to move")
        wait_until(lambda: evaluate("!!drive.scene.tool"), 30.0, "the tool on the page")
        wait_until(lambda: evaluate("drive.note") == "", 10.0, "no complaint")
        if os.environ.get("HEADSET_PICTURE"):
            evaluate.picture(Path(os.environ["HEADSET_PICTURE"]))
        evaluate("device.updateVisibilityState('visible-blurred'); 0")
        wait_until(lambda: not rig.runs(), 30.0, "the end of the stream")
        count = len(rig.humans)
        assert evaluate("drive.socket !== null")
        evaluate("device.updateVisibilityState('visible'); 0")
        wait_until(lambda: len(rig.humans) > count + 5, 30.0, "frames again")
        painted = evaluate("document.hasFocus = () => true; window.painted")
        wait_until(lambda: evaluate("window.painted") > painted + 2, 30.0, "frames of a page that has the focus")
        evaluate("document.hasFocus = () => false; window.onblur(); 0")
        wait_until(rig.silent, 30.0, "the end of the frames where the page loses the focus")
        assert evaluate("drive.socket !== null")
        evaluate("drive.session.end(); 0")
        wait_until(lambda: "No headset drives" in node.log_path.read_text(), 30.0, "the end of the drive")


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("chromium"), reason="chromium is not installed")
@pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
def test_in_a_browser_hands_rest_while_the_only_view_is_old_and_none_wait_for_a_rig_that_hangs(
    ros, free_port, wait_until, tmp_path, iwer, suspend
):
    rig, camera = Rig(ros), Camera()
    node, said = start_rig(ros, free_port(), wait_until, only_view=True)
    box = rig.boxes.wait(1, 60.0)[0].markers[0].pose.position
    origin = [0.0, 1.6 - 0.35 - box.y, -0.4]
    frames = json.dumps(recording(np.array([0.0, 1e3 * box.y, 0.0])))
    with browser(said("The view is at "), tmp_path, wait_until, size="320,240") as evaluate:
        emulate(evaluate, wait_until, iwer, frames, origin)

        def sees(condition):
            """Whether that holds, while images come."""

            def now():
                camera.publish(depth=False)
                return condition()

            return now

        wait_until(sees(lambda: evaluate("onlyView && !view.old")), 60.0, "a new image", poll=0.1)
        code = json.dumps(said("next headset is "))
        evaluate(f"code.value = {code}; document.getElementById('vr').click(); 0")
        wait_until(sees(lambda: evaluate("!!drive.socket && !!drive.session")), 60.0, "the seat", poll=0.1)
        evaluate("""{
            Object.assign(window, {sent: 0, away: 0, stale: 0});
            const send = drive.socket.send.bind(drive.socket);
            drive.socket.send = text => {
              window.sent += 1;
              if ("away" in JSON.parse(text)) window.away += 1;
              else if (view.age > 2 * OLD_MS) window.stale += 1;
              send(text);
            };
        }""")
        evaluate("window.started = performance.now(); 0")
        wait_until(sees(rig.runs), 60.0, "the stream", poll=0.1)
        wait_until(lambda: evaluate("view.age > 4 * OLD_MS && window.away > 0"), 60.0, "the age of the image")
        assert evaluate("window.stale") == 0 and evaluate("drive.socket !== null")
        wait_until(lambda: not rig.runs(), 60.0, "the end of the stream")
        hands = "window.sent - window.away"
        count = evaluate(hands)
        wait_until(sees(lambda: evaluate(hands) > count), 60.0, "hands again", poll=0.1)
        before = evaluate("Object.defineProperty(view, 'old', {get: () => false}), window.sent")
        wait_until(lambda: evaluate("window.sent") > before + 20, 60.0, "messages")
        suspend(node.pid)
        try:
            wait_until(lambda: evaluate("drive.sent.length > 0 && performance.now() - drive.sent[0] > 2 * ANSWER_MS"),
                       60.0, "answers that stay away")  # fmt: skip
            count, painted = evaluate("[window.sent, window.painted]")
            wait_until(lambda: evaluate("window.painted") > painted + 20, 60.0, "what the headset shows")
            assert evaluate("window.sent") == count
        finally:
            os.kill(node.pid, signal.SIGCONT)
        wait_until(lambda: evaluate("window.sent") > count + 20, 60.0, "messages again")
    camera.close()


def test_a_paused_terminal_stops_no_page(virtual_graph, monkeypatch):
    paused = [True]

    def write(*_, **__):
        while paused:
            clock.sleep(0.01)

    plain = SimpleNamespace(server=lambda: None, fingerprint=lambda: "")
    monkeypatch.setattr("vision.ros.stereo.web_node.own_certificate", lambda _: plain)
    _, said = start_rig(virtual_graph, 6437, virtual_graph.wait_until)
    page, code = Page(said("The view is at "), [], []), said("next headset is ")
    monkeypatch.setattr(sentence_writer, "print", write, raising=False)
    monkeypatch.setattr(headset_hands, "rospy", SimpleNamespace(**{**vars(rospy), "logwarn": write}))
    assert page.says(secret=code)["drives"]
    assert "note" in page.says(away=True)
    paused.clear()
    page.close()


def test_the_code_stands_on_the_terminal_and_not_in_the_log(virtual_graph, monkeypatch, capsys):
    """The log goes to /rosout, and with it into every recording."""
    logged = []
    monkeypatch.setattr(headset_hands, "RigScene", lambda: None)
    monkeypatch.setattr(headset_hands.rospy, "logwarn", lambda *text: logged.append(str(text)))
    hands = headset_hands.HeadsetHands(
        WebConfig("127.0.0.1", 0, PAGE, "", "", True, 0, 0.4, 0.35, "", "auto", False, "")
    )
    try:
        code = hands.endpoint.access.code
        clock.sleep(0.1)
        said = capsys.readouterr()
        assert code in said.err and code not in said.out and not any(code in text for text in logged)
    finally:
        hands.close()
