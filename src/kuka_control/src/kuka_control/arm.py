"""The robot behind one interface: what the control loop asks of it, and that over the toolbox's client.

Joints q have shape (7,) [rad]. All calls come from one thread and return within the client's time-outs. The client's
errors (kst.errors, all DeviceError) pass through: a lost connection ends the controller.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from common.poses import read_only
from kst.client import KstClient
from kst.errors import ReplyTimeout


@dataclass(frozen=True)
class ArmState:
    """The newest reading of each kind; an array is another object after each reading. None: not read yet.

    Attributes:
        joints: measured joints, shape (7,) [rad].
        torques_external: what acts on the joints from outside, as the controller estimates it, shape (7,) [Nm].
        torques_measured: at the joint sensors, shape (7,) [Nm].
        T_base_tool: tool point as the controller sees it, shape (4, 4) [m].
        force: at the tool point, in its axes, shape (3,) [N].
        moment: likewise, shape (3,) [Nm].
    """

    joints: np.ndarray | None = None
    torques_external: np.ndarray | None = None
    torques_measured: np.ndarray | None = None
    T_base_tool: np.ndarray | None = None
    force: np.ndarray | None = None
    moment: np.ndarray | None = None


class Arm(ABC):
    """A seven-joint arm that moves point to point or follows a stream of servo goals."""

    state: ArmState = ArmState()
    """The newest readings."""

    @property
    def measured_joints(self) -> np.ndarray:
        """The measured joints, shape (7,) [rad], which every arm reads at its start."""
        assert self.state.joints is not None, "no joints were read yet"
        return self.state.joints

    @property
    def round_trip(self) -> float | None:
        """Time from the last answered command to its answer [s]; None if it is not known."""
        return None

    @abstractmethod
    def read(self) -> None:
        """Brings `state` up to date outside of servo mode: joints at each call, at rest the rest in turn."""

    @abstractmethod
    def start_ptp(self, q: np.ndarray, velocity: float) -> None:
        """Starts a motion to q at the share `velocity` of the full joint speed, (0, 1]; returns once it is accepted.

        Raises:
            kst.errors.MotionRefused: the robot's controller refused it.
        """

    @abstractmethod
    def ptp_arrived(self) -> bool:
        """Returns whether the motion has ended, without waiting.

        Raises:
            kst.errors.MotionRefused: the robot's controller gave the motion up.
        """

    @abstractmethod
    def start_servo(self) -> None:
        """Starts to follow servo goals; the arm holds its joints until the first one."""

    @abstractmethod
    def servo(self, q: np.ndarray) -> None:
        """Sends a servo goal and brings one kind of reading in `state` up to date.

        Raises:
            kst.errors.MotionRefused: the robot's controller has ended servo mode.
        """

    @abstractmethod
    def stop_servo(self) -> None:
        """Ends servo mode, once the arm stands at its last goal.

        Raises:
            kst.errors.MotionRefused: servo mode had ended by itself before.
        """

    @abstractmethod
    def close(self) -> None:
        """Ends servo mode if it runs, and the connection; never raises."""

    @abstractmethod
    def abort(self) -> None:
        """Drops the connection without a word to the robot."""


class KstArm(Arm):
    """The arm that the toolbox's server steers.

    Each servo goal brings one reading back. Out of ten goals six bring joints and one each of the other kinds, so
    that at 250 goals a second joints come at 150 Hz and the others at 25 Hz each.

    A server that stands in a safety stop answers no more than joints; then `read` asks it for nothing else until it has
    taken the next motion.

    The toolbox does not tell the moment in servo mode; then it is estimated whenever external torques come.

    Args:
        client: connected to the server.
        moment: the moment at the tool point, shape (3,) [Nm], from joints and external torques, shape (7,) each.
    """

    SERVO_TURN = (
        *("joints", "torques_external", "joints", "torques_measured", "joints"),
        *("joints", "T_base_tool", "joints", "force", "joints"),
    )
    REST_TURN = ("torques_external", "torques_measured", "T_base_tool", "force", "moment")

    def __init__(self, client: KstClient, moment: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        self._client = client
        self._moment = moment
        self._turn = 0
        self._at_rest = True
        self._servo_calls = {
            "joints": client.servo_joints,
            "torques_external": client.servo_external_torques,
            "torques_measured": client.servo_measured_torques,
            "T_base_tool": client.servo_pose,
            "force": client.servo_force,
        }
        self._rest_calls = {
            "torques_external": client.external_torques,
            "torques_measured": client.measured_torques,
            "T_base_tool": client.pose,
            "force": client.force,
            "moment": client.moment,
        }
        self._take("joints", client.joints())

    @property
    def round_trip(self) -> float | None:
        return self._client.round_trip

    def read(self) -> None:
        self._take("joints", self._client.joints())
        if self._at_rest:
            kind = self._next(self.REST_TURN)
            try:
                self._take(kind, self._rest_calls[kind]())
            except ReplyTimeout:
                self._at_rest = False
                raise

    def start_ptp(self, q: np.ndarray, velocity: float) -> None:
        self._client.start_ptp_joints(q, velocity)
        self._at_rest = False

    def ptp_arrived(self) -> bool:
        self._at_rest = self._client.ptp_arrived()
        return self._at_rest

    def start_servo(self) -> None:
        self._client.start_joint_servo()
        self._at_rest = False
        self._take("joints", self._client.joints())

    def servo(self, q: np.ndarray) -> None:
        kind = self._next(self.SERVO_TURN)
        value = self._servo_calls[kind](q)
        self._take(kind, value)
        if kind == "torques_external":
            self._take("moment", self._moment(self.measured_joints, value))

    def stop_servo(self) -> None:
        self._client.stop_joint_servo()
        self._at_rest = True

    def close(self) -> None:
        self._client.close()

    def abort(self) -> None:
        self._client.abort()

    def _next(self, kinds: tuple[str, ...]) -> str:
        self._turn = (self._turn + 1) % len(kinds)
        return kinds[self._turn]

    def _take(self, kind: str, value: np.ndarray) -> None:
        self.state = replace(self.state, **{kind: read_only(value)})
