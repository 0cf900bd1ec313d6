"""The experiment with policies, on the whole rig in virtual time: `python -m campaign.policy --help`. The rig is
that of `make demo`, with rates of campaign/rig.yaml and a camera of 6 images a second; each round has another scene."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from campaign import rig as real
from campaign.arm_trace import ArmTrace, Sample
from campaign.judge import FULL_SPEED, Limits
from common.command_line import whole
from common.errors import RigError
from kuka_control.model.rig import Rig, checked_rig
from kuka_control.model.workspace import Infeasible, Workspace
from leap_rig.operator.ros.speaker import Speaker
from leap_rig.recording.ros import record_program
from rig_msgs.msg import GuardState, KukaStatus
from rig_simulation.node_parameters import EPISODES, NEVER, POLICY, WHEN
from simulated.graph import Graph, Launch
from simulated.hand_wire import HandNetwork

RATES = Path(__file__).with_name("rig.yaml")
TASK = "Pick the cup up."
ROUND_S = 90.0  # longest time of a round, with the way home
END_S = 30.0
OPERATOR = "operator"
ROBOT_CONTROL_PORT = 30011
GUARD_OFF_M, OUTSIDE_M = 0.002, 0.01  # what an arm that follows is off by


def main() -> None:
    options = _parser().parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    git = SimpleNamespace(run=lambda *_, **__: SimpleNamespace(stdout=""), TimeoutExpired=TimeoutError)
    with pytest.MonkeyPatch.context() as patch, Graph(options.seed) as graph, HandNetwork():
        patch.setattr(record_program, "subprocess", git)  # processes have no virtual time
        patch.setattr(Speaker, "play", lambda *_: None)
        result = run(graph, options)
    print(json.dumps(result))
    if options.json:
        options.json.write_text(json.dumps({**vars(options), **result}, default=str, indent=1) + "\n")


def run(graph: Graph, options: argparse.Namespace) -> dict[str, Any]:
    """Runs all rounds on a graph; returns how they went."""
    progress = Progress()
    policy = {"policy": str(options.policy.resolve())} if options.policy else {}
    arguments = {
        **{"scenario": POLICY if options.policy else EPISODES, "rounds": str(options.rounds)},
        **{"seed": str(options.seed), "takes_over": options.takes_over, **policy},
        **{"camera": "true", "camera_rate": "6.0", "view": "none", "gui": "false", "operator_view": "false"},
        "overrides": str(RATES),
    }
    if options.session:
        words = str(options.session.resolve()), "--task", TASK, "--operator", "simulated", "--camera", "rgbd"
        recorder = graph.run("leap_rig", "record_episodes.py", *words, "--countdown", "0")
    rig = graph.launch("leap_rig", "demo.launch", **arguments)

    def begun() -> bool:
        _check_operator(rig)
        return bool(progress.step)

    graph.wait_until(begun, real.START_S, "the first round")
    progress.begin()
    graph.wait_until(lambda: begun() and progress.step == "done", options.rounds * ROUND_S, "the last round")
    progress.close()
    if options.session:
        recorder.send_signal(signal.SIGINT)
        recorder.wait(END_S)
    return progress.result


def _check_operator(rig: Launch) -> None:
    """Raises RigError if the simulated operator, who begins each round, has ended."""
    for node in rig.nodes:
        if node.mappings.get("__name") == OPERATOR and node.returncode is not None:
            said = (node.log.splitlines() or ["it said nothing"])[-1]
            raise RigError(f"The simulated operator exited with code {node.returncode}: {said}")


class Progress:
    """Follows the scenario, and counts what must not happen while the tool follows a hand or a program."""

    def __init__(self) -> None:
        self.step, self._values, self._mode = "", {}, ""
        self.broken: Counter[str] = Counter()
        self._guarded = float("inf")
        self._arm: ArmTrace | None = None
        self._rig: Rig | None = None
        self._subscribers = [
            rospy.Subscriber("simulation/scenario", DiagnosticStatus, self._take, queue_size=10),
            rospy.Subscriber("kuka/status", KukaStatus, self._take_status, queue_size=10),
            rospy.Subscriber("kuka/guard", GuardState, self._take_guard, queue_size=10),
        ]

    def begin(self) -> None:
        """Looks at the arm from now on; the controller runs."""
        self._arm = ArmTrace("127.0.0.1", ROBOT_CONTROL_PORT)
        _, self._rig = checked_rig(rospy.get_param("kuka"), "kuka/")

    def close(self) -> None:
        """Looks at it no longer."""
        if self._arm is not None:
            self._arm.close()

    @property
    def result(self) -> dict[str, Any]:
        seconds = [float(one) for one in self._values["seconds"].split(",")]
        numbers = {key: int(self._values[key]) for key in ("good", "taken") if key in self._values}
        least = None if math.isinf(self._guarded) else round(self._guarded, 4)
        return {**numbers, "seconds": seconds, "broken": dict(self.broken), "least_distance_m": least}

    def _take(self, message: DiagnosticStatus) -> None:
        values = {each.key: each.value for each in message.values}
        self.step, self._values = values["step"], values
        self._look()

    def _take_status(self, message: KukaStatus) -> None:
        if message.mode == KukaStatus.STOPPED != self._mode:
            self.broken["stopped"] += 1
        self._mode = message.mode

    def _take_guard(self, message: GuardState) -> None:
        if message.on:
            self._guarded = min(self._guarded, message.distance)
            self.broken["guard"] += message.distance < message.margin - GUARD_OFF_M

    def _look(self) -> None:
        """Counts the arm's samples since the look before that break a limit."""
        if self._arm is None or self._rig is None:
            return
        samples, self._arm.samples = self._arm.samples, []
        for one in samples:
            self.broken.update(broken_by(one, self._rig.workspace, self._mode == KukaStatus.SERVO))


def broken_by(sample: Sample, workspace: Workspace, servo: bool) -> list[str]:
    """Returns which limits the arm breaks in a sample; the workspace counts in `servo` mode alone."""
    limits, where = Limits(), sample.T_base_tool[:3, 3]
    allowed = workspace.constrain(where)
    outside = isinstance(allowed, Infeasible) or float(np.linalg.norm(allowed.position - where)) > OUTSIDE_M
    kinds = {
        "joint speed": bool(np.any(np.abs(sample.v) > limits.joint_speed * FULL_SPEED)),
        "tool speed": sample.tool_speed > limits.tool_speed,
        "workspace": servo and outside,
        "safety stop": sample.safety_stop is not None,
    }
    return [kind for kind, is_broken in kinds.items() if is_broken]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="campaign.policy", description=__doc__)
    parser.add_argument("--rounds", type=whole(1, 1000), default=10, help="default 10")
    parser.add_argument("--seed", type=whole(0, 10**6), default=0, help="of the first scene, default 0")
    parser.add_argument("--session", type=Path, help="records each round as an episode in this folder")
    parser.add_argument("--policy", type=Path, help="file of the policy that picks; none: the operator does")
    parser.add_argument("--takes-over", choices=WHEN, default=NEVER, help="with a policy: when the operator does")
    parser.add_argument("--json", type=Path, help="writes the result there, too")
    return parser


if __name__ == "__main__":
    main()
