"""The robot behind one interface: what the control loop asks of it, and that over the toolbox's client.

Joints q have shape (7,) [rad]. All calls come from one thread and return within the client's time-outs. The client's
errors (kst.KstError) pass through: a lost connection reaches the reconnect supervisor.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, TypeVar

import numpy as np

from common.poses import read_only
from kst import Feedback, KstClient, ReplyTimeout, UnexpectedReply

NO_READING = (ReplyTimeout, UnexpectedReply)
"""Errors of one answer, which did not come or says nothing, on a link that may be sound."""


@dataclass(frozen=True)
class ArmState:
    """The newest reading of each kind; an array is another object after each reading. None: not read yet.

    Attributes:
        joints: measured joints, shape (7,) [rad].
        torques_external: what acts on the joints from outside, as the controller estimates it, shape (7,) [Nm].
        torques_measured: at the joint sensors, shape (7,) [Nm].
        T_base_tool: tool point as the controller sees it, shape (4, 4) [m]; None while it cannot tell it.
        force: at the tool point, in its axes, shape (3,) [N].
        moment: likewise, shape (3,) [Nm].
    """

    joints: np.ndarray | None = None
    torques_external: np.ndarray | None = None
    torques_measured: np.ndarray | None = None
    T_base_tool: np.ndarray | None = None
    force: np.ndarray | None = None
    moment: np.ndarray | None = None


QUICK_S = 1e-3
"""A goal whose answer took longer than this is followed by no question that would hold the next goal up [s]."""

NEWER = {
    "T_base_tool": ("pose", "it is calculated from the joints"),
    "force": ("force", "it is estimated from the external torques"),
}
"""Readings that not every server's servo goals bring, what people call them, and what is done then."""

_T = TypeVar("_T")


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

    @property
    def estimated_in_servo(self) -> tuple[str, ...]:
        """Names of what is not measured in servo mode, but estimated."""
        return ()

    def take_remarks(self) -> list[str]:
        """Returns the sentences about the arm that were not said yet."""
        return []

    @abstractmethod
    def read(self) -> None:
        """Brings `state` up to date outside of servo mode: joints at each call, at rest the rest in turn."""

    @abstractmethod
    def start_ptp(self, q: np.ndarray, velocity: float) -> None:
        """Starts a motion to q at the share `velocity` of the full joint speed, (0, 1]; returns once it is accepted.

        Raises:
            kst.MotionRefused: the robot's controller refused it.
        """

    @abstractmethod
    def ptp_arrived(self) -> bool:
        """Returns whether the motion has ended, without waiting.

        Raises:
            kst.MotionRefused: the robot's controller gave the motion up.
        """

    @abstractmethod
    def start_servo(self) -> None:
        """Starts to follow servo goals; the arm holds its joints until the first one."""

    @abstractmethod
    def servo(self, q: np.ndarray) -> None:
        """Sends a servo goal and brings joints, and in turn the other kinds of reading, in `state` up to date.

        Raises:
            kst.MotionRefused: the robot's controller has ended servo mode.
        """

    @abstractmethod
    def stop_servo(self) -> None:
        """Ends servo mode, once the arm stands at its last goal.

        Raises:
            kst.MotionRefused: servo mode had ended by itself before.
        """

    @abstractmethod
    def close(self) -> None:
        """Ends servo mode if it runs, and the connection; never raises."""

    @abstractmethod
    def abort(self) -> None:
        """Drops the connection without a word to the robot."""


def _second_try(call: Callable[[], _T]) -> _T:
    """Returns what `call` returns, at the second try if the first brought no answer."""
    try:
        return call()
    except NO_READING:
        return call()


class KstArm(Arm):
    """The arm that the toolbox's server steers.

    Each servo goal brings joints. Four out of ten bring another kind of reading as their own answer, one kind each, so
    that at 250 goals a second those come at 25 Hz; then the joints are asked for after it, unless the link is slow.

    A server that stands in a safety stop answers no more than joints; then `read` asks it for nothing else until it has
    taken the next motion.

    The toolbox does not tell the moment in servo mode; then it is estimated whenever external torques come. Servers
    before May 2019 tell neither pose nor force there: that shows when servo mode starts for the first time.

    Args:
        client: connected to the server.
        wrench: force and moment at the tool point, shape (3,) each, from joints and external torques, shape (7,) each.
    """

    SERVO_TURN = (
        *("joints", "torques_external", "joints", "torques_measured", "joints"),
        *("joints", "T_base_tool", "joints", "force", "joints"),
    )
    FEEDBACK: ClassVar = {
        "joints": Feedback.JOINTS,
        "torques_external": Feedback.EXTERNAL_TORQUES,
        "torques_measured": Feedback.MEASURED_TORQUES,
        "T_base_tool": Feedback.POSE,
        "force": Feedback.FORCE,
    }
    REST_TURN = ("torques_external", "torques_measured", "T_base_tool", "force", "moment")

    def __init__(
        self, client: KstClient, wrench: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    ) -> None:
        self._client = client
        self._wrench = wrench
        self._tried_out = False
        self._untold: tuple[str, ...] = ()
        self._remarks: list[str] = []
        self._turn = 0
        self._at_rest = True
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

    @property
    def estimated_in_servo(self) -> tuple[str, ...]:
        return ("moment", *(NEWER[kind][0] for kind in self._untold))

    def take_remarks(self) -> list[str]:
        remarks, self._remarks = self._remarks, []
        return remarks

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
        self.state = replace(self.state, T_base_tool=None)

    def ptp_arrived(self) -> bool:
        self._at_rest = self._client.ptp_arrived()
        return self._at_rest

    def start_servo(self) -> None:
        self._client.start_joint_servo()
        self._at_rest = False
        self._take("joints", _second_try(self._client.joints))
        if not self._tried_out:
            self._try_out(self.measured_joints)
        if "T_base_tool" in self._untold:
            self.state = replace(self.state, T_base_tool=None)

    def servo(self, q: np.ndarray) -> None:
        kind = self._next(self.SERVO_TURN)
        if kind in self._untold:
            kind = "joints"
        value = self._client.servo(q, self.FEEDBACK[kind])
        self._take(kind, value)
        if kind == "torques_external":
            force, moment = self._wrench(self.measured_joints, value)
            self._take("moment", moment)
            if "force" in self._untold:
                self._take("force", force)
        round_trip = self._client.round_trip
        if kind != "joints" and round_trip is not None and round_trip <= QUICK_S:
            self._take("joints", self._client.joints())

    def stop_servo(self) -> None:
        _second_try(self._client.stop_joint_servo)
        self._at_rest = True

    def close(self) -> None:
        self._client.close()

    def abort(self) -> None:
        self._client.abort()

    def _try_out(self, q: np.ndarray) -> None:
        """Finds out what the server's answers to servo goals can tell, by goals where the arm is."""
        for kind, (name, remedy) in NEWER.items():
            try:
                _second_try(partial(self._client.servo, q, self.FEEDBACK[kind]))
            except NO_READING:
                self._untold += (kind,)
                self._remarks.append(
                    f"In servo mode this toolbox server does not tell the {name}, as those before May 2019; {remedy}."
                )
        self._tried_out = True

    def _next(self, kinds: tuple[str, ...]) -> str:
        self._turn = (self._turn + 1) % len(kinds)
        return kinds[self._turn]

    def _take(self, kind: str, value: np.ndarray) -> None:
        self.state = replace(self.state, **{kind: read_only(value)})
