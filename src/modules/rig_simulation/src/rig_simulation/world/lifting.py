"""The rig's ReFlex hand on a vertical slide above a given scene: down to a grasp, close, lift, and perhaps shake.

The hand points down with half-closed fingers and descends to the palm distance of the rig's tool, or until the tips of
its fingers, were they straight, would be just above the table. Then each finger closes up to a given motor load, and
the hand rises. The hand is that of the shared world, with its springs, tendons and rubber.
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
from common.poses import check_pose, pose
from common.ros.files import read_text
from common.statistics import proportion
from rig_simulation.files import FLANGES, ROBOTS, read_urdf
from rig_simulation.world.hand_model import prepare_hand
from rig_simulation.world.mjcf import add_robot, body, child, numbers
from rig_simulation.world.parts import PhysicalMechanics

TIMESTEP_S = 0.001
P_HAND_GRIP = np.array([0.0152, 0.0, 0.150])
"""Position of the surface between the fingers in the hand's frame, as on the rig [m]."""
TIPS_M = 0.196  # from the hand's base to the tips of its straight fingers
GROUND_M = 0.004  # least height of the straight fingers' tips above the table, unless another one is asked for
START_M = 0.10  # start height above the grasp
LIFT_M = 0.10
RISE_M = 0.06  # an object that rises by this much, and stays up, counts as lifted
HALF_CLOSED_RAD = 1.6  # turn of a finger during the descent: the tips are about 0.11 m apart
CLOSING_RAD_S = 1.5
FARTHEST_RAD = 3.6
LOAD = 300.0  # effort at which a motor stops closing [0.1 %]: about 10 N at a finger's tip
DOWN_S, CLOSE_S, LIFT_S, HOLD_S = 0.8, 1.6, 1.0, 0.5
SLIDE_N = 120.0
FINGERS = 3
SLIDE = "slide"
FINGER = re.compile(r"reflex/(?:proximal|distal)_(\d)")  # name of a finger's body


def lift(
    scene: str,
    qpos: np.ndarray,
    T_world_grasp: np.ndarray,
    target: int | None = None,
    shake: bool = False,
    ground: float = GROUND_M,
) -> lift_trial.LiftResult:
    """Simulates a grasp.

    `scene`: MJCF of objects with free joints, without other joints, on a table whose top is z = 0; `qpos`: their poses;
    `T_world_grasp`: surface point between the fingers, x through both, shape (4, 4) [m]; the hand comes from above;
    `target`: number of the object that the grasp is meant for, None: whichever rises most; `shake`: after the lift;
    `ground`: least height of the straight fingers' tips above the table [m].
    Raises ValueError if the line through the fingers is vertical, or `qpos` does not match the scene.
    """
    model = mujoco.MjModel.from_xml_string(with_hand(scene, hand_pose(T_world_grasp, ground)))
    if model.nq - len(qpos) != model.nv - 6 * (len(qpos) // 7):
        raise ValueError(f"The scene with the hand has {model.nq} positions, but {len(qpos)} were given.")
    data = mujoco.MjData(model)
    mechanics = PhysicalMechanics()
    mechanics.bind(model, data)
    data.qpos[: len(qpos)] = qpos
    for finger in range(1, FINGERS + 1):
        data.joint(f"reflex/proximal_joint_{finger}").qpos[0] = HALF_CLOSED_RAD / 1.4
        data.joint(f"reflex/distal_joint_{finger}").qpos[0] = HALF_CLOSED_RAD * 0.4 / 1.4
    slide, motor = data.joint(SLIDE), model.actuator(SLIDE).id
    count = len(qpos) // 7

    def places() -> np.ndarray:
        return data.qpos[: 7 * count].reshape(count, 7)[:, :3].copy()

    before, risen, held, pushed = places(), np.zeros(count), np.zeros(count, bool), np.zeros(count)
    spools = np.full(FINGERS + 1, HALF_CLOSED_RAD)
    spools[FINGERS] = 0.0
    reached = False
    phases = (DOWN_S, CLOSE_S, LIFT_S, HOLD_S, lift_trial.SHAKE_S)
    for phase, seconds in enumerate(phases if shake else phases[:-1]):
        steps = round(seconds / TIMESTEP_S)
        for i in range(steps):
            done = (i + 1) / steps
            up = -START_M + LIFT_M
            data.ctrl[motor] = (-START_M * done, -START_M, -START_M + LIFT_M * done, up, up)[phase]
            if phase == 4:
                model.opt.gravity[:] = lift_trial.shaken_gravity(i * TIMESTEP_S)
            for finger in range(FINGERS if phase else 0):
                if mechanics.resistance(finger) < LOAD:
                    spools[finger] = min(FARTHEST_RAD, spools[finger] + CLOSING_RAD_S * TIMESTEP_S)
            mechanics.pull(spools)
            mujoco.mj_step(model, data)
        if phase == 0:
            reached = bool(abs(slide.qpos[0] + START_M) < 0.005)
            pushed = np.linalg.norm(places() - before, axis=1)
        elif phase == 1:
            held = _held(model, data, count)
        elif phase == 3:
            risen = (places() - before)[:, 2]
    kept = (places() - before)[:, 2]
    record = lift_trial.LiftRecord(reached, pushed, held, risen, kept, not data.warning.number.any())
    return lift_trial.judged(record, target, RISE_M)


def _held(model: mujoco.MjModel, data: mujoco.MjData, count: int) -> np.ndarray:
    """Returns whether two fingers touch each of the objects, which are the first bodies, shape (count,), bool."""
    touching: list[set[str]] = [set() for _ in range(count)]
    for pair in model.geom_bodyid[data.contact.geom]:
        for body_, other in (pair, pair[::-1]):
            finger = FINGER.search(model.body(other).name)
            if 1 <= body_ <= count and finger:
                touching[body_ - 1].add(finger[1])
    return np.array([len(fingers) > 1 for fingers in touching])


def hand_pose(T_world_grasp: np.ndarray, ground: float = GROUND_M) -> np.ndarray:
    """Returns the pose of the hand's base for a grasp, T_world_hand, shape (4, 4) [m]; ValueError as `lift`."""
    x = T_world_grasp[:3, 0] * (1.0, 1.0, 0.0)
    length = np.linalg.norm(x)
    if not length > 0.2:
        raise ValueError(f"The line through the fingers, {T_world_grasp[:3, 0].tolist()}, is nearly vertical.")
    x, z = x / length, np.array([0.0, 0.0, -1.0])
    R = np.column_stack([x, np.cross(z, x), z])
    p = T_world_grasp[:3, 3] - R @ P_HAND_GRIP
    p[2] = max(p[2], TIPS_M + ground)
    return pose(R, p)


def with_hand(scene: str, T_world_hand: np.ndarray) -> str:
    """Returns the scene's MJCF with the hand on a vertical slide, `START_M` above its target."""
    root = ET.fromstring(scene)
    child(root, "option").set("timestep", str(TIMESTEP_S))
    world = child(root, "worldbody")
    add_robot(root, world, read_urdf(ROBOTS[0], FLANGES[0]), np.eye(4), visuals=False)
    arm = child(world, f"body[@name='{BASE}']")
    hand = child(arm, ".//body[@name='reflex/base_link']")
    world.remove(arm)
    start = T_world_hand.copy()
    start[2, 3] += START_M
    carriage = body(world, "carriage", start)
    ET.SubElement(carriage, "joint", name=SLIDE, type="slide", axis="0 0 -1", damping="400")
    hand.attrib.update(pos="0 0 0", quat="1 0 0 0")
    carriage.append(hand)
    prepare_hand(root)
    for part in carriage.iter("body"):
        part.set("gravcomp", "1")  # the arm carries the hand
    law = {"kp": "40000", "forcerange": numbers((-SLIDE_N, SLIDE_N))}
    ET.SubElement(child(root, "actuator"), "position", {"name": SLIDE, "joint": SLIDE, **law})
    return ET.tostring(root, encoding="unicode")


DESCRIPTION = (
    "Tries grasps with the rig's ReFlex hand in MuJoCo: the file is one of `rosrun grasping evaluate_grasps.py"
    " --export`, or of `make_dataset.py --check`. Prints tables of success rates, by the quality, too; with --results"
    " it keeps each trial in a file and resumes from it."
)
SCHEMA = 2
LABELLED = 0.3  # from this quality on a label teaches angle and opening
QUALITIES = (0.001, 0.3, 0.6, 0.8)  # bounds of the table of reliability; below the first there is no label
NARROW_M = 0.045  # openings below this are of slender parts: the hand's two fingers stand 52 mm apart


def read(path: Path) -> list[dict[str, Any]]:
    """Returns the scenes of a file of grasps; raises RigError if it is invalid."""
    try:
        content = json.loads(read_text(path))
        if content["schema"] != SCHEMA:
            raise RigError(f"{path} has the schema {content['schema']!r}, but this program reads {SCHEMA}.")
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
            check_pose(grasp["T_world_grasp"])
            float(grasp["width"])
            if grasp["target"] not in range(len(scene["qpos"]) // 7):
                raise ValueError(f"the target {grasp['target']!r} is no object of scene {scene['scene']}")
        str(grasp["method"]), str(scene["split"]), grasp["peak"]


def read_trials(path: Path, shake: bool, ground: float) -> list[dict[str, Any]]:
    """Returns the trials in a file of results.

    Raises:
        RigError: it is not such a file, or its trials had another `shake` or `ground` [m], as in `lift`.
    """
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        for row in rows:
            row["scene"], row["method"]
            if row["shake"] != shake:
                raise RigError(f"{path} holds trials with{'out' * shake} a shake: name another file.")
            lowest = row.get("ground", GROUND_M)  # older files do not name it
            if not abs(lowest - ground) < 1e-9:
                raise RigError(f"{path} holds trials with --tips {1000.0 * lowest:g}: name another file.")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RigError(f"{path} is not a file of trials ({error}): name another file.") from None
    return rows


class SceneTask(NamedTuple):
    """Grasps to be tried in one scene."""

    scene: dict[str, Any]  # of the file
    methods: list[str]  # whose grasps
    conditions: dict[str, Any]  # `shake` and `ground`, as in `lift`


def try_scene(task: SceneTask) -> list[dict[str, Any]]:
    """Returns the results of the grasps; a missing grasp lifts nothing."""
    scene = task.scene
    mujoco.set_mju_user_warning(_ignore)
    rows = []
    for grasp in scene["grasps"]:
        if grasp["method"] in task.methods:
            row = {name: scene[name] for name in ("split", "scene", "objects")}
            row.update({name: grasp[name] for name in ("method", "width", "peak")}, **task.conditions)
            trial = lift_trial.LiftResult(False, 0.0, False, lift_trial.NO_GRASP)
            if grasp["T_world_grasp"] is not None:
                T = np.array(grasp["T_world_grasp"])
                trial = lift(scene["mjcf"], np.array(scene["qpos"]), T, grasp["target"], **task.conditions)
            rows.append({**row, **trial._asdict()})
    return rows


def _ignore(_text: str) -> None:
    """MuJoCo would write a log file; a trial with a warning counts as failed."""


def table(rows: list[dict[str, Any]]) -> str:
    """Returns the percentage of lifted objects as a Markdown table, with 95 % Wilson intervals in brackets."""
    groups: dict[str, Callable[[dict[str, Any]], bool]] = {
        "one object: lifted %": lambda row: row["objects"] == 1,
        "clutter: lifted %": lambda row: row["objects"] > 1,
        f"opening below {1000 * NARROW_M:.0f} mm: lifted %": lambda row: (row["width"] or 0.0) < NARROW_M,
        "wider: lifted %": lambda row: (row["width"] or 0.0) >= NARROW_M,
    }
    lines = [f"| method | {' | '.join(groups)} |", "| --- |" + " --- |" * len(groups)]
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        cells = [[row["lifted"] for row in own if belongs(row)] for belongs in groups.values()]
        lines.append(f"| {method} | {' | '.join(str(proportion(c)) if c else '-' for c in cells)} |")
    return "\n".join(lines) + "\n"


def reliability(rows: list[dict[str, Any]]) -> str:
    """Returns Markdown tables of how many objects were lifted by the quality of the grasps, and of how well a quality
    of `LABELLED` or more foretells it; empty if no grasp has a quality.
    """
    ranges = list(zip((-np.inf, *QUALITIES), (*QUALITIES, np.inf)))
    names = ["none", *(f"{low:g} to {high:g}" for low, high in ranges[1:-1]), f"{QUALITIES[-1]:g} and more"]
    judged = [row for row in rows if row["peak"]]
    lines, verdicts = [], []
    for method in dict.fromkeys(row["method"] for row in judged):
        own = [(row["peak"]["quality"], row["lifted"]) for row in judged if row["method"] == method]
        cells = [[lifted for quality, lifted in own if low <= quality < high] for low, high in ranges]
        lines.append(f"| {method} | {' | '.join(str(proportion(c)) if c else '-' for c in cells)} |")
        precision = [lifted for quality, lifted in own if quality >= LABELLED]
        recall = [quality >= LABELLED for quality, lifted in own if lifted]
        verdicts.append(f"| {method} | {' | '.join(str(proportion(c)) if c else '-' for c in (precision, recall))} |")
    if not lines:
        return ""
    header = f"\n| lifted %, by quality | {' | '.join(names)} |\n| --- |{' --- |' * len(names)}"
    verdict = f"\n| quality of {LABELLED:g} or more | precision % | recall % |\n| --- | --- | --- |"
    return "\n".join([header, *lines, verdict, *verdicts]) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Runs the program; returns the exit code."""
    parser = argparse.ArgumentParser(description=DESCRIPTION)
    parser.add_argument("file", type=Path, help="scenes and grasps")
    parser.add_argument("--results", type=Path, metavar="FILE", help="keep the trials there, and resume from it")
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
    try:
        scenes = read(options.file)
        rows = read_trials(options.results, **conditions) if options.results and options.results.exists() else []
    except (RigError, OSError) as error:
        parser.error(str(error))
    done = {(row["scene"], row["method"]) for row in rows}
    tasks = []
    for scene in scenes:
        missing = [g["method"] for g in scene["grasps"] if (scene["scene"], g["method"]) not in done]
        if missing:
            tasks.append(SceneTask(scene, missing, conditions))
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        for new in tqdm(pool.imap_unordered(try_scene, tasks), total=len(tasks), unit="scene"):
            rows += new
            if options.results:
                part = options.results.with_suffix(".part")
                part.write_text(json.dumps(rows) + "\n")
                part.replace(options.results)
    sys.stdout.write(table(rows) + reliability(rows))
    return 0
