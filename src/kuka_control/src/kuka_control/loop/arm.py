"""The robot behind one interface, and its implementation over the toolbox's client. Joints q have shape (7,) [rad].
All calls come from one thread and return within the client's time-outs. The client's errors (kst.KstError) pass
through: a lost connection reaches the reconnect supervisor."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from common.poses import read_only
from kst import (
    Feedback,
    KstClient,
    KstError,
    MotionInterrupted,
    ReplyTimeout,
    RobotState,
    SoftSettings,
    UnexpectedReply,
    WordRefused,
)
from kuka_control.loop.tracking import BELIEVED_RAD

NO_READING = (ReplyTimeout, UnexpectedReply)  # errors of one missing or unusable answer on a link that may be sound


@dataclass(frozen=True)
class ArmState:
    """The newest reading of each kind, None before the first; each reading is a new array object."""

    joints: np.ndarray | None = None  # measured joints, shape (7,) [rad]
    torques_external: np.ndarray | None = None  # from outside, as the controller estimates them, shape (7,) [Nm]
    torques_measured: np.ndarray | None = None  # torques at the joint sensors, shape (7,) [Nm]
    T_base_tool: np.ndarray | None = None  # as the robot's controller reports it, shape (4, 4) [m]; or None
    force: np.ndarray | None = None  # force at the tool point, in its axes, shape (3,) [N]
    moment: np.ndarray | None = None  # moment at the tool point, in its axes, shape (3,) [Nm]
    paused: bool = False  # whether the robot has paused a motion


WAIT_S = 0.02  # a cycle waits this long for a missing answer, so that the state is published meanwhile [s]

FIELD = {
    Feedback.JOINTS: "joints",
    Feedback.EXTERNAL_TORQUES: "torques_external",
    Feedback.MEASURED_TORQUES: "torques_measured",
    Feedback.POSE: "T_base_tool",
    Feedback.FORCE: "force",
}
"""The field of ArmState that the answer to a servo goal fills."""

NEWER = {
    Feedback.POSE: ("pose", "it is calculated from the joints"),
    Feedback.FORCE: ("force", "it is estimated from the external torques"),
}
"""Feedback that servers before May 2019 lack in servo mode: its name, and its substitute."""

ORDINARY = re.compile("servo mode (begins|continues|ends: the client's word)|the motion is (paused|resumed)$")
"""What the robot says of that which this controller has asked for; no remark."""

UNGUARDED = (
    "This toolbox server knows no PTP motions that end at a contact, as those before April 2018: ptp_contact_torque "
    "has no effect, and only the robot's own safety stop ends such a motion."
)

_T = TypeVar("_T")


class Arm(ABC):
    """A seven-joint arm that moves point to point or follows a stream of servo goals. Motions and servo mode raise
    kst.MotionRefused if the robot's controller refuses or has aborted them."""

    state: ArmState = ArmState()  # the newest readings

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
    def server(self) -> str:
        """What answers on the robot's controller, in words."""
        return ""

    @property
    def abilities(self) -> frozenset[str]:
        """What the application on the robot's controller can besides the toolbox's, such as "stop"."""
        return frozenset()

    @property
    def reckoned(self) -> tuple[bool, float]:
        """Whether the robot's controller knows the tool's mass, and what load it reckons with [kg]."""
        return False, 0.0

    def stop(self) -> None:
        """Stops whatever moves, where the abilities name it; any thread may call it. Raises kst.KstError: it could not
        be said."""
        raise NotImplementedError

    def pause(self, on: bool) -> None:
        """Pauses the PTP motion or continues it, where the abilities name "stop". Raises kst.WordRefused: it is not
        the time for that."""
        raise NotImplementedError

    def soften(self, on: bool) -> None:
        """Makes the next servo modes soft, or stiff again, where the abilities name "soft"; at rest only. Raises
        kst.WordRefused."""
        raise NotImplementedError

    def carry(self, mass: float) -> None:
        """Tells the robot's controller what the hand holds [kg], where it can know it; at rest only."""
        del mass

    @property
    def estimated_in_servo(self) -> tuple[str, ...]:
        """Names of the quantities that are estimated in servo mode, not measured."""
        return ()

    def take_remarks(self) -> list[str]:
        """Returns the sentences about the arm that were not reported yet."""
        return []

    def silence(self) -> float:
        """Returns for how long an answer of the robot has been missing [s], 0 if none is; waits a moment for it.
        While one is missing nothing else may be asked or sent. Raises kst.ConnectionLost once it is given up."""
        return 0.0

    @abstractmethod
    def read(self) -> None:
        """Updates `state` outside of servo mode: joints at each call, at rest the other quantities in turn."""

    @abstractmethod
    def start_ptp(self, q: np.ndarray, velocity: float, torques: np.ndarray | None = None) -> None:
        """Starts a motion to q at the fraction `velocity` of the full joint speed, (0, 1]; returns once accepted.
        Where the robot can, the motion ends as an external joint torque leaves its range, shape (7, 2) [Nm]."""

    def start_guiding(self) -> None:
        """Lets a hand move the arm while the enabling switch is pressed, where the abilities name "guide"; its release
        ends that, as `ptp_arrived` tells. Raises kst.WordRefused."""
        raise NotImplementedError

    @abstractmethod
    def ptp_arrived(self) -> bool:
        """Returns whether the motion has ended, without waiting; kst.MotionInterrupted: a torque ended it."""

    @abstractmethod
    def start_servo(self) -> None:
        """Starts servo mode; the arm holds its joints until the first goal."""

    @abstractmethod
    def servo(self, q: np.ndarray) -> None:
        """Sends a servo goal; updates the joints in `state` at each call, the other quantities in turn."""

    @abstractmethod
    def stop_servo(self) -> None:
        """Leaves servo mode once the arm stands at its last goal."""

    @abstractmethod
    def close(self) -> None:
        """Leaves servo mode if it runs, and closes the connection; never raises."""


def _second_try(call: Callable[[], _T]) -> _T:
    try:
        return call()
    except NO_READING:
        return call()


class KstArm(Arm):
    """The arm behind the toolbox's server. Servo goals are streamed: the next one does not wait for the answer to the
    one before. Each brings joints, and four out of ten another quantity, so at 250 goals a second those come at 25 Hz.

    A server in a safety stop answers requests for joints only; then `read` requests nothing else until the server has
    accepted the next motion. In servo mode the moment is estimated from the external torques. Servers before May 2019
    report neither pose nor force there; the first start of servo mode finds that out. The robot application answers
    all of that at once, in every mode.

    Args:
        wrench: force and moment at the tool point, shape (3,) each, from joints and external torques, shape (7,) each.
        sent: gets each goal when it was sent, shape (7,) [rad], and the velocity of a PTP motion, else 0.
        guarded: whether PTP motions are to end at a torque, if the server knows such.
        weighed: whether the server was told the tool's mass.
        soft: how the arm yields where it is to be soft."""

    SERVO_TURN = (
        *(Feedback.JOINTS, Feedback.EXTERNAL_TORQUES, Feedback.JOINTS, Feedback.MEASURED_TORQUES, Feedback.JOINTS),
        *(Feedback.JOINTS, Feedback.POSE, Feedback.JOINTS, Feedback.FORCE, Feedback.JOINTS),
    )

    def __init__(
        self,
        client: KstClient,
        wrench: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
        sent: Callable[[np.ndarray, float], None] = lambda q, velocity: None,
        guarded: bool = False,
        weighed: bool = False,
        soft: SoftSettings | None = None,
    ) -> None:
        self._client = client
        self._weighed, self._load, self._asked_load = weighed, 0.0, 0.0
        self._soft, self._is_soft = soft, False
        self._whole = "state" in client.abilities
        self._sent = sent
        self._wrench = wrench
        self._probed = False
        self._motion_to: np.ndarray | None = None  # goal of the last PTP motion, where the arm stands after it
        self._lacking: tuple[Feedback, ...] = ()
        self._guarded = guarded and client.knows_guarded_ptp()
        self._remarks: list[str] = [UNGUARDED] if guarded and not self._guarded else []
        self._turn = 0
        self._unusable: KstError | None = None  # an answer to a streamed goal that `servo` is still to report
        self._at_rest = True
        self._rest_turn = (
            ("torques_external", client.external_torques),
            ("torques_measured", client.measured_torques),
            ("T_base_tool", client.pose),
            ("force", client.force),
            ("moment", client.moment),
        )
        self._take("joints", client.joints())

    @property
    def round_trip(self) -> float | None:
        return self._client.round_trip

    @property
    def server(self) -> str:
        return self._client.server

    @property
    def abilities(self) -> frozenset[str]:
        return self._client.abilities

    @property
    def reckoned(self) -> tuple[bool, float]:
        return self._weighed, self._load

    def stop(self) -> None:
        self._client.stop_motion()

    def pause(self, on: bool) -> None:
        (self._client.pause_motion if on else self._client.resume_motion)()

    def soften(self, on: bool) -> None:
        if on or self._is_soft:  # said again each time: the robot checks the load then
            self._client.soften(self._soft if on else None)
        self._is_soft = on

    def carry(self, mass: float) -> None:
        if not self._weighed or mass == self._asked_load:
            return
        self._asked_load = mass
        try:
            self._client.set_load(mass)
        except WordRefused as error:
            self._remarks.append(f"The robot does not take the payload of {mass:g} kg: {error}.")
        else:
            self._load = mass

    @property
    def estimated_in_servo(self) -> tuple[str, ...]:
        if self._whole:
            return ()
        return ("moment", *(NEWER[feedback][0] for feedback in self._lacking))

    def take_remarks(self) -> list[str]:
        remarks, self._remarks = self._remarks, []
        if self.abilities:
            remarks += [f"The robot says: {event}." for event in self._client.events() if not ORDINARY.match(event)]
        return remarks

    def silence(self) -> float:
        silent = self._client.silence(WAIT_S)
        self._take_answers()
        return silent

    def read(self) -> None:
        if self._whole:
            self._take_state(self._client.state())
            return
        self._take("joints", self._client.joints())
        if self._at_rest:
            field, call = self._next(self._rest_turn)
            try:
                self._take(field, call())
            except ReplyTimeout:
                self._at_rest = False
                raise

    def start_ptp(self, q: np.ndarray, velocity: float, torques: np.ndarray | None = None) -> None:
        self._sent(q, velocity)
        self._client.start_ptp_joints(q, velocity, torques if self._guarded else None)
        self._motion_to = q
        self._at_rest = False
        self.state = replace(self.state, T_base_tool=None)

    def start_guiding(self) -> None:
        self._client.start_guiding()
        self._motion_to, self._at_rest = None, False

    def ptp_arrived(self) -> bool:
        try:
            self._at_rest = self._client.ptp_arrived()
        except MotionInterrupted as error:
            self._at_rest = True
            if error.torques is not None:
                self._take("torques_external", error.torques)
            raise
        return self._at_rest

    def start_servo(self) -> None:
        self._client.start_joint_servo()
        self._at_rest = False
        try:
            self._take("joints", _second_try(self._client.joints))
            if not (self._probed or self._whole):
                self._probe()
        except NO_READING as error:
            raise ReplyTimeout(f"{error}; servo mode has started", pending=True) from error
        if Feedback.POSE in self._lacking:
            self.state = replace(self.state, T_base_tool=None)

    def servo(self, q: np.ndarray) -> None:
        feedback = Feedback.STATE if self._whole else self._next(self.SERVO_TURN)
        if feedback in self._lacking:
            feedback = Feedback.JOINTS
        asked = self._client.stream(q, feedback, wait=False)
        self._sent(q, 0.0)
        if asked is not feedback:
            self._turn -= 1
        quick = 1e-3  # a goal is waited for this long; an answer that comes later is read in the next cycle [s]
        self._take_answers(quick)
        if feedback not in (Feedback.JOINTS, Feedback.STATE) and not self._client.open_goals:
            self._client.stream_joints()
            self._take_answers(quick)
        error, self._unusable = self._unusable, None
        if error is not None:
            raise error

    def stop_servo(self) -> None:
        _second_try(self._client.stop_joint_servo)
        self._at_rest = True

    def close(self) -> None:
        self._client.close()

    def _probe(self) -> None:
        """Finds out which feedback the server lacks, by servo goals where the arm stands; not if that is in doubt."""
        q = self.measured_joints
        if self._motion_to is not None and np.max(np.abs(q - self._motion_to)) > BELIEVED_RAD:
            return
        for feedback, (name, substitute) in NEWER.items():
            try:
                _second_try(partial(self._client.servo, q, feedback))
            except NO_READING:
                self._client.joints()  # a server that answers nothing at all lacks nothing; this raises then
                self._lacking += (feedback,)
                self._remarks.append(
                    f"In servo mode this toolbox server does not tell the {name}, as those before May 2019; "
                    f"{substitute}."
                )
        self._probed = True

    def _take_answers(self, wait: float = 0.0) -> None:
        """Takes the answers to streamed goals; waits up to `wait` seconds until all have come."""
        for feedback, value in self._client.answers(wait):
            if isinstance(value, KstError):
                self._unusable = value
            elif isinstance(value, RobotState):
                self._take_state(value)
            elif value is not None:
                self._take(FIELD[feedback], value)
                if feedback is Feedback.EXTERNAL_TORQUES:
                    force, moment = self._wrench(self.measured_joints, value)
                    self._take("moment", moment)
                    if Feedback.FORCE in self._lacking:
                        self._take("force", force)

    def _take_state(self, robot: RobotState) -> None:
        self.state = ArmState(
            read_only(robot.joints),
            read_only(robot.torques_external),
            read_only(robot.torques_measured),
            force=read_only(robot.force),
            moment=read_only(robot.moment),
            paused=robot.mode == "PAUSED",
        )

    def _next(self, turn: tuple[_T, ...]) -> _T:
        self._turn = (self._turn + 1) % len(turn)
        return turn[self._turn]

    def _take(self, field: str, value: np.ndarray) -> None:
        changed: dict[str, Any] = {field: read_only(value)}
        self.state = replace(self.state, **changed)
