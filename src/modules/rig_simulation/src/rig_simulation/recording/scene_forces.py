"""Arrows of forces in a MuJoCo scene, for the window and for films."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from rig_simulation.recording.forces import Arrow

WIDTH_M = 0.009
DRAWN_LENGTH = 2.0
"""MuJoCo draws an arrow half as long as its connector says (3.2.3)."""
OF_ROBOT, OF_OTHERS = np.array([1.0, 0.45, 0.0, 1.0]), np.array([0.35, 0.65, 1.0, 1.0])


def add_arrows(scene: mujoco.MjvScene, arrows: Sequence[Arrow]) -> None:
    """Adds arrows behind what is in the scene; those for which it has no room are left out."""
    for arrow in arrows[: scene.maxgeom - scene.ngeom]:
        geom = scene.geoms[scene.ngeom]
        colour = OF_ROBOT if arrow.by_robot else OF_OTHERS
        mujoco.mjv_initGeom(
            geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.zeros(9), colour.astype(np.float32)
        )
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, WIDTH_M, arrow.tail, arrow.tip)
        geom.size[2] *= DRAWN_LENGTH
        scene.ngeom += 1
