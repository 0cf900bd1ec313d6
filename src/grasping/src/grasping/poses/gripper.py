"""A two-fingered gripper in numbers: what labels, sampler, physics and the network's view of a grasp know of a hand."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import yaml

from common.config import number, parse
from common.errors import RigError
from grasping.network.maps import PARALLEL, REFLEX


@dataclass(frozen=True)
class Gripper:
    """Also the schema of the file of --gripper."""

    opening: float = number("m", above=0.01, high=0.5, absent=0.10, doc="between the pads when open")
    thickness: float = number("m", above=0.0, high=0.1, absent=0.008, doc="of a finger along the closing direction")
    breadth: float = number("m", above=0.0, high=0.2, absent=0.020, doc="of a finger across it")
    reach: float = number("m", low=0.0, high=0.2, absent=0.025, doc="from the surface down to the tips")
    ground: float = number("m", low=0.0, high=0.1, absent=0.006, doc="lowest height of the tips above the table")
    clearance: float = number(
        "m", low=0.0, high=0.05, absent=0.005, doc="on each side between object and pad when the hand comes down"
    )
    palm: float = number("m", above=0.0, high=0.5, absent=0.060, doc="from the tips to the palm")
    friction: float = number(above=0.0, high=2.0, absent=0.5, doc="coefficient that a grasp may count on")
    margin: float = number(
        "m", low=0.0, high=0.1, absent=0.0, doc="added to the opening of a label, as far as the gripper opens"
    )
    least: float = number("m", low=0.0, high=0.5, absent=0.0, doc="between the pads when the hand comes down")

    def faults(self) -> list[str]:
        too_wide = self.least > self.opening
        return [f"least is {self.least:g} m, but must be at most opening, {self.opening:g} m."] if too_wide else []


GRIPPER = parse(Gripper, {})
GRIPPERS = {
    PARALLEL: GRIPPER,
    REFLEX: dataclasses.replace(
        GRIPPER, opening=0.116, least=0.116, thickness=0.020, breadth=0.068, reach=0.041, friction=1.1
    ),
}
"""By hand; the ReFlex as two broad fingers, which always come down half closed: more of them meet something than do
with the hand."""


GRIPPER_HELP = "yaml file of another parallel gripper, with keys of grasping.poses.gripper"


def read_gripper(path: Path) -> Gripper:
    """Returns the gripper of a file; missing keys are those of `GRIPPER`. Raises RigError or OSError."""
    try:
        return parse(Gripper, yaml.safe_load(path.read_text(encoding="utf-8")), f"{path}: ")
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RigError(f"{path} is no yaml file: {' '.join(str(error).split())}.") from None
