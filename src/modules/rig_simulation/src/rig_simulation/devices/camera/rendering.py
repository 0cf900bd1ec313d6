"""Off-screen rendering of a MuJoCo model: colour and depth in one pass, without a display."""

from __future__ import annotations

import mujoco
import numpy as np

from common.errors import DeviceError
from rig_simulation.devices.camera.lens import PixelWindow

NEAR_M = 0.05
FAR_M = 30.0
MAX_GEOMS = 5000
EXTRAS_OFF = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_HAZE)
SHOWN = mujoco.mjtCatBit.mjCAT_STATIC | mujoco.mjtCatBit.mjCAT_DYNAMIC


class Renderer:
    """Renders one model through one window, in the thread that made it. Close it.

    Args:
        model: the model; its settings of the off-screen buffer change.
        window: replaces the field of view of the model's cameras.
        samples: a pixel, for anti-aliasing: 0, 2, 4 ...

    Attributes:
        depth_offset: position of the depth in its pixel, right and up from the centre [px]: with several samples, a
            pixel has their mean colour, but the depth of the first.

    Raises:
        DeviceError: this machine cannot render off-screen.
    """

    def __init__(self, model: mujoco.MjModel, window: PixelWindow, samples: int) -> None:
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
        self._scene = mujoco.MjvScene(model, maxgeom=MAX_GEOMS)
        for extra in EXTRAS_OFF:
            self._scene.flags[extra] = 0
        self._option = mujoco.MjvOption()
        self._free = mujoco.MjvCamera()

    def render(self, data: mujoco.MjData, camera: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns colour, shape (height, width, 3), uint8, and inverse depth, shape (height, width), float32 [1/m].

        Rows run from the bottom up.

        Args:
            data: with computed kinematics and cameras.
            camera: number of the model's camera.
        """
        window = self._window
        self._gl.make_current()
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._free, SHOWN, self._scene)
        axes = data.cam_xmat[camera].reshape(3, 3)
        for view in self._scene.camera:
            view.pos = data.cam_xpos[camera]
            view.forward, view.up = -axes[:, 2], axes[:, 1]
            view.frustum_near, view.frustum_far = NEAR_M, FAR_M
            view.frustum_bottom, view.frustum_top = window.bottom * NEAR_M, window.top * NEAR_M
            view.frustum_center = (window.left + window.right) / 2.0 * NEAR_M
            view.frustum_width = (window.right - window.left) / 2.0 * NEAR_M  # MuJoCo means half the width
        viewport = mujoco.MjrRect(0, 0, window.width, window.height)
        mujoco.mjr_render(viewport, self._scene, self._context)
        colour = np.empty((window.height, window.width, 3), np.uint8)
        inverse_depth = np.empty((window.height, window.width), np.float32)
        mujoco.mjr_readPixels(colour, inverse_depth, viewport, self._context)
        inverse_depth *= np.float32(1.0 / NEAR_M - 1.0 / FAR_M)
        inverse_depth += np.float32(1.0 / FAR_M)
        return colour, inverse_depth

    def close(self) -> None:
        """Frees the memory of the display."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()


def _sample_offset() -> tuple[float, float]:
    from OpenGL import GL

    column, row = GL.glGetMultisamplefv(GL.GL_SAMPLE_POSITION, 0)
    return float(column) - 0.5, float(row) - 0.5
