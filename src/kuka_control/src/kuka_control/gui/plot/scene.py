"""The workspace and the arm in space."""

from __future__ import annotations

import numpy as np
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import ArrayLike

from kuka_control.gui.plot import colours
from kuka_control.gui.plot.picture import WorkspacePicture
from kuka_control.model.workspace import Workspace, boundary_lines

TRIAD_M = 0.13
"""Length of the axes of a frame [m]."""

SIDE_RAD = np.radians(62.0)
"""From center_line to where the scene is looked at from, seen from above."""

LINKS = ((0, 1, 22), (1, 2, 19), (2, 3, 16), (3, 4, 12))
"""Corner, next corner and width of each part of the arm [points]."""

# What lies in front: matplotlib cannot tell for objects that pass through each other.
BACK, MIDDLE, FRONT = 1, 5, 10


def draw_scene(axes: Axes3D, picture: WorkspacePicture) -> None:
    """Draws the scene in space."""
    _draw_workspace(axes, picture.rig.workspace)
    _draw_samples(axes, picture)
    _draw_arm(axes, picture.arm)
    home = picture.rig.home
    azimuth = picture.rig.workspace.heading + SIDE_RAD
    to_the_right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    _draw_triad(axes, np.eye(4), "base", to_the_right)
    _draw_triad(axes, home.T_base_flange, "flange", to_the_right, 0.7)
    _draw_triad(axes, home.T_base_tool, "tool", to_the_right)
    axes.scatter(*home.centre, marker="*", s=170, color="black", zorder=FRONT + 3, depthshade=False)
    _set_view(axes, picture)


def _draw_workspace(axes: Axes3D, workspace: Workspace) -> None:
    half = workspace.opening_angle / 2.0
    turns = workspace.heading + np.linspace(-half, half, 25)
    heights = np.linspace(workspace.z_lower, workspace.z_upper, 17)
    radii = np.array([workspace.radii(z) for z in heights])
    between = np.linspace(0.0, 1.0, 5)
    across = radii[:, :1] + (radii[:, 1:] - radii[:, :1]) * between
    faces = [_surface(radii[:, i, None], turns, heights[:, None]) for i in (0, 1)]
    for i in (0, -1):
        faces.append(_surface(across[i, :, None], turns, heights[i]))
        faces.append(_surface(across, turns[i], heights[:, None]))
    for face in faces:
        axes.plot_surface(*face, color=colours.WORKSPACE, alpha=0.07, linewidth=0, shade=False, zorder=BACK)
    for line in boundary_lines(workspace, heights=2, headings=2):
        axes.plot(*line.T, color=colours.WORKSPACE, linewidth=1.6, zorder=BACK + 1)


def _surface(r: ArrayLike, turn: ArrayLike, z: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r, turn, z = np.broadcast_arrays(r, turn, z)
    return r * np.cos(turn), r * np.sin(turn), z


def _draw_samples(axes: Axes3D, picture: WorkspacePicture) -> None:
    samples = picture.samples
    for acted, colour in colours.ACTED.items():
        points = samples.position[samples.group(acted)]
        axes.scatter(*points.T, s=15, color=colour, zorder=MIDDLE, depthshade=False, linewidths=0)
    axes.scatter(*picture.unreached.T, marker="x", s=24, color=colours.UNREACHED, zorder=MIDDLE + 1, depthshade=False)


def _draw_arm(axes: Axes3D, corners: np.ndarray) -> None:
    turns = np.linspace(0.0, 2.0 * np.pi, 40)
    foot = 0.1 * np.cos(turns), 0.1 * np.sin(turns), 0.0 * turns
    axes.plot(*foot, color=colours.JOINT, linewidth=4, zorder=FRONT - 2)
    for i, j, width in LINKS:
        _draw_tube(axes, corners[[i, j]], width, colours.ARM)
    _draw_tube(axes, corners[[4, 5]], 5, colours.TOOL)
    for joint, size in zip(corners[1:4], (22, 19, 16)):
        for fraction, shade in ((1.0, 0.6), (0.8, 1.0), (0.3, 2.2)):
            axes.plot(*joint[:, None], "o", color=colours.shaded(colours.JOINT, shade), markersize=fraction * size,
                      markeredgewidth=0, zorder=FRONT)  # fmt: skip


def _draw_tube(axes: Axes3D, ends: np.ndarray, width: float, colour: str) -> None:
    """Draws a line with a dark rim and a light middle, so that it looks round."""
    for order, (fraction, shade) in enumerate(((1.0, 0.75), (0.78, 1.0), (0.3, 1.25))):
        axes.plot(*ends.T, color=colours.shaded(colour, shade), linewidth=fraction * width, solid_capstyle="round",
                  zorder=FRONT - 1 + 0.1 * order)  # fmt: skip


def _draw_triad(axes: Axes3D, T: np.ndarray, name: str, to_the_right: np.ndarray, size: float = 1.0) -> None:
    """Draws the axes of a frame, and its name on the side that they leave free."""
    origin = T[:3, 3]
    text, side = (f"{name}   ", "right") if to_the_right @ T[:3, :2].sum(axis=1) > 0.0 else (f"   {name}", "left")
    for column, colour in zip(T[:3, :3].T, colours.AXES):
        tip = origin + size * TRIAD_M * column
        axes.plot(*np.array([origin, tip]).T, color=colour, linewidth=2.8, zorder=FRONT + 2)
    axes.text(*origin, text, fontsize=12, ha=side, va="bottom", zorder=FRONT + 4,
              path_effects=[withStroke(linewidth=3, foreground="white")])  # fmt: skip


def _set_view(axes: Axes3D, picture: WorkspacePicture) -> None:
    """Gives all axes the same scale, and looks at the arm's plane from in front and above."""
    foot = [[-0.15, -0.15, 0.0], [0.15, 0.15, 0.0]]
    shown = np.vstack([picture.arm, *boundary_lines(picture.rig.workspace), foot])
    low, high = np.append(shown.min(axis=0)[:2] - 0.05, 0.0), shown.max(axis=0) + 0.05
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(high - low, zoom=0.98)
    axes.view_init(elev=22.0, azim=np.degrees(picture.rig.workspace.heading + SIDE_RAD))
    axes.set_xlabel("x [m]", labelpad=8, fontsize=11)
    axes.set_ylabel("y [m]", labelpad=8, fontsize=11)
    axes.zaxis.set_rotate_label(False)
    axes.set_zlabel("z [m]", labelpad=6, fontsize=11, rotation=90)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MultipleLocator(0.2))
        axis.set_pane_color((0.97, 0.97, 0.98, 1.0))
