"""Simulated operators who grasp, and episodes of them in the form of the recorded ones; no person was measured.

Each sees the exact labels, chooses by rules of its own (`OPERATORS`), not always alike (`whim`), and grasps beside the
chosen place by a constant bias and a tremor. The hand leans with the surface, away from the operator, who sits below
the image, and to a side, and goes deeper the higher the place is. Whether the thing was held says the physics of
`evaluation.lifting`, the gripper as wide open as the hand.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import cv2
import numpy as np
import pinocchio as pin

from common.poses import inverse, pose, read_only
from grasping.lab.dataset.episode import TELEOPERATION, Episode, Metadata, angles_of_opening
from grasping.lab.evaluation import trials
from grasping.lab.evaluation.lifting import lift
from grasping.lab.synthetic import labels, samples, scene
from grasping.lab.synthetic.samples import CELL_M
from grasping.network import depth_image, maps
from grasping.network.depth_image import CAMERA
from grasping.network.maps import gaussian
from grasping.network.networks import MapNetwork, infer
from grasping.poses.gripper import GRIPPER

DOWN = np.array([0.0, 0.0, -1.0])
SMOOTHING = maps.Smoothing(quality=2.0)
NAME = re.compile(r"simulated_(\w+)_(\d+)")


class SimulatedOperator(NamedTuple):
    """An operator's taste and hand. What is liked is in units of the label's quality, which is at most 1."""

    holds: float = 0.3  # lowest quality of a grasp that the operator considers
    higher: float = 8.0  # what height is worth [1/m]
    slender: float = 6.0  # what a narrow opening is worth, by the metre less
    middle: float = 0.0  # what it is worth to be nearer to the middle of the thing [1/m]
    near: float = 0.0  # and nearer to the operator [1/m]
    handle: float = 0.0  # what a slender part outside of the thing's bulk is worth
    inside: float = 0.0  # what it is worth not to be at the thing's outline
    across: float = 0.0  # what it is worth to close the fingers across the long axis of a long thing
    comfort: float = 0.0  # what it is worth to close them along the line that the wrist likes
    wrist: float = 0.0  # that line, anticlockwise in the image [rad]
    whim: float = 0.0  # standard deviation of what is liked today and not tomorrow
    blur: float = 0.004  # standard deviation of the eye's blur of all that [m]
    twist: float = 0.0  # by which the line through the fingers misses, anticlockwise [rad]
    turn: float = 4.0  # of that line by the height [rad/m]
    lean: float = 0.3  # away from the operator, on the table [rad]; less with the height, none from
    upright: float = 0.12  # this height on [m]
    sideways: float = 0.0  # that the approach leans to the left, of a hand from the right [rad]
    dip: float = 0.0  # how much further the hand goes along its approach, as a fraction of the place's height
    follow: float = 0.4  # fraction of the surface's lean that the hand takes over
    margin: float = 0.005  # that the hand opens wider than it must, on the table [m]
    generous: float = 0.15  # how much more by the height [m/m]
    bias: tuple[float, float, float] = (0.008, 0.006, 0.0)  # x, y, z [m] beside the chosen place, in the base frame
    tremor_m: float = 0.005  # standard deviation of a position along each axis [m]
    tremor_rad: float = np.radians(5.0)  # standard deviation of a turn about each axis [rad]


# fmt: off
OPERATORS: Mapping[str, SimulatedOperator] = {
    # Takes what stands up and is slender; turns the wrist with the height.
    "high": SimulatedOperator(),
    # Takes a thing by its middle, across it, and comes down straight.
    "middle": SimulatedOperator(
        higher=0.0, slender=1.0, middle=8.0, across=0.3, whim=0.1, turn=0.0, lean=0.08, dip=0.2, follow=0.2,
        margin=0.01, generous=0.0, bias=(-0.006, 0.010, 0.0), tremor_m=0.004, tremor_rad=np.radians(4.0)),
    # The handle first, else whatever is slender; not the bulk.
    "handle": SimulatedOperator(
        higher=1.0, slender=4.0, handle=0.6, whim=0.1, turn=2.0, lean=0.2, sideways=-0.2, follow=0.3,
        bias=(0.003, -0.012, 0.004), tremor_m=0.006, tremor_rad=np.radians(6.0)),
    # The end that is nearest to the operator, with a hand that leans.
    "near": SimulatedOperator(
        higher=0.0, slender=2.0, near=8.0, comfort=0.1, whim=0.15, twist=0.1, turn=0.0, lean=0.5, dip=0.1, follow=0.2,
        bias=(0.002, -0.008, -0.004)),
    # Away from the outline, rather high: nothing shall slip out or tip over.
    "inside": SimulatedOperator(
        higher=3.0, slender=0.0, middle=2.0, inside=0.6, whim=0.05, turn=1.0, lean=0.05, follow=0.5, margin=0.015,
        generous=0.1, bias=(-0.010, -0.004, 0.0)),
    # A firm hold low on the bulk, where the wrist need not turn: a right hand that comes from the lower right.
    "firm": SimulatedOperator(
        higher=-4.0, slender=-4.0, middle=3.0, comfort=0.3, wrist=np.radians(35.0), whim=0.1, twist=-0.08, turn=0.0,
        lean=0.15, sideways=0.3, dip=0.3, follow=0.1, margin=0.02, generous=0.0, bias=(0.005, 0.002, 0.006),
        tremor_m=0.007, tremor_rad=np.radians(6.0)),
}
# fmt: on
"""Six differing tastes, hands and misses, written down as rules before anything was fitted to them."""


class CellFeatures(NamedTuple):
    """What an operator sees on the cells of the height map, each shape (n, n)."""

    position: np.ndarray  # in the base frame but for its origin, which is the world's, shape (n, n, 3) [m]
    height: np.ndarray  # above the table [m]
    away: np.ndarray  # distance from the middle of the thing, over the table [m]
    nearer: np.ndarray  # how much nearer to the operator than that middle [m]
    axis: np.ndarray  # long axis of the thing, anticlockwise in the image [rad]
    long: np.ndarray  # how long it is: 0 is round, 1 a line
    handle: np.ndarray  # 1 on slender parts outside of the bulk, else 0
    inside: np.ndarray  # 0 at the outline of the thing, 1 from its rim's breadth on


class EpisodeScene(NamedTuple):
    """A scene and what an operator and a network know of it."""

    number: int
    view: samples.SceneView  # the scene, as the camera sees it
    found: labels.Grasps  # of the cells of its height map
    features: CellFeatures  # likewise
    friction: float  # of the scene
    T_base_world: np.ndarray  # shape (4, 4) [m]


class Chosen(NamedTuple):
    """An operator's grasp."""

    T_base_grasp: np.ndarray  # shape (4, 4) [m]; z the approach, x through the fingers
    opening: float  # of the hand before it closes [m]


def base_in_world(camera: scene.SceneCamera) -> np.ndarray:
    """Returns a base frame whose x axis points to the image's right, T_world_base, shape (4, 4): on a rig the camera
    stands still before the base, here the scenes stand still before cameras turned anyhow.
    """
    heading = np.arctan2(camera.R[1, 0], camera.R[0, 0])
    return pose(pin.exp3(np.array([0.0, 0.0, heading])))


def cell_features(seen: samples.SceneView) -> CellFeatures:
    rim_m = 0.012  # so near to the outline of a thing is its rim
    slender_part = 0.6  # a part is a handle where it is thinner than this fraction of the thing's thickest place
    n, camera = len(seen.surface), seen.camera
    c = CELL_M * (np.arange(n) - 0.5 * (n - 1))
    x, y = np.meshgrid(c, c)
    world = camera.position + np.stack([x, y, seen.surface], axis=-1) @ camera.R.T
    position = world @ base_in_world(camera)[:3, :3]
    objects = seen.surface < seen.table - labels.LOWEST_OBJECT_M
    depth = cv2.distanceTransform(objects.astype(np.uint8), cv2.DIST_L2, 5)
    count, parts = cv2.connectedComponents(objects.astype(np.uint8))
    away, nearer, axis, long, handle = (np.zeros((n, n)) for _ in range(5))
    for part in range(1, count):
        of = parts == part
        points = position[of][:, :2]
        off = points - points.mean(axis=0)
        sizes, axes = np.linalg.eigh(off.T @ off / len(off))
        away[of], nearer[of] = np.linalg.norm(off, axis=1), -off[:, 1]
        axis[of] = np.arctan2(axes[1, 1], axes[0, 1])
        long[of] = 1.0 - np.sqrt(max(0.0, sizes[0]) / max(sizes[1], 1e-12))
        bulk = np.argmax(np.where(of, depth, 0.0))
        thick = depth.flat[bulk]
        from_bulk = np.linalg.norm(position[of][:, :2] - position.reshape(-1, 3)[bulk, :2], axis=1) / CELL_M
        # A part is as thin as the thickest place within its own half width.
        near = cv2.dilate(np.where(of, depth, 0.0).astype(np.float32), np.ones((5, 5), np.uint8))
        handle[of] = (near[of] < slender_part * thick) & (from_bulk > 1.2 * thick)
    return CellFeatures(
        position, position[..., 2], away, nearer, axis, long, handle, np.clip(depth * CELL_M / rim_m, 0.0, 1.0)
    )


def liked(
    operator: SimulatedOperator, of: CellFeatures, found: labels.Grasps, rng: np.random.Generator
) -> tuple[int, tuple[int, int]] | None:
    """Returns direction and cell of the grasp the operator likes best, None where nothing holds."""
    whim_m = 0.01  # standard deviation of the blur of a whim: near places are liked alike
    holds = found.scores > operator.holds
    if not holds.any():
        return None
    places = operator.higher * of.height - operator.middle * of.away + operator.near * of.nearer
    places = places + operator.handle * of.handle + operator.inside * of.inside
    whim = gaussian(rng.standard_normal(of.height.shape), whim_m / CELL_M)
    places = places + operator.whim * whim / max(float(whim.std()), 1e-12)
    angles = found.angles[:, None, None]
    lines = operator.comfort * np.cos(2.0 * (angles - operator.wrist))
    lines = lines - operator.across * of.long * np.cos(2.0 * (angles - of.axis))
    worth = found.scores - operator.slender * found.openings + places + lines
    # A place is liked for its neighbourhood; what does not hold is worth little there.
    worth = np.where(holds, worth, worth[holds].min() - 1.0)
    blurred = np.stack([gaussian(one, operator.blur / CELL_M) for one in worth])
    k, row, column = np.unravel_index(np.argmax(np.where(holds, blurred, -np.inf)), blurred.shape)
    return int(k), (int(row), int(column))


def lean(operator: SimulatedOperator, height: np.ndarray, at: tuple[int, int]) -> np.ndarray:
    """Returns the hand's lean about the base frame's x and y axes, shape (2,) [rad], at row and column `at`; `height`:
    of the cells above the table, shape (n, n) [m].
    """
    eye_m = 0.02  # standard deviation of the blur through which the lean of a surface is seen
    row, column = at
    seen = gaussian(np.clip(height, 0.0, None).astype(np.float32), eye_m / CELL_M)
    down, right = (float(np.gradient(seen, CELL_M, axis=axis)[row, column]) for axis in (0, 1))
    steep = 1.0 + np.hypot(down, right)  # an edge is no slope to lean with
    away = operator.lean * max(0.0, 1.0 - max(0.0, height[at]) / operator.upright)
    # Rows run against the base frame's y axis.
    return np.array([away - operator.follow * down / steep, operator.sideways - operator.follow * right / steep])


def grasp_pose(
    operator: SimulatedOperator,
    position: np.ndarray,
    line: np.ndarray,
    leant: np.ndarray,
    height: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Returns the operator's grasp, T_base_grasp, shape (4, 4) [m]; x through the fingers, z the approach. In the base
    frame: `position`, shape (3,) [m], its `height` above the table [m], the fingers' direction `line`, shape (3,), lean
    about x and y, shape (2,) [rad].
    """
    x = line - (line @ DOWN) * DOWN
    x /= np.linalg.norm(x)
    upright = np.column_stack([x, np.cross(DOWN, x), DOWN])
    R = pin.exp3(np.append(leant, 0.0)) @ upright
    deep = operator.dip * max(0.0, height) * R[:, 2]
    R = R @ pin.exp3(rng.normal(0.0, operator.tremor_rad, 3))
    return pose(R, position + deep + operator.bias + rng.normal(0.0, operator.tremor_m, 3))


def opening(operator: SimulatedOperator, needed: float, height: float, rng: np.random.Generator) -> float:
    """Returns how wide the operator opens the hand [m], as wide as it goes at most; `needed`: opening that the thing
    needs [m]; `height`: of the place above the table [m].
    """
    wanted = needed + operator.margin + operator.generous * max(0.0, height) + rng.normal(0.0, operator.tremor_m)
    return float(np.clip(wanted, needed, GRIPPER.opening))


def choose(of: EpisodeScene, who: SimulatedOperator, steady: bool = False, time: int = 0) -> Chosen | None:
    """Returns the operator's grasp in a scene, always the same; None where nothing holds. `steady`: without bias,
    twist and tremor, which is what the operator meant; another `time` the whim is another.
    """
    rng = np.random.default_rng([97, of.number, time] if time else [97, of.number])
    best = liked(who, of.features, of.found, rng)
    if best is None:
        return None
    if steady:
        who = who._replace(twist=0.0, bias=(0.0, 0.0, 0.0), tremor_m=0.0, tremor_rad=0.0)
    k, cell = best
    height = float(of.features.height[cell])
    angle = labels.angle_at(of.found, k, cell) + who.twist + who.turn * max(0.0, height)
    line = of.T_base_world[:3, :3] @ of.view.camera.R @ np.array([np.cos(angle), -np.sin(angle), 0.0])
    leant = lean(who, of.features.height, cell)
    T_base_grasp = grasp_pose(who, of.features.position[cell], line, leant, height, rng)
    return Chosen(T_base_grasp, opening(who, float(of.found.openings[k][cell]), height, rng))


def file_name(split: str, number: int) -> str:
    """Returns the name, without its ending, of the file of an episode."""
    return f"simulated_{split}_{number:06d}"


def scene_of(name: str) -> tuple[str, int] | None:
    """Returns split and number of the scene of an episode's file; None where the file is no simulated one's."""
    found = NAME.fullmatch(name)
    return None if found is None else (found[1], int(found[2]))


def situation(split: str, number: int) -> EpisodeScene:
    """Returns scene `number` of a split: one object of a kind, or where the split is of several kinds, one object where
    the number is even, else two or three.
    """
    alone = number % 2 == 0 or len(samples.SPLITS[split].families) == 1
    seen = samples.view(split, number, 1 if alone else 2 + number // 2 % 2)
    found = labels.grasps(seen.surface, seen.table, CELL_M, GRIPPER)
    friction = float(np.random.default_rng([98, number]).uniform(*trials.FRICTION))
    return EpisodeScene(number, seen, found, cell_features(seen), friction, inverse(base_in_world(seen.camera)))


def meant(of: EpisodeScene, made: Episode, time: int = 0) -> np.ndarray:
    """Returns what the operator of an episode meant, T_base_grasp, shape (4, 4) [m]: no miss and no tremor; another
    `time` than the episode: what the same operator would have."""
    person = made.metadata.configuration["person"]
    found = choose(of, SimulatedOperator(**{**person, "bias": tuple(person["bias"])}), steady=True, time=time)
    assert found is not None, "an episode is of a grasp"
    return found.T_base_grasp


def held(of: EpisodeScene, T_base_grasp: np.ndarray, width: float = GRIPPER.opening, hard: bool = False) -> bool:
    """Returns whether the gripper, open by `width` [m], lifts something there; `hard`: with the arm's error, and holds
    it through a shake."""
    T_world_grasp = inverse(of.T_base_world) @ T_base_grasp
    if hard:
        T_world_grasp = T_world_grasp @ trials.drawn(of.number, trials.USUAL)[1]
    return lift(of.view.scene, T_world_grasp, width, GRIPPER, of.friction, shake=hard).lifted


def camera_pose(of: EpisodeScene) -> np.ndarray:
    """Returns the camera in the base frame, T_base_camera, shape (4, 4) [m]."""
    return of.T_base_world @ pose(of.view.camera.R, of.view.camera.position)


def photograph(of: EpisodeScene, rng: np.random.Generator) -> np.ndarray:
    """Returns the camera's image of a scene as an episode keeps it, shape (side, side), uint16 [mm], 0 = no reading."""
    return np.nan_to_num(np.round(1000.0 * samples.observe(of.view.exact, rng))).astype(np.uint16)


def episodes(
    split: str, number: int, network: MapNetwork, network_sha256: str, operators: Iterable[str], frames: int
) -> Iterator[tuple[str, Episode]]:
    """Yields for each operator, by name, the scene's episode, none where nothing can be grasped. All see the same
    `frames` images, each of which draws the camera's faults again.
    """
    map_side = 150
    frame_s = 0.5  # between two frames
    reach_s = 2.0  # from the last one to the closing of the fingers
    of, rng = situation(split, number), np.random.default_rng([96, number])
    stored: dict[str, list] = {"depth": [], "maps": [], "mean": [], "peak": []}
    for _ in range(frames):
        depth = photograph(of, rng)
        image = depth_image.prepare(depth * np.float32(0.001), trials.CROP)
        output = infer(network, image.input)
        peak = maps.highest(maps.smoothed(output, image.valid, SMOOTHING))
        small = np.stack([cv2.resize(m, (map_side, map_side), interpolation=cv2.INTER_AREA) for m in output])
        for key, value in zip(stored, (depth, small.astype(np.float16), image.mean, peak)):
            stored[key].append(value)
    stamp = frame_s * np.arange(frames)
    for name in operators:
        chosen = choose(of, OPERATORS[name])
        if chosen is None:
            continue
        lifted = held(of, chosen.T_base_grasp, chosen.opening)
        yield (
            name,
            Episode(
                metadata=_metadata(of, name, lifted, network_sha256),
                camera=trials.camera(),
                crop=trials.CROP,
                T_flange_tool=np.eye(4),
                T_tool_grasp=np.eye(4),
                T_base_tool_closed=read_only(chosen.T_base_grasp),
                t_grasp=float(stamp[-1] + reach_s),
                held=lifted,
                stamp=stamp,
                depth=np.stack(stored["depth"]),
                maps=np.stack(stored["maps"]),
                mean=np.array(stored["mean"], np.float32),
                peak=np.array(stored["peak"], float),
                T_base_camera=np.stack([camera_pose(of)] * frames),
                T_base_tool_measured=np.stack([chosen.T_base_grasp] * frames),
                T_base_tool_desired=np.full((frames, 4, 4), np.nan),
                finger_angles=np.tile(angles_of_opening(chosen.opening), (frames, 1)).astype(np.float32),
                teleop_active=np.ones(frames, bool),
            ),
        )


def _metadata(of: EpisodeScene, name: str, lifted: bool, network_sha256: str) -> Metadata:
    settings_version = 3
    return Metadata(
        version="0.1.0",
        revision="",
        date="",
        operator=f"simulated {name}",
        object=", ".join(of.view.scene.families),
        source=TELEOPERATION,
        reason="lifted by a parallel gripper in simulation" if lifted else "not lifted in simulation",
        configuration={
            "simulated": settings_version,
            "person": OPERATORS[name]._asdict(),
            "view": CAMERA,
            "crop": {"side": trials.CROP.side, "rows_up": 0},
            "table": None,
            "weights": network_sha256,
        },
    )
