"""Episodes of a simulated operator, in the very form of the recorded ones: scene, images, GGCNN's maps, the grasp.

Whether the thing was held says the physics: the parallel gripper of `evaluation.lifting` goes to the operator's grasp
as wide open as the operator opens the hand, and lifts. The opening stands in the fingers' angles, as a recorded hand's.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import cv2
import numpy as np

from common.poses import inverse, pose, read_only
from grasping.lab.dataset import opening
from grasping.lab.dataset.episode import TELEOPERATION, Episode, Metadata
from grasping.lab.evaluation import trials
from grasping.lab.evaluation.lifting import lift
from grasping.lab.synthetic import labels, samples, sensor, simulated_operator
from grasping.network import depth_image, maps
from grasping.network.depth_image import CAMERA
from grasping.network.networks import MapNetwork, infer

SMOOTHING = maps.Smoothing(quality=2.0)
MAP_SIDE = 150
FRAME_S, REACH_S = 0.5, 2.0
"""Between two frames; from the last one to the closing of the fingers [s]."""
OPERATOR = "simulated"
NAME = re.compile(r"simulated_(\w+)_(\d+)")
SETTINGS_VERSION = 2


class OperatorGrasp(NamedTuple):
    """The operator's grasp."""

    T_base_grasp: np.ndarray  # shape (4, 4) [m]
    opening: float  # of the hand before it closes [m]


class EpisodeScene(NamedTuple):
    """A scene and what an operator and a network know of it."""

    view: samples.SceneView  # the scene, as the camera sees it
    labels: labels.Labels  # of the pixels of the network's image
    depth: np.ndarray  # exact, in that image [m]
    friction: float  # of the scene
    T_base_world: np.ndarray  # shape (4, 4) [m]


def file_name(split: str, number: int) -> str:
    """Returns the name, without its ending, of the file of an episode."""
    return f"simulated_{split}_{number:06d}"


def scene_of(name: str) -> tuple[str, int] | None:
    """Returns split and number of the scene of an episode's file; None where the file is no simulated one's."""
    found = NAME.fullmatch(name)
    return None if found is None else (found[1], int(found[2]))


def situation(split: str, number: int) -> EpisodeScene:
    """Returns scene `number` of a split: one object where the number is even, else two or three."""
    seen = samples.view(split, number, 1 if number % 2 == 0 else 2 + number // 2 % 2)
    side = depth_image.NETWORK_SIDE
    exact = cv2.resize(seen.exact, (side, side), interpolation=cv2.INTER_NEAREST)
    found = labels.best(labels.grasps(seen.surface, seen.table, samples.CELL_M, samples.GRIPPER))
    focal = seen.camera.focal * side / depth_image.CROP_SIDE
    of_pixels = labels.in_image(found, seen.surface, samples.CELL_M, exact, focal)
    friction = float(np.random.default_rng([98, number]).uniform(*trials.FRICTION))
    return EpisodeScene(seen, of_pixels, exact, friction, inverse(simulated_operator.base_in_world(seen.camera)))


def intended(of: EpisodeScene, made: Episode) -> np.ndarray:
    """Returns the grasp of an episode as the simulated operator meant it, without its tremor, T_base_grasp, shape (4,
    4) [m]: no prediction can be expected to be nearer.
    """
    who = simulated_operator.SimulatedOperator(**made.metadata.configuration["person"])
    steady = who._replace(tremor_m=0.0, tremor_rad=0.0)
    found = _grasp(of, steady, np.random.default_rng(0))
    assert found is not None, "an episode is of a grasp"
    return found.T_base_grasp


def held(of: EpisodeScene, T_base_grasp: np.ndarray, width: float = samples.GRIPPER.opening) -> bool:
    """Returns whether the gripper, open by `width` [m], lifts something there."""
    T_world_grasp = inverse(of.T_base_world) @ T_base_grasp
    return lift(of.view.scene, T_world_grasp, width, samples.GRIPPER, of.friction).lifted


def episode(
    split: str,
    number: int,
    network: MapNetwork,
    network_sha256: str,
    who: simulated_operator.SimulatedOperator,
    frames: int,
) -> Episode | None:
    """Returns the episode of a scene, None where the operator finds nothing to grasp.

    Args:
        frames: images, each with the camera's faults drawn again.
    """
    of = situation(split, number)
    rng = np.random.default_rng([97, number])
    chosen = _grasp(of, who, rng)
    if chosen is None:
        return None
    T_base_grasp = chosen.T_base_grasp
    T_base_camera = of.T_base_world @ pose(of.view.camera.R, of.view.camera.position)
    stored: dict[str, list] = {"depth": [], "maps": [], "mean": [], "peak": []}
    for _ in range(frames):
        depth = np.nan_to_num(np.round(1000.0 * sensor.observe(of.view.exact, rng))).astype(np.uint16)
        image = depth_image.prepare(depth * np.float32(0.001), trials.CROP)
        output = infer(network, image.input)
        peak = maps.highest(maps.smoothed(output, image.valid, SMOOTHING))
        small = np.stack([cv2.resize(m, (MAP_SIDE, MAP_SIDE), interpolation=cv2.INTER_AREA) for m in output])
        for name, value in zip(stored, (depth, small.astype(np.float16), image.mean, peak)):
            stored[name].append(value)
    lifted = held(of, *chosen)
    stamp = FRAME_S * np.arange(frames)
    return Episode(
        metadata=_metadata(of, who, lifted, network_sha256),
        camera=trials.camera(),
        crop=trials.CROP,
        T_flange_tool=np.eye(4),
        T_tool_grasp=np.eye(4),
        T_base_tool_closed=read_only(T_base_grasp),
        t_grasp=float(stamp[-1] + REACH_S),
        held=lifted,
        stamp=stamp,
        depth=np.stack(stored["depth"]),
        maps=np.stack(stored["maps"]),
        mean=np.array(stored["mean"], np.float32),
        peak=np.array(stored["peak"], float),
        T_base_camera=np.stack([T_base_camera] * frames),
        T_base_tool_measured=np.stack([T_base_grasp] * frames),
        T_base_tool_desired=np.full((frames, 4, 4), np.nan),
        finger_angles=np.tile(opening.angles(chosen.opening), (frames, 1)).astype(np.float32),
        teleop_active=np.ones(frames, bool),
    )


def _grasp(
    of: EpisodeScene, who: simulated_operator.SimulatedOperator, rng: np.random.Generator
) -> OperatorGrasp | None:
    camera = of.view.camera
    places = simulated_operator.points(of.depth, camera)
    height = places[..., 2]
    pixel_m = of.depth * camera.side / len(of.depth) / camera.focal
    pixel = simulated_operator.chosen_pixel(who, of.labels, height, of.labels.opening * pixel_m)
    if pixel is None:
        return None
    angle = float(of.labels.angle[pixel]) + who.turn * max(0.0, height[pixel])
    line = camera.R @ np.array([np.cos(angle), -np.sin(angle), 0.0])
    leant = simulated_operator.lean(who, height, float(pixel_m[pixel]), pixel)
    R, p = of.T_base_world[:3, :3], of.T_base_world[:3, 3]
    T_base_grasp = simulated_operator.grasp_pose(who, R @ places[pixel] + p, R @ line, leant, rng)
    needed = float(of.labels.opening[pixel] * pixel_m[pixel])
    return OperatorGrasp(T_base_grasp, simulated_operator.opening(who, needed, float(height[pixel]), rng))


def _metadata(
    of: EpisodeScene, who: simulated_operator.SimulatedOperator, lifted: bool, network_sha256: str
) -> Metadata:
    return Metadata(
        version="0.1.0",
        revision="",
        date="",
        operator=OPERATOR,
        object=", ".join(of.view.scene.families),
        source=TELEOPERATION,
        reason="lifted by a parallel gripper in simulation" if lifted else "not lifted in simulation",
        configuration={
            "simulated": SETTINGS_VERSION,
            "person": who._asdict(),
            "view": CAMERA,
            "crop": {"side": trials.CROP.side, "rows_up": 0},
            "table": None,
            "weights": network_sha256,
        },
    )
