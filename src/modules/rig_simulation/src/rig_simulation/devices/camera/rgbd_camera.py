"""The RGB-D camera: one infrared and one colour camera side by side in the simulated world, rendered off-screen. Depth
has its own viewpoint; registered depth has the pixels of the colour image and shares its rendering pass."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter

import mujoco
import numpy as np

from common.camera_model import CameraModel
from common.errors import DeviceError
from common.frames import DEPTH_OPTICAL, RGB_OPTICAL
from rig_simulation.devices.camera.sensors import CameraLens, ColourSensor, DepthSensor, PixelWindow
from rig_simulation.node_parameters import ColourConfig, DepthConfig

EXTRAS_OFF = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_HAZE)
SHOWN = mujoco.mjtCatBit.mjCAT_STATIC | mujoco.mjtCatBit.mjCAT_DYNAMIC


class Renderer:
    """Renders one model, whose settings of the off-screen buffer change, through one window, which replaces the field
    of view of the model's cameras, in the thread that made it. Close it. `samples`: per pixel, for anti-aliasing (0, 2,
    4, ...); `sky`: whether it is drawn where nothing is; `depth_offset`: position of the depth in its pixel, right and
    up from the centre [px]: a pixel has its samples' mean colour, but the depth of the first. Raises DeviceError if
    this machine cannot render off-screen."""

    def __init__(self, model: mujoco.MjModel, window: PixelWindow, samples: int, sky: bool = True) -> None:
        max_geoms = 5000
        try:
            from mujoco.egl import GLContext  # opens the display
        except (ImportError, AttributeError, RuntimeError) as error:
            reason = " ".join(str(error).split())
            raise DeviceError(f"Cannot render without a display: {reason}. Install libegl1 and libegl-mesa0.") from None
        self._window = window
        model.vis.global_.offwidth, model.vis.global_.offheight = window.width, window.height
        model.vis.quality.offsamples = samples
        self._model = model
        self._gl = GLContext(window.width, window.height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self.depth_offset = _sample_offset() if self._context.offSamples else (0.0, 0.0)
        self._scene = mujoco.MjvScene(model, maxgeom=max_geoms)
        for extra in EXTRAS_OFF:
            self._scene.flags[extra] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = sky
        self._option = mujoco.MjvOption()
        self._free = mujoco.MjvCamera()

    def render(self, data: mujoco.MjData, camera: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns colour, shape (height, width, 3), uint8, and inverse depth, shape (height, width), float32 [1/m],
        rows from the bottom up, of `data` with computed kinematics and cameras; `camera`: its number in the model."""
        near_m = 0.05
        far_m = 30.0
        hidden_group = 5  # of geoms; not drawn by default
        window = self._window
        self._gl.make_current()
        groups = self._model.geom_group.copy()
        self._model.geom_group[self._beyond(data, camera)] = hidden_group
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._free, SHOWN, self._scene)
        self._model.geom_group[:] = groups
        axes = data.cam_xmat[camera].reshape(3, 3)
        for view in self._scene.camera:
            view.pos = data.cam_xpos[camera]
            view.forward, view.up = -axes[:, 2], axes[:, 1]
            view.frustum_near, view.frustum_far = near_m, far_m
            view.frustum_bottom, view.frustum_top = window.bottom * near_m, window.top * near_m
            view.frustum_center = (window.left + window.right) / 2.0 * near_m
            view.frustum_width = (window.right - window.left) / 2.0 * near_m  # MuJoCo means half the width
        viewport = mujoco.MjrRect(0, 0, window.width, window.height)
        mujoco.mjr_render(viewport, self._scene, self._context)
        colour = np.empty((window.height, window.width, 3), np.uint8)
        inverse_depth = np.empty((window.height, window.width), np.float32)
        mujoco.mjr_readPixels(colour, inverse_depth, viewport, self._context)
        inverse_depth *= np.float32(1.0 / near_m - 1.0 / far_m)
        inverse_depth += np.float32(1.0 / far_m)
        return colour, inverse_depth

    def _beyond(self, data: mujoco.MjData, camera: int) -> np.ndarray:
        """Returns which geoms lie outside the view, whose vertices need not be transformed, shape (n,), bool."""
        window, reach = self._window, self._model.geom_rbound
        x, y, z = ((data.geom_xpos - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(3, 3)).T
        beyond = np.zeros(len(reach), bool)
        for side, distance in ((window.left, x), (-window.right, -x), (window.bottom, y), (-window.top, -y)):
            beyond |= distance + side * z < -reach * np.hypot(1.0, side)
        return beyond & (reach > 0.0)  # a plane has no end

    def close(self) -> None:
        self._gl.make_current()
        self._context.free()
        self._gl.free()


def _sample_offset() -> tuple[float, float]:
    from OpenGL import GL

    column, row = GL.glGetMultisamplefv(GL.GL_SAMPLE_POSITION, 0)
    return float(column) - 0.5, float(row) - 0.5


@dataclass(frozen=True)
class RgbdImages:
    """Images of one moment; None for those not requested."""

    colour: np.ndarray | None  # shape (height, width, 3), uint8, red first
    depth: np.ndarray | None  # of the infrared camera, shape (height, width), uint16 [mm], 0 = no depth
    registered: np.ndarray | None  # depth in the colour camera's pixels, the same type
    seconds: Mapping[str, float]  # duration of each stage [s]


class RgbdCamera:
    """Takes images of a model, in one thread only; close it. `samples`: of a pixel of the colour image, for
    anti-aliasing; `seed`: of the unit's errors and of the noise; `clock` measures the duration of the stages [s]."""

    def __init__(
        self,
        rgb: CameraModel,
        depth: CameraModel,
        colour_config: ColourConfig,
        depth_config: DepthConfig,
        samples: int,
        seed: int,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        self._clock = clock
        self._lenses = CameraLens(rgb), CameraLens(depth)
        self._depth_config, self._samples, self._seed = depth_config, samples, seed
        self._colour = ColourSensor(self._lenses[0], colour_config, np.random.default_rng(seed))
        self._depth = DepthSensor(self._lenses[1], depth_config, np.random.default_rng(seed + 1))
        self._registered: DepthSensor | None = None
        self._renderers: list[Renderer] = []

    def attach(self, model: mujoco.MjModel) -> None:
        """Attaches the camera to a model; DeviceError if it lacks the cameras or this machine cannot render."""
        self.close()
        try:
            self._numbers = [model.camera(name).id for name in (RGB_OPTICAL, DEPTH_OPTICAL)]
        except KeyError:
            raise DeviceError(f"The world lacks the cameras {RGB_OPTICAL} and {DEPTH_OPTICAL}.") from None
        self._renderers.append(Renderer(model, self._lenses[0].window, self._samples))
        self._renderers.append(Renderer(model, self._lenses[1].window, 0, sky=False))
        if self._registered is None:
            lens = CameraLens(self._lenses[0].camera, self._renderers[0].depth_offset)
            # The same unit: the same random draws.
            unit = np.random.default_rng(self._seed + 1)
            self._registered = DepthSensor(lens, self._depth_config, unit, _infrared_offset(model, *self._numbers))

    def take(self, data: mujoco.MjData, colour: bool, depth: bool, registered: bool) -> RgbdImages:
        """Returns the requested images of a state of the attached model, with computed kinematics and cameras."""
        seconds: dict[str, float] = {}
        started = self._clock()

        def finished(stage: str) -> None:
            nonlocal started
            now = self._clock()
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
