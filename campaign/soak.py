#!/usr/bin/env python3
"""`make soak HOURS=2`: the whole simulated rig works for hours, and a judgement says whether anything grows.

A simulated operator visits the Leap; about every minute a device fails, the operator recovers as the handbook says,
switches the scaling factor and other settings, and a listener or the control panel comes and goes. Every SAMPLE_S the
memory, threads, sockets and files of each process go to a file, line by line, with delays and counts. How to read the
result: docs/handbook/endurance.md. Exit code 0: steady, 1: something grows or died, 2: the rig did not start.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [] if str(ROOT) in sys.path else [str(ROOT)]

from bench.bench_demo import processes_below  # noqa: E402 - needs the path above
from campaign.soak_report import check_name, report  # noqa: E402
from common.errors import DeviceError, RigError  # noqa: E402
from common.teleop_record import teleop_record  # noqa: E402
from rig_simulation.control_port import ControlClient  # noqa: E402
from rig_simulation.faults.arm import ARM_FAULTS  # noqa: E402
from rig_simulation.faults.camera import CAMERA_FAULTS  # noqa: E402
from rig_simulation.faults.hand import HAND_FAULTS  # noqa: E402
from rig_simulation.faults.leap import LEAP_FAULTS  # noqa: E402
from simulated.ports import free_port, ports_of_a_rig  # noqa: E402
from tools.options import number  # noqa: E402

SAMPLE_S = 10.0
LEAST_HOURS = 0.05  # a shorter run cannot be judged
READY_S, END_S, ANSWER_S, RECOVERY_S = 240.0, 30.0, 10.0, 60.0
FAULT_S, WATCH_S, REST_S = (1.0, 6.0), 6.0, 30.0
LISTENER_S, PANEL_S, PANEL_EVERY = 8.0, 15.0, 5
STAGE = b"kuka_control"  # the goal is on the arm's wire
NAME = "__name:="
STAGE_TIME = struct.Struct("<7I")  # a TimeReference up to its source, as leap_rig.report.ros.listener reads it
FAULTS = {"arm": ARM_FAULTS, "leap": LEAP_FAULTS, "hand": HAND_FAULTS, "camera": CAMERA_FAULTS}
LISTENER = """if True:
    import rosgraph, rospy
    rospy.init_node("soak_listener")
    for topic, _ in rosgraph.Master("/soak_listener").getPublishedTopics(""):
        rospy.Subscriber(topic, rospy.AnyMsg, lambda message: None)
    rospy.spin()
"""


def measures(pid: int) -> dict[str, float]:
    """Returns memory [MiB], threads, sockets and open files of a process; raises psutil.Error or OSError if it has
    ended."""
    process = psutil.Process(pid)
    memory = process.memory_full_info()
    links = []
    for file in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            links.append(os.readlink(file))
    return {
        "rss": memory.rss / 2**20,
        "pss": memory.pss / 2**20,
        "threads": process.num_threads(),
        "sockets": sum(link.startswith("socket:") for link in links),
        "files": len(links),
    }


class Rig:
    """The simulated rig of demo.launch on a master and ports of its own, its nodes one by one as on the real rig."""

    def __init__(self, folder: Path) -> None:
        self._master = free_port()
        ports = ports_of_a_rig()
        self.log_folder = folder / "log"
        os.environ.update(
            ROS_MASTER_URI=f"http://localhost:{self._master}", ROS_HOSTNAME="localhost", ROS_HOME=str(folder),
            ROS_LOG_DIR=str(self.log_folder), DISPLAY="", QT_QPA_PLATFORM="offscreen",
            LEAP_RIG_NICENESS="5",  # images that yield to everything would never come on a busy machine
        )  # fmt: skip
        arguments = {
            **{"rviz": "false", "gui": "false", "operator_view": "true", "auto_start": "false"},
            **{"camera": "true", "camera_rate": "1.0", **ports},
        }
        with open(folder / "rig.log", "wb") as log:
            self._launch = subprocess.Popen(
                ["roslaunch", "-p", str(self._master), "leap_rig", "demo.launch"]
                + [f"{name}:={value}" for name, value in arguments.items()],
                stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
        self._used: dict[int, float] = {}
        self._nodes: dict[str, int] | None = None
        self.arm = ControlClient("127.0.0.1", ports["robot_control_port"])
        self.camera = ControlClient("127.0.0.1", ports["camera_control_port"])

    def processes(self, seconds: float) -> dict[str, dict[str, float]]:
        """Returns the measures of each node, the master and roslaunch by name, and its share of a processor in the last
        `seconds` [%]. What a node starts for a moment is left out."""
        used, found = {}, {}
        for pid, (words, time_used) in processes_below(self._launch.pid).items():
            name = next((word[len(NAME) :] for word in words if word.startswith(NAME)), None)
            if pid == self._launch.pid or name is None:
                name = "roslaunch" if pid == self._launch.pid else "rosmaster" if "--core" in words else None
            if name is None:
                continue
            with contextlib.suppress(OSError, psutil.Error):  # it has just ended
                share = 100.0 * (time_used - self._used.get(pid, 0.0)) / seconds
                found[name] = {"pid": pid, **measures(pid), "cpu": share}
            used[pid] = time_used
        self._used = used
        return found

    def has_camera(self) -> bool:
        """Returns whether the camera runs."""
        try:
            self.camera.ask("faults")
        except DeviceError:
            return False
        return True

    def died(self, processes: dict[str, dict[str, float]]) -> list[str]:
        """Returns what ended or was started again since the first call."""
        now = {name: int(process["pid"]) for name, process in processes.items()}
        before, self._nodes = self._nodes, now
        if before is None:
            return []
        ended = [f"{name} has ended" for name in before if name not in now]
        return ended + [f"{name} was started again" for name in now if before.get(name) != now[name]]

    def end(self) -> None:
        """Ends the rig, and what roslaunch may leave behind."""
        self.arm.close()
        self.camera.close()
        pids = set(processes_below(self._launch.pid))
        if self._launch.poll() is None:
            self._launch.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._launch.wait(END_S)
        if self._launch.poll() is None:
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        self._launch.wait()


class Ears:
    """What the rig's topics say: modes, goals, streams, delays since the last sample."""

    def __init__(self) -> None:
        import rospy
        from diagnostic_msgs.msg import DiagnosticStatus

        from rig_msgs.msg import KukaStatus, TeleopState

        self.status: KukaStatus | None = None
        self.goals = self.streams = self.servo = 0
        self._running, self._delays = False, []
        for topic, kind, take in (
            ("kuka/status", KukaStatus, self._take_status),
            ("leap_kuka/state", TeleopState, self._take_teleop),
            ("simulation/status", DiagnosticStatus, self._take_simulation),
            ("rig/stage_times", rospy.AnyMsg, self._take_time),
        ):
            rospy.Subscriber(topic, kind, take, queue_size=500)

    @property
    def mode(self) -> str:
        """The controller's mode; empty before it reported."""
        return self.status.mode if self.status else ""

    def delay(self) -> dict[str, float]:
        """Returns the delays from a frame to the goal since the last call [ms]."""
        delays, self._delays = self._delays, []
        if not delays:
            return {}
        p50, p99 = np.percentile(delays, (50, 99)).tolist()
        return {"p50": p50, "p99": p99, "samples": len(delays)}

    def _take_status(self, status) -> None:
        self.servo += status.mode == "servo" != self.mode
        self.status = status

    def _take_teleop(self, message) -> None:
        running = teleop_record(message).running
        self.streams += running and not self._running
        self._running = running

    def _take_simulation(self, message) -> None:
        self.goals = int({v.key: v.value for v in message.values}.get("goals") or self.goals)

    def _take_time(self, message) -> None:
        from common.ros.raw_tf import data_of

        data = data_of(message)
        _, stamp_s, stamp_ns, _, done_s, done_ns, length = STAGE_TIME.unpack_from(data)
        if data[STAGE_TIME.size : STAGE_TIME.size + length] == STAGE:
            self._delays.append(1e3 * (done_s - stamp_s) + 1e-6 * (done_ns - stamp_ns))


class _Stopped(Exception):
    """The run is over."""


class Operator(threading.Thread):
    """Provokes faults and recovers from each; switches settings; starts and ends listeners. `note` takes events."""

    def __init__(self, rig: Rig, ears: Ears, note: Callable[..., None], seed: int) -> None:
        super().__init__(name="operator", daemon=True)
        self._rig, self._ears, self._note, self._random = rig, ears, note, random.Random(seed)
        self._stop_request = threading.Event()
        self.doing = ""

    def stop(self) -> None:
        """Ends what it does."""
        self._stop_request.set()
        if self.ident is not None:
            self.join(END_S)

    def run(self) -> None:
        """Runs until `stop`."""
        try:
            self._step("start", self._switch, True)
            for count, (device, fault) in enumerate(self._faults()):
                seconds = self._random.uniform(*FAULT_S)
                self._step(f"{device} {fault}", self._provoke, device, fault, seconds)
                self._step("recovery", self._recover)
                self._step("listener", self._listen, count)
                self._wait(REST_S)
        except _Stopped:
            self.doing = ""
        except Exception as error:  # a defect of this program ends the faults, not the measurement
            self._note("finding", f"the simulated operator stopped: {type(error).__name__}: {error}")

    def _faults(self) -> Iterator[tuple[str, str]]:
        every = [(device, fault.name) for device, faults in FAULTS.items() for fault in faults]
        while True:
            self._random.shuffle(every)
            yield from every

    def _step(self, what: str, act: Callable, *values) -> None:
        self.doing = what
        try:
            act(*values)
        except (RigError, OSError) as error:
            self._note("finding", f"{what}: {error}")

    def _wait(self, seconds: float) -> None:
        """Raises _Stopped at `stop`."""
        if self._stop_request.wait(seconds):
            raise _Stopped

    def _call(self, name: str, kind: str, *values):
        import kuka_msgs.srv
        import reflex_msgs.srv
        import rig_msgs.srv
        from common.ros.service_calls import call

        kinds = {**vars(kuka_msgs.srv), **vars(reflex_msgs.srv), **vars(rig_msgs.srv)}
        return call(name, kinds[kind], *values, timeout=ANSWER_S)

    def _provoke(self, device: str, fault: str, seconds: float) -> None:
        self._note("fault", f"{device} {fault} {seconds:.1f} s")
        answer = self._call("simulation/fault", "SimulationFault", device, fault, True, 0.0, seconds)
        if not answer.success:
            raise DeviceError(answer.message)
        self._wait(seconds + WATCH_S)

    def _recover(self) -> None:
        """Controls off, the run key after a safety stop, other settings, controls on; tried again until that worked."""
        deadline = time.monotonic() + RECOVERY_S
        while True:
            try:
                self._call("kuka/kuka_control", "setKukaControl", False)
                if self._rig.arm.ask("state")["safety_stop"]:
                    self._rig.arm.ask("release")
                self._wait(1.0)
                self._until(lambda: self._ears.mode in ("home", "stopped"), ANSWER_S)
                self._settings()
                self._switch(True)
                self._until(lambda: self._ears.mode in ("home", "pick_up", "servo"), ANSWER_S)
                return
            except RigError:
                if time.monotonic() > deadline:
                    raise
                self._wait(1.0)

    def _switch(self, on: bool) -> None:
        for name, kind in (("kuka/gripper_control", "setGripperControl"), ("kuka/kuka_control", "setKukaControl")):
            answer = self._call(name, kind, on)
            if not answer.success:
                raise DeviceError(answer.message)

    def _until(self, condition: Callable[[], bool], seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                status = self._ears.status
                raise DeviceError(f"the mode is {self._ears.mode!r}: {status.reason if status else 'no status'}")
            self._wait(0.1)

    def _settings(self) -> None:
        import rospy

        self._call("kuka/scaling_factor", "setScalingFactor", self._random.choice((0.5, 0.8, 1.0)))
        self._call("kuka/set_payload", "setPayload", self._random.choice((0.0, 0.3)))
        self._call("reflex_takktile/set_speed", "SetSpeed", [self._random.uniform(1.0, 3.0)] * 4)
        rospy.set_param("soak", {"round": self._random.random()})
        rospy.delete_param("soak")

    def _listen(self, count: int) -> None:
        panel = count % PANEL_EVERY == PANEL_EVERY - 1
        command = ["rosrun", "kuka_control", "gui.py"] if panel else [sys.executable, "-c", LISTENER]
        end = signal.SIGKILL if count % 2 else signal.SIGINT
        self._note("listener", f"{'panel' if panel else 'listener'}, ended by {end.name}")
        process = subprocess.Popen(
            command, env={**os.environ, "DISPLAY": ":0"}, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            self._wait(PANEL_S if panel else LISTENER_S)
            if process.poll() is not None:
                raise DeviceError(f"it ended by itself with code {process.returncode}")
            os.killpg(process.pid, end)
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            raise DeviceError(f"it did not end by {end.name}") from None
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


class Soak:
    """One run; `path` takes the samples and events, one JSON object a line."""

    def __init__(self, path: Path) -> None:
        self._file = open(path, "w", buffering=1)  # noqa: SIM115 - open as long as the run
        self._began = time.monotonic()
        self._lock = threading.Lock()
        self.findings: list[str] = []

    def note(self, kind: str, text: str) -> None:
        """Writes an event: a fault, a listener or a finding."""
        if kind == "finding":
            self.findings.append(text)
        self._write({kind: text})

    def run(self, seconds: float, seed: int) -> None:
        """Runs the rig and writes; raises RigError if it does not start."""
        with tempfile.TemporaryDirectory(prefix="soak") as folder:
            rig = Rig(Path(folder))
            operator: Operator | None = None
            try:
                ears = until_home(rig, Path(folder) / "rig.log")
                operator = Operator(rig, ears, self.note, seed)
                self._sample(rig, ears, operator, seconds)
            except KeyboardInterrupt:
                print("\nThe run is interrupted; the report is about what there is.")
            finally:
                signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C would leave nodes behind
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
                if operator is not None:
                    operator.stop()
                rig.end()
                self._file.close()

    def _sample(self, rig: Rig, ears: Ears, operator: Operator, seconds: float) -> None:
        before, goals = time.monotonic(), ears.goals
        rig.died(rig.processes(1.0))
        self._began = before
        operator.start()
        for i in itertools.count(1):
            time.sleep(max(0.0, self._began + i * SAMPLE_S - time.monotonic()))
            now = time.monotonic()
            processes = rig.processes(now - before)
            for what in rig.died(processes):
                self.note("finding", what)
            delay, rate = ears.delay(), max(0, ears.goals - goals) / (now - before)
            before, goals = now, ears.goals
            self._write({
                "processes": processes, "delay": delay, "goals": rate, "streams": ears.streams, "servo": ears.servo,
                "mode": ears.mode, "log": sum(f.stat().st_size for f in rig.log_folder.rglob("*.log*")) / 2**20,
            })  # fmt: skip
            memory = sum(process["pss"] for process in processes.values())
            busy = sum(process["cpu"] for process in processes.values())
            line = (
                f"{(now - self._began) / 60:6.1f} min | {ears.mode:8} | {operator.doing:20} | {memory:6.0f} MiB | "
                f"{busy:3.0f} % CPU | {rate:3.0f} goals/s | {delay.get('p50', np.nan):4.1f} ms | "
                f"{ears.streams} streams | {len(self.findings)} findings"
            )
            print(
                f"\r\x1b[K{line}" if sys.stdout.isatty() else line, end="" if sys.stdout.isatty() else "\n", flush=True
            )
            if now - self._began >= seconds:
                print()
                return

    def _write(self, record: dict) -> None:
        with self._lock:
            if not self._file.closed:
                self._file.write(json.dumps({"t": round(time.monotonic() - self._began, 2), **record}) + "\n")


def until_home(rig: Rig, log: Path) -> Ears:
    """Waits until the arm is at home and the camera runs; raises RigError if they are not in time."""
    import rosgraph
    import rospy

    deadline = time.monotonic() + READY_S
    while not rosgraph.is_master_online():
        if time.monotonic() > deadline:
            raise RigError("The ROS master did not start.")
        time.sleep(0.2)
    rospy.init_node("soak", disable_signals=True)
    ears = Ears()
    while not (ears.mode == "home" and rig.has_camera()):
        if time.monotonic() > deadline:
            last = log.read_text(errors="replace").strip().splitlines()[-3:]
            raise RigError(f"Arm at home and camera were not there within {READY_S:.0f} s: {' '.join(last)}")
        time.sleep(0.2)
    return ears


def main(argv: list[str] | None = None) -> int:
    """Runs the soak, or judges a stored one."""
    parser = argparse.ArgumentParser(prog="soak.py", description="The simulated rig works for hours.")
    parser.add_argument("--hours", type=number(LEAST_HOURS, 10_000.0), default=2.0)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "soak.jsonl", help="where the data go")
    parser.add_argument("--seed", type=int, default=0, help="of the order of the faults")
    parser.add_argument("--judge", type=Path, metavar="FILE", help="judge the data of a run that was cut off")
    arguments = parser.parse_args(argv)
    for sign in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sign, signal.default_int_handler)
    try:
        if arguments.judge is not None:
            return report(arguments.judge)
        check_name(arguments.out)
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        if arguments.out.is_file() and arguments.out.stat().st_size:
            before = arguments.out.with_name(f"{arguments.out.stem}.before{arguments.out.suffix}")
            arguments.out.replace(before)
            print(f"The data of the run before are kept as {before}.")
        Soak(arguments.out).run(3600.0 * arguments.hours, arguments.seed)
        return report(arguments.out)
    except (RigError, OSError) as error:
        print(f"soak: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
