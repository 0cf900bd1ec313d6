"""A simulated operator who grasps, and episodes of it in the very form of the recorded ones.

Stands in for a teleoperating operator where none is at hand; whatever was found with it is to be called simulated. It
sees the exact labels, prefers high and slender parts of things, and grasps beside the chosen place by a constant bias
and a tremor. The higher the place, the more the wrist turns, the wider the hand opens, and the less it leans away from
the operator, who sits below the image; and it leans with the surface. How people do it, nobody has measured here.
Whether the thing was held says the physics: the parallel gripper of `evaluation.lifting` goes to the grasp, as wide
open as the operator opens the hand (the recorded fingers' angles say so), and lifts.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import cv2
import numpy as np
import pinocchio as pin

from common.poses import inverse, pose, read_only
from grasping.lab.dataset.episode import TELEOPERATION, Episode, Metadata, angles_of_opening
from grasping.lab.evaluation import trials
from grasping.lab.evaluation.lifting import lift
from grasping.lab.synthetic import labels, samples, scene
from grasping.lab.synthetic.labels import Labels
from grasping.lab.synthetic.samples import GRIPPER
from grasping.network import depth_image, maps
from grasping.network.depth_image import CAMERA
from grasping.network.maps import gaussian
from grasping.network.networks import MapNetwork, infer

DOWN = np.array([0.0, 0.0, -1.0])
EYE_M = 0.02  # standard deviation of the blur through which the lean of a surface is seen
SMOOTHING = maps.Smoothing(quality=2.0)
MAP_SIDE = 150
FRAME_S, REACH_S = 0.5, 2.0  # between two frames; from the last one to the closing of the fingers [s]
OPERATOR = "simulated"
NAME = re.compile(r"simulated_(\w+)_(\d+)")
SETTINGS_VERSION = 2


class SimulatedOperator(NamedTuple):
    """An operator's taste and hand."""

    holds: float = 0.3  # lowest quality of a grasp that the operator considers
    higher: float = 8.0  # what height is worth, in quality a metre
    slender: float = 6.0  # what a narrow opening is worth, in quality a metre less
    blur: float = 2.0  # standard deviation of the eye's blur of all that [px]
    turn: float = 4.0  # of the line through the fingers, anticlockwise in the image, by the height [rad/m]
    lean: float = 0.3  # away from the operator, on the table [rad]; less with the height, none from
    upright: float = 0.12  # this height on [m]
    follow: float = 0.4  # fraction of the surface's lean that the hand takes over
    margin: float = 0.005  # that the hand opens wider than it must, on the table [m]
    generous: float = 0.15  # how much more by the height [m/m]
    bias: tuple[float, float, float] = (0.008, 0.006, 0.0)  # x, y, z [m] beside the chosen place, in the base frame
    tremor_m: float = 0.005  # standard deviation of a position along each axis [m]
    tremor_rad: float = np.radians(5.0)  # standard deviation of a turn about each axis [rad]


def base_in_world(camera: scene.SceneCamera) -> np.ndarray:
    """Returns a base frame whose x axis points to the image's right, T_world_base, shape (4, 4): on a rig the camera
    stands still before the base, here the scenes stand still before cameras turned anyhow.
    """
    heading = np.arctan2(camera.R[1, 0], camera.R[0, 0])
    return pose(pin.exp3(np.array([0.0, 0.0, heading])))


def chosen_pixel(
    operator: SimulatedOperator, labels: Labels, height: np.ndarray, opening: np.ndarray
) -> tuple[int, int] | None:
    """Returns row and column of the grasp the operator likes best, None where nothing holds; `height`: above the table,
    shape (h, w) [m]; `opening`: that the grasp needs, shape (h, w) [m].
    """
    worth = labels.quality + operator.higher * height - operator.slender * opening
    holds = (labels.quality > operator.holds) & labels.known
    if not holds.any():
        return None
    # A place is liked for its neighbourhood; what does not hold is worth little there.
    blurred = gaussian(np.where(holds, worth, worth[holds].min() - 1.0).astype(np.float32), operator.blur)
    row, column = np.unravel_index(np.argmax(np.where(holds, blurred, -np.inf)), blurred.shape)
    return int(row), int(column)


def points(depth: np.ndarray, camera: scene.SceneCamera) -> np.ndarray:
    """Returns where the pixels of a square depth image, shape (h, w) [m], lie in the world, shape (h, w, 3) [m]."""
    scaled = camera._replace(focal=camera.focal * len(depth) / camera.side, side=len(depth))
    rays = scene.rays(scaled).reshape(*depth.shape, 3)
    return camera.position + (depth[..., None] * rays) @ camera.R.T


def lean(operator: SimulatedOperator, height: np.ndarray, pixel_m: float, at: tuple[int, int]) -> np.ndarray:
    """Returns the hand's lean about the base frame's x and y axes, shape (2,) [rad], at row and column `at`.

    `height`: above the table, shape (h, w) [m]; `pixel_m`: what a pixel shows of the scene [m].
    """
    row, column = at
    seen = gaussian(np.clip(height, 0.0, None).astype(np.float32), EYE_M / pixel_m)
    down, right = (float(np.gradient(seen, pixel_m, axis=axis)[row, column]) for axis in (0, 1))
    steep = 1.0 + np.hypot(down, right)  # an edge is no slope to lean with
    away = operator.lean * max(0.0, 1.0 - max(0.0, height[at]) / operator.upright)
    # Rows run against the base frame's y axis.
    return np.array([away - operator.follow * down / steep, -operator.follow * right / steep])


def grasp_pose(
    operator: SimulatedOperator, place: np.ndarray, line: np.ndarray, leant: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Returns the operator's grasp, T_base_grasp, shape (4, 4) [m]; x through the fingers, z the approach. In the base
    frame: `place`, shape (3,) [m], the fingers' direction `line`, shape (3,), lean about x and y, shape (2,) [rad].
    """
    x = line - (line @ DOWN) * DOWN
    x /= np.linalg.norm(x)
    upright = np.column_stack([x, np.cross(DOWN, x), DOWN])
    R = pin.exp3(np.append(leant, 0.0)) @ upright @ pin.exp3(rng.normal(0.0, operator.tremor_rad, 3))
    return pose(R, place + operator.bias + rng.normal(0.0, operator.tremor_m, 3))


def opening(operator: SimulatedOperator, needed: float, height: float, rng: np.random.Generator) -> float:
    """Returns how wide the operator opens the hand [m], as wide as it goes at most; `needed`: opening that the thing
    needs [m]; `height`: of the place above the table [m].
    """
    wanted = needed + operator.margin + operator.generous * max(0.0, height) + rng.normal(0.0, operator.tremor_m)
    return float(np.clip(wanted, needed, GRIPPER.opening))


class EpisodeScene(NamedTuple):
    """A scene and what an operator and a network know of it."""

    view: samples.SceneView  # the scene, as the camera sees it
    labels: Labels  # of the pixels of the network's image
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
    found = labels.best(labels.grasps(seen.surface, seen.table, samples.CELL_M, GRIPPER))
    focal = seen.camera.focal * side / depth_image.CROP_SIDE
    of_pixels = labels.in_image(found, seen.surface, samples.CELL_M, exact, focal)
    friction = float(np.random.default_rng([98, number]).uniform(*trials.FRICTION))
    return EpisodeScene(seen, of_pixels, exact, friction, inverse(base_in_world(seen.camera)))


def intended(of: EpisodeScene, made: Episode) -> np.ndarray:
    """Returns the operator's intended T_base_grasp, shape (4, 4) [m], without tremor: no prediction can be nearer."""
    who = SimulatedOperator(**made.metadata.configuration["person"])
    steady = who._replace(tremor_m=0.0, tremor_rad=0.0)
    found = _grasp(of, steady, np.random.default_rng(0))
    assert found is not None, "an episode is of a grasp"
    return found[0]


def held(of: EpisodeScene, T_base_grasp: np.ndarray, width: float = GRIPPER.opening) -> bool:
    """Returns whether the gripper, open by `width` [m], lifts something there."""
    T_world_grasp = inverse(of.T_base_world) @ T_base_grasp
    return lift(of.view.scene, T_world_grasp, width, GRIPPER, of.friction).lifted


def episode(
    split: str,
    number: int,
    network: MapNetwork,
    network_sha256: str,
    who: SimulatedOperator,
    frames: int,
) -> Episode | None:
    """Returns a scene's episode, None without a grasp; each of `frames` images draws the camera's faults again."""
    of, rng = situation(split, number), np.random.default_rng([97, number])
    chosen = _grasp(of, who, rng)
    if chosen is None:
        return None
    T_base_grasp, wide = chosen
    T_base_camera = of.T_base_world @ pose(of.view.camera.R, of.view.camera.position)
    stored: dict[str, list] = {"depth": [], "maps": [], "mean": [], "peak": []}
    for _ in range(frames):
        depth = np.nan_to_num(np.round(1000.0 * samples.observe(of.view.exact, rng))).astype(np.uint16)
        image = depth_image.prepare(depth * np.float32(0.001), trials.CROP)
        output = infer(network, image.input)
        peak = maps.highest(maps.smoothed(output, image.valid, SMOOTHING))
        small = np.stack([cv2.resize(m, (MAP_SIDE, MAP_SIDE), interpolation=cv2.INTER_AREA) for m in output])
        for name, value in zip(stored, (depth, small.astype(np.float16), image.mean, peak)):
            stored[name].append(value)
    lifted = held(of, T_base_grasp, wide)
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
        finger_angles=np.tile(angles_of_opening(wide), (frames, 1)).astype(np.float32),
        teleop_active=np.ones(frames, bool),
    )


def _grasp(of: EpisodeScene, who: SimulatedOperator, rng: np.random.Generator) -> tuple[np.ndarray, float] | None:
    """Returns T_base_grasp, shape (4, 4) [m], and the opening of the hand before it closes [m]."""
    camera = of.view.camera
    places = points(of.depth, camera)
    height = places[..., 2]
    pixel_m = of.depth * camera.side / len(of.depth) / camera.focal
    pixel = chosen_pixel(who, of.labels, height, of.labels.opening * pixel_m)
    if pixel is None:
        return None
    angle = float(of.labels.angle[pixel]) + who.turn * max(0.0, height[pixel])
    line = camera.R @ np.array([np.cos(angle), -np.sin(angle), 0.0])
    leant = lean(who, height, float(pixel_m[pixel]), pixel)
    R, p = of.T_base_world[:3, :3], of.T_base_world[:3, 3]
    T_base_grasp = grasp_pose(who, R @ places[pixel] + p, R @ line, leant, rng)
    needed = float(of.labels.opening[pixel] * pixel_m[pixel])
    return T_base_grasp, opening(who, needed, float(height[pixel]), rng)


def _metadata(of: EpisodeScene, who: SimulatedOperator, lifted: bool, network_sha256: str) -> Metadata:
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
