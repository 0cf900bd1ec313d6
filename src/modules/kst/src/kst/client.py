"""Client of the KUKA Sunrise Toolbox server on the arm's controller: point-to-point motions, joint servo, measurements.

One socket, no thread of its own: all calls come from one thread, but `abort`. Angles in rad, lengths in m, forces in N,
torques in Nm. The client refuses joint angles outside the limits, and commands that the server would never answer in
the present mode. It does not plan: servo goals must be smooth by themselves. The caller checks that the arm follows
them, because a servo mode that the controller stopped still acknowledges its goals
(docs/handbook/wire-protocols.md)."""

from __future__ import annotations

import contextlib
import enum
import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from kst import application, codec
from kst.application import ApplicationSettings, RobotState, SoftSettings, StopChannel
from kst.codec import Feedback, KstCommand, KstReply, ReplyKind, ToolTransform
from kst.errors import (
    ConnectionLost,
    ForeignServer,
    KstError,
    MotionInterrupted,
    MotionRefused,
    MotionStopped,
    NoServer,
    NotLeapRig,
    ReplyTimeout,
    ServerBusy,
    ToolNotAttached,
    UnexpectedReply,
    WordRefused,
    WrongMode,
)
from kst.limits import LBR_IIWA_LIMITS, JointLimits, check_relative_velocity
from kst.session import ARRIVED_RAD, KstSession, KstTiming, LinkCounts
from kst.stranger import stranger
from kst.transport import LEAP_RIG, TOOLBOX, KstTransport

LATE_END_S = 2.0  # the final word of a motion comes sooner after the arrival than this, or not at all [s]
EVENT_S = 0.02  # the reason of a stop comes so long after the stop itself at most [s]
BEAT_S = 0.05  # time between two beats while the client waits [s]
OVERDUE_S = 0.002  # an answer is overdue once it takes this much longer than twice the usual time [s]
_FEEDBACK = {**{feedback.value[0]: feedback for feedback in Feedback}, codec.JOINTS.word: Feedback.JOINTS}


class KstMode(enum.Enum):
    """What the server's main thread is busy with."""

    IDLE = "idle"
    PTP = "ptp"
    SERVO = "servo"


class KstClient:
    """A connection to the server; `connect` makes it, `close` ends it. Also a context manager.

    Every call that talks to the server may raise, besides what it lists:
        ConnectionLost: the link is gone, was aborted, or the server answered nothing for `KstTiming.silence`; all later
            calls raise it too.
        ReplyTimeout: this answer did not come, or an earlier one is still missing and nothing was sent; the next call
            looks for it first. `silence` does so in small steps.
        UnexpectedReply: the answer does not fit the command.
        MotionRefused: the controller refused with a `nak`, or had left servo mode by itself; the tool is attached
            again.
        MotionStopped: the robot application has stopped what moved; WordRefused: it refused this command.
        WrongMode: the server never answers the command in the present mode; nothing was sent.
        BadJoints, BadVelocity, ValueError: a goal, velocity or pin out of range; nothing was sent."""

    def __init__(self, session: KstSession, tool: ToolTransform, limits: JointLimits) -> None:
        self._session = session
        self._application: ApplicationSettings | None = None
        self._channel: StopChannel | None = None
        self._heard: list[str] = []  # from the robot application, unasked
        self._left_because = ""  # the last of that about the end of servo mode
        self._load = (0.0, np.zeros(3))  # that was told to it: mass [kg], centre [m]
        self.abilities: frozenset[str] = frozenset()  # of the robot application; of the toolbox none
        self.monotonic = session.monotonic  # the time of the link [s]
        self._tool = tool
        self._limits = limits
        self._mode = KstMode.IDLE
        self._goal = np.zeros(7)
        self._still_since: float | None = None  # since when a motion in doubt has stood still [s]
        self._at_goal_since: float | None = None  # since when a motion without its final word has been at its goal [s]

    def pause(self, duration: float) -> None:
        """Waits `duration` seconds; raises ConnectionLost if the link is aborted."""
        self._session.transport.pause(duration)

    @property
    def mode(self) -> KstMode:
        """What the server is busy with, as far as this client asked for it."""
        return self._mode

    @property
    def counts(self) -> LinkCounts:
        """The events on the link so far, as a copy."""
        return replace(self._session.counts)

    @classmethod
    def connect(
        cls,
        host: str,
        port: int = 30001,
        tool: ToolTransform | np.ndarray | None = None,
        limits: JointLimits | None = None,
        timeout: float = 5.0,
        timing: KstTiming | None = None,
        application: ApplicationSettings | None = None,
    ) -> KstClient:
        """Connects and attaches the tool, T_flange_tool, shape (4, 4) [m]; None is the flange itself. Raises NoServer:
        nobody listens, or the connection ended without a word; ForeignServer: something answers, but not as the toolbox
        does; ServerBusy: the server accepted and stays silent; ToolNotAttached: the server answers but does not attach
        the tool; NotLeapRig: it is not the robot application; ValueError: the tool is not a rigid pose in metres.

        Args:
            limits: joint ranges that goals must keep to; None: those of the LBR iiwa.
            timeout: longest wait for the connection, and again for the first answer [s].
            timing: the other waits.
            application: the server must be the robot application, which gets this; None: it is spoken to as the
                toolbox's, whatever it is."""
        if not isinstance(tool, ToolTransform):
            tool = ToolTransform(np.eye(4) if tool is None else tool)
        timing = KstTiming() if timing is None else timing
        program = TOOLBOX if application is None else LEAP_RIG
        transport = KstTransport.connect(host, port, timeout, program)
        session = KstSession(transport, timing)
        client = cls(session, tool, LBR_IIWA_LIMITS if limits is None else limits)
        address = f"{host}:{port}"
        try:
            patience = max(timeout - timing.reply, timing.reply)
            if application is None:
                transport.pause(timing.connect_settle)
            else:
                client._greet(host, port, application, timeout, patience)
            client._attach_tool(patience)
        except (ConnectionLost, ReplyTimeout, UnexpectedReply) as error:
            ended = transport.ended_by_peer
            client.close()
            holder = transport.holder
            if holder is not None:
                raise ServerBusy(f"{address} is held by {holder}; end that client", address=address) from error
            if transport.is_foreign:
                expected = "the toolbox's server" if application is None else "the robot application"
                what = stranger(address, expected, transport.heard)
                cure = f"check address and port, and the version of {program}"
                raise ForeignServer(f"{what}; {cure}", address=address, answer=transport.heard) from error
            if ended and not isinstance(error, UnexpectedReply):
                raise NoServer(
                    f"the connection to {address} was closed without a word: the application on the controller ends, or"
                    f" another program has this port, such as one with TLS; start {program} on the smartPad again"
                    f"{' (it waits 60 s for a client)' if program == TOOLBOX else ''}",
                    address=address,
                ) from error
            if session.counts.answered == 0 and not isinstance(error, UnexpectedReply):
                raise ServerBusy(
                    f"{address} is open but silent for {timeout:g} s: another client is connected, or the server lost"
                    f" one and no longer reads; end and start {program} on the smartPad",
                    address=address,
                ) from error
            raise
        except BaseException:
            client.close()
            raise
        return client

    def _greet(
        self, host: str, port: int, settings: ApplicationSettings, timeout: float, patience: float | None
    ) -> None:
        """Says hello to the robot application, joins it a second time, and sets its watchdog."""
        address, session = f"{host}:{port}", self._session
        try:
            reply = session.ask(application.HELLO)
        except ReplyTimeout as error:
            session.resynchronise(patience)
            raise NotLeapRig(
                f"the controller at {address} speaks the toolbox's words only; start LeapRigServer on the smartPad, or"
                " set robot_server to toolbox",
                address=address,
            ) from error
        hello = application.parse_hello(reply)
        if hello is None or hello.version != application.VERSION:
            raise NotLeapRig(
                f"the controller at {address} answered hello by `{reply.text}`, but this client knows version"
                f" {application.VERSION} of LeapRigServer; install the one of this workspace",
                address=address,
            )
        self._application, self.abilities = settings, hello.abilities
        self._ask(application.watchdog(settings))
        self._channel = StopChannel(host, port, hello.session, timeout)

    @property
    def server(self) -> str:
        """What is spoken to, in words."""
        return "toolbox" if self._application is None else f"LeapRigServer {application.VERSION}"

    def stop_motion(self) -> None:
        """Stops whatever moves, by the second connection to the robot application; from any thread, and also while
        this client waits or its link hangs. Then `ptp_arrived` raises MotionStopped. Raises KstError: the word could
        not be sent; WrongMode: the toolbox's server knows no such word."""
        if self._channel is None:
            raise WrongMode("the toolbox's server cannot stop a motion; only the smartPad can", mode=self.mode)
        self._channel.stop()

    def pause_motion(self) -> None:
        """Pauses the PTP motion, which `resume_motion` continues; raises WordRefused: none runs."""
        self._require_application("pause")
        self._ask(application.PAUSE)

    def resume_motion(self) -> None:
        """Continues a motion that was paused; raises WordRefused: none was."""
        self._require_application("resume")
        self._ask(application.RESUME)

    def beat(self) -> None:
        """Tells the watchdog of the robot application, if that is there, that this program is alive, as every command
        does."""
        if self._application is not None:
            self._ask(application.BEAT)

    def state(self) -> RobotState:
        """Returns all that the robot application measures; in every mode."""
        self._require_application("tell its state")
        timing = self._session.timing
        timeout = timing.servo_reply if self.mode is KstMode.SERVO else timing.reply
        reply = self._ask(application.STATE, timeout)
        return application.state_of(reply, self._numbers(application.STATE, reply))

    def set_load(self, mass: float) -> None:
        """Tells the robot application what the hand holds, at the tool point [kg]; at rest only. Raises WordRefused:
        also if the robot reckons with something else."""
        self._require_application("take a load")
        self._require_idle("a change of the load")
        centre = self._tool.T_flange_tool[:3, 3]
        command = application.weigh_load(mass, centre.tolist())
        self._load = float(mass), centre
        self._check_mass(command, self._accept(command))

    def soften(self, soft: SoftSettings | None) -> None:
        """Makes the next servo modes soft, None: stiff again; at rest only. Raises WordRefused: also while the robot
        does not know the tool's mass, or its load check fails."""
        self._require_application("be soft")
        self._require_idle("a change of the compliance")
        self._accept(application.STIFF if soft is None else application.soften(soft))

    def events(self) -> list[str]:
        """Returns what the robot application has said unasked since the last call, parts of sentences."""
        self._hear()
        heard, self._heard = self._heard, []
        return heard

    def _hear(self) -> None:
        for event in [] if self._channel is None else self._channel.events():
            self._heard.append(event)
            if "brakes" in event or "ends" in event:
                self._left_because = event

    def _require_application(self, what: str) -> None:
        if self._application is None:
            raise WrongMode(f"the toolbox's server cannot {what}; the robot application can", mode=self.mode)

    def _check_mass(self, command: KstCommand, reply: KstReply) -> None:
        """Compares tool and load together with what the robot says it reckons with; raises WordRefused."""
        assert self._application is not None
        near_kg, near_mm = 1e-3, 0.5
        (load, at), tool = self._load, self._application.tool_mass
        mass = tool + load
        moment = 1000.0 * (tool * np.asarray(self._application.tool_centre, dtype=float) + load * at)
        centre = moment / mass if mass > 0.0 else np.zeros(3)
        told = application.numbers_of(reply) or ()
        if len(told) == 4 and abs(told[0] - mass) <= near_kg and np.max(np.abs(centre - told[1:])) <= near_mm:
            return
        raise WordRefused(
            f"the robot reckons with `{reply.text}` instead of {mass:.3f} kg at {centre.round(1).tolist()} mm",
            command=command.word,
        )

    def _wait_alive(self, duration: float) -> None:
        """Waits while the watchdog of the robot application hears this program."""
        end = self.monotonic() + duration
        while self._application is not None and self.monotonic() + BEAT_S < end:
            self.beat()
            self._session.transport.pause(BEAT_S)
        self._session.transport.pause(max(end - self.monotonic(), 0.0))

    def __enter__(self) -> KstClient:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def round_trip(self) -> float | None:
        """Time from the last answered command to its answer [s]; None before the first."""
        return self._session.round_trip

    def silence(self, wait: float) -> float:
        """Returns for how long an answer has been missing [s], 0 if none is; waits up to `wait` seconds for it.
        While one is missing nothing but probes is sent. The server may be frozen, with its connection alive. An
        answer to a streamed goal counts as missing as soon as the window is full, from the delay on that is usual on
        the link."""
        session = self._session
        if session.in_step and not session.open:
            return 0.0
        deadline = self.monotonic() + wait
        session.collect(deadline)
        if session.in_step:
            return 0.0 if session.has_room else max(self.monotonic() - session.open[0].sent_at - session.usual, 1e-3)
        return 0.0 if session.settle(deadline) else session.silent

    def joints(self) -> np.ndarray:
        """Returns the measured joint angles, shape (7,) [rad]; in every mode."""
        timing = self._session.timing
        timeout = timing.servo_reply if self.mode is KstMode.SERVO else timing.reply
        joints = self._numbers(codec.JOINTS, self._ask(codec.JOINTS, timeout))
        if np.max(np.abs(joints - self._goal)) > ARRIVED_RAD:
            self._at_goal_since = None
        elif self._at_goal_since is None:
            self._at_goal_since = self.monotonic()
        return joints

    def external_torques(self) -> np.ndarray:
        """Returns the external joint torques, shape (7,) [Nm]; only when idle."""
        return self._measure(codec.EXTERNAL_TORQUES, Feedback.EXTERNAL_TORQUES)

    def measured_torques(self) -> np.ndarray:
        """Returns the measured joint torques, shape (7,) [Nm]; only when idle."""
        return self._measure(codec.MEASURED_TORQUES, Feedback.MEASURED_TORQUES)

    def pose(self) -> np.ndarray:
        """Returns the pose of the tool in the arm's base, shape (4, 4) [m]; only when idle."""
        return codec.pose_from_fields(self._measure(codec.POSE, Feedback.POSE))

    def force(self) -> np.ndarray:
        """Returns the external force at the tool, shape (3,) [N], along the tool's axes; only when idle."""
        return self._measure(codec.FORCE, Feedback.FORCE)

    def moment(self) -> np.ndarray:
        """Returns the external moment at the tool, shape (3,) [Nm], about the tool's axes; only when idle."""
        return self._measure(codec.MOMENT, None)

    def ptp_joints(self, q: ArrayLike, velocity: float, timeout: float) -> None:
        """Moves the arm to q, shape (7,) [rad], and waits until it arrives, at most `timeout` seconds. Raises
        ReplyTimeout: the arm did not arrive in time. It may still move: the mode stays PTP."""
        self.start_ptp_joints(q, velocity)
        deadline = self.monotonic() + timeout
        while not self.ptp_arrived():
            if self.monotonic() >= deadline:
                left = np.abs(self.joints() - self._goal)
                worst = int(np.argmax(left))
                raise ReplyTimeout(
                    f"the PTP motion did not end within {timeout:g} s: joint {worst + 1} is still"
                    f" {np.degrees(left[worst]):.2f} deg away; the arm may keep moving, only the smartPad stops it",
                    command=codec.START_PTP.word,
                )
            self._session.wait_for_word(deadline)
            self.beat()

    def knows_guarded_ptp(self) -> bool:
        """Returns whether the server knows PTP motions that end at a torque; only when idle. Nothing moves. Servers
        before April 2018 do not: they are silent, which takes some seconds to be sure of."""
        self._require_idle("a PTP motion")
        session = self._session
        session.expect_final(True)
        try:
            self._accept(codec.GUARDED_PTP)
            deadline = self.monotonic() + session.timing.reply
            while session.final is None and self.monotonic() < deadline:
                session.wait_for_word(deadline)
            if session.final is None:
                raise UnexpectedReply("a motion of no length did not end", command=codec.GUARDED_PTP.word)
        except ReplyTimeout as error:
            if not session.in_step or error.pending:
                raise
            session.expect_final(False)
            self._accept(codec.EXTERNAL_TORQUES)  # raises if the main thread answers nothing at all
            return False
        finally:
            session.expect_final(False)
        return True

    def start_guiding(self) -> None:
        """Lets a hand move the arm while the enabling switch is pressed; its release ends that, as `ptp_arrived` tells.
        At rest only."""
        self._require_application("be guided by hand")
        self._require_idle("hand guiding")
        self._goal = np.full(7, np.inf)  # it has none
        self._still_since = self._at_goal_since = None
        self._session.expect_final(True)
        self._mode = KstMode.PTP
        try:
            self._accept(application.GUIDE)
        except KstError:
            self._end_motion()
            raise

    def start_ptp_joints(self, q: ArrayLike, velocity: float, torques: ArrayLike | None = None) -> None:
        """Starts a motion to q, shape (7,) [rad], at the fraction `velocity` of the greatest speed, in (0, 1]. With
        `torques`, shape (7, 2) [Nm], it ends where the external torque of a joint leaves its range from the lowest
        to the highest; a server that `knows_guarded_ptp` only. ValueError: not such ranges; nothing was sent. A
        start that is not acknowledged although it may have been carried out counts as a motion that runs: the arm
        moves, or the server has fallen silent. Then the joints show later what became of it (`ptp_arrived`)."""
        goal = self._limits.check(q)
        velocity = check_relative_velocity(velocity)
        start = codec.START_PTP if torques is None else codec.start_guarded_ptp(torques)
        self._require_idle("a PTP motion")
        before = None if torques is None else self.joints()  # an arm that met something stands neither here nor there
        self._accept(codec.relative_velocity(velocity))
        self._ask(codec.joint_goal(goal))
        self._goal = goal
        self._still_since = self._at_goal_since = None
        self._session.expect_final(True)
        self._mode = KstMode.PTP
        try:
            self._accept(start, goal, before)
            self._session.doubt |= (self._session.round_trip or 0.0) > self._session.timing.quiet
        except (ReplyTimeout, UnexpectedReply) as error:
            if self._session.in_step and not error.pending:
                self._end_motion()
                raise
        except KstError:
            if self._session.in_step:
                self._end_motion()
            raise

    def ptp_arrived(self) -> bool:
        """Returns whether the motion has ended at its goal; does not wait. Ends the mode PTP when it has. An arm that
        has been at the goal for LATE_END_S and then for KstTiming.reply has lost its final word. Raises MotionRefused:
        the controller gave the motion up, or its start was wiped; MotionInterrupted: an external torque ended it."""
        if self.mode is not KstMode.PTP:
            raise WrongMode(f"no PTP motion runs (mode {self.mode.value}); start one first", mode=self.mode)
        self._session.poll()
        final = self._session.final
        if final is None:
            lost = self._at_goal_since is not None and self.monotonic() - self._at_goal_since > LATE_END_S
            return (lost or self._session.doubt) and self._arrived_by_joints()
        self._end_motion()
        if final is ReplyKind.NAK:
            self._refused("the PTP motion (an unreachable goal, or a stop during the motion)")
        if final is ReplyKind.INTERRUPTED:
            raise self._interrupted()
        if final is ReplyKind.STOPPED:
            why = self._session.stopped_by
            raise self._interrupted() if why.startswith("contact") else self._stopped("the motion was stopped by", why)
        return True

    @staticmethod
    def _stopped(what: str, reason: str) -> MotionStopped:
        return MotionStopped(f"{what} {reason}", reason=reason)

    def _interrupted(self) -> MotionInterrupted:
        """Asks for the torques at which the arm stands: the server does not tell which of them ended the motion."""
        torques = None
        with contextlib.suppress(ReplyTimeout, UnexpectedReply):
            reply = self._session.ask(codec.EXTERNAL_TORQUES)
            torques = self._numbers(codec.EXTERNAL_TORQUES, reply) if reply.numbers else None
        return MotionInterrupted("an external joint torque ended the PTP motion before its goal", torques=torques)

    def _arrived_by_joints(self) -> bool:
        """Returns whether a motion has ended whose words leave that open: by its joints. The final word may come
        somewhat after the arrival, and a motion may begin late, so an arm that stands still is watched as long as an
        answer is waited for."""
        session, now = self._session, self.monotonic()
        at_goal = session.arm_is_at(self._goal)
        acknowledged = session.acknowledged
        if not at_goal and (acknowledged or session.arm_moves() or session.acknowledged):
            # A word that came while the joints were read is the acknowledgement or the final one, as before.
            session.doubt, self._still_since = session.acknowledged and not acknowledged, None
            return False
        self._still_since = now if self._still_since is None else self._still_since
        if now < self._still_since + session.timing.reply:
            return False
        if at_goal:
            session.expect_second_word()
            self._mode = KstMode.IDLE
            return True
        self._end_motion()
        raise MotionRefused("the PTP motion did not begin: its start was lost; nothing moves")

    def start_joint_servo(self) -> None:
        """Starts the joint position servo with the present joints, which must be within the limits, as its goal."""
        self._require_idle("the joint servo")
        self._ask(codec.joint_goal(self._limits.check(self.joints())))
        self._session.arrived.clear()
        self._hear()
        self._left_because = ""
        try:
            self._accept(codec.START_SERVO)
        except (ReplyTimeout, UnexpectedReply) as error:
            if self._session.in_step:
                raise
            self._mode = KstMode.SERVO
            raise ReplyTimeout(f"{error}; servo mode may have started", pending=True) from error
        self._mode = KstMode.SERVO
        self._wait_alive(self._session.timing.servo_start)

    def stop_joint_servo(self) -> None:
        """Waits until the arm stands still at its last goal and stops the servo."""
        self._require_servo()
        with contextlib.suppress(ReplyTimeout, UnexpectedReply):
            self._session.rest(self._session.timing.rest)
        self._ask(codec.STOP_SERVO)
        self._mode = KstMode.IDLE
        self._session.transport.pause(self._session.timing.servo_stop)
        self._session.poll()
        self._heed_refusal()

    def servo(self, q: ArrayLike, feedback: Feedback = Feedback.DONE) -> np.ndarray | RobotState | None:
        """Sets the servo's goal to q, shape (7,) [rad], and returns the feedback. DONE is only an acknowledgement.
        NOTHING is no answer: the caller keeps the pace and sends an answered goal now and then. The others are
        measurements, taken before the goal acts. UnexpectedReply: also for POSE from a server older than May 2019,
        which answers the force instead.

        Returns:
            JOINTS: shape (7,) [rad]. EXTERNAL_TORQUES, MEASURED_TORQUES: shape (7,) [Nm]. POSE of the tool in the base,
                shape (4, 4) [m]. FORCE at the tool, shape (3,) [N]. STATE: a RobotState (robot application).
                None for DONE and NOTHING."""
        self._require_servo()
        command = self._goal_command(q, feedback)
        if feedback is Feedback.NOTHING:
            self._session.post(command)
            self._heed_refusal()
            return None
        reply = self._ask(command, self._session.timing.servo_reply)
        if feedback is Feedback.DONE:
            return None
        value = self._value(command, reply)
        if isinstance(value, KstError):
            raise value
        return value

    def stream(self, q: ArrayLike, feedback: Feedback = Feedback.JOINTS, wait: bool = True) -> Feedback:
        """Sets the servo's goal to q, shape (7,) [rad], without waiting for its answer, which `answers` returns.
        Waits while the window is full: `KstTiming.servo_window`, or less on a link whose answers come soon. A caller
        that looks at `silence` before each goal need not `wait`; then no goal becomes old here. Returns the
        requested feedback: DONE instead of one whose answer could be mistaken for another, if one were lost."""
        self._require_servo()
        if not self._is_unmistakable(feedback):
            feedback = Feedback.DONE
        self._session.stream(self._goal_command(q, feedback), wait)
        self._heed_refusal()
        return feedback

    def stream_joints(self) -> None:
        """Asks for the measured joints in servo mode as `stream` does, without a goal."""
        self._require_servo()
        self._session.stream(codec.JOINTS, wait=False)

    @property
    def open_goals(self) -> int:
        """The number of streamed goals whose answers have not been read yet."""
        return len(self._session.open)

    def answers(self, wait: float = 0.0) -> list[tuple[Feedback, np.ndarray | RobotState | KstError | None]]:
        """Returns the answers to streamed goals that have come since the last call, the oldest first. Waits up to
        `wait` seconds until none is open. A value is what `servo` returns, or the error it would raise."""
        session = self._session
        session.collect(self.monotonic() + wait, every=wait > 0.0)
        found = [(_FEEDBACK[goal.command.word], self._value(goal.command, reply)) for goal, reply in session.arrived]
        session.arrived.clear()
        return found

    def _value(self, command: KstCommand, reply: KstReply) -> np.ndarray | RobotState | KstError | None:
        if not command.accepts(reply):
            return self._session.unexpected(command, reply)
        if reply.kind is ReplyKind.NO:
            return self._no(command, reply)
        if command.answer is ReplyKind.DONE:
            return None
        try:
            numbers = self._numbers(command, reply)
        except UnexpectedReply as error:
            return error
        if command.answer is ReplyKind.STATE:
            state = application.state_of(reply, numbers)
            return state if state.mode == "SERVO" or self.mode is not KstMode.SERVO else self._left_servo(state.mode)
        return codec.pose_from_fields(numbers) if command.answer is ReplyKind.SIX else numbers

    def _is_unmistakable(self, feedback: Feedback) -> bool:
        """Returns whether the answer to a goal would differ in kind from its neighbours' and none is overdue."""
        session = self._session
        if not session.open:
            return True
        newest, answer = _FEEDBACK[session.open[-1].command.word], feedback.value[1]
        overdue = self.monotonic() - session.open[0].sent_at > 2.0 * session.usual + OVERDUE_S
        return (newest is feedback or newest.value[1] is not answer) and not overdue

    def set_blue(self, on: bool) -> None:
        """Switches the blue light of the media flange; in every mode."""
        self._ask(codec.blue(on))

    def set_pin(self, number: int, on: bool) -> None:
        """Switches output 1, 2, 11 or 12 of connector X3; in every mode."""
        self._ask(codec.set_pin(number, on))

    def pin(self, number: int) -> bool:
        """Returns input 3, 4, 10, 13 or 16 of connector X3; in every mode. Always True without a media flange."""
        command = codec.get_pin(number)
        return bool(self._numbers(command, self._ask(command))[0])

    def close(self) -> None:
        """Stops the servo, ends the server's application and closes the socket, in about a second at most. Never
        raises on a dead link. A running PTP motion continues to its goal; the application ends after it. A server
        that is silent, frozen perhaps, gets the same words: they wait for it."""
        servo, timing = self.mode is KstMode.SERVO, self._session.timing
        with contextlib.suppress(KstError):
            if servo and self._session.in_step:
                self._session.rest(min(timing.rest, timing.farewell))
        with contextlib.suppress(KstError):
            self._session.farewell(stop_servo=servo)
        if self._channel is not None:
            self._channel.close()
        self._mode = KstMode.IDLE
        self._session.transport.close()

    def abort(self) -> None:
        """Drops the connection without a command to the server; any thread may call it. A pending call raises
        ConnectionLost, and so does every later one. The arm holds its last goal or completes its PTP motion, and
        somebody must restart the server on the smartPad."""
        self._session.transport.abort()

    def _measure(self, command: KstCommand, in_servo: Feedback | None) -> np.ndarray:
        if self.mode is KstMode.SERVO:
            cure = f"use servo(q, {in_servo})" if in_servo else "call stop_joint_servo() first"
            raise WrongMode(f"`{command.word}` is not answered in servo mode; {cure}", mode=self.mode)
        if self.mode is KstMode.PTP:
            cure = "use joints() or wait for its end"
            raise WrongMode(f"`{command.word}` is not answered during a PTP motion; {cure}", mode=self.mode)
        return self._numbers(command, self._accept(command))

    def _left_servo(self, mode: str) -> MotionStopped:
        self._hear()
        if not self._left_because:  # which comes by the other connection
            self._session.transport.pause(EVENT_S)
            self._hear()
        reason = self._left_because or ("it holds the arm" if mode == "HELD" else "servo mode has ended")
        return self._stopped("the robot follows no goals:", reason)

    def _no(self, command: KstCommand, reply: KstReply) -> KstError:
        if reply.reason.startswith("held") and self.mode is KstMode.SERVO:
            return self._left_servo("HELD")
        return WordRefused(f"the robot refused `{command.word}`: {reply.reason}", command=command.word)

    def _ask(self, command: KstCommand, timeout: float | None = None) -> KstReply:
        reply = self._session.ask(command, timeout)
        self._heed_refusal()
        if reply.kind is ReplyKind.NO:
            raise self._no(command, reply)
        return reply

    def _accept(self, command: KstCommand, goal: np.ndarray | None = None, start: np.ndarray | None = None) -> KstReply:
        """Asks the main thread; a `nak` becomes MotionRefused. `goal`, `start`: of the motion that it starts."""
        reply = self._session.ask_main(command, goal=goal, start=start)
        if reply.kind is ReplyKind.NAK:
            self._end_motion()
            self._refused(f"`{command.word}`")
        self._heed_refusal()
        if reply.kind in (ReplyKind.NO, ReplyKind.STOPPED):
            self._end_motion()
            if reply.kind is ReplyKind.STOPPED:
                raise self._stopped(f"`{command.word}` was stopped by", reply.reason)
            raise self._no(command, reply)
        return reply

    def _heed_refusal(self) -> None:
        if not self._session.refused:
            return
        self._session.refused = False
        self._session.ask(codec.STOP_SERVO)
        self._mode = KstMode.IDLE
        self._session.transport.pause(self._session.timing.servo_stop)
        self._refused("to continue and left servo mode by itself (a limit or a safety stop)")

    def _refused(self, what: str) -> None:
        """Raises MotionRefused, after attaching the tool again, which the server dropped with its `nak`."""
        if self._application is not None:  # it keeps its tool
            raise MotionRefused(f"the controller refused {what}; look at the smartPad for the reason")
        self._attach_tool()
        raise MotionRefused(
            f"the controller refused {what}; look at the smartPad for the reason. The tool is attached again"
        )

    def _attach_tool(self, patience: float | None = None) -> None:
        settings = self._application
        weighs = settings is not None and settings.tool_mass > 0.0
        command = codec.attach_tool(self._tool)
        if settings is not None and weighs:
            command = application.weigh_tool(settings, self._tool)
        try:
            reply = self._session.ask_main(command, patience)
        except ReplyTimeout as error:
            if not self._session.in_step:
                raise
            raise ToolNotAttached(
                "the server answers but does not attach the tool: its main program has ended, or it is older than"
                f" version 1.7; restart {self._session.transport.program} on the smartPad"
            ) from error
        if reply.kind is ReplyKind.NAK:
            raise ToolNotAttached(
                f"the controller refused the tool `{command.line}`; restart {self._session.transport.program}"
            )
        if reply.kind is ReplyKind.NO:
            raise ToolNotAttached(f"the robot refused the tool `{command.line}`: {reply.reason}")
        if weighs:
            try:
                self._check_mass(command, reply)
            except WordRefused as error:
                raise ToolNotAttached(str(error)) from error
        if settings is None:
            self._session.transport.pause(self._session.timing.tool_settle)

    def _end_motion(self) -> None:
        self._session.expect_final(False)
        self._mode = KstMode.IDLE

    def _require_idle(self, what: str) -> None:
        if self.mode is KstMode.PTP:
            raise WrongMode(f"{what} cannot start during a PTP motion; wait for ptp_arrived()", mode=self.mode)
        if self.mode is KstMode.SERVO:
            raise WrongMode(f"{what} cannot start in servo mode; call stop_joint_servo() first", mode=self.mode)

    def _goal_command(self, q: ArrayLike, feedback: Feedback) -> KstCommand:
        angles = self._limits.check(q).tolist()
        if feedback is Feedback.STATE:
            self._require_application("answer a goal by its state")
        return codec.joint_goal(angles, feedback)

    def _require_servo(self) -> None:
        if self.mode is not KstMode.SERVO:
            what = f"the joint servo does not run (mode {self.mode.value}); call start_joint_servo() first"
            raise WrongMode(what, mode=self.mode)

    @staticmethod
    def _numbers(command: KstCommand, reply: KstReply) -> np.ndarray:
        if not all(map(math.isfinite, reply.numbers)):
            what = f"the controller reported `{reply.text}`, which is not all numbers; it was ignored"
            raise UnexpectedReply(what, command=command.word, reply=reply.text)
        return np.array(reply.numbers)
