"""The RGB-D camera: one infrared and one colour camera side by side in the simulated world.

Depth has its own viewpoint; registered depth has the pixels of the colour image and shares its rendering pass.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from common.camera_model import CameraModel
from common.errors import DeviceError
from common.frames import DEPTH_OPTICAL, RGB_OPTICAL
from rig_simulation.devices.camera.colour_sensor import ColourSensor
from rig_simulation.devices.camera.config import ColourConfig, DepthConfig
from rig_simulation.devices.camera.depth_sensor import DepthSensor
from rig_simulation.devices.camera.lens import CameraLens
from rig_simulation.devices.camera.rendering import Renderer


@dataclass(frozen=True)
class RgbdImages:
    """Images of one moment; None for those not requested."""

    colour: np.ndarray | None  # shape (height, width, 3), uint8, red first
    depth: np.ndarray | None  # of the infrared camera, shape (height, width), uint16 [mm], 0 = no depth
    registered: np.ndarray | None  # depth in the colour camera's pixels, the same type
    seconds: Mapping[str, float]  # duration of each stage [s]


class RgbdCamera:
    """Takes images of a model. Use it in one thread only, and close it.

    Args:
        rgb, depth: intrinsics of the two cameras.
        colour_config, depth_config: effects of the sensors.
        samples: a pixel of the colour image, for anti-aliasing.
        seed: of the unit's errors and of the noise.
    """

    def __init__(
        self,
        rgb: CameraModel,
        depth: CameraModel,
        colour_config: ColourConfig,
        depth_config: DepthConfig,
        samples: int,
        seed: int,
    ) -> None:
        self._lenses = CameraLens(rgb), CameraLens(depth)
        self._depth_config, self._samples, self._seed = depth_config, samples, seed
        self._colour = ColourSensor(self._lenses[0], colour_config, np.random.default_rng(seed))
        self._depth = DepthSensor(self._lenses[1], depth_config, np.random.default_rng(seed + 1))
        self._registered: DepthSensor | None = None
        self._renderers: list[Renderer] = []

    def attach(self, model: mujoco.MjModel) -> None:
        """Attaches the camera to a model.

        Raises:
            DeviceError: this machine cannot render off-screen, or the model lacks the cameras.
        """
        self.close()
        try:
            self._numbers = [model.camera(name).id for name in (RGB_OPTICAL, DEPTH_OPTICAL)]
        except KeyError:
            raise DeviceError(f"The world lacks the cameras {RGB_OPTICAL} and {DEPTH_OPTICAL}.") from None
        self._renderers.append(Renderer(model, self._lenses[0].window, self._samples))
        self._renderers.append(Renderer(model, self._lenses[1].window, 0))
        if self._registered is None:
            lens = CameraLens(self._lenses[0].camera, self._renderers[0].depth_offset)
            # The same unit: the same random draws.
            unit = np.random.default_rng(self._seed + 1)
            self._registered = DepthSensor(lens, self._depth_config, unit, _infrared_offset(model, *self._numbers))

    def take(self, data: mujoco.MjData, colour: bool, depth: bool, registered: bool) -> RgbdImages:
        """Returns the requested images.

        Args:
            data: state of the attached model, with computed kinematics and cameras.
        """
        seconds: dict[str, float] = {}
        started = time.perf_counter()

        def finished(stage: str) -> None:
            nonlocal started
            now = time.perf_counter()
            seconds[stage], started = now - started, now

        colour_image = depth_image = registered_image = None
        if colour or registered:
            rendered, inverse_depth = self._renderers[0].render(data, self._numbers[0])
            finished("render_rgb")
            if colour:
                colour_image = self._colour.take(rendered)
                finished("colour")
            if registered:
                assert self._registered is not None  # made by `attach`
                registered_image = self._registered.take(inverse_depth, rendered)
                finished("registered")
        if depth:
            rendered, inverse_depth = self._renderers[1].render(data, self._numbers[1])
            finished("render_depth")
            depth_image = self._depth.take(inverse_depth, rendered)
            finished("depth")
        return RgbdImages(colour_image, depth_image, registered_image, seconds)

    def close(self) -> None:
        """Frees the memory of the display; `attach` allocates it again."""
        for renderer in self._renderers:
            renderer.close()
        self._renderers.clear()


def _infrared_offset(model: mujoco.MjModel, rgb: int, depth: int) -> float:
    """Returns the offset of the infrared camera to the right of the colour camera [m]; both have one orientation."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    return float((data.cam_xpos[depth] - data.cam_xpos[rgb]) @ data.cam_xmat[rgb].reshape(3, 3)[:, 0])
