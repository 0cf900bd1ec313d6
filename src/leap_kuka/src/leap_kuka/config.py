"""Configuration: the parameters under `leap/`, and those of the arm that leap_kuka needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from common.config import choice, flag, integer, number, vector
from common.hand_tracking import ANY, LEFT, RIGHT
from common.mounting import EVEN, MountingFrame, ToolConfig, mounting_field, mounting_frame
from common.poses import read_only
from common.rotations import rotation_from_quaternion
from leap_kuka.hand_filter import FILTERS

ABSOLUTE, RELATIVE = "absolute", "relative"
NONE, DEVICE = "none", "device"
SERVICE, REGION = "service", "region"  # how one hand chooses among several arms
OPERATOR_INPUT = "operator_input"  # the parameters of operator_input_node, also under leap/
SWITCHES = (NONE, "second_hand_fist", "second_hand_pinch", DEVICE)


@dataclass(frozen=True)
class LeapConfig:
    """The parameters under `leap/`."""

    z_clearance: float = number(
        "m", low=0.0, high=1.0, doc="height of the workspace's lower limit over the virtual Leap, beside z_lower_limit"
    )
    box_dimensions: np.ndarray = vector(
        3, "m", above=0.0, high=1.0, doc="size of the interaction box along the Leap's axes"
    )
    box_offset: float = number(
        "m", low=-0.3, high=0.3, absent=0.0, doc="of that box to the right of the Leap; two arms need two boxes"
    )
    hand: str = choice(
        *(LEFT, RIGHT, ANY), absent=ANY, doc="which hand of the operator steers; where there are two arms, one each"
    )
    buffer_size: int = integer(
        "samples",
        low=1,
        high=1000,
        doc="before a start, or as many as come in buffer_size / 110 s; each one more smooths more and delays by 4.5 "
        "ms (filters kalman and one_euro: each above 10)",
    )
    filter: str = choice(
        "mean", *FILTERS, absent="mean", doc="filter of palm and orientation; mean: of buffer_size samples, as in 2019"
    )
    start_tol_pitch: float = number("deg", above=0.0, below=90.0, doc="largest pitch at which a stream starts")
    start_tol_roll: float = number("deg", above=0.0, below=90.0, doc="largest roll at which a stream starts")
    run_tol_yaw: float = number("deg", low=0.0, high=90.0, doc="yaw is clipped to this, counted from the start")
    run_tol_pitch: float = number("deg", low=0.0, below=90.0, doc="pitch is clipped to this")
    run_tol_roll: float = number("deg", low=0.0, high=90.0, doc="roll is clipped to this")
    min_confidence: float = number(low=0.0, below=1.0, doc="confidence above which a stream runs")
    engagement: str = choice(
        ABSOLUTE,
        RELATIVE,
        absent=ABSOLUTE,
        doc="the tool goes to where the hand is, as in 2019, or starts where it is and follows the hand's changes",
    )
    hold_time: float = number(
        "s", low=0.0, high=120.0, absent=0.0, doc="relative: how long the tool stays for the next hand; 0: goes home"
    )
    enabling: str = choice(*SWITCHES, absent=NONE, doc="what must be pressed for a hand to steer")
    clutch: str = choice(*SWITCHES, absent=NONE, doc="relative: what keeps the tool while the hand moves freely")
    arm_choice: str = choice(
        *(NONE, SERVICE, REGION),
        absent=NONE,
        doc="relative: whether one hand chooses which of several arms it steers, and how; the others hold their tools",
    )

    def faults(self) -> list[str]:
        faults = []
        if self.clutch != NONE and self.engagement != RELATIVE:
            faults.append(f"clutch is {self.clutch}, but needs the engagement relative.")
        elif self.clutch != NONE and not self.hold_time:
            faults.append(f"clutch is {self.clutch}, but needs a hold_time above 0 s, in which the tool stays.")
        if self.arm_choice != NONE and not (self.engagement == RELATIVE and self.hold_time):
            faults.append(
                f"arm_choice is {self.arm_choice}, but needs the engagement relative and a hold_time above 0 s, in "
                "which an arm that is not chosen holds its tool."
            )
        if self.enabling != NONE and not (self.engagement == RELATIVE and self.hold_time):
            faults.append(
                f"enabling is {self.enabling}, but needs the engagement relative and a hold_time above 0 s: otherwise "
                "the arm drives home when it is released."
            )
        if self.enabling.startswith("second") and self.clutch.startswith("second"):
            faults.append("enabling and clutch cannot both be the second hand: a fist pinches, too.")
        return faults


@dataclass(frozen=True)
class ArmPlacement(ToolConfig):
    """The parameters under `kuka/` that place the virtual Leap and the flange."""

    center_line: np.ndarray = vector(3, doc="middle of the workspace seen from above")
    z_lower_limit: float = number("m", low=0.0, doc="lower limit of the workspace")
    z_upper_limit: float | None = number("m", absent=None, doc="upper limit of the workspace")
    mounting: np.ndarray = mounting_field()
    ws_center: np.ndarray = vector(3, "m", doc="centre of the workspace, uploaded by the controller")
    time_out: float = number("s", above=0.0, doc="how long the arm waits for a lost hand", absent=0.2)
    use_home_pos: bool = flag("whether the arm has a home position of one's own", absent=False)
    rotation_home: np.ndarray | None = vector(
        4, absent=None, doc="quaternion x, y, z, w of the tool at home, uploaded by the controller"
    )

    def faults(self) -> list[str]:
        faults = super().faults()
        if self.center_line[2] != 0.0:
            faults.append(f"center_line is {self.center_line.tolist()}, but its z must be zero.")
        if not np.any(self.center_line[:2]):
            faults.append("center_line is the zero vector and has no direction.")
        z, low, high = self.ws_center[2], self.z_lower_limit, self.z_upper_limit
        if z <= low:
            faults.append(f"ws_center has z {z:g} m, but must be above z_lower_limit {low:g} m.")
        if self.use_home_pos and self.rotation_home is None:
            faults.append("rotation_home is missing, but use_home_pos is true; the controller uploads it.")
        elif self.rotation_home is not None:
            try:
                rotation_from_quaternion(self.rotation_home)
            except ValueError as error:
                faults.append(f"rotation_home is no rotation: {error}.")
        if not faults and self.hangs:
            if high is None:
                faults.append("z_upper_limit is missing; an arm that hangs needs it.")
            elif z >= high:
                faults.append(f"ws_center has z {z:g} m, but must be below z_upper_limit {high:g} m.")
        return faults

    @property
    def mounting_frame(self) -> MountingFrame:
        """The operator's directions in the base frame."""
        return mounting_frame(self.center_line, self.mounting)

    @cached_property
    def R_level_home(self) -> np.ndarray:
        """Orientation of the tool at home relative to that of a tool which points down as the calculated home has
        it, shape (3, 3); the identity unless the home position is one's own."""
        if not self.use_home_pos or self.rotation_home is None:
            return read_only(np.eye(3))
        return read_only(self.mounting_frame.R_base_tool.T @ rotation_from_quaternion(self.rotation_home))

    @property
    def hangs(self) -> bool:
        """Whether z_upper_limit, and not z_lower_limit, is the lower one in the world."""
        return bool(self.mounting_frame.up[2] < -EVEN)

    @property
    def depth(self) -> float:
        """Distance from the centre of the workspace to its lower limit in the world [m]."""
        return self.z_upper_limit - self.ws_center[2] if self.hangs else self.ws_center[2] - self.z_lower_limit
