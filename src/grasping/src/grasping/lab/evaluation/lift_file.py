"""The file with which grasps go to `rosrun rig_simulation lift_grasps.py`, and what it says of them: the rig's hand is
lifted there, since the rig's world is not known here."""

from __future__ import annotations

import json
import multiprocessing
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from common.errors import RigError
from common.lift_trial import FAILURES, LIFTED
from grasping.lab.synthetic.scene import HeapScene, world_xml
from grasping.network.maps import Peak

Task = TypeVar("Task")
SCHEMA = 2


def scene_entry(
    split: str, number: int, scene: HeapScene, friction: float, grasps: list[dict[str, Any]]
) -> dict[str, Any]:
    return {
        "split": split,
        "scene": number,
        "objects": len(scene.objects),
        "mjcf": world_xml(scene.objects, friction, fixed=scene.fixed),
        "qpos": scene.state.tolist(),
        "grasps": grasps,
    }


def grasp_entry(
    method: str, T_world_grasp: np.ndarray, width: float, target: int, peak: Peak | None, own_approach: bool = False
) -> dict[str, Any]:
    """Returns a grasp, opening `width` [m], as the file has it; `own_approach`: the hand comes along its z axis, else
    from straight above."""
    at = {"T_world_grasp": T_world_grasp.tolist(), "own_approach": own_approach}
    return {"method": method, **at, "width": width, "target": target, "peak": None if peak is None else peak._asdict()}


def no_grasp(method: str) -> dict[str, Any]:
    return {"method": method, "T_world_grasp": None, "width": None, "target": None, "peak": None}


def write(path: Path, make: Callable[[Task], dict[str, Any]], tasks: Sequence[Task], processes: int) -> None:
    """Writes the scenes that `make` returns of tasks; raises OSError."""
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        scenes = list(tqdm(pool.imap(make, tasks), total=len(tasks), unit="scene"))
    path.write_text(json.dumps({"schema": SCHEMA, "scenes": scenes}) + "\n")


@lru_cache(maxsize=1)
def results_by_scene(path: Path) -> dict[tuple[str, int], list[dict[str, Any]]]:
    """Returns `read_results` by split and scene."""
    found = defaultdict(list)
    for row in read_results(path):
        found[row["split"], row["scene"]].append(row)
    return found


def read_results(path: Path) -> list[dict[str, Any]]:
    """Returns the results of `lift_grasps.py --results`, one of each grasp; raises RigError for any other file."""
    try:
        rows = json.loads(path.read_text())
        for row in rows:
            str(row["split"]), int(row["scene"]), str(row["method"])
            if row["reason"] not in (LIFTED, *FAILURES):
                raise ValueError(f"unknown reason {row['reason']!r}")
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror}.") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RigError(f"{path} holds no results of lift_grasps.py ({error}).") from None
    return rows
