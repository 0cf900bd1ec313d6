"""One training example: a heap, the camera's image of it and the label of each pixel, all from one number.

The camera is a structured-light one (Asus Xtion, Kinect 1): noise after Nguyen, Izadi and Lovell (2012) and Khoshelham
and Elberink (2012); errors are alike in neighbouring pixels, because the camera compares windows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import mujoco
import numpy as np

from common.poses import inverse, pose
from grasping.lab.synthetic import labels, random_urdfs, reflex_labels, scene, shapes, surroundings
from grasping.network import depth_image
from grasping.network.maps import PARALLEL, WIDTH_SCALE_PX
from grasping.poses.gripper import GRIPPER, Gripper

FOCAL_PX = 570.3  # focal length of the 640 x 480 image
BASELINE_M = 0.075  # between projector and camera, along the rows
NEAREST_M = 0.45
SCALE_ERROR = 0.005  # of the distances of one camera, standard deviation
CELL_M = 0.0025
CELLS = 168


class Split(NamedTuple):
    """Scenes of their own."""

    number: int
    families: tuple[scene.Family, ...]
    surroundings: str = ""  # one of `surroundings.KINDS`; empty: the bare table


def _all_splits() -> dict[str, Split]:
    """Returns the splits by name; those of a person and of a kind are a simulated operator's."""
    kinds = *shapes.TRAINING, *shapes.HELD_OUT, *shapes.UNSEEN
    one_kind = [Split(100 + i, (family,)) for i, family in enumerate(kinds)]
    trained = *shapes.TRAINING, random_urdfs.seen_blob
    chosen_by, held_out = (*shapes.TRAINING, random_urdfs.other_blob), (*shapes.HELD_OUT, *shapes.UNSEEN)
    return {
        "train": Split(0, shapes.TRAINING),
        "validation": Split(1, shapes.TRAINING),
        "test": Split(2, shapes.HELD_OUT),
        "person": Split(3, shapes.TRAINING),
        "person_test": Split(4, shapes.HELD_OUT),
        "unseen": Split(5, shapes.UNSEEN),
        "blobs": Split(6, (random_urdfs.kept_blob,)),
        "train_blobs": Split(7, trained),
        "validation_blobs": Split(8, chosen_by),
        **{f"kind_{of.families[0].__name__}": of for of in one_kind},
        **{kind: Split(200 + i, held_out, kind) for i, kind in enumerate(surroundings.KINDS)},
        **{f"train_{kind}": Split(210 + i, trained, kind) for i, kind in enumerate(surroundings.KINDS)},
        **{f"validation_{kind}": Split(220 + i, chosen_by, kind) for i, kind in enumerate(surroundings.KINDS)},
    }


SPLITS = _all_splits()


def observe(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns the camera's image, float32 [m], NaN = unseen, of exact depths, shape (h, w) [m], for `FOCAL_PX`."""
    disparity_step_px = 0.125
    depth_step_m = 0.001
    lateral_px = 0.8
    correlation_px = 2.0  # standard deviation of the blur that makes neighbouring errors alike
    warp = 0.0015  # smooth error over the image that grows with the distance squared, standard deviation at 1 m [m]
    steepest_rad = 1.3  # surfaces further from the line of sight return no pattern
    edge_step_m = 0.01
    edge_loss = 0.3  # share of the pixels at an edge that is lost
    dark_share = 0.3  # share of the images with spots that return no pattern
    h, w = depth.shape
    angle = _incidence(depth)
    lost = shadow(depth) | (depth < NEAREST_M) | (angle > steepest_rad + 0.1 * _field(rng, depth.shape, 3.0))
    step = cv2.morphologyEx(depth.astype(np.float32), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    lost |= (step > edge_step_m) & (rng.random(depth.shape) < edge_loss)
    if rng.random() < dark_share:
        lost |= _field(rng, depth.shape, 6.0) > rng.uniform(2.4, 3.2)
    row, column = np.mgrid[:h, :w].astype(np.float32)
    shift = [lateral_px * _field(rng, depth.shape, correlation_px) for _ in range(2)]
    seen = cv2.remap(
        depth.astype(np.float32), column + shift[0], row + shift[1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
    )
    # The angle's term is Nguyen's for steep surfaces; beyond the steepest the reading is lost anyway.
    steep = np.minimum(angle, steepest_rad)
    sigma = 0.0012 + 0.0019 * (seen - 0.4) ** 2 + 1e-4 / np.sqrt(seen) * (steep / (0.5 * np.pi - steep)) ** 2
    seen = seen * (1.0 + SCALE_ERROR * rng.standard_normal()) + sigma * _field(rng, depth.shape, correlation_px)
    seen = seen + warp * seen**2 * _field(rng, depth.shape, 60.0)
    disparity = np.round(FOCAL_PX * BASELINE_M / seen / disparity_step_px) * disparity_step_px
    seen = np.round(FOCAL_PX * BASELINE_M / disparity / depth_step_m) * depth_step_m
    return np.where(lost, np.nan, seen).astype(np.float32)


def shadow(depth: np.ndarray) -> np.ndarray:
    """Returns where the projector, `BASELINE_M` to the left, does not shine, shape as `depth`, bool. A point is dark
    when one to its left in the same row lies further right in the projector's image.
    """
    in_projector = np.arange(depth.shape[1]) + FOCAL_PX * BASELINE_M / depth
    return np.maximum.accumulate(in_projector, axis=1) > in_projector + 1e-6


def _incidence(depth: np.ndarray) -> np.ndarray:
    """Returns the angle between optical axis and surface normal [rad]; a step between two surfaces is no surface."""
    slopes = []
    for axis in (0, 1):
        step = np.abs(np.diff(depth, axis=axis))
        before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        before[axis], after[axis] = (1, 0), (0, 1)
        slopes.append(np.minimum(np.pad(step, before, mode="edge"), np.pad(step, after, mode="edge")))
    return np.arctan(np.hypot(*slopes) * FOCAL_PX / depth)


def _field(rng: np.random.Generator, shape: tuple[int, ...], blur: float) -> np.ndarray:
    """Returns normal noise of unit variance that is blurred over `blur` pixels, float32."""
    shrink = max(1, int(blur / 3.0))
    small = (max(2, -(-shape[0] // shrink)), max(2, -(-shape[1] // shrink)))
    noise = cv2.GaussianBlur(rng.standard_normal(small, dtype=np.float32), (0, 0), blur / shrink)
    noise = np.multiply(noise, np.float32(2.0 * np.sqrt(np.pi) * blur / shrink))
    return noise if shrink == 1 else cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_LINEAR)


class SceneView(NamedTuple):
    """A scene as a camera sees it."""

    scene: scene.HeapScene  # what lies there
    camera: scene.SceneCamera  # how it is seen
    exact: np.ndarray  # depth without faults, shape (400, 400) [m]
    observed: np.ndarray  # depth as the camera gives it, NaN where it sees nothing
    surface: np.ndarray  # height map about the optical axis, shape (CELLS, CELLS) [m]
    table: np.ndarray  # the same of the bare table


class LabelSettings(NamedTuple):
    """What labels mean."""

    hand: str = PARALLEL  # name in `network.maps.HANDS`
    margin: float = 0.0  # added to each opening, as far as the hand opens [m]


DEFAULT_LABELS = LabelSettings()


class SceneGrasps(NamedTuple):
    """A hand's grasps of a scene, and where its height map is."""

    found: labels.Grasps
    surface: np.ndarray  # height map, shape (CELLS, CELLS) [m]
    T_map_camera: np.ndarray | None  # of the camera in the map, shape (4, 4) [m]; None: the map is about its axis
    exact: np.ndarray  # depth of the network's image, shape (300, 300) [m]
    focal: float  # of that image [px]

    def in_image(self, of: labels.Labels) -> labels.Labels:
        """Returns labels of the map's cells as labels of the pixels of the network's image."""
        return labels.in_image(of, self.surface, CELL_M, self.exact, self.focal, self.T_map_camera)


class Sample(NamedTuple):
    """A training example, each shape (300, 300)."""

    depth: np.ndarray  # the network's image with its mean, float16 about that mean [m]
    quality: np.ndarray  # uint8, 255 is 1
    angle: np.ndarray  # uint8, 256 is pi
    width: np.ndarray  # uint8, 255 is `WIDTH_SCALE_PX`
    known: np.ndarray  # bool


def view(split: str, seed: int, count: int | None = None) -> SceneView:
    """Returns the scene `seed` of a split, always the same, with `count` objects or a random number of them; where the
    split has surroundings, these say how many."""
    max_tilt_rad = 0.15
    clean_share = 0.1  # share of the images without the camera's faults
    rng, found = _settled(split, seed, count)
    camera = scene.random_camera(rng, FOCAL_PX, depth_image.CROP_SIDE, max_tilt_rad)
    model = mujoco.MjModel.from_xml_string(found.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = found.state
    exact = scene.depth_image(model, data, camera)
    surface = scene.height_map(model, data, camera, CELL_M, CELLS)
    observed = exact.astype(np.float32) if rng.random() < clean_share else observe(exact, rng)
    return SceneView(found, camera, exact, observed, surface, scene.table_depth(camera, CELL_M, CELLS))


def settled(split: str, seed: int, count: int | None = None) -> scene.HeapScene:
    """Returns what lies in the scene of `view`."""
    return _settled(split, seed, count)[1]


def _settled(split: str, seed: int, count: int | None) -> tuple[np.random.Generator, scene.HeapScene]:
    single_share = 0.4  # share of the scenes with one object; the others hold two to five
    number, families, kind = SPLITS[split]
    rng = np.random.default_rng([number, seed])
    found = None
    if kind:
        while found is None:
            found = surroundings.hard_scene(rng, kind, families)
    if count is None and not kind:
        count = 1 if rng.random() < single_share else int(rng.integers(2, 6))
    while found is None:
        found = scene.settled_scene(rng, families, count)
    return rng, found


def hand_grasps(seen: SceneView, settings: LabelSettings = DEFAULT_LABELS, gripper: Gripper = GRIPPER) -> SceneGrasps:
    """Returns the grasps of a hand: the parallel `gripper` comes along the camera's axis, the ReFlex from above."""
    side = depth_image.NETWORK_SIDE
    exact = cv2.resize(seen.exact, (side, side), interpolation=cv2.INTER_NEAREST)
    focal = seen.camera.focal * side / depth_image.CROP_SIDE
    if settings.hand == PARALLEL:
        found = labels.grasps(seen.surface, seen.table, CELL_M, replace(gripper, margin=settings.margin))
        return SceneGrasps(found, seen.surface, None, exact, focal)
    above = scene.straight_above(seen.camera)
    model = mujoco.MjModel.from_xml_string(seen.scene.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = seen.scene.state
    surface = scene.height_map(model, data, above, CELL_M, CELLS)
    table = scene.table_depth(above, CELL_M, CELLS)
    found = reflex_labels.grasps(surface, table, CELL_M, reflex_labels.Hand(margin=settings.margin))
    T_map_camera = inverse(pose(above.R, above.position)) @ pose(seen.camera.R, seen.camera.position)
    return SceneGrasps(found, surface, T_map_camera, exact, focal)


def sample(seen: SceneView, settings: LabelSettings = DEFAULT_LABELS) -> Sample:
    image = depth_image.prepare(seen.observed, depth_image.Crop(0, 0, depth_image.CROP_SIDE))
    of_hand = hand_grasps(seen, settings)
    label = of_hand.in_image(labels.best(of_hand.found))
    return Sample(
        (image.depth - image.mean).astype(np.float16),
        np.round(255.0 * label.quality).astype(np.uint8),
        (np.round(256.0 * label.angle / np.pi) % 256).astype(np.uint8),
        np.round(255.0 * np.clip(label.opening / WIDTH_SCALE_PX, 0.0, 1.0)).astype(np.uint8),
        label.known,
    )
