"""Two arms of the simulated world before one fixed camera, whose rendered images the calibration gets."""

from __future__ import annotations

import cv2
import mujoco
import numpy as np
from depth_scene import DEPTH, RGB, load

from apriltag_ros.detector import TagDetector
from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import detector_settings
from common.config import parse
from common.poses import inverse, pose, translation
from common.ros.files import read_yaml
from common.rotations import rotation_about
from rig_description.urdf import urdf
from rig_simulation.devices.camera.rgbd_camera import RgbdCamera
from rig_simulation.files import SOURCE_TREE, read_board, read_scene
from rig_simulation.node_parameters import ColourConfig, DepthConfig
from rig_simulation.world.model import WorldDescription, build_model
from vision.calibration.acceptance import BoardDetection, CalibrationConfig, refined, view_from
from vision.calibration.arm_model import JOINTS, ArmModel
from vision.calibration.view_planner import ViewPlanner, ViewsConfig
from vision.marker_board.board import MarkerBoardConfig, board_target
from vision.marker_board.pose_evaluation import inexact_arm

KIND = ("LBR7R800", "MF_elektrisch")
OPTICAL = "camera_rgb_optical_frame"
BOARD = parse(MarkerBoardConfig, load("panel.yaml"))
TARGET = board_target(load("tags.yaml"), "tags.yaml", BOARD.frame)
SETTINGS = detector_settings({**load("settings.yaml"), "rectified": False})
FRAME_S = 1.0 / 15.0


class TwoArmScene:
    """The arms stand as `arms` says, a mapping as two_arms.yaml, and the camera as `camera` says, as in a scene's yaml;
    by default as in the scene two_arms. It is the same unit for both arms; `seed`: of its errors and noise. Close it.
    """

    def __init__(self, arms: dict, seed: int, camera: dict | None = None) -> None:
        scene = read_scene("two_arms")
        self._arms, self._scene = arms, {**scene, "camera": camera or scene["camera"]}
        values = read_yaml(SOURCE_TREE / "config" / "camera.yaml")
        sensors = parse(ColourConfig, values["colour"]), parse(DepthConfig, values["depth"])
        self._camera = RgbdCamera(RGB, DEPTH, *sensors, values["samples"], seed)
        self._detector, self._refiner = (
            TagDetector(SETTINGS, (TARGET,)),
            PhotometricRefiner(SETTINGS.tag_family, TARGET),
        )
        self._now = 0.0
        self.drawn = ArmModel(urdf(*KIND))

    def close(self) -> None:
        self._camera.close()

    def hold(self, arm: str) -> None:
        """Mounts the marker board on an arm; both arms stand upright."""
        self.arm = arm
        description = WorldDescription(*KIND, (0, 0, 0), self._scene, read_board("bundle"), self._arms, arm)
        self._model = build_model(description)
        self._data = mujoco.MjData(self._model)
        self._camera.attach(self._model)
        mujoco.mj_fwdPosition(self._model, self._data)

    def base(self, arm: str) -> np.ndarray:
        """T_world_base by the physics, shape (4, 4) [m]."""
        body = self._data.body(f"{arm}/kuka/base_frame")
        return pose(body.xmat.reshape(3, 3), body.xpos)

    @property
    def T_base_camera(self) -> np.ndarray:
        """Where the camera truly stands in the base of the arm with the board, shape (4, 4) [m]."""
        camera = self._data.camera(OPTICAL)
        T_world_camera = pose(camera.xmat.reshape(3, 3) @ rotation_about(0, np.pi), camera.xpos)
        return inverse(self.base(self.arm)) @ T_world_camera

    def plan(self, config: ViewsConfig, seed: int) -> list[np.ndarray]:
        """Joints of the views, chosen from a guess of the camera pose that is 3 cm wrong."""
        planner = ViewPlanner(config, self.drawn, RGB, TARGET.corners, BOARD, self.base(self.arm)[:3, :3])
        guess = self.T_base_camera @ translation(0.02, -0.01, 0.02)
        return planner.choose(planner.candidates(guess, np.random.default_rng(seed)), guess)

    def views(self, joints: list[np.ndarray], limits: CalibrationConfig, rng: np.random.Generator):
        """The views of a calibration, from images. The arm touches nothing there; its measured flange has errors as
        large as the calibration states them.
        """
        error = inexact_arm(1e-3 * limits.arm_mm, np.radians(limits.arm_deg), rng)
        views = []
        for q in joints:
            self._go(q)
            assert not self.touched(), self.touched()
            pairs = list(filter(None, (self._look() for _ in range(limits.pictures))))
            detections = [detection for detection, _ in pairs]
            if limits.photometric:
                detections, _ = refined(pairs, RGB, self._refiner)
            views.append(view_from(detections, error(self.drawn.flange(q)), views, limits))
        return views

    def _go(self, q: np.ndarray) -> None:
        for joint, angle in zip(JOINTS, q):
            self._data.qpos[self._model.joint(f"{self.arm}/{joint}").qposadr[0]] = angle
        mujoco.mj_fwdPosition(self._model, self._data)
        self._now += 1.0  # no orientation is known from the view before

    def _look(self):
        """The marker board in the next image, and that image; None if it is not detected."""
        self._now += FRAME_S
        colour = self._camera.take(self._data, colour=True, depth=False, registered=False).colour
        grey = cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_RGB2GRAY)
        found = self._detector.detect(grey, RGB, self._now).targets
        return (BoardDetection(found[0].pose.T_camera_tag, found[0].pose.covariance), grey) if found else None

    def touched(self) -> set[str]:
        """What the arm with the board touches, by names of geoms."""
        names = [[self._model.geom(i).name for i in pair] for pair in self._data.contact.geom]
        return {name for pair in names if any(n.startswith(f"{self.arm}/") for n in pair) for name in pair}
