"""Drawings of the handbook, made of the code's own models: joint axes, paths of the tool, what the Leap sees."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon, Rectangle

from common.config import parse
from iiwa_kinematics import Kinematics, RobotModel, arm_points, robot_model
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.rig import Rig
from leap_kuka.config import ArmPlacement, LeapConfig
from leap_kuka.start_gate import InteractionBox, interaction_box
from tools.reference.sources import ROOT

ARM, INK, PALE, BLUE, GREEN, RED = "#e8730c", "#1f2933", "#b4bec8", "#1f5fd0", "#2e9e44", "#c62828"
SHOWN_RAD = np.radians(40.0)  # how far a joint is turned
SIGHT_M = (0.025, 0.6)  # heights at which the vendor promises to see a hand
SIGHT_DEG = (150.0, 120.0)  # its field of view along and across the device, as the vendor states
STEPS = 200
ELBOW_RAD, ELBOW_STEPS = 2.4, 120  # sum of the joints' motion [rad], and in how many steps
LOST_MM = ((272.0, 396.0), (321.0, 164.0), (226.0, 101.0))  # x and y at which recordings of real hands lost them


def rig() -> Rig:
    """Returns the arm, workspace and home of the shipped parameters."""
    values = yaml.safe_load((ROOT / "src/kuka_control/config/kuka_params_rt.yaml").read_text())
    return Rig.of(parse(RealTimeConfig, values))


def joint_axes(file: Path) -> None:
    """The seven axes, and which way the arm turns by a positive angle of each."""
    model = robot_model("LBR7R800", "MF_elektrisch")
    figure = Figure((13.0, 4.9), layout="constrained")
    upright, *bent = figure.subplots(1, 4, sharey=True)
    _draw_upright(upright, model)
    for axes, joint in zip(bent, (1, 3, 5)):
        q = np.zeros(7)
        _draw_arm(axes, arm_points(model, q), PALE)
        q[joint] = SHOWN_RAD
        points = arm_points(model, q)
        _draw_arm(axes, points, ARM)
        axes.plot(*points[(joint + 1) // 2, [0, 2]], "o", color=INK, markersize=9)
        axes.set_title(f"joint {joint + 1} at +{np.degrees(SHOWN_RAD):.0f} deg", fontsize=11)
    for axes in (upright, *bent):
        axes.set_aspect("equal")
        axes.set_xlim(-0.55, 0.75)
        axes.set_ylim(-0.06, 1.45)
        axes.set_xlabel("x [m]")
    upright.set_ylabel("z [m], seen from the base's -y side")
    upright.set_title("all at 0, positive directions", fontsize=11)
    _save(figure, file)


def _draw_upright(axes: Axes, model: RobotModel) -> None:
    """Draws the arm at zero with an arrow about each axis, positive by the right-hand rule."""
    points = arm_points(model, np.zeros(7))
    _draw_arm(axes, points, ARM)
    z = points[:, 2]
    heights = {1: 0.5 * z[1], 3: 0.5 * (z[1] + z[2]), 5: 0.5 * (z[2] + z[3]), 7: 0.5 * (z[3] + z[4])}
    for joint, height in heights.items():
        # About z, seen from the side: in front of the arm a positive turn goes from left to right.
        arrow = FancyArrowPatch(
            (-0.17, height + 0.02), (0.17, height + 0.02), connectionstyle="arc3,rad=0.35", color=BLUE,
            arrowstyle="-|>", mutation_scale=18, linewidth=2.2, zorder=5,
        )  # fmt: skip
        axes.add_patch(arrow)
        axes.text(0.23, height + 0.02, f"+{joint}", color=BLUE, fontsize=13, va="center")
    for joint, height, sign in ((2, z[1], 1.0), (4, z[2], -1.0), (6, z[3], 1.0)):
        axes.plot(0.0, height, "o", color=INK, markersize=11, zorder=6)
        arrow = FancyArrowPatch(
            (-0.14 * sign, height + 0.07), (0.14 * sign, height + 0.07), connectionstyle=f"arc3,rad={-0.5 * sign}",
            color=RED, arrowstyle="-|>", mutation_scale=18, linewidth=2.2, zorder=5,
        )  # fmt: skip
        axes.add_patch(arrow)
        axes.text(-0.23 * sign, height + 0.08, f"+{joint}", color=RED, fontsize=13, va="center", ha="center")


def _draw_arm(axes: Axes, points: np.ndarray, colour: str) -> None:
    axes.plot([-0.12, 0.12], [0.0, 0.0], color=INK, linewidth=5)
    for i, width in enumerate((16, 14, 12, 8)):
        axes.plot(*points[i : i + 2, [0, 2]].T, color=colour, linewidth=width, solid_capstyle="round")


def tool_paths(file: Path) -> None:
    """The tool's path between two poses: a straight line, and PTP motions of two joint configurations."""
    found = rig()
    kinematics = found.kinematics
    begin = found.home.q
    T_begin = kinematics.forward(begin)
    T_end = T_begin.copy()
    turn = np.radians(-80.0)
    T_end[:2, 3] = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ T_begin[:2, 3] * 1.08
    T_end[2, 3] += 0.12
    end = kinematics.inverse(T_end, begin).q
    if end is None:
        raise ValueError("the goal of the drawn motions is out of reach")
    other = other_configuration(kinematics, T_end, end)
    paths = {
        "straight line (LIN)": (BLUE, np.linspace(T_begin[:3, 3], T_end[:3, 3], STEPS)),
        "PTP": (RED, ptp_path(kinematics, begin, end)),
        "PTP to the same tool pose, other joints": (ARM, ptp_path(kinematics, begin, other)),
    }
    along = (T_end - T_begin)[:3, 3] / np.linalg.norm((T_end - T_begin)[:3, 3])
    figure = Figure((11.0, 5.8), layout="constrained")
    above, aside = figure.subplots(1, 2)
    for name, (colour, path) in paths.items():
        length = 1e3 * np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        beside = 1e3 * np.linalg.norm(np.cross(path - path[0], along), axis=1).max()
        text = f"{name}: {length:.0f} mm long, up to {beside:.0f} mm beside the line"
        above.plot(*path[:, :2].T, color=colour, linewidth=2.5, label=text)
        aside.plot(np.linspace(0.0, 1.0, STEPS), path[:, 2], color=colour, linewidth=2.5)
    for T, text in ((T_begin, "start"), (T_end, "goal")):
        above.plot(*T[:2, 3], "o", color=INK, markersize=8, zorder=5)
        above.annotate(text, T[:2, 3], textcoords="offset points", xytext=(8, 8))
    above.plot(0.0, 0.0, "s", color=INK, markersize=10)
    above.annotate("base", (0.0, 0.0), textcoords="offset points", xytext=(8, 8))
    above.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="the tool from above")
    aside.set(xlabel="fraction of the motion", ylabel="z of the tool [m]", title="its height")
    for axes in (above, aside):
        axes.grid(color="#e4e7eb")
    figure.legend(loc="outside lower center", ncols=1, frameon=False)
    _save(figure, file)


def ptp_path(kinematics: Kinematics, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Returns the tool points of a PTP motion, in which all joints begin and end together, shape (STEPS, 3) [m]."""
    return np.array([kinematics.forward(begin + s * (end - begin))[:3, 3] for s in np.linspace(0.0, 1.0, STEPS)])


def other_configuration(kinematics: Kinematics, T: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Returns other joints of the pose T, shape (7,) [rad]: from those in q the elbow swings by ELBOW_RAD."""
    for _ in range(ELBOW_STEPS):
        swing = np.linalg.svd(kinematics.jacobian(q))[2][-1]  # which leaves the tool where it is
        q = q + np.sign(swing[2]) * swing * ELBOW_RAD / ELBOW_STEPS
        found = kinematics.forward(q)
        turned = 0.5 * sum(np.cross(found[:3, i], T[:3, i]) for i in range(3))
        q = q + np.linalg.pinv(kinematics.jacobian(q)) @ np.append(T[:3, 3] - found[:3, 3], turned)
    return q


def leap_workspace(file: Path) -> None:
    """What the Leap sees, from the operator's seat and from the side, with the box in which a stream starts."""
    values = yaml.safe_load((ROOT / "src/leap_kuka/config/leap_params.yaml").read_text())
    found = rig()
    arm = {
        "center_line": [1.0, -1.0, 0.0],
        "z_lower_limit": found.workspace.z_lower,
        "ws_center": found.home.centre.tolist(),
        "tool_length": 0.106,
    }
    box = interaction_box(parse(LeapConfig, values), parse(ArmPlacement, arm, others=("tool_length",)))
    figure = Figure((11.0, 5.8), layout="constrained")
    front, side = figure.subplots(1, 2, sharey=True)
    for axes, axis, angle, title, label in (
        (front, 0, SIGHT_DEG[0], "from the operator's seat", "x: left and right [mm]"),
        (side, 2, SIGHT_DEG[1], "from the side; the operator sits on the right", "z: towards the operator [mm]"),
    ):
        _draw_sight(axes, angle, box, axis)
        axes.set(aspect="equal", xlabel=label, title=title, xlim=(-520, 520), ylim=(-60, 660))
    front.plot(*np.transpose(LOST_MM), "x", color=RED, markersize=9, markeredgewidth=2.5)
    front.text(LOST_MM[1][0], 60, "hands lost\nin recordings", color=RED, ha="center", va="center", fontsize=10)
    front.set_ylabel("y: height above the Leap [mm]")
    _save(figure, file)


def _draw_sight(axes: Axes, angle_deg: float, box: InteractionBox, axis: int) -> None:
    low, high = (1e3 * height for height in SIGHT_M)
    slope = np.tan(np.radians(0.5 * angle_deg))
    edge = [(-slope * low, low), (-slope * high, high), (slope * high, high), (slope * low, low)]
    axes.add_patch(Polygon(edge, facecolor=BLUE, alpha=0.12, edgecolor=BLUE, linewidth=1.5))
    axes.text(-460, high + 14, f"seen: {low:.0f} to {high:.0f} mm, {angle_deg:.0f} deg", color=BLUE, fontsize=11)
    size, centre = 1e3 * box.size, 1e3 * box.center
    corner = centre[axis] - 0.5 * size[axis], centre[1] - 0.5 * size[1]
    axes.add_patch(Rectangle(corner, size[axis], size[1], facecolor=GREEN, alpha=0.25, edgecolor=GREEN, linewidth=2))
    text = f"box in which a stream starts:\n{size[axis]:.0f} x {size[1]:.0f} mm, centre at {centre[1]:.0f} mm"
    top = centre[axis], centre[1] + 0.5 * size[1] + 40.0
    axes.text(*top, text, ha="center", va="center", color="#14532d", fontsize=10)
    half = 40.0 if axis == 0 else 15.0
    axes.add_patch(Rectangle((-half, -11.0), 2.0 * half, 11.0, facecolor=INK))
    axes.text(half + 12, -30, "Leap", color=INK, fontsize=11)
    axes.axhline(-11.0, color=PALE, linewidth=2, zorder=0)


def _save(figure: Figure, file: Path) -> None:
    figure.savefig(file, dpi=100, bbox_inches="tight")


PLOTS = {"joint-axes.png": joint_axes, "tool-paths.png": tool_paths, "leap-workspace.png": leap_workspace}
"""Files in docs/pictures by what draws them."""
