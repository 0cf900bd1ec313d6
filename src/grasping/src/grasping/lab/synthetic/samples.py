"""One training example: a heap, the camera's image of it and the label of each pixel, all from one number."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import mujoco
import numpy as np

from grasping.lab.synthetic import labels, scene, sensor, shapes
from grasping.network import depth_image
from grasping.network.networks import WIDTH_SCALE_PX

CELL_M = 0.0025
CELLS = 168
MAX_TILT_RAD = 0.15
SINGLE_SHARE = 0.4
"""Share of the scenes with one object; the others hold two to five."""
CLEAN_SHARE = 0.1
"""Share of the images without the camera's faults."""
GRIPPER = labels.Gripper()
SPLITS = {
    "train": (0, shapes.TRAINING),
    "validation": (1, shapes.TRAINING),
    "test": (2, shapes.HELD_OUT),
    "person": (3, shapes.TRAINING),
    "person_test": (4, shapes.HELD_OUT),
}
"""Number and families of each split; no scene belongs to two of them. The last two are a simulated operator's."""


class SceneView(NamedTuple):
    """A scene as a camera sees it."""

    scene: scene.HeapScene  # what lies there
    camera: scene.SceneCamera  # how it is seen
    exact: np.ndarray  # depth without faults, shape (400, 400) [m]
    observed: np.ndarray  # depth as the camera gives it, NaN where it sees nothing
    surface: np.ndarray  # height map about the optical axis, shape (CELLS, CELLS) [m]
    table: np.ndarray  # the same of the bare table


class Sample(NamedTuple):
    """A training example, each shape (300, 300)."""

    depth: np.ndarray  # the network's image with its mean, float16 about that mean [m]
    quality: np.ndarray  # uint8, 255 is 1
    angle: np.ndarray  # uint8, 256 is pi
    width: np.ndarray  # uint8, 255 is `WIDTH_SCALE_PX`
    known: np.ndarray  # bool


def view(split: str, seed: int, count: int | None = None) -> SceneView:
    """Returns the scene number `seed` of a split; the same for the same number.

    Args:
        count: of objects; drawn at random when left out.
    """
    number, families = SPLITS[split]
    rng = np.random.default_rng([number, seed])
    if count is None:
        count = 1 if rng.random() < SINGLE_SHARE else int(rng.integers(2, 6))
    settled = None
    while settled is None:
        settled = scene.settled_scene(rng, families, count)
    camera = scene.random_camera(rng, sensor.FOCAL_PX, depth_image.CROP_SIDE, MAX_TILT_RAD)
    model = mujoco.MjModel.from_xml_string(settled.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = settled.state
    exact = scene.depth_image(model, data, camera)
    surface = scene.height_map(model, data, camera, CELL_M, CELLS)
    observed = exact.astype(np.float32) if rng.random() < CLEAN_SHARE else sensor.observe(exact, rng)
    return SceneView(settled, camera, exact, observed, surface, scene.table_depth(camera, CELL_M, CELLS))


def sample(seen: SceneView) -> Sample:
    """Returns the network's image of a scene and its labels."""
    side = depth_image.NETWORK_SIDE
    image = depth_image.prepare(seen.observed, depth_image.Crop(0, 0, depth_image.CROP_SIDE))
    exact = cv2.resize(seen.exact, (side, side), interpolation=cv2.INTER_NEAREST)
    found = labels.best(labels.grasps(seen.surface, seen.table, CELL_M, GRIPPER))
    focal = seen.camera.focal * side / depth_image.CROP_SIDE
    label = labels.in_image(found, seen.surface, CELL_M, exact, focal)
    return Sample(
        (image.depth - image.mean).astype(np.float16),
        np.round(255.0 * label.quality).astype(np.uint8),
        (np.round(256.0 * label.angle / np.pi) % 256).astype(np.uint8),
        np.round(255.0 * np.clip(label.opening / WIDTH_SCALE_PX, 0.0, 1.0)).astype(np.uint8),
        label.known,
    )
