"""The picture of the workspace: the scene in space on the left; on the right the arm from above and in a section.
The section is vertical, and all points are rotated into it. Above are the constrained samples, below is the reach."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import ArrayLike

from common.limits import Limit
from common.rotations import rotation_about
from iiwa_kinematics import arm_points
from kuka_control.model.rig import Rig
from kuka_control.model.workspace import Workspace, boundary_lines
from kuka_control.model.workspace_study import SEVERAL, UNCHANGED, ConstrainedSamples, ReachStudy

WORKSPACE = "#3b82c4"
ARM = "#e8730c"
JOINT = "#3f4650"
TOOL = "#7a8490"
UNREACHED = "#c40018"
AXES = ("#d62728", "#2ca02c", "#1f5fd0")  # of x, y and z in a triad
FRACTIONS = "viridis"  # colour map of the fraction of orientations that are reached

ACTED = {
    UNCHANGED: "#a9b2bd",
    Limit.OPENING_ANGLE.value: "#009e73",
    Limit.Z_LOWER.value: "#d3609a",
    Limit.Z_UPPER.value: "#7b3fa0",
    Limit.INNER_SPHERE.value: "#45aee6",
    Limit.OUTER_SPHERE.value: "#0b4f8a",
    SEVERAL: "#e0b400",
}
"""Which bound moved a sample."""

TRIAD_M = 0.13  # length of the axes of a frame [m]
SIDE_RAD = np.radians(62.0)  # from center_line to where the scene is looked at from, seen from above
FRONT = 10  # order of the arm: matplotlib cannot tell for objects that pass through each other
SIZE_INCH = (18.0, 10.0)
TEXT_PT = 10.5
HEADING = {"fontsize": 13, "fontweight": "bold", "va": "center"}


@dataclass(frozen=True, eq=False)
class WorkspacePicture:
    title: str  # one line above
    notes: tuple[str, ...]  # lines of text below
    rig: Rig  # the arm, its workspace and home
    samples: ConstrainedSamples  # positions that were constrained
    reach: ReachStudy  # where the arm reaches

    @property
    def arm(self) -> np.ndarray:
        """Base, shoulder, elbow, wrist, flange and tool point at home, shape (6, 3) [m]."""
        return np.vstack([arm_points(self.rig.model, self.rig.home.q), self.rig.home.T_base_tool[:3, 3]])

    @property
    def unreached(self) -> np.ndarray:
        """Positions that the tool does not reach pointing straight down, shape (n, 3) [m]."""
        return self.reach.positions[~self.reach.down]


def draw_scene(axes: Axes3D, picture: WorkspacePicture) -> None:
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
    back = 1  # behind samples and arm; see FRONT
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
        axes.plot_surface(*face, color=WORKSPACE, alpha=0.07, linewidth=0, shade=False, zorder=back)
    for line in boundary_lines(workspace, heights=2, headings=2):
        axes.plot(*line.T, color=WORKSPACE, linewidth=1.6, zorder=back + 1)


def _surface(r: ArrayLike, turn: ArrayLike, z: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r, turn, z = np.broadcast_arrays(r, turn, z)
    return r * np.cos(turn), r * np.sin(turn), z


def _draw_samples(axes: Axes3D, picture: WorkspacePicture) -> None:
    middle = 5  # between workspace and arm; see FRONT
    samples = picture.samples
    for acted, colour in ACTED.items():
        points = samples.position[samples.group(acted)]
        axes.scatter(*points.T, s=15, color=colour, zorder=middle, depthshade=False, linewidths=0)
    axes.scatter(*picture.unreached.T, marker="x", s=24, color=UNREACHED, zorder=middle + 1, depthshade=False)


def _draw_arm(axes: Axes3D, corners: np.ndarray) -> None:
    link_widths = (22, 19, 16, 12)  # of each part of the arm [points]
    turns = np.linspace(0.0, 2.0 * np.pi, 40)
    foot = 0.1 * np.cos(turns), 0.1 * np.sin(turns), 0.0 * turns
    axes.plot(*foot, color=JOINT, linewidth=4, zorder=FRONT - 2)
    for i, width in enumerate(link_widths):
        _draw_tube(axes, corners[i : i + 2], width, ARM)
    _draw_tube(axes, corners[[4, 5]], 5, TOOL)
    for joint, size in zip(corners[1:4], (22, 19, 16)):
        for fraction, shade in ((1.0, 0.6), (0.8, 1.0), (0.3, 2.2)):
            axes.plot(*joint[:, None], "o", color=_shaded(JOINT, shade), markersize=fraction * size,
                      markeredgewidth=0, zorder=FRONT)  # fmt: skip


def _draw_tube(axes: Axes3D, ends: np.ndarray, width: float, colour: str) -> None:
    for order, (fraction, shade) in enumerate(((1.0, 0.75), (0.78, 1.0), (0.3, 1.25))):
        axes.plot(*ends.T, color=_shaded(colour, shade), linewidth=fraction * width, solid_capstyle="round",
                  zorder=FRONT - 1 + 0.1 * order)  # fmt: skip


def _shaded(colour: str, factor: float) -> np.ndarray:
    """Returns the colour darker (factor below 1) or lighter (above 1)."""
    return np.minimum(factor * np.array(to_rgb(colour)), 1.0)


def _draw_triad(axes: Axes3D, T: np.ndarray, name: str, to_the_right: np.ndarray, size: float = 1.0) -> None:
    origin = T[:3, 3]
    text, side = (f"{name}   ", "right") if to_the_right @ T[:3, :2].sum(axis=1) > 0.0 else (f"   {name}", "left")
    for column, colour in zip(T[:3, :3].T, AXES):
        tip = origin + size * TRIAD_M * column
        axes.plot(*np.array([origin, tip]).T, color=colour, linewidth=2.8, zorder=FRONT + 2)
    axes.text(*origin, text, fontsize=12, ha=side, va="bottom", zorder=FRONT + 4,
              path_effects=[withStroke(linewidth=3, foreground="white")])  # fmt: skip


def _set_view(axes: Axes3D, picture: WorkspacePicture) -> None:
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


def draw(figure: Figure, picture: WorkspacePicture) -> None:
    """Draws the picture on an empty figure of `SIZE_INCH`."""
    figure.text(0.02, 0.965, picture.title, fontsize=15, fontweight="bold", va="center")
    draw_scene(figure.add_axes((0.012, 0.16, 0.43, 0.76), projection="3d", computed_zorder=False), picture)
    arm = Line2D([], [], color=ARM, linewidth=6, solid_capstyle="round", label="arm at home")
    border = Line2D([], [], color=WORKSPACE, linewidth=2, label="workspace")
    axes = (Line2D([], [], color=colour, linewidth=3, label=f"{name} axis") for name, colour in zip("xyz", AXES))
    figure.legend(handles=[arm, border, *axes], loc="upper left", bbox_to_anchor=(0.012, 0.94), ncol=5,
                  fontsize=TEXT_PT - 1, frameon=False, handlelength=1.4)  # fmt: skip
    figure.text(0.02, 0.155, "\n".join(picture.notes), fontsize=TEXT_PT, va="top", linespacing=1.55)

    left, right, width, height = 0.475, 0.725, 0.215, 0.35
    figure.text(left, 0.965, "How positions are constrained", **HEADING)
    samples = picture.samples
    above = figure.add_axes((left, 0.58, width, height)), figure.add_axes((right, 0.58, width, height))
    _draw_outlines(*above, picture)
    _draw_moves(above[0], picture, samples.raw[:, :2], samples.position[:, :2])
    _draw_moves(above[1], picture, _in_section(samples.raw), _in_section(samples.position))
    acted = [_dots(colour, "o", f"{name} ({samples.group(name).sum()})") for name, colour in ACTED.items()]
    figure.legend(handles=acted, loc="upper left", bbox_to_anchor=(left - 0.008, 0.54), ncol=4,
                  fontsize=TEXT_PT - 1, frameon=False, columnspacing=1.4, handletextpad=0.3)  # fmt: skip

    figure.text(left, 0.461, "Where the arm reaches", **HEADING)
    below = figure.add_axes((left, 0.065, width, height)), figure.add_axes((right, 0.065, width, height))
    _draw_outlines(*below, picture)
    _draw_fractions(below[0], picture, picture.reach.positions[:, :2])
    fractions = _draw_fractions(below[1], picture, _in_section(picture.reach.positions))
    bar = figure.colorbar(fractions, cax=figure.add_axes((0.95, 0.065, 0.009, height)))
    bar.set_label("orientations within the tolerances that are reached [%]", fontsize=TEXT_PT - 1)
    unreached = _dots(UNREACHED, "x", f"out of reach with the tool straight down ({len(picture.unreached)})")
    figure.legend(handles=[unreached, _dots("black", "*", "workspace centre", 11)], loc="center right", ncol=2,
                  bbox_to_anchor=(0.948, 0.461), fontsize=TEXT_PT - 1, frameon=False, handletextpad=0.3)  # fmt: skip


def _dots(colour: str, marker: str, label: str, size: float = 7) -> Line2D:
    return Line2D([], [], linestyle="none", marker=marker, markersize=size, color=colour, label=label)


def _in_section(points: np.ndarray) -> np.ndarray:
    """Returns each of the points as distance from the base axis and height, shape (n, 2) [m]."""
    return np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])


def _in_home_plane(points: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray:
    """Returns the points in the vertical plane of the tool, shape (n, 2) [m]: towards the tool, and height."""
    turn = math.atan2(T_base_tool[1, 3], T_base_tool[0, 3])
    return (points @ rotation_about(2, turn))[:, [0, 2]]


def _draw_moves(axes: Axes, picture: WorkspacePicture, raw: np.ndarray, position: np.ndarray) -> None:
    for acted, colour in ACTED.items():
        group = picture.samples.group(acted)
        gaps = np.full_like(raw[group], np.nan)
        moves = np.stack([raw[group], position[group], gaps], axis=1).reshape(-1, 2)
        axes.plot(*moves.T, color=colour, linewidth=0.8, alpha=0.5, zorder=5)
        axes.scatter(*position[group].T, s=12, color=colour, linewidths=0, zorder=6)


def _draw_fractions(axes: Axes, picture: WorkspacePicture, points: np.ndarray) -> PathCollection:
    """Draws where the arm reaches; returns what the colour bar is for."""
    down = picture.reach.down
    percent = 100.0 * picture.reach.fraction[down]
    fractions = axes.scatter(*points[down].T, s=13, c=percent, cmap=FRACTIONS, vmin=0.0, vmax=100.0,
                             linewidths=0, zorder=5)  # fmt: skip
    axes.scatter(*points[~down].T, marker="x", s=22, linewidths=1.5, color=UNREACHED, zorder=6)
    return fractions


def _draw_outlines(above: Axes, side: Axes, picture: WorkspacePicture) -> None:
    workspace, home = picture.rig.workspace, picture.rig.home
    half = workspace.opening_angle / 2.0
    turns = workspace.heading + np.linspace(-half, half, 60)
    arc = np.column_stack([np.cos(turns), np.sin(turns)])
    z = np.linspace(workspace.z_lower, workspace.z_upper, 61)
    radii = np.array([workspace.radii(height) for height in z])
    T = home.T_base_tool
    _fill(above, np.vstack([radii[:, 0].min() * arc, radii[:, 1].max() * arc[::-1]]))
    _draw_pale_arm(above, picture.arm[:, :2], T[:2, 3], T[:2, :3])
    above.plot(*home.centre[:2], "*", color="black", markersize=11, zorder=11)
    _finish(above, "From above", "x [m]", "y [m]")
    _fill(side, np.column_stack([np.append(radii[:, 0], radii[::-1, 1]), np.append(z, z[::-1])]))
    origin, directions = _in_home_plane(T[None, :3, 3], T)[0], _in_home_plane(T[:3, :3].T, T).T
    _draw_pale_arm(side, _in_home_plane(picture.arm, T), origin, directions)
    side.plot(*_in_section(home.centre[None])[0], "*", color="black", markersize=11, zorder=11)
    _finish(side, "From the side, turned into one plane", "distance from the base axis [m]", "z [m]")


def _fill(axes: Axes, outline: np.ndarray) -> None:
    axes.fill(*outline.T, color=WORKSPACE, alpha=0.1, linewidth=0, zorder=1)
    axes.plot(*np.vstack([outline, outline[:1]]).T, color=WORKSPACE, linewidth=1.6, zorder=2)


def _draw_pale_arm(axes: Axes, corners: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> None:
    pale_widths = (10, 9, 8, 6)
    for i, width in enumerate(pale_widths):
        axes.plot(*corners[i : i + 2].T, color="#f6c9a0", linewidth=width, solid_capstyle="round", zorder=3)
    axes.plot(*corners[4:6].T, color="#c3c9d0", linewidth=3, zorder=3)
    axes.plot(*corners[1:4].T, "o", color="#8d949d", markersize=8, zorder=4)
    for direction, colour in zip(directions.T, AXES):
        axes.plot(*np.array([origin, origin + 0.1 * direction]).T, color=colour, linewidth=2.2, zorder=10)


def _finish(axes: Axes, title: str, across: str, up: str) -> None:
    axes.set_title(title, fontsize=TEXT_PT, loc="left")
    axes.set_xlabel(across, fontsize=TEXT_PT)
    axes.set_ylabel(up, fontsize=TEXT_PT)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(True, color="#e3e6ea", linewidth=0.8)
    axes.set_axisbelow(True)
