"""The RGB-D camera: one infrared and one colour camera side by side in the simulated world.

Depth comes from a viewpoint of its own; registered depth belongs, pixel by pixel, to the colour picture and shares its
pass of rendering.
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
    """What the camera took; None where it was not asked for.

    Attributes:
        colour: shape (height, width, 3), uint8, red first.
        depth: seen by the infrared camera, shape (height, width), uint16 [mm], 0 = none.
        registered: depth in the colour camera's pixels, the same type.
        seconds: how long each stage took [s].
    """

    colour: np.ndarray | None
    depth: np.ndarray | None
    registered: np.ndarray | None
    seconds: Mapping[str, float]


class RgbdCamera:
    """Takes pictures of a model. Use it in one thread only, and close it.

    Args:
        rgb, depth: intrinsics of the two cameras.
        colour_config, depth_config: what the sensors do.
        samples: of a pixel of the colour picture, against stairs along edges.
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
        """Takes the model to look at from now on.

        Raises:
            DeviceError: this machine cannot render without a screen, or the model has no such cameras.
        """
        self.close()
        try:
            self._numbers = [model.camera(name).id for name in (RGB_OPTICAL, DEPTH_OPTICAL)]
        except KeyError:
            raise DeviceError(f"The world has no cameras {RGB_OPTICAL} and {DEPTH_OPTICAL}.") from None
        self._renderers.append(Renderer(model, self._lenses[0].window, self._samples))
        self._renderers.append(Renderer(model, self._lenses[1].window, 0))
        if self._registered is None:
            lens = CameraLens(self._lenses[0].camera, self._renderers[0].depth_offset)
            # The same unit: the same draws of the generator.
            unit = np.random.default_rng(self._seed + 1)
            self._registered = DepthSensor(lens, self._depth_config, unit, _infrared_offset(model, *self._numbers))

    def take(self, data: mujoco.MjData, colour: bool, depth: bool, registered: bool) -> RgbdImages:
        """Returns the pictures that are asked for.

        Args:
            data: state of the attached model, with kinematics and cameras computed.
        """
        seconds: dict[str, float] = {}
        started = time.perf_counter()

        def finished(stage: str) -> None:
            nonlocal started
            now = time.perf_counter()
            seconds[stage], started = now - started, now

        colour_picture = depth_picture = registered_picture = None
        if colour or registered:
            seen, inverse_depth = self._renderers[0].render(data, self._numbers[0])
            finished("render_rgb")
            if colour:
                colour_picture = self._colour.take(seen)
                finished("colour")
            if registered:
                assert self._registered is not None  # made by `attach`
                registered_picture = self._registered.take(inverse_depth, seen)
                finished("registered")
        if depth:
            seen, inverse_depth = self._renderers[1].render(data, self._numbers[1])
            finished("render_depth")
            depth_picture = self._depth.take(inverse_depth, seen)
            finished("depth")
        return RgbdImages(colour_picture, depth_picture, registered_picture, seconds)

    def close(self) -> None:
        """Gives the display's memory back; `attach` takes it again."""
        for renderer in self._renderers:
            renderer.close()
        self._renderers.clear()


def _infrared_offset(model: mujoco.MjModel, rgb: int, depth: int) -> float:
    """Returns how far to the right of the colour camera the infrared camera stands [m]; both look the same way."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    return float((data.cam_xpos[depth] - data.cam_xpos[rgb]) @ data.cam_xmat[rgb].reshape(3, 3)[:, 0])
