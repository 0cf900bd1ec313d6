"""What a study of the workspace found, in sentences."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from kuka_control.model.config import ControllerConfig
from kuka_control.model.reach_study import ReachStudy
from kuka_control.model.rig import Rig


def title(config: ControllerConfig) -> str:
    """Returns what the picture shows, in one line."""
    line = ", ".join(f"{part:.3g}" for part in config.center_line)
    return f"Workspace of the {config.robot}: center_line [{line}], {config.opening_angle:g} deg"


def sentences(config: ControllerConfig, rig: Rig, study: ReachStudy, tolerances_deg: Sequence[float]) -> list[str]:
    """Returns the settings and the findings, one sentence a line.

    Args:
        config: the parameters.
        rig: what they describe.
        study: how much of the workspace the arm reaches.
        tolerances_deg: yaw, pitch and roll of the study [deg].
    """
    x, y, z = rig.home.centre
    joints = ", ".join(f"{joint:.1f}" for joint in np.degrees(rig.home.q).round(1) + 0.0)
    home = "home_pos" if config.use_home_pos else "calculated"
    lines = [
        f"The tool may be {config.z_lower_limit:g} to {config.z_upper_limit:g} m high, and "
        f"{config.inner_sphere_limit:g} to {config.outer_sphere_limit:g} m from joint 2; its point is "
        f"{np.linalg.norm(rig.T_flange_tool[:3, 3]):g} m from the flange.",
        f"Its centre is ({x:.3f}, {y:.3f}, {z:.3f}) m.",
        f"The joints at home ({home}): {joints} deg.",
        f"Reached with the tool straight down: {study.percent_down:.1f} % of {len(study.positions)} positions all over "
        "the workspace.",
        f"Reached within yaw, pitch, roll of {_tolerances(tolerances_deg)} deg: {study.percent_within:.1f} % of the "
        "poses.",
        f"Reached with every orientation that was tried: {study.percent_always:.1f} % of the positions.",
    ]
    if study.failures:
        reasons = (f"{count} {str(reason).split(': ')[-1].rstrip('.')}" for reason, count in study.failures.items())
        lines.append(f"Positions out of reach with the tool straight down: {'; '.join(reasons)}.")
    return lines


def _tolerances(values: Sequence[float]) -> str:
    return ", ".join(f"+-{value:g}" for value in values) if len(set(values)) > 1 else f"+-{values[0]:g}"
