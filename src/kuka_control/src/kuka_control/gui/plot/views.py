"""The workspace and the arm from above, and in a vertical section, into which all points are rotated."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection

from kuka_control.gui.plot import colours
from kuka_control.gui.plot.picture import WorkspacePicture, in_home_plane, in_section
from kuka_control.model.workspace import Workspace

TRIAD_M = 0.1
LABEL_PT = 10.5
ARM_WIDTHS = (10, 9, 8, 6)


def draw_samples(above: Axes, side: Axes, picture: WorkspacePicture) -> None:
    """Draws where the workspace moves positions to, from above and in the section."""
    samples = picture.samples
    _draw_from_above(above, picture)
    _draw_moves(above, picture, samples.raw[:, :2], samples.position[:, :2])
    _draw_section(side, picture)
    _draw_moves(side, picture, in_section(samples.raw), in_section(samples.position))


def draw_reach(above: Axes, side: Axes, picture: WorkspacePicture) -> PathCollection:
    """Draws where the arm reaches, from above and in the section; returns what the colour bar is for."""
    _draw_from_above(above, picture)
    _draw_fractions(above, picture, picture.reach.positions[:, :2])
    _draw_section(side, picture)
    return _draw_fractions(side, picture, in_section(picture.reach.positions))


def _draw_moves(axes: Axes, picture: WorkspacePicture, raw: np.ndarray, position: np.ndarray) -> None:
    for acted, colour in colours.ACTED.items():
        group = picture.samples.group(acted)
        gaps = np.full_like(raw[group], np.nan)
        moves = np.stack([raw[group], position[group], gaps], axis=1).reshape(-1, 2)
        axes.plot(*moves.T, color=colour, linewidth=0.8, alpha=0.5, zorder=5)
        axes.scatter(*position[group].T, s=12, color=colour, linewidths=0, zorder=6)


def _draw_fractions(axes: Axes, picture: WorkspacePicture, points: np.ndarray) -> PathCollection:
    down = picture.reach.down
    percent = 100.0 * picture.reach.fraction[down]
    fractions = axes.scatter(*points[down].T, s=13, c=percent, cmap=colours.FRACTIONS, vmin=0.0, vmax=100.0,
                             linewidths=0, zorder=5)  # fmt: skip
    axes.scatter(*points[~down].T, marker="x", s=22, linewidths=1.5, color=colours.UNREACHED, zorder=6)
    return fractions


def _draw_from_above(axes: Axes, picture: WorkspacePicture) -> None:
    workspace, home = picture.rig.workspace, picture.rig.home
    half = workspace.opening_angle / 2.0
    turns = workspace.heading + np.linspace(-half, half, 60)
    arc = np.column_stack([np.cos(turns), np.sin(turns)])
    radii = _radii(workspace)
    _fill(axes, np.vstack([radii[:, 0].min() * arc, radii[:, 1].max() * arc[::-1]]))
    _draw_arm(axes, picture.arm[:, :2])
    _draw_triad(axes, home.T_base_tool[:2, 3], home.T_base_tool[:2, :3])
    axes.plot(*home.centre[:2], "*", color="black", markersize=11, zorder=11)
    _finish(axes, "From above", "x [m]", "y [m]")


def _draw_section(axes: Axes, picture: WorkspacePicture) -> None:
    workspace, home = picture.rig.workspace, picture.rig.home
    z, radii = _heights(workspace), _radii(workspace)
    _fill(axes, np.column_stack([np.append(radii[:, 0], radii[::-1, 1]), np.append(z, z[::-1])]))
    T = home.T_base_tool
    _draw_arm(axes, in_home_plane(picture.arm, T))
    _draw_triad(axes, in_home_plane(T[None, :3, 3], T)[0], in_home_plane(T[:3, :3].T, T).T)
    axes.plot(*in_section(home.centre[None])[0], "*", color="black", markersize=11, zorder=11)
    _finish(axes, "From the side, turned into one plane", "distance from the base axis [m]", "z [m]")


def _heights(workspace: Workspace) -> np.ndarray:
    return np.linspace(workspace.z_lower, workspace.z_upper, 61)


def _radii(workspace: Workspace) -> np.ndarray:
    return np.array([workspace.radii(z) for z in _heights(workspace)])


def _fill(axes: Axes, outline: np.ndarray) -> None:
    axes.fill(*outline.T, color=colours.WORKSPACE, alpha=0.1, linewidth=0, zorder=1)
    axes.plot(*np.vstack([outline, outline[:1]]).T, color=colours.WORKSPACE, linewidth=1.6, zorder=2)


def _draw_arm(axes: Axes, corners: np.ndarray) -> None:
    """Draws the arm pale, behind the samples."""
    for i, width in enumerate(ARM_WIDTHS):
        axes.plot(*corners[i : i + 2].T, color="#f6c9a0", linewidth=width, solid_capstyle="round", zorder=3)
    axes.plot(*corners[4:6].T, color="#c3c9d0", linewidth=3, zorder=3)
    axes.plot(*corners[1:4].T, "o", color="#8d949d", markersize=8, zorder=4)


def _draw_triad(axes: Axes, origin: np.ndarray, directions: np.ndarray) -> None:
    for direction, colour in zip(directions.T, colours.AXES):
        axes.plot(*np.array([origin, origin + TRIAD_M * direction]).T, color=colour, linewidth=2.2, zorder=10)


def _finish(axes: Axes, title: str, across: str, up: str) -> None:
    axes.set_title(title, fontsize=LABEL_PT, loc="left")
    axes.set_xlabel(across, fontsize=LABEL_PT)
    axes.set_ylabel(up, fontsize=LABEL_PT)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(True, color="#e3e6ea", linewidth=0.8)
    axes.set_axisbelow(True)
