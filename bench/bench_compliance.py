"""A stiff arm, a soft one, and a stiff one that gives way by the PC's admittance in contact: a cup in the hand presses
on a wall, and goes into a ring with 2 mm of play that is not where it should be. The arm hears the robot application's
own words, the admittance of the force every 40 ms, as the toolbox tells it. The cup is welded to the palm, so that what
gives way is the arm; the fingers touch nothing. Simulated time: the same on every machine."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from bench.measure import Row, number
from common.frames import FLANGE
from common.poses import pose, translation
from common.rotations import rotation_about
from kuka_control.model.admittance import Admittance, AdmittanceSettings
from rig_simulation.devices.sunrise.application import ControllerIO
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.leap_rig import LeapRigApplication
from rig_simulation.devices.sunrise.robot import CYCLE_S, Robot
from rig_simulation.files import read_scene, read_urdf
from rig_simulation.world.mjcf import Touch, body, child, geom
from rig_simulation.world.model import WorldDescription, mjcf
from rig_simulation.world.parts import ArmJoints, HandPart
from rig_simulation.world.physics import World

HOME_DEG = np.array([-45.0, 30.0, 0.0, -80.0, 0.0, 70.0, 0.0])
GIVES_WAY = "admittance"
ARMS = {
    "stiff": "lrStiff_",
    "soft": "lrSoftTool_500_500_1000_100_100_100_0.7_20_100_20_100_1_",
    GIVES_WAY: "lrStiff_",
}
COLOURS = ("tab:red", "tab:blue", "tab:green")
ADMITTANCE, FORCE_S = AdmittanceSettings(), 0.04  # as kuka_control has it; how often the toolbox tells the force
TIP_M = 0.22  # of the cup's bottom from the flange
CUP_RADIUS_M, PLAY_M, RING_DEPTH_M, CHAMFER_M, PLATES = 0.035, 0.002, 0.03, 0.004, 24
ABOVE_M, INTO_M = 0.01, 0.022  # the cup begins so far above the ring, and is to go so deep into it
SPEED_M_S, GOAL_S, HOLDS_S = 0.02, 0.01, 0.8
WALL_M, PRESS_M = 0.015, 0.02  # distance of the wall, and how far behind it the goal ends
OFFSETS_MM = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
DIRECTIONS = 4
THING = Touch(kind=64, partners=64, group=0)  # cup and ring touch each other alone
COLOUR = (0.85, 0.65, 0.2)


class Contact(NamedTuple):
    """What came of it: times [s] and forces of contact [N], shape (n,); how deep the cup is in the ring [mm]; why it
    ended early, or nothing."""

    times: np.ndarray
    forces: np.ndarray
    depth: float
    ended: str


class Workplace(World):
    """The empty scene, a cup in the hand, and later a ring or a wall."""

    def __init__(self) -> None:
        self._ring: np.ndarray | None = None
        self._wall: np.ndarray | None = None
        super().__init__(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), read_scene("empty")))

    def build_in(self, ring: np.ndarray | None, wall: np.ndarray | None) -> None:
        """Adds a ring or a wall: pose of its middle, shape (4, 4), or None."""
        self._ring, self._wall = ring, wall
        self.set_scene(read_scene("empty"))

    def _build(self, description: WorldDescription) -> mujoco.MjModel:
        root = ET.fromstring(mjcf(description, visuals=False))
        world = child(root, "worldbody")
        cup = body(child(root, f".//body[@name='{FLANGE}']"), "thing/cup", translation(0.0, 0.0, TIP_M - 0.05))
        geom(cup, "thing/cup", THING, "cylinder", (CUP_RADIUS_M, 0.05), mass=1e-3, friction=0.4, colour=COLOUR)
        if self._ring is not None:
            _add_ring(body(world, "thing/ring", self._ring))
        if self._wall is not None:
            geom(body(world, "thing/wall", self._wall), "thing/wall", THING, "box", (0.01, 0.2, 0.2), friction=0.4)
        return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))

    def force(self) -> float:
        """Returns the force on ring or wall [N]."""
        return sum(contact["force"] for contact in self.contacts() if "thing/cup" in contact["bodies"])


def _add_ring(ring: ET.Element) -> None:
    """Plates around a hole, and above them plates that slope outwards."""
    inner, thick = CUP_RADIUS_M + 0.5 * PLAY_M, 0.003
    for k in range(PLATES):
        turn = rotation_about(2, 2.0 * np.pi * k / PLATES)
        wide = (inner + 2.0 * thick + CHAMFER_M) * math.tan(math.pi / PLATES)
        depth = 0.5 * (RING_DEPTH_M - CHAMFER_M)
        middle = turn @ [inner + thick, 0.0, -CHAMFER_M - depth]
        geom(ring, f"thing/ring_{k}", THING, "box", (thick, wide, depth), p=middle, R=turn, mass=0.01, friction=0.4)
        sloped = turn @ rotation_about(1, math.radians(-45.0))
        half = 0.5 * math.sqrt(2.0) * CHAMFER_M
        middle = turn @ [inner + 0.5 * CHAMFER_M, 0.0, -0.5 * CHAMFER_M] - sloped @ [0.0, 0.0, thick]
        geom(ring, f"thing/slope_{k}", THING, "box", (half, wide, thick), p=middle, R=sloped, mass=0.01, friction=0.4)


class Trial:
    """One arm at home with the cup in its hand, and its client; `ring`, `wall`: where they are from the cup's bottom,
    shape (3,) [m], or None."""

    def __init__(self, kind: str, ring: np.ndarray | None = None, wall: np.ndarray | None = None) -> None:
        robot, home = Robot(read_urdf("LBR7R800", "MF_elektrisch")), np.radians(HOME_DEG)
        tip = (robot.flange(home) @ translation(0.0, 0.0, TIP_M))[:3, 3]
        self._ring = None if ring is None else tip + ring
        upright = None if self._ring is None else pose(p=self._ring)
        facing = None if wall is None else pose(_facing(wall), tip + wall + 0.01 * wall / np.linalg.norm(wall))
        self._world = Workplace()
        self._world.add(HandPart())
        self._arm = SimulatedArm(robot, ArmSettings(speed_limit=math.inf, tool_weight=True), ArmJoints(self._world))
        self._application, self._now = LeapRigApplication(self._arm, ControllerIO()), 0.0
        self._admittance = Admittance(ADMITTANCE) if kind == GIVES_WAY else None
        self._given, self._force, self._told = np.zeros(3), np.zeros(3), -math.inf
        self._times: list[float] = []
        self._forces: list[float] = []
        self.say("lrHello_1_")
        self.say("jRelVel_0.5_")
        self.say(_goal(home))
        self.say("doPTPinJS")
        while self._application.busy:
            self._wait()
        self._world.build_in(upright, facing)
        centre = "_".join(str(1e3 * x) for x in self._arm.hand.com)
        self.say(f"lrTool_{self._arm.hand.mass}_{centre}_0_0_{1e3 * TIP_M}_0_0_0_")
        self.say(ARMS[kind])
        self.say("startDirectServoJoints")
        self._goal = home
        self._move(np.zeros(3), 0.3)

    def say(self, line: str) -> None:
        """Says a word of the wire; raises ValueError if it is refused."""
        answer = self._application.receive(line, self._now)
        if answer.startswith(("no_", "nak")):
            raise ValueError(f"{line} is answered {answer}")

    def _wait(self) -> None:
        """Waits until the next goal, alive."""
        self.say("lrBeat_")
        for _ in range(round(GOAL_S / CYCLE_S)):
            self._now += CYCLE_S
            self._application.advance(self._now)
        self._times.append(self._now)
        self._forces.append(self._world.force())

    def _move(self, way: np.ndarray, seconds: float) -> None:
        """Lets the goals of the cup's bottom go along a way, shape (3,) [m], in this time."""
        steps = round(seconds / GOAL_S)
        for _ in range(steps):
            if self._application.phase != "SERVO":
                return
            T = self._arm.robot.flange(self._goal) @ self._arm.T_flange_tool
            twist = np.concatenate([T[:3, :3].T @ (way / steps + self._gives_way()), np.zeros(3)])
            J = self._arm.robot.jacobian(self._goal, self._arm.T_flange_tool)
            self._goal = self._goal + J.T @ np.linalg.solve(J @ J.T, twist)
            self.say(_goal(self._goal))
            self._wait()

    def _gives_way(self) -> np.ndarray:
        """Returns by how much more than before the goal gives way to the force on the tool, shape (3,) [m]."""
        if self._admittance is None:
            return np.zeros(3)
        if self._now - self._told >= FORCE_S:
            self._told, self._force = self._now, self._arm.tool[:3, :3] @ self._arm.tool_force
        before, self._given = self._given, self._admittance.step(self._force, self._now - self._told, GOAL_S)
        return self._given - before

    def press(self, way: np.ndarray) -> Contact:
        """Moves the cup by a way and waits there; returns what came of it."""
        begin = len(self._times)
        self._move(way, float(np.linalg.norm(way)) / SPEED_M_S)
        self._move(np.zeros(3), HOLDS_S)
        times = np.array(self._times[begin:]) - self._times[begin]
        cup = self._world.data.body("thing/cup")
        bottom = cup.xpos + cup.xmat.reshape(3, 3) @ [0.0, 0.0, 0.05]
        depth = 0.0 if self._ring is None else 1e3 * float(self._ring[2] - bottom[2])
        ended = self._arm.gave_up or self._arm.safety_stop or ""
        return Contact(times, np.array(self._forces[begin:]), depth, ended)


def _goal(q: np.ndarray) -> str:
    return f"jp_{'_'.join(map(str, q.tolist()))}_"


def _facing(direction: np.ndarray) -> np.ndarray:
    """Returns the orientation whose x axis has a horizontal direction, shape (3, 3)."""
    return rotation_about(2, math.atan2(direction[1], direction[0]))


def pressed(kind: str) -> Contact:
    """Presses the cup on a wall, straight away from the base."""
    away = np.array([math.cos(math.radians(HOME_DEG[0])), math.sin(math.radians(HOME_DEG[0])), 0.0])
    return Trial(kind, wall=(CUP_RADIUS_M + WALL_M) * away).press((WALL_M + PRESS_M) * away)


def put_in(kind: str, offset_mm: float, direction: float) -> Contact:
    """Puts the cup into a ring that is beside its place, by an offset in a direction [rad]."""
    aside = 1e-3 * offset_mm * np.array([math.cos(direction), math.sin(direction), 0.0])
    return Trial(kind, ring=aside - [0.0, 0.0, ABOVE_M]).press(np.array([0.0, 0.0, -ABOVE_M - INTO_M]))


def is_in(contact: Contact) -> bool:
    """Whether the cup is as deep in the ring as it was to go, but for 4 mm, and nothing ended the motion."""
    return contact.depth > 1e3 * INTO_M - 4.0 and not contact.ended


def tries(quick: bool) -> Iterator[tuple[str, float, list[Contact]]]:
    """Returns what came of the cup and the ring by arm and offset [mm], one for each direction."""
    for offset in OFFSETS_MM[2:3] if quick else OFFSETS_MM:
        directions = 2.0 * np.pi * (np.arange(1 if quick or not offset else DIRECTIONS) + 0.15) / DIRECTIONS
        for kind in ARMS:
            yield kind, offset, [put_in(kind, offset, direction) for direction in directions]


def rows(quick: bool) -> list[Row]:
    """Returns the forces on the wall, and how often the cup goes into the ring and with which force, by its offset."""
    table = []
    for kind in ARMS:
        wall = pressed(kind)
        how = f"{wall.forces[-1]:.0f} N where it stands, {1e3 * PRESS_M:g} mm behind the wall; {wall.ended or 'holds'}"
        table.append(number(f"{kind} arm on a wall", float(max(wall.forces)), "N", how))
    for kind, offset, found in tries(quick):
        inside = sum(map(is_in, found))
        how = f"{inside} of {len(found)} are in; 2 mm of play, a chamfer of 4 mm"
        greatest = max(float(max(contact.forces)) for contact in found)
        table.append(number(f"{kind} arm, ring {offset:g} mm aside: force", greatest, "N", how))
        table.append(number(f"{kind} arm, ring {offset:g} mm aside: in", 100.0 * inside / len(found), "%", how))
    return table


def plot(path: Path) -> None:
    """Draws the force on the wall over time, one try in a ring that is 3 mm aside, and success and force by offset."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(11, 3.6), layout="constrained")
    wall, ring, success = figure.subplots(1, 3)
    found: dict[str, list[tuple[float, list[Contact]]]] = {kind: [] for kind in ARMS}
    for kind, offset, contacts in tries(False):
        found[kind].append((offset, contacts))
    for kind, colour in zip(ARMS, COLOURS):
        against = pressed(kind)
        wall.plot(against.times, against.forces, color=colour, label=f"{kind}, {against.forces[-1]:.0f} N at the end")
        one = dict(found[kind])[3.0][0]
        ring.plot(one.times, one.forces, color=colour, label=f"{kind}: {'in' if is_in(one) else 'not in'}")
        offsets = [offset for offset, _ in found[kind]]
        share = [100.0 * np.mean([is_in(contact) for contact in contacts]) for _, contacts in found[kind]]
        success.plot(offsets, share, "o-", color=colour, label=kind)
    for axes, what in ((wall, "Cup on a wall"), (ring, "Cup into a ring 3 mm aside")):
        axes.set(title=what, xlabel="s", ylabel="contact force [N]")
    success.set(title="Cup in the ring, 2 mm of play", xlabel="offset [mm]", ylabel="tries [%]", ylim=(-5, 105))
    for axes in (wall, ring, success):
        axes.legend()
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
