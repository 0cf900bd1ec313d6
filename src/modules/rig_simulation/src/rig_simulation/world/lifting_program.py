"""Tries grasps with the rig's ReFlex hand in MuJoCo: the file is one of `rosrun grasping evaluate_grasps.py --export`.

Prints a table of success rates; with --results it keeps each trial in a file and resumes from it.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from tqdm import tqdm

from common.errors import RigError
from common.poses import check_pose
from common.statistics import proportion
from rig_simulation.world.lifting import lift

SCHEMA = 1
NARROW_M = 0.045
"""Openings below this are of slender parts: the hand's two fingers stand 52 mm apart."""


def read(path: Path) -> list[dict[str, Any]]:
    """Returns the scenes of a file of grasps, checked.

    Raises:
        RigError: the file is invalid.
    """
    try:
        content = json.loads(path.read_text())
        if content["schema"] != SCHEMA:
            raise RigError(f"{path} has the schema {content['schema']!r}, but this program reads {SCHEMA}.")
        for scene in content["scenes"]:
            _check(scene)
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror}.") from None
    except (ValueError, KeyError, TypeError) as error:
        raise RigError(
            f"{path} is not a file of grasps ({' '.join(str(error).split())}); make it again by evaluate_grasps.py."
        ) from None
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
    if not all(math.isfinite(value) for value in scene["qpos"]):
        raise ValueError(f"the positions of scene {scene['scene']} are not finite")
    for grasp in scene["grasps"]:
        if grasp["T_world_grasp"] is not None:
            check_pose(grasp["T_world_grasp"])
            float(grasp["width"])
        str(grasp["method"])


def try_scene(task: tuple[dict[str, Any], list[str]]) -> list[dict[str, Any]]:
    """Returns the results of the grasps of some methods in one scene; a missing grasp lifts nothing."""
    scene, names = task
    mujoco.set_mju_user_warning(_ignore)
    rows = []
    for grasp in scene["grasps"]:
        if grasp["method"] in names:
            row = {name: scene[name] for name in ("scene", "objects")}
            row.update({name: grasp[name] for name in ("method", "width")})
            T = grasp["T_world_grasp"]
            found = T is not None and lift(scene["mjcf"], np.array(scene["qpos"]), np.array(T))._asdict()
            rows.append({**row, **(found or {"lifted": False, "rise": 0.0, "reached": False})})
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


def main(arguments: list[str] | None = None) -> int:
    """Runs the program; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="scenes and grasps")
    parser.add_argument("--results", type=Path, metavar="FILE", help="keep the trials there, and resume from it")
    parser.add_argument("--processes", type=int, default=1, help="number of scenes at a time")
    options = parser.parse_args(arguments)
    if options.processes < 1:
        parser.error(f"--processes is {options.processes}, but must be at least 1.")
    try:
        scenes = read(options.file)
        rows = json.loads(options.results.read_text()) if options.results and options.results.exists() else []
    except (RigError, OSError, ValueError) as error:
        parser.error(str(error))
    done = {(row["scene"], row["method"]) for row in rows}
    tasks = []
    for scene in scenes:
        missing = [g["method"] for g in scene["grasps"] if (scene["scene"], g["method"]) not in done]
        if missing:
            tasks.append((scene, missing))
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        for new in tqdm(pool.imap_unordered(try_scene, tasks), total=len(tasks), unit="scene"):
            rows += new
            if options.results:
                part = options.results.with_suffix(".part")
                part.write_text(json.dumps(rows) + "\n")
                part.replace(options.results)
    sys.stdout.write(table(rows))
    return 0
