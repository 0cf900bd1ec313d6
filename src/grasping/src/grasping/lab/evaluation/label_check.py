"""Grasps of a scene with the quality that labels give them, for physics to judge: a random one, and the best one.

The random grasp is a pixel of an object and a direction that depend on the scene's number alone, so that labels of
several hands are judged on the same grasps, and the fractions are those of all grasps.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from common.poses import pose
from common.rotations import rotation_about
from grasping.lab.evaluation.lifting import nearest_object
from grasping.lab.evaluation.trials import FRICTION
from grasping.lab.synthetic import labels, samples
from grasping.lab.synthetic.scene import world_xml
from grasping.network.maps import Peak

SCHEMA = 2  # of the file of `evaluate_grasps.py --export`
RANDOM, BEST = "random grasp", "best label"


def scene_grasps(split: str, number: int, settings: samples.LabelSettings) -> dict[str, Any]:
    """Returns a scene and its grasps as a file of grasps has them; there is no best grasp where none has a label."""
    seen = samples.view(split, number)
    of_hand = samples.hand_grasps(seen, settings)
    rng = np.random.default_rng([77, number])
    friction, turned = float(rng.uniform(*FRICTION)), int(rng.integers(2))
    best = of_hand.in_image(labels.best(of_hand.found))
    pixel = np.unravel_index(np.argmax(best.quality), best.quality.shape)
    chosen = {BEST: (pixel, best)} if best.quality[pixel] > 0.0 else {}
    rows, columns = np.nonzero(heights(seen, of_hand) > labels.LOWEST_OBJECT_M)
    i, k = rng.integers(len(rows)), rng.integers(len(of_hand.found.angles))
    angle, score = of_hand.found.angles[k], of_hand.found.scores[k]
    one = labels.Labels(score, np.full_like(score, angle), of_hand.found.openings[k], np.ones_like(score, bool))
    chosen[RANDOM] = (rows[i], columns[i]), of_hand.in_image(one)
    grasps = []
    for method, (at, label) in chosen.items():
        d = float(of_hand.exact[at])
        T_camera_grasp = pose(rotation_about(2, np.pi * turned - float(label.angle[at])), d * _ray(at, of_hand))
        T = pose(seen.camera.R, seen.camera.position) @ T_camera_grasp
        peak = Peak(int(at[0]), int(at[1]), *(float(v[at]) for v in (label.quality, label.angle, label.opening)))
        target = nearest_object(seen.scene, T[:3, 3])
        found = {"width": peak.width * d / of_hand.focal, "target": target, "peak": peak._asdict()}
        grasps.append({"method": method, "T_world_grasp": T.tolist(), **found})
    return {
        "split": split,
        "scene": number,
        "objects": len(seen.scene.objects),
        "mjcf": world_xml(seen.scene.objects, friction),
        "qpos": seen.scene.state.tolist(),
        "grasps": grasps,
    }


def heights(seen: samples.SceneView, of_hand: samples.SceneGrasps) -> np.ndarray:
    """Returns the height above the table that each pixel of the network's image sees, shape (300, 300) [m]."""
    rays = _ray(np.indices(of_hand.exact.shape), of_hand)
    return seen.camera.position[2] + np.tensordot(seen.camera.R[2], rays, 1) * of_hand.exact


def _ray(at: Any, of_hand: samples.SceneGrasps) -> np.ndarray:
    """Returns the viewing directions of pixels (row, column) with z = 1, shape (3, ...)."""
    row, column = np.asarray(at[0]), np.asarray(at[1])
    middle = 0.5 * (len(of_hand.exact) - 1)
    return np.stack([(column - middle) / of_hand.focal, (row - middle) / of_hand.focal, np.ones(row.shape)])
