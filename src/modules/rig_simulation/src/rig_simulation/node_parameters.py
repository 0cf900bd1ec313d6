"""Private parameters of the simulation's nodes, and the sections of camera.yaml."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, flag, integer, names, number, text

LOOPBACK = "127.0.0.1"
PICK_CUP, ASSISTED_GRASP, WALL, BY_CLUTCH, TWO_HANDS = "pick_cup", "assisted_grasp", "wall", "clutch", "two_hands"
TWO_CUPS, HAND_OVER = "two_cups", "hand_over"
EPISODES, POLICY = "episodes", "policy"
NEVER, ONCE, NEEDED = WHEN = "never", "once", "needed"
OF_SEVERAL_ARMS = ("", TWO_CUPS, HAND_OVER)


@dataclass(frozen=True)
class WorldConfig:
    """Of the node camera_truth."""

    host: str = text(doc="address of the simulated world", absent=LOOPBACK)
    port: int = integer(low=1, high=65535, doc="its control port", absent=30021)


@dataclass(frozen=True)
class CameraConfig:
    """Of the node camera, beside its sections."""

    rate: float = number("Hz", above=0.0, high=60.0, doc="images per second")
    samples: int = integer(
        low=0,
        high=8,
        doc="of a colour pixel, against stairs along edges; with 4, tag corners lie 0.12 px off instead of 0.17",
    )
    seed: int = integer(low=0, high=2**31 - 1, doc="of the unit's errors and of all noise")
    host: str = text(doc="address of the simulated world")
    port: int = integer(low=1, high=65535, doc="its control port")
    control_port: int = integer(low=0, high=65535, doc="the camera's own control port, for faults")
    fault: str = text(
        doc="from the start, as --fault of the other devices takes them, parted by blanks; empty: none", empty=True
    )


@dataclass(frozen=True)
class ColourConfig:
    """The section colour of the node camera, and of camera.yaml: effects of the sensor on its images."""

    exposure: float = number(low=0.1, high=4.0, doc="factor on the brightness; 1 = as rendered")
    blur: float = number("px", low=0.0, high=5.0, doc="standard deviation of the point spread; 0 = none")
    noise: float = number("grey levels", low=0.0, high=30.0, doc="standard deviation of the noise; 0 = none")


@dataclass(frozen=True)
class DepthConfig:
    """The section depth: a projector of infrared points and an infrared camera. Each doc names the value that disables
    its effect. Sources: reference values of structured-light sensors (Nguyen, Izadi, Lovell 2012; Khoshelham 2011;
    Boehm 2014) and the data sheet of the Xtion Pro Live."""

    noise: bool = flag(doc="random error along the axis")
    correlation: float = number("px", low=0.0, high=10.0, doc="reach of the noise over neighbouring pixels; 0 = white")
    edge_jitter: float = number("px", low=0.0, high=5.0, doc="standard deviation of where edges lie; 0 = none")
    quantisation: float = number("px", low=0.0, high=1.0, doc="step of the disparity; 0 = none")
    shadows: bool = flag(doc="no depth where the projector's light does not reach")
    projector_baseline: float = number("m", low=0.01, high=0.3, doc="projector's place to the right of the camera")
    min_range: float = number("m", low=0.1, high=2.0, doc="no depth nearer than this")
    max_range: float = number("m", above=0.5, high=20.0, doc="no depth farther than this")
    max_angle: float = number("deg", above=0.0, high=90.0, doc="no depth where the surface is steeper; 90 = no limit")
    min_signal: float = number(low=0.0, high=1.0, doc="no depth where less light returns; 1 = white, 1 m away; 0 = off")
    dark_return: float = number(low=0.0, high=1.0, doc="fraction of the light that a black surface returns")
    scale_error_sd: float = number(low=0.0, high=0.05, doc="spread of a unit's error of scale; 0 = none")
    warp_sd: float = number("m", low=0.0, high=0.02, doc="spread of a unit's smooth warp at 1 m; 0 = none")

    def faults(self) -> list[str]:
        if self.min_range >= self.max_range:
            return [f"min_range is {self.min_range:g} m, but must be less than max_range, {self.max_range:g} m."]
        return []


@dataclass(frozen=True)
class SimulationConfig:
    """Of the node simulation; a control port of 0 means that there is no such device."""

    host: str = text(doc="address of the simulated devices", absent=LOOPBACK)
    arm_port: int = integer(low=0, high=65535, doc="control port of the arm; 0: no arm", absent=30011)
    world_port: int = integer(low=0, high=65535, doc="control port of the world; 0: no world", absent=30021)
    leap_port: int = integer(low=0, high=65535, doc="control port of the Leap service; 0: none", absent=16437)
    hand_port: int = integer(low=0, high=65535, doc="control port of the hand; 0: none", absent=11433)
    camera_port: int = integer(low=0, high=65535, doc="control port of the camera; 0: none", absent=30031)
    flange_rate: float = number("Hz", above=0.0, high=100.0, doc="how often the flange is published", absent=100.0)
    world_rate: float = number("Hz", above=0.0, high=100.0, doc="how often the objects are published", absent=30.0)
    view_rate: float = number("Hz", above=0.0, high=60.0, doc="how often their markers are published", absent=10.0)


@dataclass(frozen=True)
class OperatorConfig:
    """Of the node operator."""

    arms: tuple[str, ...] = names(doc="namespaces of several arms, such as [left, right]", absent=())
    auto_start: bool = flag(doc="switch gripper and arm control on; false: only start the hand", absent=True)
    leapd_port: int = integer(
        low=0, high=65535, doc="control port of the simulated Leap service; 0: a person's own hand", absent=16437
    )
    world_port: int = integer(low=1, high=65535, doc="control port of the simulated world, for scenarios", absent=30021)
    scenario: str = choice(
        *("", PICK_CUP, ASSISTED_GRASP, WALL, BY_CLUTCH, TWO_HANDS, TWO_CUPS, HAND_OVER, EPISODES, POLICY),
        doc="what the hand does; empty: what the simulated Leap service plays",
        absent="",
    )
    rounds: int = integer(
        low=1, high=1000, doc="of assisted_grasp, episodes and policy: how many grasps there are to be", absent=1
    )
    seed: int = integer(low=0, high=2**31 - 1, doc="of episodes and policy: of the first scene", absent=0)
    takes_over: str = choice(
        *WHEN, doc="of policy: when the operator does, never, once in the first round, or where needed", absent=NEVER
    )
    time_out: float = number("s", above=0.0, doc="longest time to wait for each thing", absent=300.0)

    def faults(self) -> list[str]:
        if self.arms and self.scenario not in OF_SEVERAL_ARMS:
            return [f"scenario is {self.scenario}, which is for one arm, but arms are {', '.join(self.arms)}."]
        if self.scenario in (TWO_CUPS, HAND_OVER) and not self.arms:
            return [f"scenario is {self.scenario}, which is for several arms, but arms names none."]
        if self.scenario == HAND_OVER and len(self.arms) != 2:
            return [f"scenario is {self.scenario}, which is for two arms, but arms are {', '.join(self.arms)}."]
        return []
