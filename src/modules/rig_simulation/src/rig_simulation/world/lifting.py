"""The rig's ReFlex hand on a slide above a given scene: on to a grasp, close, lift straight up, and perhaps shake.

The hand points down, or along a grasp's own approach, with half-closed fingers and goes on to the palm distance of the
rig's tool, or until its palm or the tips of its fingers, were they straight, would be just above the table. Then each
finger closes up to a given motor load, and the hand rises. The hand is that of the shared world, with its springs,
tendons and rubber.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from tqdm import tqdm

from common import lift_trial
from common.config import is_number
from common.errors import RigError
from common.frames import BASE
from common.poses import check_pose, pose, translation
from common.ros.files import read_text, write_whole
from common.statistics import proportion
from rig_simulation.files import FLANGES, ROBOTS, read_urdf
from rig_simulation.world.hand_model import prepare_hand
from rig_simulation.world.mjcf import add_robot, body, child, numbers
from rig_simulation.world.parts import PhysicalMechanics

TIMESTEP_S = 0.001
P_HAND_GRIP = np.array([0.0152, 0.0, 0.150])
"""Position of the surface between the fingers in the hand's frame, as on the rig [m]."""
TIPS_M = 0.196  # from the hand's base to the tips of its straight fingers
LOWEST = np.array(
    [(0.090, side * 0.034, TIPS_M) for side in (-1.0, 1.0)]
    + [(-0.059, side * 0.008, TIPS_M) for side in (-1.0, 1.0)]
    + [(x, side * 0.053, 0.090) for x in (-0.055, 0.083) for side in (-1.0, 1.0)]
)
"""Corners of the fingers' and the thumb's tips, as deep as straight ones and as far out as half-closed ones, and of the
palm's face, in the hand's frame, shape (8, 3) [m]."""
MAX_TILT_RAD = np.radians(50.0)  # of an approach
GROUND_M = 0.004  # least height of the straight fingers' tips above the table, unless another one is asked for
START_M = 0.10  # start height above the grasp
PHASES_S = (0.8, 1.6, 1.0, 0.5, lift_trial.SHAKE_S)  # of `lift_trial.PHASES`
FINGERS = 3
SLIDE, RISE = "slide", "rise"
FINGER = re.compile(r"reflex/(?:proximal|distal)_(\d)")  # name of a finger's body


def lift(
    scene: str,
    qpos: np.ndarray,
    T_world_grasp: np.ndarray,
    target: int | None = None,
    shake: bool = False,
    ground: float = GROUND_M,
    own_approach: bool = False,
) -> lift_trial.LiftResult:
    """Simulates a grasp. `scene`: MJCF of objects with free joints, without other joints, on a table whose top is z =
    0; `qpos`: their poses; `T_world_grasp`: surface point between the fingers, x through both, shape (4, 4) [m];
    `target`: number of the object that the grasp is meant for, None: whichever rises most; `shake`: after the lift;
    `ground`: least height of the palm and of the straight fingers' tips above the table [m]; `own_approach`: the hand
    comes along the grasp's z axis, else from straight above. Raises ValueError as `hand_pose`, or if `qpos` does not
    match the scene."""
    rise_m = 0.06  # an object that rises by this much, and stays up, counts as lifted
    model = mujoco.MjModel.from_xml_string(with_hand(scene, hand_pose(T_world_grasp, ground, own_approach)))
    if model.nq - len(qpos) != model.nv - 6 * (len(qpos) // 7):
        raise ValueError(f"The scene with the hand has {model.nq} positions, but {len(qpos)} were given.")
    record = lift_trial.lift(SlidingReflex(model, qpos), PHASES_S, TIMESTEP_S, shake)
    return lift_trial.judged(record, target, rise_m)


class SlidingReflex:
    """The ReFlex hand above a scene, half closed at first, a `lift_trial.LiftingHand`."""

    def __init__(self, model: mujoco.MjModel, qpos: np.ndarray) -> None:
        half_closed_rad = 1.6  # turn of a finger during the descent: the tips are about 0.11 m apart
        self._model, self._count = model, len(qpos) // 7
        self._rises = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, RISE) >= 0
        self._data = mujoco.MjData(model)
        self._mechanics = PhysicalMechanics()
        self._mechanics.bind(model, self._data)
        self._data.qpos[: len(qpos)] = qpos
        for finger in range(1, FINGERS + 1):
            self._data.joint(f"reflex/proximal_joint_{finger}").qpos[0] = half_closed_rad / 1.4
            self._data.joint(f"reflex/distal_joint_{finger}").qpos[0] = half_closed_rad * 0.4 / 1.4
        self._spools = np.full(FINGERS + 1, half_closed_rad)
        self._spools[FINGERS] = 0.0

    def step(self, approach: float, lift: float, closing: bool, gravity: np.ndarray) -> None:
        lift_m = 0.10
        closing_rad_s = 1.5
        farthest_rad = 3.6
        load = 300.0  # effort at which a motor stops closing [0.1 %]: about 10 N at a finger's tip
        self._model.opt.gravity[:] = gravity
        back_m, up_m = -START_M * approach, lift_m * lift
        if self._rises:
            self._data.ctrl[self._model.actuator(RISE).id] = up_m
        else:
            back_m += up_m
        self._data.ctrl[self._model.actuator(SLIDE).id] = back_m
        for finger in range(FINGERS if closing else 0):
            if self._mechanics.resistance(finger) < load:
                self._spools[finger] = min(farthest_rad, self._spools[finger] + closing_rad_s * TIMESTEP_S)
        self._mechanics.pull(self._spools)
        mujoco.mj_step(self._model, self._data)

    def places(self) -> np.ndarray:
        return self._data.qpos[: 7 * self._count].reshape(-1, 7)[:, :3].copy()

    def missing(self) -> float:
        up = self._data.joint(RISE).qpos[0] if self._rises else 0.0
        return float(np.hypot(self._data.joint(SLIDE).qpos[0] + START_M, up))

    def held(self) -> np.ndarray:
        touching: list[set[str]] = [set() for _ in range(self._count)]
        for pair in self._model.geom_bodyid[self._data.contact.geom]:
            for body_, other in (pair, pair[::-1]):
                finger = FINGER.search(self._model.body(other).name)
                if 1 <= body_ <= self._count and finger:
                    touching[body_ - 1].add(finger[1])
        return np.array([len(fingers) > 1 for fingers in touching])

    def valid(self) -> bool:
        return not self._data.warning.number.any()


def hand_pose(T_world_grasp: np.ndarray, ground: float = GROUND_M, own_approach: bool = False) -> np.ndarray:
    """Returns the pose of the hand's base for a grasp, T_world_hand, shape (4, 4) [m], arguments as of `lift`; nearer
    to the table than `ground` it goes back along its approach. Raises ValueError if a hand from straight above would
    have the line through its fingers nearly vertical, or if an approach of its own is tilted too far."""
    if own_approach:
        R = T_world_grasp[:3, :3]
        tilt = np.arccos(np.clip(-R[2, 2], -1.0, 1.0))
        if not tilt <= MAX_TILT_RAD:
            most = np.degrees([tilt, MAX_TILT_RAD]).round()
            raise ValueError(f"the approach is tilted by {most[0]:.0f} degrees, and {most[1]:.0f} are possible")
    else:
        x = T_world_grasp[:3, 0] * (1.0, 1.0, 0.0)
        length = np.linalg.norm(x)
        if not length > 0.2:
            raise ValueError(f"the line through the fingers, {T_world_grasp[:3, 0].tolist()}, is nearly vertical")
        x, z = x / length, np.array([0.0, 0.0, -1.0])
        R = np.column_stack([x, np.cross(z, x), z])
    p = T_world_grasp[:3, 3] - R @ P_HAND_GRIP
    least = ground - (R[2] * LOWEST).sum(axis=1).min()
    if p[2] < least:
        p[:2] += (least - p[2]) / R[2, 2] * R[:2, 2]
        p[2] = least
    return pose(R, p)


def with_hand(scene: str, T_world_hand: np.ndarray) -> str:
    """Returns the scene's MJCF with the hand `START_M` before its target, on a slide along its approach, and if that is
    tilted, with the vertical slide for the lift."""
    slide_n = 120.0
    root = ET.fromstring(scene)
    child(root, "option").set("timestep", str(TIMESTEP_S))
    world = child(root, "worldbody")
    add_robot(root, world, read_urdf(ROBOTS[0], FLANGES[0]), np.eye(4), visuals=False)
    arm = child(world, f"body[@name='{BASE}']")
    hand = child(arm, ".//body[@name='reflex/base_link']")
    world.remove(arm)
    start = T_world_hand @ translation(0.0, 0.0, -START_M)
    carriage = body(world, "carriage", start)
    axes = {SLIDE: "0 0 -1"}
    if start[2, 2] != -1.0:
        axes[RISE] = numbers(start[2, :3])
    for name, axis in axes.items():
        ET.SubElement(carriage, "joint", name=name, type="slide", axis=axis, damping="400")
    hand.attrib.update(pos="0 0 0", quat="1 0 0 0")
    carriage.append(hand)
    prepare_hand(root)
    for part in carriage.iter("body"):
        part.set("gravcomp", "1")  # the arm carries the hand
    law = {"kp": "40000", "forcerange": numbers((-slide_n, slide_n))}
    if RISE in axes:
        child(carriage, f"joint[@name='{RISE}']").set("armature", "1")  # keeps two almost parallel slides apart
    for slide in axes:
        ET.SubElement(child(root, "actuator"), "position", {"name": slide, "joint": slide, **law})
    return ET.tostring(root, encoding="unicode")


DESCRIPTION = (
    "Tries grasps with the rig's ReFlex hand in MuJoCo: the file is one of `rosrun grasping evaluate_grasps.py"
    " --export`, or of `make_dataset.py --check`. Prints tables of success rates, by the quality, too; with --results"
    " it writes each trial to a file, too."
)


def read(path: Path) -> list[dict[str, Any]]:
    """Returns the scenes of a file of grasps; raises RigError if it is invalid."""
    schema = 2
    try:
        content = json.loads(read_text(path))
        if content["schema"] != schema:
            raise RigError(f"{path} has the schema {content['schema']!r}, but this program reads {schema}.")
        for scene in content["scenes"]:
            _check(scene)
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror}.") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise RigError(f"{path} is not a file of grasps ({reason}); make it again by evaluate_grasps.py.") from None
    if not content["scenes"]:
        raise RigError(f"{path} contains no scene.")
    return content["scenes"]


def _check(scene: dict[str, Any]) -> None:
    """Raises ValueError, KeyError or TypeError for an invalid scene."""
    int(scene["scene"]), int(scene["objects"])
    try:
        ET.fromstring(scene["mjcf"])
    except ET.ParseError as error:
        raise ValueError(f"the model of scene {scene['scene']} is not XML: {error}") from None
    if not all(is_number(value) for value in scene["qpos"]):
        raise ValueError(f"the positions of scene {scene['scene']} are not finite")
    for grasp in scene["grasps"]:
        if grasp["T_world_grasp"] is not None:
            hand_pose(check_pose(grasp["T_world_grasp"]), own_approach=_own_approach(grasp))
            float(grasp["width"])
            if grasp["target"] not in range(len(scene["qpos"]) // 7):
                raise ValueError(f"the target {grasp['target']!r} is no object of scene {scene['scene']}")
        str(grasp["method"]), str(scene["split"]), grasp["peak"]


def _own_approach(grasp: dict[str, Any]) -> bool:
    """Returns whether the hand comes along the grasp's own approach; the file need not say it of those from above."""
    return bool(grasp.get("own_approach", False))


class SceneTask(NamedTuple):
    """Grasps to be tried in one scene."""

    scene: dict[str, Any]  # of the file
    conditions: dict[str, Any]  # `shake` and `ground`, as in `lift`


def try_scene(task: SceneTask) -> list[dict[str, Any]]:
    """Returns the results of the grasps; a missing grasp lifts nothing, and one that several methods chose is tried
    once."""
    scene = task.scene
    mujoco.set_mju_user_warning(_ignore)
    rows, tried = [], {}
    for grasp in scene["grasps"]:
        row = {name: scene[name] for name in ("split", "scene", "objects")}
        row.update({name: grasp[name] for name in ("method", "width", "peak")}, **task.conditions)
        trial = lift_trial.LiftResult(False, 0.0, False, lift_trial.NO_GRASP)
        if grasp["T_world_grasp"] is not None:
            at = grasp["T_world_grasp"], grasp["target"], _own_approach(grasp)
            if str(at) not in tried:
                T, qpos = np.array(at[0]), np.array(scene["qpos"])
                tried[str(at)] = lift(scene["mjcf"], qpos, T, at[1], **task.conditions, own_approach=at[2])
            trial = tried[str(at)]
        rows.append({**row, **trial._asdict()})
    return rows


def _ignore(_text: str) -> None:
    """MuJoCo would write a log file; a trial with a warning counts as failed."""


def table(rows: list[dict[str, Any]]) -> str:
    """Returns the percentage of lifted objects as a Markdown table, with 95 % Wilson intervals in brackets."""
    narrow_m = 0.045  # openings below this are of slender parts: the hand's two fingers stand 52 mm apart
    groups: dict[str, Callable[[dict[str, Any]], bool]] = {
        "one object: lifted %": lambda row: row["objects"] == 1,
        "clutter: lifted %": lambda row: row["objects"] > 1,
        f"opening below {1000 * narrow_m:.0f} mm: lifted %": lambda row: (row["width"] or 0.0) < narrow_m,
        "wider: lifted %": lambda row: (row["width"] or 0.0) >= narrow_m,
    }
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        cells = [[row["lifted"] for row in own if belongs(row)] for belongs in groups.values()]
        lines.append([method, *map(_percent, cells)])
    return _table(["method", *groups], lines)


def reliability(rows: list[dict[str, Any]]) -> str:
    """Returns Markdown tables of how many objects were lifted by the quality of the grasps, and of how well a quality
    of 0.3 or more foretells it; empty if no grasp has a quality."""
    labelled = 0.3  # from this quality on a label teaches angle and opening
    qualities = (0.001, 0.3, 0.6, 0.8)  # bounds of the table of reliability; below the first there is no label
    ranges = list(zip((-np.inf, *qualities), (*qualities, np.inf)))
    names = ["none", *(f"{low:g} to {high:g}" for low, high in ranges[1:-1]), f"{qualities[-1]:g} and more"]
    judged = [row for row in rows if row["peak"]]
    lines, verdicts = [], []
    for method in dict.fromkeys(row["method"] for row in judged):
        own = [(row["peak"]["quality"], row["lifted"]) for row in judged if row["method"] == method]
        lines.append([method, *(_percent([up for q, up in own if low <= q < high]) for low, high in ranges)])
        precision = [lifted for quality, lifted in own if quality >= labelled]
        recall = [quality >= labelled for quality, lifted in own if lifted]
        verdicts.append([method, _percent(precision), _percent(recall)])
    if not lines:
        return ""
    by_quality = _table(["lifted %, by quality", *names], lines)
    return f"\n{by_quality}\n" + _table([f"quality of {labelled:g} or more", "precision %", "recall %"], verdicts)


def _percent(outcomes: list[bool]) -> str:
    return str(proportion(outcomes)) if outcomes else "-"


def _table(header: list[str], rows: list[list[str]]) -> str:
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (header, ["---"] * len(header), *rows))


def main(arguments: list[str] | None = None) -> int:
    """Runs the program; returns the exit code."""
    parser = argparse.ArgumentParser(description=DESCRIPTION)
    parser.add_argument("file", type=Path, help="scenes and grasps")
    parser.add_argument("--results", type=Path, metavar="FILE", help="write the trials there, too")
    parser.add_argument("--processes", type=int, default=1, help="number of scenes at a time")
    parser.add_argument("--shake", action="store_true", help="shake the hand after the lift, 0.5 g along three axes")
    usual = 1000.0 * GROUND_M
    tips_help = f"least height above the table that the fingers' tips would have, were they straight, default {usual:g}"
    parser.add_argument("--tips", type=float, default=usual, metavar="MM", help=tips_help)
    options = parser.parse_args(arguments)
    if options.processes < 1:
        parser.error(f"--processes is {options.processes}, but must be at least 1.")
    if not 0.0 <= options.tips <= 100.0:
        parser.error(f"--tips is {options.tips:g} mm, but must be between 0 and 100.")
    conditions = {"shake": options.shake, "ground": options.tips / 1000.0}
    rows: list[dict[str, Any]] = []
    try:
        scenes = read(options.file)
        if options.results:
            options.results.open("x").close()  # before the hours of lifting
            sys.stderr.write(f"After each scene its trials are in {options.results}.\n")
        tasks = [SceneTask(scene, conditions) for scene in scenes]
        with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
            for new in tqdm(pool.imap(try_scene, tasks), total=len(tasks), unit="scene"):
                rows += new
                if options.results:
                    write_whole(options.results, json.dumps(rows) + "\n")
    except FileExistsError:
        parser.error(f"{options.results} is there already: name another file.")
    except (RigError, OSError) as error:
        parser.error(str(error))
    sys.stdout.write(table(rows) + reliability(rows))
    return 0
