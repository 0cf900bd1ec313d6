"""The servo goals of one stay in servo mode: from joint targets between frames to goals within the limits. A target
may be far from the one before. If the desired tool frame itself jumped, or the joints are too far off, the arm does
not servo there; else it catches up slowly."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from common.frame_rate import FrameRate
from common.limits import Limit
from common.poses import read_only
from common.rotations import rotation_angle
from kuka_control.limits.motion_limits import LimitedGoal, MotionLimits, Unlimited
from kuka_control.loop.servo_law import LtsGoals
from kuka_control.loop.tracking import TrackingMonitor
from kuka_control.loop.transitions import Trigger
from kuka_control.model.desired_frame import RATE_WINDOW_S, DesiredFrame
from kuka_control.numbers import (
    CONTINUED_S,
    FADE_S,
    FULL_SPEED_HZ,
    GAP_S,
    HOLD_HZ,
    LONGEST_STALL_S,
    LOST_S,
    RESUME_HZ,
    TOLERANCE_M,
)

TOLERANCE_RAD = float(np.radians(2.0))  # largest joint step servoed to from rest, and tolerance on the speed limits
SHORT_S = 0.006  # frames nearer in time than this give no speed [s]
SETTLED_RAD = 1e-3  # an arm this close to its goal has come to rest with it [rad]


def is_jump(q_before: np.ndarray, q_now: np.ndarray, dt: float, joint_speeds: np.ndarray, stall: float = 0.0) -> bool:
    """Returns whether some joint moves more than 2 deg beyond what its speed limit allows in the time `dt` [s].
    Joints before and now: shape (7,) [rad]; limits `joint_speeds`: shape (7,) [rad/s]; for `stall` [s] of that time
    the control loop did not look."""
    cycle = _cycle(dt, stall)
    steps = zip(q_before.tolist(), q_now.tolist(), joint_speeds.tolist())
    return any([abs(now - before) > TOLERANCE_RAD + speed * cycle for before, now, speed in steps])


class FrameSteps:
    """Watches the steps of the desired tool frame itself, also while the arm cannot follow it. Joints may jump
    although the frame did not: it was out of reach for a while and returns elsewhere, or it passes a position where
    a joint reaches the end of its range and the others have to compensate. A frame that is faster than `tool_speed`
    [m/s] or `turn_speed` [rad/s] jumps. `jumped` is true if it has done so since the arm last followed."""

    def __init__(self, tool_speed: float, turn_speed: float) -> None:
        self._tool_speed = tool_speed
        self._turn_speed = turn_speed
        self._last: DesiredFrame | None = None
        self.jumped = False

    def take(self, frame: DesiredFrame, stall: float) -> None:
        """Takes a new frame in; for `stall` [s] since the frame before the control loop did not look."""
        last, self._last = self._last, frame
        if last is None:
            return
        cycle = _cycle(frame.stamp - last.stamp, stall)
        distance = math.dist(frame.T_base_tool[:3, 3].tolist(), last.T_base_tool[:3, 3].tolist())
        turn = rotation_angle(last.T_base_tool[:3, :3].T @ frame.T_base_tool[:3, :3])
        jump = distance > TOLERANCE_M + self._tool_speed * cycle or turn > TOLERANCE_RAD + self._turn_speed * cycle
        self.jumped = self.jumped or jump

    def followed(self) -> None:
        self.jumped = False


def _cycle(dt: float, stall: float) -> float:
    """Returns the time in which the arm has to make a step that took the stream `dt` [s]. Frames that came while the
    control loop did not look, for `stall` [s], were not lost."""
    cycle = 0.01  # of the stream; the arm has to cross a longer gap in this time [s]
    return max(dt, 0.0) if dt <= LOST_S + min(stall, LONGEST_STALL_S) else cycle


@dataclass(frozen=True)
class MovingTarget:
    q: np.ndarray  # joints, shape (7,) [rad]
    v: np.ndarray  # their speeds, shape (7,) [rad/s]


class TargetMotion:
    """Continues joint targets between frames, which come at 74 or 115 Hz and unevenly, at the speed that the stamps
    show: goals at 250 Hz pass through the joints of each frame without lag.

    The speed is the smaller of that over the last frame and that over the last few, and zero where their signs differ,
    so that a hand that slows down or trembles is not extrapolated. A frame is continued for little longer than the time
    between frames. The least delayed of the recent frames gives the difference of the clocks; every other one counts as
    older by its additional delay.

    Args:
        lower, upper: joint ranges, shape (7,) [rad], that no extrapolation leaves.
        q: joints at the start, shape (7,) [rad], where the target rests; as an attribute those of the last frame."""

    def __init__(self, lower: np.ndarray, upper: np.ndarray, q: np.ndarray) -> None:
        self._ranges = list(zip(lower.tolist(), upper.tolist()))
        self.q = np.asarray(q, dtype=float)
        self._q: list[float] = self.q.tolist()
        self._v = [0.0] * 7
        self._since = 0.0
        self._horizon = CONTINUED_S
        compared = 64  # so many recent frames, of which the least delayed one is sought
        self._frames: deque[tuple[float, list[float]]] = deque(maxlen=compared)
        self._delays: deque[float] = deque(maxlen=compared)

    def take(self, q: np.ndarray, stamp: float, now: float) -> None:
        """Takes the joints of a new frame, shape (7,) [rad], with its stamp by any clock; `now` is monotonic [s]."""
        if self._frames and not 0.0 < stamp - self._frames[-1][0] <= LOST_S:
            self._frames.clear()
            self._delays.clear()
        self._delays.append(now - stamp)
        self._since = stamp + min(self._delays)
        if self._frames:
            self._horizon = min(1.5 * (stamp - self._frames[-1][0]), CONTINUED_S)
        self.q = np.asarray(q, dtype=float)
        self._q = self.q.tolist()
        self._v = self._speed(stamp)
        self._frames.append((stamp, self._q))

    def hold(self) -> None:
        """Stops the target at the joints of the last frame, because the new frame cannot be reached."""
        self._v = [0.0] * 7
        self._frames.clear()

    def at(self, now: float) -> MovingTarget:
        """Returns the target at the monotonic time `now` [s]."""
        age = max(now - self._since, 0.0)
        faded = min(max(age - self._horizon, 0.0), FADE_S)
        duration = min(age, self._horizon) + faded - faded * faded / (2.0 * FADE_S)
        fraction = 1.0 - faded / FADE_S
        joints, speeds = [], []
        for angle, v, (lower, upper) in zip(self._q, self._v, self._ranges):
            free = angle + duration * v
            joints.append(min(max(free, lower), upper))
            speeds.append(fraction * v if lower <= free <= upper else 0.0)
        return MovingTarget(read_only(joints), read_only(speeds))

    def _speed(self, stamp: float) -> list[float]:
        short = self._mean_speed(stamp, SHORT_S)
        long = self._mean_speed(stamp, 0.024)
        return [(a if abs(a) < abs(b) else b) if a * b > 0.0 else 0.0 for a, b in zip(short, long)]

    def _mean_speed(self, stamp: float, least: float) -> list[float]:
        """Returns the mean speed since the newest frame that is `least` seconds old, or since the oldest one."""
        frames = self._frames
        if not frames or stamp - frames[0][0] < SHORT_S:
            return [0.0] * 7
        time, before = next((frame for frame in reversed(frames) if stamp - frame[0] >= least), frames[0])
        return [(now - angle) / (stamp - time) for now, angle in zip(self._q, before)]


def rare_frames(rate: float) -> str:
    """Returns that frames at this rate [Hz] are not followed, a sentence."""
    return (
        f"The desired tool frame comes at {rate:.3g} Hz, but the arm follows it only from {RESUME_HZ:g} Hz on, at full "
        f"speed from {FULL_SPEED_HZ:g} Hz."
    )


class RateLimit:
    """How fast the arm may follow frames that come at a `rate` [Hz]: less often seen, a hand is followed more slowly;
    `holds` says whether they come too rarely."""

    def __init__(self) -> None:
        self._rate = FrameRate(RATE_WINDOW_S)
        self.holds = False
        self.rate = 0.0

    def take(self, stamp: float, stall: float) -> None:
        """Takes the stamp of a new frame [s]; a stall of the control loop says nothing about the rate."""
        last = self._rate.last
        if last is None or stall > 0.0 or stamp <= last:
            self._rate.clear()
        self._rate.take(stamp)
        if self._rate.span >= RATE_WINDOW_S:
            self.rate = self._rate.value or 1.0 / self._rate.span
            rounding = 1e-3  # of a rate by stamps in seconds since 1970 [Hz]
            self.holds = self.rate < (RESUME_HZ if self.holds else HOLD_HZ) - rounding

    @property
    def cap(self) -> float:
        """Scaling factor of the speed limits: 1 down to FULL_SPEED_HZ, falling with the rate, 0 below HOLD_HZ. Until
        the rate is known it is CATCH_UP_SCALE, with which the arm starts anyway."""
        if self.holds:
            return 0.0
        if self._rate.span < RATE_WINDOW_S:
            return CATCH_UP_SCALE
        return min(self.rate / FULL_SPEED_HZ, 1.0)


CATCH_UP_SCALE = 1.0 / 3.0
"""Fraction of the speed limits until the arm has caught up with a hand that moved on while the arm could not follow:
while the pick-up motion ran, out of reach, or after a gap between two goals."""


@dataclass(frozen=True)
class GoalStreamSettings:
    joint_speeds: np.ndarray  # limits of the stream, shape (7,) [rad/s]
    tool_speed: float  # limit of the stream [m/s]
    shaped: bool  # whether the stream is shaped; if not, every target is a goal as it is
    lower: np.ndarray  # least joint angles of a goal, shape (7,) [rad]
    upper: np.ndarray  # greatest joint angles of a goal, shape (7,) [rad]


class ServoStream:
    """What every stay in servo mode shares: it starts at rest at the joints q, shape (7,) [rad], and can brake.
    `lts`: whether goals are made for a server with the LTS law; `now` is the monotonic time of the start [s]."""

    def __init__(
        self, settings: GoalStreamSettings, limits: MotionLimits | Unlimited, lts: bool, q: np.ndarray, now: float
    ) -> None:
        limits.reset(q)
        self._settings = settings
        self._limits = limits
        self._monitor = TrackingMonitor()
        self._lts = LtsGoals(settings.lower, settings.upper) if lts else None
        self._time = now
        self._stands_at: float | None = None  # when braking goals came to rest
        self._settled = False  # whether the arm has come there

    def lag(self, measured: np.ndarray, now: float) -> str | None:
        """Returns None while the arm follows its goals, else what is wrong, as a part of a sentence."""
        return self._monitor.step(self._limits.goal, measured, now)

    def brake(self, measured: np.ndarray, now: float) -> LimitedGoal | None:
        """Returns the goal of this cycle on the way to the earliest stop within the limits. None: the arm may be
        left as it is. Goals for the LTS law lie beyond the arm: they are sent until it has come."""
        dt, self._time = now - self._time, now
        if self._limits.at_rest and self._stands_at is None:
            self._stands_at = now
            if self._lts is None:
                return None
        stopped = self._limits.brake(dt)
        if self._stands_at is None:
            return self._for_robot(stopped, measured, dt)
        if self._settled:
            return None
        near = max(abs(stopped.q - measured).tolist()) < SETTLED_RAD
        longest = 0.3  # of the wait for the arm [s]
        self._settled = near or now - self._stands_at > longest
        return stopped if self._settled else self._for_robot(stopped, measured, dt)

    def _for_robot(self, limited: LimitedGoal, measured: np.ndarray, dt: float) -> LimitedGoal:
        if self._lts is None:
            return limited
        return LimitedGoal(self._lts.step(limited.q, limited.v, measured, dt), limited.v, limited.limited_by)


class GoalStream(ServoStream):
    """Makes the goals of one stay in servo mode that follows the desired tool frame; arguments as `ServoStream`."""

    def __init__(
        self, settings: GoalStreamSettings, limits: MotionLimits | Unlimited, lts: bool, q: np.ndarray, now: float
    ) -> None:
        super().__init__(settings, limits, lts, q, now)
        self._motion = TargetMotion(settings.lower, settings.upper, q)
        self._frames = FrameSteps(settings.tool_speed, float(np.max(settings.joint_speeds)))
        self._rate = RateLimit()
        self._stamp: float | None = None
        self._held = False  # whether the frame before came too rarely
        self._catching_up = True
        self._looked = now
        self._stall = 0.0  # since the last frame [s]

    @property
    def q_target(self) -> np.ndarray:
        """The joints of the last target, shape (7,) [rad]."""
        return self._motion.q

    @property
    def too_rare(self) -> str | None:
        """Why the goals hold whatever the frames are, a sentence, or None."""
        return rare_frames(self._rate.rate) if self._rate.holds else None

    def hear(self, frame: DesiredFrame, now: float) -> float:
        """Takes note of a new desired tool frame before its joints are known; `now` is monotonic. Returns for how
        long the control loop did not look since the frame before [s]."""
        self._look(now)
        stall, self._stall = self._stall, 0.0
        self._frames.take(frame, stall)
        self._held = self._rate.holds
        self._rate.take(frame.stamp, stall)
        return stall

    def take(
        self, frame: DesiredFrame, q: np.ndarray | None, measured: np.ndarray, now: float, stall: float
    ) -> Trigger | None:
        """Takes the joints of the frame that was heard; returns why they are not to be servoed to, None if they are.
        Its joints q and the `measured` ones have shape (7,) [rad]; without q the arm keeps its joints. `now` is
        monotonic, `stall` as `hear` returned it [s]."""
        if self._rate.holds:
            self._motion.hold()
            return None
        if self._held and q is not None and is_jump(self._motion.q, q, 0.0, self._settings.joint_speeds):
            return Trigger.JUMPED
        if q is None:
            self._motion.hold()
            return None
        trigger = self._too_far(q, frame.stamp, measured, stall)
        if trigger is None:
            self._motion.take(q, frame.stamp, now)
            self._frames.followed()
            self._stamp = frame.stamp
        return trigger

    def goal(self, measured: np.ndarray, now: float) -> LimitedGoal:
        """Returns the goal of this cycle for the robot; `measured` are the joints of the arm, shape (7,) [rad]."""
        self._look(now)
        dt, self._time = now - self._time, now
        target = self._motion.at(now) if self._settings.shaped else MovingTarget(self._motion.q, np.zeros(7))
        scale, cap = CATCH_UP_SCALE if self._catching_up else 1.0, self._rate.cap
        limited = self._limits.step(target.q, measured, dt, scale, target.v, cap)
        if limited.limited_by is None and self._stamp is not None:
            self._catching_up = False
        if self._rate.holds:
            limited, self._catching_up = replace(limited, limited_by=Limit.FRAME_RATE), True
        return self._for_robot(limited, measured, dt)

    def _look(self, now: float) -> None:
        """Notes a stall of the control loop: a gap since it looked last."""
        gap, self._looked = now - self._looked, now
        if gap > GAP_S:
            self._stall = max(self._stall, gap)
            self._catching_up = True

    def _too_far(self, q: np.ndarray, stamp: float, measured: np.ndarray, stall: float) -> Trigger | None:
        speeds, shaped = self._settings.joint_speeds, self._settings.shaped
        if self._stamp is None:
            return None if shaped or not is_jump(measured, q, 0.0, speeds) else Trigger.MOVED_ON
        before = self._motion.q
        if not is_jump(before, q, stamp - self._stamp, speeds, stall):
            return None
        if self._frames.jumped:
            return Trigger.JUMPED
        catch_up = math.radians(60.0)  # joints that differ by more are caught up with by a pick-up motion [rad]
        if shaped and np.max(np.abs(q - before)) <= catch_up:
            self._motion.hold()
            self._catching_up = True
            return None
        return Trigger.JOINTS_JUMPED
