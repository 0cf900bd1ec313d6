"""Processor time of one image, 640 x 480, of the simulated camera, registration, tag detection and headset view. All
threads of the process count: the software renderer and OpenCV have their own."""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import mujoco
import numpy as np
import rospy
import yaml
from std_msgs.msg import Header

from apriltag_ros.detector import TagDetector
from apriltag_ros.settings import TAG_KEYS, detector_settings, targets
from apriltag_ros.tag_rendering import TagPattern, black_cells
from bench.measure import SRC, Row, row
from common.camera_model import CameraModel, from_calibration
from common.config import parse
from common.errors import DeviceError
from common.poses import pose
from common.ros.images import image_message, metres_from_millimetres
from common.rotations import rotation_about
from rig_simulation.devices.camera.rgbd_camera import RgbdCamera
from rig_simulation.files import read_scene
from rig_simulation.node_parameters import ColourConfig, DepthConfig
from rig_simulation.world.model import WorldDescription, build_model
from vision.camera.registration import Registration, millimetres_from_metres
from vision.ros.camera.register_node import cloud_message
from vision.stereo.view import StereoView, StereoViewConfig

CONFIG = SRC / "vision" / "config"
T_RGB_DEPTH = pose(p=(-0.027, 0.001, -0.002))
BLACK, WHITE, WALL = 25.0, 200.0, 110.0  # grey levels of the marker board and of the wall behind it
CELL_PX = 16  # of the drawn tags, before they are seen from the camera


def rows(quick: bool) -> list[Row]:
    """Returns the processor time of one image [ms]."""
    count = 3 if quick else 60
    rgb, depth = (from_calibration(_yaml(f"xtion_{name}.yaml")) for name in ("rgb", "depth"))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # as in the nodes
    try:
        return _rows(count, rgb, depth)
    finally:
        cv2.setNumThreads(threads)


def _rows(count: int, rgb: CameraModel, depth: CameraModel) -> list[Row]:
    return [
        *_camera(count, rgb, depth),
        *_registration(count, rgb, depth),
        *_detection(count, rgb),
        *_headset(count, rgb),
    ]


def _spent(call: Callable[..., object], *arguments: object) -> float:
    """Returns the processor time of a call [ms]."""
    begin = time.process_time()
    call(*arguments)
    return 1e3 * (time.process_time() - begin)


def _in_turns(count: int, *calls: Callable[[int], object]) -> np.ndarray:
    """Returns the times [ms] of each of the calls, which get the image's number, after one that is not counted."""
    return np.array([[_spent(call, i) for call in calls] for i in range(count + 1)][1:]).T


def _camera(count: int, rgb: CameraModel, depth: CameraModel) -> list[Row]:
    """The simulated camera above the table, arm and hand in its view, by stages."""
    model = build_model(WorldDescription("LBR7R800", "MF_elektrisch", (0.0, 0.0, 0.0), read_scene("cup")))
    data = mujoco.MjData(model)
    values = yaml.safe_load((SRC / "modules" / "rig_simulation" / "config" / "camera.yaml").read_text())
    effects = parse(ColourConfig, values["colour"]), parse(DepthConfig, values["depth"])
    camera = RgbdCamera(rgb, depth, *effects, values["samples"], values["seed"], clock=time.process_time)
    stages: dict[str, list[float]] = {}
    try:
        camera.attach(model)
        for i in range(count + 1):
            data.qpos[:7] = 0.3 * np.sin(0.1 * i + np.arange(7.0))
            mujoco.mj_forward(model, data)
            for stage, seconds in camera.take(data, colour=True, depth=True, registered=True).seconds.items():
                stages.setdefault(stage, []).append(1e3 * seconds)
    except DeviceError as error:
        return [Row("camera, colour and depth", None, None, "ms", str(error))]
    finally:
        camera.close()
    times = {stage: np.array(values[1:]) for stage, values in stages.items()}
    whole = times["render_rgb"] + times["colour"] + times["render_depth"] + times["depth"]
    floor = "floor: software rendering of two views, since colour and infrared camera have one each"
    table = [row("camera, colour and depth", whole, "ms", floor)]
    for stage in ("render_rgb", "render_depth"):
        how = "floor: MuJoCo on Mesa's llvmpipe; vertices of arm and hand, and 330 000 pixels"
        table.append(row(f"camera: {stage}", times[stage], "ms", how))
    table.append(row("camera: effects on colour", times["colour"], "ms", "lens, blur and noise"))
    table.append(row("camera: effects on depth", times["depth"], "ms", "edges, shadows, signal, noise, steps"))
    table.append(row("camera: effects on registered depth", times["registered"], "ms", "shadows of two cameras"))
    return table


def _registration(count: int, rgb: CameraModel, depth: CameraModel) -> list[Row]:
    """Everything that the node register_rgbd does with a pair of images, its messages included."""
    registration = Registration(rgb, depth, T_RGB_DEPTH)
    colours, depths = zip(*(_images(seed) for seed in range(4)))
    header, stamp = Header(), rospy.Time()

    def ours(i: int) -> None:
        rectified = registration.rectify(colours[i % 4])
        image_message(rectified, "rgb8", "", stamp)
        registered = registration.register(metres_from_millimetres(depths[i % 4]))
        image_message(millimetres_from_metres(registered), "16UC1", "", stamp)
        image_message(registered, "32FC1", "", stamp)
        cloud_message(registration.cloud(registered, rectified), header)

    def only_depth(i: int) -> np.ndarray:
        return registration.register(metres_from_millimetres(depths[i % 4]))

    whole, part = _in_turns(count, ours, only_depth)
    return [
        row("registration, with coloured cloud", whole, "ms", "from two images to five messages"),
        row("registration: depth", part, "ms", "float32 [m]"),
    ]


def _detection(count: int, camera: CameraModel) -> list[Row]:
    """The marker board before a wall, moving slowly; a new image every 33 ms."""
    tags = _yaml("tags.yaml")
    found = targets({key: tags.get(key) for key in TAG_KEYS})
    detector = TagDetector(detector_settings(_yaml("settings.yaml")), found)
    images = [board_image(camera, found[0].tags, 0.02 * i, i) for i in range(8)]
    there_and_back = [*range(8), *range(6, 0, -1)]
    (whole,) = _in_turns(count, lambda i: detector.detect(images[there_and_back[i % 14]], camera, i / 30.0))
    return [row("tag detection", whole, "ms", "five tags, 1 m away; pose and covariance")]


def board_image(camera: CameraModel, tags: tuple, x: float, seed: int) -> np.ndarray:
    """Returns a grey image, shape (height, width), uint8, of tags on a white board, `x` [m] beside the camera's axis
    and 1 m away, turned by 25 deg, before a wall of patches; without the camera's distortion."""
    rng = np.random.default_rng(seed)
    patches = np.random.default_rng(0).uniform(-50.0, 50.0, (12, 16)).astype(np.float32)
    image = WALL + cv2.resize(patches, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
    T = pose(rotation_about(1, np.radians(25.0)) @ rotation_about(0, np.pi), (x, 0.0, 1.0))
    outline = 0.15 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    corners = outline @ T[:3, :3].T + T[:3, 3]
    cv2.fillConvexPoly(image, np.rint((corners @ camera.K.T)[:, :2] / corners[:, 2:]).astype(np.int32), WHITE)
    for tag in tags:
        bitmap, A = TagPattern(tag, black_cells("tag36h11", tag.id)).bitmap(CELL_PX)
        H = camera.K @ (T @ tag.T_target_tag)[:3, [0, 1, 3]] @ np.linalg.inv(A)
        options = {"flags": cv2.INTER_AREA, "borderMode": cv2.BORDER_CONSTANT, "borderValue": 2.0}
        seen = cv2.warpPerspective(bitmap, H, (camera.width, camera.height), **options)
        image = np.where(seen <= 1.0, BLACK + (WHITE - BLACK) * seen, image)
    image = cv2.GaussianBlur(image, (0, 0), 0.6) + rng.normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _headset(count: int, rgb: CameraModel) -> list[Row]:
    """Both eyes' images, and the screen of the Rift DK2."""
    view = StereoView(rgb, parse(StereoViewConfig, _yaml("stereo_view.yaml")))
    colours, depths = zip(*(_images(seed) for seed in range(4)))

    def eyes(i: int) -> None:
        view.eyes(colours[i % 4], metres_from_millimetres(depths[i % 4]))

    def screen(i: int) -> None:
        seen = view.eyes(colours[i % 4], metres_from_millimetres(depths[i % 4]))
        view.screen.draw(seen.left, seen.right)

    whole, part = _in_turns(count, screen, eyes)
    return [
        row("headset view, DK2", whole, "ms", "floor of the lens: cv2.remap once an eye and colour"),
        row("headset view: eye images", part, "ms", "floor: two images rectified, two shifted"),
    ]


def _images(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns colour, uint8, and depth, uint16 [mm], of boxes before a wall, with noise and shadows."""
    rng = np.random.default_rng(seed)
    colour = cv2.resize(rng.integers(0, 255, (48, 64, 3), np.uint8), (640, 480))
    depth = np.full((480, 640), 1800.0, np.float32)
    for _ in range(8):
        y, x, tall, wide = *rng.integers(20, 400, 2), *rng.integers(40, 160, 2)
        depth[y : y + tall, max(x - 12, 0) : x] = 0.0
        depth[y : y + tall, x : x + wide] = rng.uniform(700.0, 1500.0)
    depth += np.where(depth > 0.0, rng.normal(0.0, 4.0, depth.shape), 0.0)
    depth[rng.random(depth.shape) < 0.02] = 0.0
    return colour, np.rint(depth).astype(np.uint16)


def _yaml(name: str) -> dict:
    return yaml.safe_load((CONFIG / name).read_text())
