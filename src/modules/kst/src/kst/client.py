"""Client of the KUKA Sunrise Toolbox server on the arm's controller: point-to-point motions, joint servo, measurements.

One socket, no thread of its own, called from one thread (only `abort` may come from another). Angles in rad, lengths
in m, forces in N, torques in Nm. A command that the server would never answer in the present mode is refused, not sent;
so are joint angles that are no numbers or outside the limits. Every call ends: with a result or with an error of
`kst.errors`. It does not plan: the goals of the servo mode must be smooth by themselves, and whether the arm follows
them is for the caller to watch, since a servo mode that ended by itself still acknowledges its goals (reference:
kst.md, 3.5).
"""

from __future__ import annotations

import contextlib
import enum

import numpy as np
from numpy.typing import ArrayLike

from common.errors import DeviceError
from kst import codec
from kst.codec import Command, Feedback, Kind, Reply, ToolTransform
from kst.errors import (
    ConnectionLost,
    MotionRefused,
    NoServer,
    ProtocolError,
    ReplyTimeout,
    ServerBusy,
    ToolNotAttached,
    WrongMode,
)
from kst.limits import LBR_IIWA_LIMITS, JointLimits, check_relative_velocity
from kst.session import Counts, Session, Timing
from kst.transport import Transport


class Mode(enum.Enum):
    """What the server's main thread is busy with."""

    IDLE = "idle"
    PTP = "ptp"
    SERVO = "servo"


class KstClient:
    """A connection to the server; made by `connect`, ended by `close`, also as a context manager.

    Every call that talks to the server may raise, besides what it lists:
        ConnectionLost: the link is gone, was aborted, or the server fell silent; all later calls raise it too.
        ReplyTimeout: this answer did not come; the next call first finds the pairing of answers again.
        ProtocolError: the answer does not fit the command.
        MotionRefused: the controller had given up the servo mode by itself and said `nak`.
        WrongMode: the command is never answered in the present mode; nothing was sent.
    """

    def __init__(self, session: Session, tool: ToolTransform, limits: JointLimits) -> None:
        self._session = session
        self._tool = tool
        self._limits = limits
        self._mode = Mode.IDLE
        self._goal: np.ndarray | None = None

    @classmethod
    def connect(
        cls,
        host: str,
        port: int = 30001,
        tool: ToolTransform | np.ndarray | None = None,
        limits: JointLimits | None = None,
        timeout: float = 5.0,
        timing: Timing | None = None,
    ) -> KstClient:
        """Connects and attaches the tool.

        Args:
            host: address of the controller.
            port: its port.
            tool: T_flange_tool, shape (4, 4) [m]; None is the flange itself.
            limits: joint ranges that goals must keep to; None: those of the LBR iiwa.
            timeout: longest wait for the connection, and again for the first answer [s].
            timing: the other waits.

        Raises:
            NoServer: nobody listens, or the server ended at once.
            ServerBusy: the server accepted and stays silent.
            ToolNotAttached: the server answers but does not attach the tool.
            ValueError: the tool is not a rigid pose in metres.
        """
        if not isinstance(tool, ToolTransform):
            tool = ToolTransform(np.eye(4) if tool is None else tool)
        timing = Timing() if timing is None else timing
        transport = Transport.connect(host, port, timeout)
        session = Session(transport, timing)
        client = cls(session, tool, LBR_IIWA_LIMITS if limits is None else limits)
        try:
            transport.pause(timing.connect_settle)
            client._attach_tool(patience=max(timeout - timing.reply, timing.reply))
        except ConnectionLost as error:
            client.close()
            if transport.ended_by_peer:
                raise NoServer(
                    f"the server at {host}:{port} ended the connection at once: its application has just ended;"
                    f" start MatlabToolboxServer on the pad again (it waits 60 s for a client)"
                ) from error
            if session.counts.answered == 0:
                raise ServerBusy(
                    f"{host}:{port} is open but silent for {timeout:g} s: somebody else is connected, or the server is"
                    f" deaf since a client was lost; end and start MatlabToolboxServer on the pad"
                ) from error
            raise
        except BaseException:
            client.close()
            raise
        return client

    def __enter__(self) -> KstClient:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def mode(self) -> Mode:
        """What the server is busy with as far as this client made it so."""
        return self._mode

    @property
    def limits(self) -> JointLimits:
        """The joint ranges that goals must keep to."""
        return self._limits

    @property
    def counts(self) -> Counts:
        """What happened on the link so far."""
        return self._session.counts

    @property
    def round_trip(self) -> float | None:
        """Time from the last answered command to its answer [s]; None before the first."""
        return self._session.round_trip

    def joints(self) -> np.ndarray:
        """Returns the measured joint angles, shape (7,) [rad]; in every mode."""
        timing = self._session.timing
        return self._numbers(self._ask(codec.JOINTS, timing.servo_reply if self._mode is Mode.SERVO else timing.reply))

    def external_torques(self) -> np.ndarray:
        """Returns the external joint torques, shape (7,) [Nm]; only when idle."""
        return self._measure(codec.EXTERNAL_TORQUES, "servo_external_torques")

    def measured_torques(self) -> np.ndarray:
        """Returns the measured joint torques, shape (7,) [Nm]; only when idle."""
        return self._measure(codec.MEASURED_TORQUES, "servo_measured_torques")

    def pose(self) -> np.ndarray:
        """Returns the pose of the tool in the arm's base, shape (4, 4) [m]; only when idle."""
        return codec.pose_from_fields(self._measure(codec.POSE, "servo_pose"))

    def force(self) -> np.ndarray:
        """Returns the external force at the tool, shape (3,) [N], along the tool's axes; only when idle."""
        return self._measure(codec.FORCE, "servo_force")

    def moment(self) -> np.ndarray:
        """Returns the external moment at the tool, shape (3,) [Nm], about the tool's axes; only when idle."""
        return self._measure(codec.MOMENT, None)

    def ptp_joints(self, q: ArrayLike, velocity: float, timeout: float) -> None:
        """Moves the arm to q, shape (7,) [rad], and waits until it is there, at most `timeout` seconds.

        Raises:
            BadJoints, BadVelocity, WrongMode: as `start_ptp_joints`.
            MotionRefused: the controller refused the motion or gave it up; the tool is attached again.
            ReplyTimeout: the arm is not there in time. It may still move: the mode stays PTP.
        """
        self.start_ptp_joints(q, velocity)
        if self._session.wait_for_final(timeout) is None:
            left = np.abs(self.joints() - self._goal)
            worst = int(np.argmax(left))
            raise ReplyTimeout(
                f"the PTP motion did not end within {timeout:g} s: joint {worst + 1} is still"
                f" {np.degrees(left[worst]):.2f} deg away; the arm may go on moving, only the pad stops a PTP"
            )
        self.ptp_arrived()

    def start_ptp_joints(self, q: ArrayLike, velocity: float) -> None:
        """Starts a motion to q, shape (7,) [rad], at `velocity` of the greatest speed, in (0, 1].

        Raises:
            BadJoints: q is not seven numbers within the limits.
            BadVelocity: the velocity is not in (0, 1].
            MotionRefused: the controller refused; the tool is attached again.
        """
        goal = self._limits.check(q)
        velocity = check_relative_velocity(velocity)
        self._require_idle("a PTP motion")
        self._accept(codec.relative_velocity(velocity))
        self._ask(codec.joint_goal(goal))
        self._goal = goal
        self._session.expect_final(True)
        self._mode = Mode.PTP
        try:
            self._accept(codec.START_PTP)
        except DeviceError:
            if self._session.in_step:
                self._end_motion()
            raise

    def ptp_arrived(self) -> bool:
        """Returns whether the motion has ended at its goal; does not wait. Ends the mode PTP when it has.

        Raises:
            MotionRefused: the controller refused the motion or gave it up; the tool is attached again.
            WrongMode: no PTP motion was started, or its end was reported already.
        """
        if self._mode is not Mode.PTP:
            raise WrongMode(f"no PTP motion is under way (mode {self._mode.value})")
        self._session.look()
        final = self._session.final
        if final is None:
            return False
        self._end_motion()
        if final is Kind.NAK:
            self._refused("the PTP motion (a goal it cannot reach, or a stop on the way)")
        return True

    def start_joint_servo(self) -> None:
        """Starts the joint position servo with the present joints as its goal.

        Raises:
            BadJoints: the arm stands outside the limits.
            MotionRefused: the controller refused; the tool is attached again.
        """
        self._require_idle("the joint servo")
        self._ask(codec.joint_goal(self._limits.check(self.joints())))
        self._accept(codec.START_SERVO)
        self._mode = Mode.SERVO
        self._session.transport.pause(self._session.timing.servo_start)

    def stop_joint_servo(self) -> None:
        """Waits until the arm stands at its last goal and stops the servo.

        Raises:
            MotionRefused: the servo had ended by itself before; the tool is attached again.
        """
        self._require_servo()
        with contextlib.suppress(ReplyTimeout, ProtocolError):
            self._session.rest(self._session.timing.rest)
        self._ask(codec.STOP_SERVO)
        self._mode = Mode.IDLE
        self._session.transport.pause(self._session.timing.servo_stop)
        self._session.look()
        self._heed_refusal()

    def servo(self, q: ArrayLike) -> None:
        """Sets the servo's goal to q, shape (7,) [rad], acknowledged.

        Raises:
            BadJoints: q is not seven numbers within the limits.
        """
        self._servo(q, Feedback.DONE)

    def servo_unacknowledged(self, q: ArrayLike) -> None:
        """As `servo`, without an answer: the caller keeps the pace, and looks now and then with an answered goal."""
        self._require_servo()
        self._session.tell(codec.joint_goal(self._limits.check(q), Feedback.NOTHING))
        self._heed_refusal()

    def servo_joints(self, q: ArrayLike) -> np.ndarray:
        """As `servo`; returns the measured joint angles, shape (7,) [rad]."""
        return self._numbers(self._servo(q, Feedback.JOINTS))

    def servo_external_torques(self, q: ArrayLike) -> np.ndarray:
        """As `servo`; returns the external joint torques, shape (7,) [Nm]."""
        return self._numbers(self._servo(q, Feedback.EXTERNAL_TORQUES))

    def servo_measured_torques(self, q: ArrayLike) -> np.ndarray:
        """As `servo`; returns the measured joint torques, shape (7,) [Nm]."""
        return self._numbers(self._servo(q, Feedback.MEASURED_TORQUES))

    def servo_pose(self, q: ArrayLike) -> np.ndarray:
        """As `servo`; returns the pose of the tool in the arm's base, shape (4, 4) [m].

        Raises:
            ProtocolError: also from a server older than May 2019, which answers the force instead.
        """
        return codec.pose_from_fields(self._numbers(self._servo(q, Feedback.POSE)))

    def servo_force(self, q: ArrayLike) -> np.ndarray:
        """As `servo`; returns the external force at the tool, shape (3,) [N]; needs a server of May 2019 or later."""
        return self._numbers(self._servo(q, Feedback.FORCE))

    def set_blue(self, on: bool) -> None:
        """Switches the blue light of the media flange; in every mode."""
        self._ask(codec.blue(on))

    def set_pin(self, number: int, on: bool) -> None:
        """Switches output 1, 2, 11 or 12 of connector X3; in every mode.

        Raises:
            ValueError: there is no such output.
        """
        self._ask(codec.set_pin(number, on))

    def pin(self, number: int) -> bool:
        """Returns input 3, 4, 10, 13 or 16 of connector X3; in every mode. Servers without a media flange say True.

        Raises:
            ValueError: there is no such input.
        """
        return bool(self._numbers(self._ask(codec.get_pin(number)))[0])

    def close(self) -> None:
        """Stops the servo, ends the server's application and closes the socket, in about a second at most.

        Never raises on a dead link. A PTP motion under way runs to its end; the application ends after it.
        """
        servo = self._mode is Mode.SERVO
        timing = self._session.timing
        with contextlib.suppress(DeviceError):
            if servo and self._session.in_step:
                self._session.rest(min(timing.rest, timing.servo_reply))
        with contextlib.suppress(DeviceError):
            self._session.farewell(stop_servo=servo)
        self._mode = Mode.IDLE
        self._session.transport.close()

    def abort(self) -> None:
        """Ends the connection without a word to the server; safe from any thread.

        A call that is under way raises ConnectionLost, and so does every later one. The arm holds its last goal or runs
        its PTP to the end, and the server must be restarted on the pad.
        """
        self._session.transport.abort()

    def _servo(self, q: ArrayLike, feedback: Feedback) -> Reply:
        self._require_servo()
        return self._ask(codec.joint_goal(self._limits.check(q), feedback), self._session.timing.servo_reply)

    def _measure(self, command: Command, alternative: str | None) -> np.ndarray:
        if self._mode is Mode.SERVO:
            way = f"use {alternative}(q)" if alternative else "stop the servo first"
            raise WrongMode(f"`{command.word}` is not answered in the servo mode; {way}")
        if self._mode is Mode.PTP:
            raise WrongMode(f"`{command.word}` is not answered during a PTP motion; use joints() or wait for its end")
        return self._numbers(self._accept(command))

    def _ask(self, command: Command, timeout: float | None = None) -> Reply:
        reply = self._session.ask(command, timeout)
        self._heed_refusal()
        return reply

    def _accept(self, command: Command) -> Reply:
        """Asks the main thread; a `nak` becomes MotionRefused."""
        reply = self._session.ask_main(command)
        if reply.kind is Kind.NAK:
            self._end_motion()
            self._refused(f"`{command.word}`")
        self._heed_refusal()
        return reply

    def _heed_refusal(self) -> None:
        if not self._session.refused:
            return
        self._session.refused = False
        self._session.ask(codec.STOP_SERVO)
        self._mode = Mode.IDLE
        self._session.transport.pause(self._session.timing.servo_stop)
        self._refused("to go on and left its mode by itself (a limit or a safety stop)")

    def _refused(self, what: str) -> None:
        """The server dropped the tool with its `nak`: attaches it again and raises MotionRefused."""
        self._attach_tool()
        raise MotionRefused(
            f"the controller refused {what}; look at the pad for the reason. The tool is attached again"
        )

    def _attach_tool(self, patience: float | None = None) -> None:
        command = codec.attach_tool(self._tool)
        try:
            reply = self._session.ask_main(command, patience)
        except ReplyTimeout as error:
            raise ToolNotAttached(
                "the server answers but does not attach the tool: its main program has died, or it is older than"
                " version 1.7; restart MatlabToolboxServer on the pad"
            ) from error
        if reply.kind is Kind.NAK:
            raise ToolNotAttached(f"the controller refused the tool `{command.line}`; restart MatlabToolboxServer")
        self._session.transport.pause(self._session.timing.tool_settle)

    def _end_motion(self) -> None:
        self._session.expect_final(False)
        self._mode = Mode.IDLE

    def _require_idle(self, what: str) -> None:
        if self._mode is Mode.PTP:
            raise WrongMode(f"{what} cannot start while a PTP motion runs; wait until ptp_arrived() says so")
        if self._mode is Mode.SERVO:
            raise WrongMode(f"{what} cannot start in the servo mode; call stop_joint_servo() first")

    def _require_servo(self) -> None:
        if self._mode is not Mode.SERVO:
            raise WrongMode(f"the joint servo does not run (mode {self._mode.value}); call start_joint_servo() first")

    @staticmethod
    def _numbers(reply: Reply) -> np.ndarray:
        numbers = np.array(reply.numbers)
        if not np.all(np.isfinite(numbers)):
            raise ProtocolError(f"the controller reported `{reply.text}`, which is not all numbers")
        return numbers
