"""Private parameters of the simulation's nodes."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, flag, integer, number, text

LOOPBACK = "127.0.0.1"
PICK_CUP, ASSISTED_GRASP = "pick_cup", "assisted_grasp"


@dataclass(frozen=True)
class MonitorConfig:
    """Of the node simulation_monitor."""

    host: str = text(doc="address of the simulated controller", absent=LOOPBACK)
    port: int = integer(low=1, high=65535, doc="its control port", absent=30011)


@dataclass(frozen=True)
class WorldConfig:
    """Of the node camera_truth, and of those below."""

    host: str = text(doc="address of the simulated world", absent=LOOPBACK)
    port: int = integer(low=1, high=65535, doc="its control port", absent=30021)


@dataclass(frozen=True)
class WorldMonitorConfig(WorldConfig):
    """Of the node world_monitor."""

    rate: float = number("Hz", above=0.0, high=100.0, doc="how often the objects are published", absent=30.0)


@dataclass(frozen=True)
class WorldViewConfig(WorldConfig):
    """Of the node world_view."""

    rate: float = number("Hz", above=0.0, high=60.0, doc="how often the markers are published", absent=10.0)


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
class FaultServiceConfig:
    """Of the node simulation_faults."""

    host: str = text(doc="address of the simulated devices", absent=LOOPBACK)
    arm_port: int = integer(low=1, high=65535, doc="control port of the arm", absent=30011)
    leap_port: int = integer(low=1, high=65535, doc="control port of the Leap service", absent=16437)
    hand_port: int = integer(low=1, high=65535, doc="control port of the hand", absent=11433)
    camera_port: int = integer(low=1, high=65535, doc="control port of the camera", absent=30031)


@dataclass(frozen=True)
class OperatorConfig:
    """Of the node operator."""

    auto_start: bool = flag(doc="switch gripper and arm control on; false: only start the hand", absent=True)
    leapd_port: int = integer(low=1, high=65535, doc="control port of the simulated Leap service", absent=16437)
    world_port: int = integer(low=1, high=65535, doc="control port of the simulated world, for scenarios", absent=30021)
    scenario: str = choice(
        "", PICK_CUP, ASSISTED_GRASP, doc="what the hand does; empty: what the simulated Leap service plays", absent=""
    )
    rounds: int = integer(low=1, high=100, doc="of assisted_grasp: how many grasps there are to be", absent=1)
    time_out: float = number("s", above=0.0, doc="longest time to wait for each thing", absent=300.0)
