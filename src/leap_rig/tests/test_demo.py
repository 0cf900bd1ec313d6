"""The demonstrations in virtual time, with the parameters as shipped: demo.py, its launch files and the report."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from common import clock
from rig_simulation.control_port import ControlClient

pytest.importorskip("rig_msgs.srv")
import rospy
from std_srvs.srv import Trigger, TriggerResponse

from common.teleop_record import LED
from rig_msgs.msg import KukaStatus, TeleopState
from rig_msgs.srv import ChooseArm
from simulated.hand_wire import HandNetwork

pytestmark = pytest.mark.ros

END_S = 30.0
"""Longest time that a node may take to its end."""
ROBOT_CONTROL_PORT, WORLD_PORT = 30011, 30021
SEED = 1002
"""Of a scene that the shipped policy manages."""
CEILING = Path(__file__).parents[2] / "kuka_control" / "config" / "ceiling.yaml"
WITHOUT_WORLD = {"world": "false"}
"""For tests in which nothing is touched: physics takes time."""


class LaunchParent:
    """Stands for roslaunch.parent.ROSLaunchParent on a graph."""

    def __init__(self, graph, files, listeners):
        self._graph, ((self._file, self._arguments),), self._listeners = graph, files, listeners
        self.pm = SimpleNamespace(get_process_names_with_spawn_count=lambda: ((), ()))
        self.nodes = []

    def start(self, auto_terminate):
        arguments = dict(each.split(":=", 1) for each in self._arguments)
        self.nodes = self._graph.launch("", self._file, **arguments).nodes
        for node in self.nodes:
            clock.Thread(target=self._watch, args=(node,), name="watch", daemon=True).start()

    def shutdown(self):
        self._listeners = []
        running = [node for node in self.nodes if node.poll() is None]
        for node in running:
            node.send_signal(signal.SIGINT)
        assert not any([node.wait(END_S) for node in running])

    def _watch(self, node):
        node.ended.wait()
        name = f"{node.namespace}{node.mappings['__name']}".lstrip("/")
        for listener in self._listeners:
            listener.process_died(f"{name}-1", node.returncode)


def report_of(demo, seconds, code=0):
    """Waits for the end of a demo, and returns its report."""
    assert demo.wait(seconds) == code, demo.log
    return json.loads(Path(demo.argv[demo.argv.index("--report") + 1]).read_text())


@pytest.fixture
def demo(virtual_graph, monkeypatch, tmp_path):
    """Starts a demo; returns its node."""
    from leap_rig.ros import demo

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setenv("ROSCONSOLE_FORMAT", "")  # which it changes
    monkeypatch.setattr(
        demo.roslaunch.parent, "ROSLaunchParent",
        lambda _, files, process_listeners, **__: LaunchParent(virtual_graph, files, process_listeners),
    )  # fmt: skip
    monkeypatch.setattr(demo.roslaunch.rlutil, "get_or_generate_uuid", lambda *_: "")
    monkeypatch.setattr(demo.rosgraph, "is_master_online", lambda: True)
    monkeypatch.setattr(demo, "end_closed_servers", lambda: None)
    words = ("leap_rig", "demo.py", "--headless", "--report", str(tmp_path / "report.json"))
    with HandNetwork():
        yield lambda *arguments, **launch: virtual_graph.run(
            *words, *arguments, "--", *(f"{name}:={value}" for name, value in launch.items())
        )


def assert_sound(summary):
    """Each message of the tracker came, the arm followed it closely, and nothing stopped it."""
    assert summary["faults"] == [] and summary["nodes_died"] == [] and summary["safety_stops"] == 0
    assert summary["streams"] and summary["frames_received"] == pytest.approx(114.5 * summary["duration_s"], rel=0.01)
    goals = summary["delay_ms"]["frame received to goal on the arm's wire"]
    assert goals["samples"] > 0.9 * summary["frames_received"] and goals["p95"] < 4.0


def test_the_simulated_operator_picks_a_cup_up_and_puts_it_down(demo):
    summary = report_of(demo("--scenario", "pick_cup"), 60.0)
    assert_sound(summary)
    assert summary["scenario"]["step"] == "done" and summary["duration_s"] == pytest.approx(22.0, abs=1.5)
    cup = summary["objects"]["cup"]
    assert cup["picked_and_placed"] and cup["lifted_mm"] > 195.0 and cup["tilt_deg"] < 5.0
    assert summary["servo_goals_sent"] > 6000 and max(summary["hand_travel_rad"]) > 1.5
    assert summary["tracking_error"]["commanded"]["rms_mm"] < 2.0
    assert summary["hand_to_arm_ms"]["p50"] < 70.0


def test_the_simulated_operator_records_episodes_of_a_cup_that_stands_elsewhere_each_time(demo):
    marks, places = [], []

    def mark(name):
        marks.append(name)
        seen = ControlClient("127.0.0.1", WORLD_PORT).ask("objects")["objects"]["cup"]
        places.append(seen["position"][:2] if name == "begin" else seen["clearance"])
        return TriggerResponse(True, "")

    for name in ("begin", "success", "failure"):
        rospy.Service(f"episodes/{name}", Trigger, lambda _, name=name: mark(name))
    summary = report_of(demo("--scenario", "episodes", rounds=2, seed=3), 90.0)
    assert summary["faults"] == [] and summary["nodes_died"] == [] and summary["safety_stops"] == 0
    assert marks == ["begin", "success"] * 2 and np.linalg.norm(np.subtract(places[2], places[0])) > 0.02
    assert places[1] > 0.1 and places[3] > 0.1, "the cup is up at the end of each"
    assert summary["scenario"]["good"] == summary["scenario"]["rounds"] == "2"


def test_an_arm_that_hangs_from_the_ceiling_follows(demo):
    options = {"mounting": "180 0 0", "overrides": CEILING, "leap_args": "--figure line --size 40"}
    summary = report_of(demo("--duration", "10", **options, **WITHOUT_WORLD), 40.0)
    assert_sound(summary)
    assert summary["tracking_error"]["commanded"]["rms_mm"] < 3.0


def test_two_arms_follow_a_hand_each(demo):
    summary = report_of(demo("--duration", "6", robots=2, leap_args="--figure line --size 40"), 40.0, code=1)
    assert summary["nodes_died"] == [] and set(summary["arms"]) == {"left", "right"}
    for part in summary["arms"].values():
        assert part["faults"] == ["The robot hand never moved."], "there was no time for that"
        assert part["streams"] and part["safety_stops"] == 0 and part["tool_path_m"] > 0.2
        assert part["tracking_error"]["commanded"]["rms_mm"] < 3.0


def handbook_node():
    """The text of the node on the page about extending."""
    page = (Path(__file__).parents[3] / "docs" / "handbook" / "extending.md").read_text()
    (text,) = re.findall(r"```python\n(#!/usr/bin/env python3\n.*?)```", page, re.DOTALL)
    return text


def test_the_handbooks_node_moves_the_arm_of_a_demo_without_teleoperation(demo, virtual_graph):
    running = demo("--tracker", "none", "--duration", "10", **WITHOUT_WORLD)
    states = virtual_graph.record("kuka/status", KukaStatus)
    virtual_graph.wait_until(lambda: "Ready" in running.log, 30.0, "the arm at home")
    program = compile(handbook_node(), "circle.py", "exec")
    circle = virtual_graph.start("circle.py", lambda: exec(program, {"__name__": "__main__"}))
    virtual_graph.wait_until(lambda: states[-1].mode == "servo", 8.0, "the arm that follows")
    clock.sleep(1.0)
    assert states[-1].reason == "The arm follows the desired tool frame in servo mode."
    summary = report_of(running, 40.0)
    circle.send_signal(signal.SIGINT)
    assert circle.wait(END_S) == 0
    assert summary["faults"] == [] and not summary["teleoperated"] and summary["hand_commands"] is None
    assert summary["tool_path_m"] > 0.3 and "The arm followed, no node died." in running.log
    assert "| arm servo" in running.log and "hand waits" not in running.log


def test_with_control_off_nothing_moves_and_a_dead_node_is_named(demo, virtual_graph):
    running = demo(auto_start="false", **WITHOUT_WORLD)
    virtual_graph.wait_until(lambda: "Ready" in running.log, 30.0, "the arm at home")
    clock.sleep(3.0)
    (teleop,) = (node for node in virtual_graph.nodes if node.name == "/leap_teleop")
    teleop.send_signal(signal.SIGKILL)
    summary = report_of(running, 5.0, code=1)
    *dead, follows, moves = summary["faults"]
    assert "leap_teleop" in " ".join(dead) and "arm never followed" in follows and "hand never moved" in moves
    assert summary["tool_path_m"] < 1e-3


@pytest.mark.long
def test_the_simulated_operator_plays_the_tutorial(demo):
    running = demo("--tutorial", "--language", "de", **WITHOUT_WORLD)
    summary = report_of(running, 60.0)
    assert_sound(summary)
    assert summary["scenario"] == {"scenario": "tutorial", "step": "done", "failure": ""}
    names = ("Hand flach halten", "Auf Grün warten", "Langsam bewegen", "Finger schließen", "Hand neigen")
    ticks = [running.log.index(f"✔ {name}") for name in (*names, "Hand wegnehmen")]
    assert ticks == sorted(ticks)


@pytest.mark.parametrize("scenario", ["clutch", pytest.param("two_hands", marks=pytest.mark.long)])
def test_the_simulated_operator_clutches_and_continues_from_there(demo, scenario):
    summary = report_of(demo("--scenario", scenario), 60.0)
    report = summary["scenario"]
    assert report["step"] == "done" and summary["faults"] == [] and summary["returns_home"] == 0
    assert report["clutched"] == "3" and float(report["travel_mm"]) > 200.0
    assert float(report["engagement_step_mm"]) < 2.0
    kept = [stream["reason"] for stream in summary["streams"][:-1]]
    assert len(kept) == 3 and all("the clutch is pressed; the tool stays for 3" in reason for reason in kept)


def test_the_collision_guard_holds_the_tool_before_a_wall_and_lets_it_back(demo):
    summary = report_of(demo("--scenario", "wall"), 60.0)
    report = summary["scenario"]
    assert summary["faults"] == [] and report["step"] == "done" and report["way_back"] == "true"
    assert float(report["smallest_mm"]) > 29.0 and float(report["held_s"]) == pytest.approx(8.5, abs=1.0)


@pytest.mark.long
def test_a_proposed_grasp_is_corrected_by_hand_lifted_and_put_down(demo):
    summary = report_of(demo("--scenario", "assisted_grasp"), 200.0)
    assert summary["scenario"]["step"] == "done" and summary["faults"] == []
    (grasp,) = summary["grasps"]
    assert grasp["executed"] >= 1 and grasp["held"] and grasp["lifted_mm"] > 100.0
    assert grasp["correction_mm"] < 60.0
    assert summary["objects"][grasp["object"]]["picked_and_placed"]


def held_by_left_alone(world):
    box = world.ask("objects")["objects"]["box"]
    return box["clearance"] > 0.05 and {body.split("/")[0] for body in box["touches"]} == {"left"}


@pytest.mark.long
def test_two_arms_hand_a_box_over_and_the_one_that_is_not_chosen_holds_its_tool(demo, virtual_graph):
    """With relative engagement, which the choice of an arm needs: neither the choice nor its end moves a tool."""
    running = demo("--scenario", "hand_over", robots=2, arm_choice="service")
    choose = rospy.ServiceProxy("leap_kuka/choose_arm", ChooseArm)
    virtual_graph.wait_until(lambda: "Ready" in running.log, 30.0, "the arms at home")
    left, world = (ControlClient("127.0.0.1", port) for port in (ROBOT_CONTROL_PORT, WORLD_PORT))
    virtual_graph.wait_until(lambda: held_by_left_alone(world), 30.0, "the box in the left hand")
    answer = choose("middle")
    assert not answer.success and "the arm is 'middle', but must be left, right or both" in answer.message
    assert choose("right").success
    clock.sleep(0.5)
    before = left.ask("state")["joints"]
    for _ in range(15):
        clock.sleep(0.2)
        np.testing.assert_allclose(left.ask("state")["joints"], before, atol=1e-3)
    assert choose("both").success
    summary = report_of(running, 120.0)
    assert summary["faults"] == [] and set(summary["arms"]) == {"left", "right"}
    for part in summary["arms"].values():
        assert part["scenario"]["step"] == "done" and part["streams"] and part["safety_stops"] == 0
        assert max(part["hand_travel_rad"]) > 1.0
    box = summary["objects"]["box"]
    assert box["picked_and_placed"] and box["at_m"][1] < -0.1


def test_the_shipped_policy_lifts_a_cup_and_the_operator_takes_over_and_gives_back(demo):
    states = []
    rospy.Subscriber("leap_kuka/state", TeleopState, lambda m: states.append((m.state, m.hold)), queue_size=100)
    summary = report_of(demo("--scenario", "policy", rounds=1, seed=SEED), 90.0)
    assert summary["faults"] == [] and summary["nodes_died"] == [] and summary["safety_stops"] == 0
    assert (summary["scenario"]["good"], summary["scenario"]["taken"]) == ("1", "1")
    assert summary["objects"]["cup"]["lifted_mm"] > 50.0
    led = [hold == LED for _, hold in states]
    taken = states.index(("running", "taken"))
    assert led.index(True) < taken and any(led[taken:]), "it leads, is taken over, and leads again"
