"""The whole simulated rig: its nodes, what they publish, the truth about the arm, and a hand to steer it."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import xmlrpc.client
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from campaign.arm_trace import ArmTrace
from campaign.clocks import Clock
from campaign.crowd import bound, burners
from campaign.hand_puppet import PATIENCE_S, PuppetClient
from campaign.network.link import CLEAR
from campaign.network.wire import Wire
from campaign.sockets import DeafSubscriber
from campaign.trial import runs
from common import clock
from common.frames import BASE
from common.ros.action_client import ActionClient
from common.ros.conversions import pose_from_message, pose_from_transform, stamped_pose
from common.teleop_record import RUNNING, WAITING, teleop_record
from kuka_msgs.msg import MoveAction, MoveGoal
from kuka_msgs.srv import setGripperControl, setKukaControl
from leap_motion.msg import Human
from rig_msgs.msg import KukaStatus, TeleopState
from rig_msgs.srv import CheckToolPose, HoldTool
from rig_simulation.control_port import ControlClient

CONTROLLER, DRIVER, TELEOP = "kuka_real_time_node", "leap_driver", "leap_kuka_node"
HAND, HAND_DRIVER = "leap_hand_node", "reflex_takktile_driver"
PROGRAMS = {
    CONTROLLER: ("kuka_control", "real_time_controller.py"),
    DRIVER: ("leap_motion", "leap_driver.py"),
    TELEOP: ("leap_kuka", "leap_kuka_node.py"),
    HAND: ("leap_hand", "leap_hand_node.py"),
    HAND_DRIVER: ("reflex", "reflex_takktile_driver.py"),
}
START_S, MOVE_S, SOON_S = 60.0, 15.0, 5.0
"""Longest waits [s]: for the rig to start, for a motion, for a message."""

STANDING = 2e-3
"""A servo goal is approached ever more slowly: at this speed [rad/s] a joint is 0.1 deg away from it."""


class RigUnderTest:
    """One rig. The hand is the caller's own, on the simulated Leap service; the rest is in rig.launch.

    Attributes:
        hand: what the simulated Leap service shows.
        leap, robot_hand, camera: control ports of the simulated Leap service, hand and, where there is one, camera.
        arm: the truth about the arm, and requests to its control port.
        clock: the clock of its programs.
        modes: modes of the controller.
        desired: desired tool frames, shape (4, 4); `desired_at`: their stamps [s].
        commanded: tool frames that the controller aimed at, shape (4, 4).
        stream: what leap_kuka said of its stream, as (state, reason).
        said: what any node said since the last `calm`, as (monotonic time [s], topic, text).
        statuses: mode of the controller and whether control was on, as (monotonic time [s], mode, on).
        entered: when it entered each mode, as (monotonic time [s], mode).
        exact: whether its times are virtual.

    Args:
        shared: the module conftest of the project, for its processes and waits.
        folder: for the output of the programs.
        wire: a link that may become bad, of the arm, the Leap or ROS (see worker.master); else they meet on loopback.
        core: the ROS master (worker.Core), for rows that kill it.
        arguments: of rig.launch, besides the ports."""

    exact = False

    def __init__(self, shared, folder: Path, wire: Wire | None = None, core: Any = None, **arguments: str) -> None:
        self.wire, self.core = wire, core
        self.clock: Clock | None = None
        self._shared = shared
        self._wait_until = shared.wait_until if shared else None
        self._arguments = arguments
        self._sees = arguments.get("world") == "true"
        self.camera: ControlClient | None = None
        self._processes = shared.Processes(folder) if shared else None
        self._started = {}
        self._subscribers: list[rospy.Subscriber] = []
        self._marks: dict[Path, int] = {}  # sizes of the programs' outputs at the last `calm`
        self._counts: dict[str, dict[str, str]] = {}
        self.mode = ""
        self.status: KukaStatus | None = None
        self.modes: list[str] = []
        self.desired: list = []
        self.desired_at: list[float] = []
        self.commanded: list = []
        self.stream: list[tuple[str, str]] = []
        self.stream_state = ""
        self.said: list[tuple[float, str, str]] = []
        self.statuses: list[tuple[float, str, bool]] = []
        self.entered: list[tuple[float, str]] = []
        self._last_said: dict[str, str] = {}

    def bring_up(self) -> None:
        """Starts everything; waits until the arm is at home and the robot hand is steered."""
        robot_host, robot_ip = self._addresses("arm")
        leap_host, leap_ip = self._addresses("leap")
        leap = self._processes.start(sys.executable, str(Path(__file__).with_name("hand_puppet.py")), leap_host)
        ready = self.wait(
            lambda: re.match(r"ready (\d+) (\d+) (\d+)\n", leap.log_path.read_text()), "the Leap service", START_S
        )
        self.hand = PuppetClient(int(ready[3]))
        self.leap = ControlClient(leap_host, int(ready[2]), PATIENCE_S)
        self.listen()
        robot, hand = self._shared.free_port(), self._shared.free_port()
        self._arguments = {
            **{"robot_port": self._shared.free_port(), "robot_control_port": robot},
            **{"hand_port": self._shared.free_port(socket.SOCK_DGRAM), "hand_control_port": hand},
            **{"leap_port": ready[1], "leap_host": leap_ip, "robot_host": robot_host, "robot_ip": robot_ip},
            **self._arguments,
        }
        if self._sees:
            self._arguments.update(world_port=self._shared.free_port(), camera_control_port=self._shared.free_port())
        if self.wire is not None and self.wire.name == "afar":
            self._arguments.update(leap_port=self._shared.free_port(), page_port=self._shared.free_port())
        self.launch()
        if "page_port" in self._arguments:
            self._connect_headset(ready[1])
        self.arm = ArmTrace(robot_host, robot, PATIENCE_S)
        self.robot_hand = ControlClient("127.0.0.1", hand, PATIENCE_S)
        self.wait(lambda: self.mode in ("home", "stopped"), "the arm at home, or latched by a pause", START_S)
        if self._sees:
            self.camera = ControlClient("127.0.0.1", self._arguments["camera_control_port"], PATIENCE_S)
            self.wait(lambda: self.count("ggcnn", "pictures") > 0, "the network's first image", 2.0 * START_S)
        self.wait(lambda: self.count("leap_hand", "commands_sent") > 0, "the robot hand to be steered", START_S)

    def listen(self) -> None:
        """Listens to the nodes, anew if the master is another one now."""
        for subscriber in self._subscribers:
            with contextlib.suppress(OSError):
                subscriber.unregister()
        self._subscribers = [
            rospy.Subscriber(topic, kind, take, queue_size=1000, tcp_nodelay=True)
            for topic, kind, take in (
                ("kuka/mode", String, self._take_mode),
                ("kuka/status", KukaStatus, self._take_status),
                ("/tf", TFMessage, self._take_transforms),
                ("leap_kuka/state", TeleopState, self._take_teleop),
                ("/diagnostics", DiagnosticArray, self._take_counts),
                ("/rosout_agg", Log, lambda log: self.hear("rosout", f"{log.name}: {log.msg}")),
            )
        ]

    def launch(self, devices: bool = True) -> None:
        """Starts the nodes, and with `devices` the simulated arm and hand, by rig.launch."""
        arguments = {**self._arguments, "devices": str(devices).lower()}
        self._launch = self._processes.start(
            "roslaunch", "--wait", str(Path(__file__).with_name("rig.launch")),
            *(f"{k}:={v}" for k, v in arguments.items()),
        )  # fmt: skip

    def _connect_headset(self, leap_port: str) -> None:
        """Lets a headset's page, a relay and the rig's way to it bring the hands of the Leap service to the rig."""
        folder = self._launch.log_path.parent
        relay, page, key = self._shared.free_port(), self._shared.free_port(), folder / "relay.key"
        key.touch(0o600)
        key.write_text(os.urandom(32).hex())
        serve = ("serve", "--host", self.wire.near, "--port", str(relay), "--page", f"headset={page}")
        served = self.run("leap_rig", "relay.py", *serve, "--key", str(key))
        url, own = f"ws://{self.wire.far}:{relay}/rig", f"headset={self._arguments['page_port']}"
        code = self.wait(lambda: re.search(r"next headset is (\d+)", self.log), "the code of the page", START_S)[1]
        self.run("leap_rig", "relay.py", "connect", url, "--page", own, "--key", str(key))
        self.wait(lambda: "A rig is connected" in served.log_path.read_text(), "the rig at the relay", START_S)
        urls = (f"ws://127.0.0.1:{leap_port}/v6.json", f"wss://{self.wire.near}:{page}/hands")
        program = ("-m", "campaign.network.headset", *urls, code)
        headset = self._processes.start(sys.executable, *program)
        self.wait(lambda: "drives" in headset.log_path.read_text(), "the headset to drive", START_S)

    def interrupt_launch(self) -> None:
        """Ends the launch file that was started last, as Ctrl-C does."""
        self._launch.send_signal(signal.SIGINT)

    def _addresses(self, device: str) -> tuple[str, str]:
        """Returns where a device listens, and where it is reached."""
        if self.wire is None or self.wire.name != device:
            return "127.0.0.1", "127.0.0.1"
        return self.wire.near, self.wire.far

    def end(self) -> None:
        """Ends everything and clears the parameters."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._processes.end_all()
        self.arm.close()
        for port in (self.hand, self.leap, self.robot_hand, *([self.camera] if self.camera else [])):
            port.close()
        with contextlib.suppress(OSError):  # a row has killed the master
            for name in rospy.get_param_names():
                if not name.startswith(("/ros", "/run_id")):
                    with contextlib.suppress(KeyError):
                        rospy.delete_param(name)

    def calm(self) -> None:
        """Brings the rig to rest: no faults, all nodes run, no hand, controls off, no safety stop, the arm at home."""
        self.hand.hide()
        if self.wire is not None:
            self.wire.set(CLEAR)
        for device in self.devices().values():
            for fault in device.ask("faults")["faults"]:
                if fault["on"]:
                    device.ask("fault", name=fault["name"], on=False)
        self.arm.ask("set_external_torque", value=[0.0] * 7)
        if self.arm.ask("state")["safety_stop"]:
            self.wait(lambda: self.arm.now.speed == 0.0, "the arm to stand", MOVE_S)
            self.arm.ask("release")
        for name in PROGRAMS:
            if self.pid(name) is None:
                self.start(name)
        self.wait(lambda: self.mode not in ("", "starting"), "the controller", MOVE_S)
        self.gripper(False)
        self.control(False)
        self.wait(self._comes_home, "the arm at home", START_S)
        self.wait(lambda: self.stream_state == "waiting", "the stream to end", MOVE_S)
        for record in (
            self.modes,
            self.desired,
            self.desired_at,
            self.commanded,
            self.stream,
            self.said,
            self.statuses,
            self.entered,
            self._last_said,
        ):
            record.clear()
        self.mark()
        self.arm.forget()

    def _comes_home(self) -> bool:
        """Returns whether the arm is at home, control off; brings it there as the operator does if it is latched."""
        if self.mode == "stopped":
            self.control(True)
        elif self.status.control_on:
            self.control(False)
        return self.mode == "home" and not self.status.control_on

    def mark(self) -> None:
        """From now on `log_since_calm` counts."""
        self._marks = {path: path.stat().st_size for path in self._logs}

    def devices(self) -> dict:
        """Returns the control ports of the simulated devices, by the names that the faults' page gives them."""
        devices = {"arm": self.arm, "leap": self.leap, "hand": self.robot_hand}
        return {**devices, "camera": self.camera} if self.camera else devices

    def pids(self) -> dict[str, int]:
        """Returns the processes of all nodes that answer, by name."""
        master = rosgraph.Master("/test")
        names = {name for kind in master.getSystemState() for _, nodes in kind for name in nodes}
        own = rospy.get_name()
        return {name: pid for name in names if name != own and (pid := self.pid(name)) is not None}

    def hear(self, who: str, text: str) -> None:
        """Records what somebody says: a topic's message, or the answer of a service."""
        if text and self._last_said.get(who) != text:
            self._last_said[who] = text
            self.said.append((clock.monotonic(), who, text))

    def streams_of(self, name: str) -> list[tuple[int, str, str]]:
        """Returns the streams of messages from a node to the nodes of PROGRAMS, as (socket, topic, node)."""
        master = rosgraph.Master("/test")
        uri, topics = master.lookupNode(f"/{name}"), {topic for topic, _ in master.getSystemState()[0]}
        found = []
        for _, peer, direction, kind, topic, connected, *how in xmlrpc.client.ServerProxy(uri).getBusInfo("/test")[2]:
            number = re.search(r"on socket (\d+)", how[0]) if how else None
            is_stream = direction == "o" and kind == "TCPROS" and connected and topic in topics  # else a service's
            if is_stream and number and peer.lstrip("/") in PROGRAMS:
                found.append((int(number[1]), topic, peer.lstrip("/")))
        return found

    def listen_anew(self) -> None:
        """Lets `hear` also record what was said last before."""
        self._last_said.clear()

    def program(self, *command: str):
        """Starts another program, which ends with the rig; returns its process."""
        return self._processes.start(*command)

    def start(self, name: str, **parameters) -> None:
        """Starts a node again that has ended; `parameters` are those under kuka/ that are changed first."""
        self.set(**parameters)
        if name == CONTROLLER:
            self.mode = ""
        self._started[name] = self.run(*PROGRAMS[name], f"__name:={name}")

    def run(self, package: str, program: str, *arguments: str) -> Any:
        """Starts a program with rosrun and returns its process, which has the attribute log_path."""
        return self.run_command("rosrun", package, program, *arguments)

    def run_command(self, *command: str) -> Any:
        """Starts a command beside the rig, as `run`; it ends with the rig at the latest."""
        return self._processes.start(*command)

    def finish(self, process: Any, seconds: float = MOVE_S) -> str:
        """Waits until a program ends by itself, and returns what it printed."""
        self.wait(lambda: process.poll() is not None, f"the end of {process.args[0]}", seconds)
        return process.log_path.read_text(errors="replace")

    def end_program(self, process: Any) -> int:
        """Interrupts a program as Ctrl-C does and returns its exit code."""
        return self._processes.end(process)

    def answer(self, text: str, *command: str) -> Any:
        """Lets a program end that asks and gets this text as its input; returns code and output."""
        return subprocess.run(command, input=text, text=True, capture_output=True, timeout=90.0, check=False)

    def deaf(self, topic: str, node: str) -> Any:
        """Subscribes to a topic of a node, and never reads a message."""
        return DeafSubscriber(topic, node)

    @contextlib.contextmanager
    def crowded(self, name: str) -> Iterator[None]:
        """Lets a node share its processor with many programs."""
        pid, core = self.pid(name), min(os.sched_getaffinity(0))
        with burners(16, core), bound(pid, core):
            yield

    def set(self, **parameters) -> None:
        """Changes parameters under kuka/, for controllers that are started later."""
        for key, value in parameters.items():
            rospy.set_param(f"kuka/{key}", value)

    def parameters(self, *keys: str) -> dict[str, object]:
        """Returns parameters under kuka/ by key."""
        return {key: rospy.get_param(f"kuka/{key}") for key in keys}

    def pid(self, name: str) -> int | None:
        """Returns the process of a node, None if it does not run."""
        try:
            uri = rosgraph.Master("/test").lookupNode(f"/{name.lstrip('/')}")
            return xmlrpc.client.ServerProxy(uri).getPid("/test")[2]
        except (rosgraph.MasterError, OSError):
            return None

    def runs(self, pid: int) -> bool:
        """Returns whether a process runs."""
        return runs(pid)

    def kill(self, pid: int, number: signal.Signals) -> None:
        """Sends a signal to a process; one that stands still tells nobody its number."""
        os.kill(pid, number)

    def signal(self, name: str, number: signal.Signals) -> None:
        """Sends a signal to a node."""
        self.kill(self.pid(name), number)

    def suspend(self, name: str) -> None:
        """Lets a node stand still, as if it hung."""
        self._shared.suspend(self.pid(name))

    def exit_code(self, name: str) -> int:
        """Waits until a node ends and returns its exit code."""
        if name in self._started:
            process = self._started[name]
            self.wait(lambda: process.poll() is not None, f"the end of {name}", MOVE_S)
            return process.returncode
        pattern = rf"\[{name}-\d+\] process has (?:finished (cleanly)|died \[pid \d+, exit code (-?\d+))"
        end = self.wait(lambda: re.search(pattern, self.log), f"the end of {name}", MOVE_S)
        return 0 if end[1] else int(end[2])

    def wait(self, condition, what: str, timeout: float = SOON_S):
        """Waits until the condition is true and returns its value; fails the test if that takes too long."""
        try:
            return self._wait_until(condition, timeout, what)
        except pytest.fail.Exception as failure:
            pytest.fail(f"{failure.msg}\n{self.situation}")

    @property
    def situation(self) -> str:
        """What is known of the rig now, for the text of a failure."""
        lines = [f"controller: mode {self.mode!r}, before: {self.modes[-12:]}"]
        if self.status is not None:
            lines.append(f"  control {'on' if self.status.control_on else 'off'}; {self.status.reason}")
        lines.append(f"stream: {self.stream_state!r}, the last of {len(self.stream)} changes:")
        lines += [f"  {state}: {why}" for state, why in self.stream[-6:]]
        if self.arm.now is not None:
            arm = self.arm.now
            lines.append(
                f"arm: mode {arm.mode!r}, fastest joint {arm.speed:.4f} rad/s, tool {arm.tool_speed:.3f} m/s at "
                f"{arm.T_base_tool[:3, 3].round(4).tolist()} m, {arm.stops} stops, safety stop: {arm.safety_stop}"
            )
        for name, tools in (("desired", self.desired), ("commanded", self.commanded)):
            if tools:
                lines.append(f"{name}: {tools[-1][:3, 3].round(4).tolist()} m, {len(tools)} frames")
        return "\n".join(["", *lines, "the end of the log:", *self.log.splitlines()[-25:]])

    def watch(self, seconds: float) -> None:
        """Lets so much time pass on the arm's clock."""
        until = self.arm.now.time + seconds
        self.wait(lambda: self.arm.now.time >= until, f"{seconds} s on the arm's clock", seconds + PATIENCE_S)

    def wait_for_mode(self, *modes: str) -> None:
        """Waits until the controller is in one of these modes."""
        self.wait(lambda: self.mode in modes, f"mode {' or '.join(modes)} instead of {self.mode}", MOVE_S)

    def wait_for_modes(self, *sequence: str) -> None:
        """Waits until the controller went through these modes in this order, perhaps with others between them."""

        def went_through():
            modes = iter(list(self.modes))
            return all(mode in modes for mode in sequence)

        self.wait(went_through, f"the modes {sequence} in {self.modes}", MOVE_S)

    def wait_until_at(self, joints: np.ndarray) -> None:
        """Waits until the arm stands at these joint angles, shape (7,) [rad]; its state is seen late."""
        self.wait(lambda: np.allclose(self.arm.now.q, joints, rtol=0.0, atol=1e-3), f"the arm at {joints}")

    def follow(self, **at: float) -> None:
        """Switches control on, brings a hand in and waits until the arm stands where the hand has sent it."""
        assert self.control(True).success
        self.engage(**at)

    def engage(self, **at: float) -> None:
        """Brings a hand in, and waits until the arm stands where it has sent it."""
        self.bring_hand(**at)
        self.wait_for_mode("servo")
        self.settle()

    def bring_hand(self, **at: float) -> None:
        """Brings a hand in, and waits until it is followed."""
        self.wait(lambda: self.stream_state != "running", "the end of the stream before")
        self.hand.show(**at)
        self.wait(lambda: self.stream_state == "running", "a hand to be followed", MOVE_S)

    def settle(self) -> None:
        """Waits until the hand, its mean and the arm in servo mode stand still."""
        self.wait(lambda: self.hand.still, "the hand to stand still", MOVE_S)
        self.see(20)
        self.wait(self._stands_in_servo_mode, "the arm to stand still in servo mode", MOVE_S)

    def _stands_in_servo_mode(self) -> bool:
        """Returns whether it has stood for half a second: the arm also stands while servo mode starts."""
        return self.mode == "servo" and max(s.speed for s in self.arm.since(self.arm.now.time - 0.5)) < STANDING

    def see(self, frames: int) -> None:
        """Waits until so many more frames with a hand have gone to the Leap driver."""
        until = self.hand.seen + frames
        self.wait(lambda: self.hand.seen >= until, f"{frames} frames with a hand")

    def listen_to_hands(self) -> list[Human]:
        """Returns a list that grows by every message on leap_motion/leap_device with a hand in it."""
        heard = []

        def take(human: Human) -> None:
            if human.nr_of_hands:
                heard.append(human)

        subscriber = rospy.Subscriber("leap_motion/leap_device", Human, take, queue_size=1000)
        self._subscribers.append(subscriber)
        self.wait(lambda: subscriber.get_num_connections() > 0, "the Leap driver")
        return heard

    def control(self, on: bool):
        """Switches control of the arm."""
        return self.call("kuka/kuka_control", setKukaControl, on)

    def gripper(self, on: bool):
        """Switches control of the robot hand."""
        return self.call("kuka/gripper_control", setGripperControl, on)

    def hold_tool(self, T_base_tool: np.ndarray, duration: float):
        """Has the arm wait at a tool pose, shape (4, 4) [m], for a hand that takes over; 0 s ends that."""
        check = self.call("kuka/check_tool_pose", CheckToolPose, stamped_pose(T_base_tool, BASE, rospy.Time.now()))
        assert check.success, check.message
        desired = stamped_pose(pose_from_message(check.desired), BASE, rospy.Time.now())
        return self.call("leap_kuka/hold_tool", HoldTool, desired, duration)

    def argument(self, name: str) -> Any:
        """Returns an argument of rig.launch."""
        return self._arguments[name]

    def moves(self) -> ActionClient:
        """Returns a client of kuka/move, connected."""
        client = ActionClient("kuka/move", MoveAction)
        assert client.wait_for_server(rospy.Duration(MOVE_S))
        return client

    def move(self, client: ActionClient | None = None, **goal):
        """Has a program move the arm (kuka_msgs/MoveGoal); returns the result as `moved`."""
        client = client or self.moves()
        client.send_goal(MoveGoal(**goal))
        return self.moved(client)

    def moved(self, client: ActionClient):
        """Waits for the end of a motion for a program and returns its result, whose sentence is heard."""
        self.wait(lambda: client.wait_for_result(rospy.Duration(0.1)), "the end of the motion", 2.0 * MOVE_S)
        result = client.get_result()
        self.hear("kuka/move", result.message)
        return result

    def call(self, name: str, kind, *values):
        """Calls a service, once it is there."""
        rospy.wait_for_service(name, MOVE_S)
        return rospy.ServiceProxy(name, kind)(*values)

    def count(self, node: str, name: str) -> int:
        """Returns a counter from /diagnostics, 0 before it came."""
        return int(self._counts.get(node, {}).get(name, 0))

    @property
    def log(self) -> str:
        """What the launch file and the nodes that were started later printed so far."""
        return "".join(path.read_text(errors="replace") for path in self._logs)

    @property
    def log_since_calm(self) -> str:
        """What of that they printed since the last `calm`."""
        texts = ((path, path.read_bytes()) for path in self._logs)
        return "".join(text[self._marks.get(path, 0) :].decode(errors="replace") for path, text in texts)

    @property
    def _logs(self) -> list[Path]:
        return sorted(self._launch.log_path.parent.glob("*.log"))

    def _take_status(self, status: KukaStatus) -> None:
        self.status = status
        self.statuses.append((clock.monotonic(), status.mode, status.control_on))
        self.hear("kuka/status", status.reason)
        self.hear("kuka/status, limited by", ", ".join(status.limited_by))

    def _take_mode(self, message: String) -> None:
        self.mode = message.data
        self.modes.append(message.data)
        self.entered.append((clock.monotonic(), message.data))

    def _take_teleop(self, message: TeleopState) -> None:
        self.stream_state = RUNNING if teleop_record(message).running else WAITING
        said = self.stream_state, message.reason
        if not self.stream or self.stream[-1] != said:
            self.stream.append(said)
        self.hear("leap_kuka/state", message.reason)

    def _take_counts(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._counts[status.name] = {v.key: v.value for v in status.values}
            self.hear(f"/diagnostics {status.name}", status.message)

    def _take_transforms(self, message: TFMessage) -> None:
        transforms = {t.child_frame_id: t for t in message.transforms}
        if {"leap_motion/virtual_frame", "kuka/tool_frame/desired"} <= transforms.keys():
            T_base_leap, T_leap_tool = (
                pose_from_transform(transforms[name].transform)
                for name in ("leap_motion/virtual_frame", "kuka/tool_frame/desired")
            )
            self.desired.append(T_base_leap @ T_leap_tool)
            self.desired_at.append(transforms["kuka/tool_frame/desired"].header.stamp.to_sec())
        if "kuka/tool_frame/commanded" in transforms:
            self.commanded.append(pose_from_transform(transforms["kuka/tool_frame/commanded"].transform))
