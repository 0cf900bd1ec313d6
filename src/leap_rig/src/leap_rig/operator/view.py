"""What the operator is shown, out of the newest messages: always the same rows in the same order. A record that is old
is shown as it was, marked as stale; one that never came as a dash. Numbers that are not finite are shown as missing,
and never as a bar."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Callable, TypeVar

from common.config import flag, number
from common.modes import Mode
from common.operator_rows import ARM, BARS, NOTHING, OLD_ROWS_S, TEXT, TICKS, Row, RowTone, fraction, stale
from common.robot_hand import HAND
from common.teleop_record import LED, WAITING, TeleopRecord
from leap_rig.operator.cues import Cue

DELAY_SILENCE_S = 5.0  # the delay from hand to arm is measured over seconds


@dataclass(frozen=True)
class OperatorViewConfig:
    """Private parameters of the node."""

    sounds: bool = flag(doc="short sounds on engage, release, limit and stop; needs a sound card", absent=False)


@dataclass(frozen=True)
class TouchConfig:
    """The force limit of the fingers, which fills a tactile bar."""

    force_limit_pressure: float = number("counts", above=0.0, absent=60.0)


@dataclass(frozen=True)
class ArmView:
    """Of rig_msgs/KukaStatus: the arm's controller."""

    mode: str
    reason: str
    limited_by: Sequence[str]
    round_trip: float  # [s]
    robot_server: str = ""  # what answers on the robot's controller
    robot_abilities: Sequence[str] = ()  # of that
    soft: bool = False  # whether servo modes begin soft


@dataclass(frozen=True)
class GuardedPair:
    """Of rig_msgs/GuardState: the collision guard."""

    on: bool
    distance: float  # of the nearest pair [m]
    margin: float  # at which the guard stops the arm [m]
    scale: float  # of the speed, 0 to 1
    pair: Sequence[str]


@dataclass(frozen=True)
class GripView:
    """The robot hand: index, middle and thumb."""

    angles: Sequence[float]  # [rad], 0 is open
    pressures: Sequence[Sequence[float]]  # of their taxels [counts]
    touches: Sequence[bool]


@dataclass(frozen=True)
class DelayView:
    """The delay from hand to arm as it was measured last."""

    milliseconds: float


Draw = Callable[[Any], "tuple[Any, ...]"]  # from a record to text and tone, and labels and values of ticks or bars
Record = TypeVar("Record", TeleopRecord, ArmView, GuardedPair, GripView, DelayView)


class OperatorView:
    """The newest record of each kind; `full_pressure` is what fills a tactile bar [counts]."""

    def __init__(self, full_pressure: float) -> None:
        round_trips = 50  # over which the jitter is taken
        self._full_pressure = full_pressure
        self._newest: dict[type, tuple[object, float]] = {}
        self._round_trips: deque[float] = deque(maxlen=round_trips)

    def take(self, record: TeleopRecord | ArmView | GuardedPair | GripView | DelayView, now: float) -> None:
        """Takes a record that arrived at `now` [s]."""
        max_round_trip_s = 1e3  # what is longer is no measurement
        self._newest[type(record)] = record, now
        if isinstance(record, ArmView) and 0.0 < record.round_trip < max_round_trip_s:
            self._round_trips.append(record.round_trip)

    def rows(self, now: float) -> tuple[Row, ...]:
        """Returns what is shown at `now` [s]."""
        arm, hand = ArmView, TeleopRecord
        return (
            self._row("Hand", hand, now, _hand),
            self._row("Leader", hand, now, _leader),
            self._row("Start", hand, now, _start, TICKS),
            self._row(ARM, arm, now, _arm),
            self._row("Limits", arm, now, lambda record: _limits(record, self._fresh(hand, now))),
            self._row("Guard", GuardedPair, now, _guard),
            self._row("Fingers", GripView, now, _fingers, BARS),
            self._row("Grip", GripView, now, self._grip, BARS),
            self._row("Link", arm, now, self._link),
            self._row("Delay", DelayView, now, _delay, silence=DELAY_SILENCE_S),
        )

    def cue(self, now: float) -> Cue:
        """Returns what can be heard at `now` [s]; a controller that falls silent counts as a stop."""
        hand, arm, guard = self._fresh(TeleopRecord, now), self._fresh(ArmView, now), self._fresh(GuardedPair, now)
        limited = bool((hand and hand.limits) or (arm and arm.limited_by) or (guard and guard.on and guard.scale < 1.0))
        stopped = ArmView in self._newest and (arm is None or arm.mode == Mode.STOPPED)
        return Cue(hand is not None and hand.running, limited, stopped)

    def taxels(self, now: float) -> tuple[tuple[float, ...], ...]:
        """Returns the bars of the taxels of index, middle and thumb, 0 to 1; nothing while they are unknown."""
        hand = self._fresh(GripView, now)
        return () if hand is None else self._bars(hand)

    def _bars(self, hand: GripView) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(fraction(count / self._full_pressure) for count in taxels) for taxels in hand.pressures)

    def _fresh(self, kind: type[Record], now: float) -> Record | None:
        record, at = self._newest.get(kind, (None, 0.0))
        return record if now - at <= OLD_ROWS_S else None  # type: ignore[return-value]  # of that kind, by `take`

    def _row(self, name: str, kind: type, now: float, draw: Draw, form: str = TEXT, silence: float = OLD_ROWS_S) -> Row:
        if kind not in self._newest:
            return Row(name, NOTHING, RowTone.STALE, form)
        record, at = self._newest[kind]
        text, tone, *items = draw(record)
        row = Row(name, text, tone, form, *items)
        age = now - at
        return row if age <= silence else stale(row, f"{text} ({min(age, 999.0):.0f} s old)")

    def _grip(self, hand: GripView) -> tuple:
        bars = tuple(max(taxels) for taxels in self._bars(hand))
        *fingers, thumb = hand.touches
        text = "grips" if thumb and any(fingers) else "touches" if any(hand.touches) else "free"
        tone = RowTone.WARNING if 1.0 in bars else RowTone.NORMAL if text == "free" else RowTone.GOOD
        return text, tone, HAND.fingers, bars

    def _link(self, arm: ArmView) -> tuple[str, RowTone]:
        slow_link_s = 0.02  # round trips or a jitter above this are worth a warning
        abilities = f" ({', '.join(arm.robot_abilities)})" if arm.robot_abilities else ""
        server = f"{arm.robot_server}{abilities}{', soft' if arm.soft else ''}"
        if not self._round_trips:
            return server or NOTHING, RowTone.NORMAL
        spread = jitter(self._round_trips)
        text = f"round trip {1e3 * self._round_trips[-1]:.1f} ms, jitter {1e3 * spread:.1f} ms"
        text += f"; {server}" if server else ""
        return text, RowTone.WARNING if max(self._round_trips[-1], spread) > slow_link_s else RowTone.NORMAL


def jitter(round_trips: Sequence[float]) -> float:
    """Returns the mean change from one round trip to the next [s], as RFC 3550 defines it for transit times."""
    times = list(round_trips)
    changes = [abs(later - earlier) for earlier, later in zip(times, times[1:])]
    return sum(changes) / len(changes) if changes else 0.0


def _hand(hand: TeleopRecord) -> tuple[str, RowTone]:
    tone = RowTone.GOOD if hand.follows else RowTone.NORMAL if hand.state == WAITING else RowTone.WARNING
    return f"{hand.state}: {hand.reason}", tone


def _leader(hand: TeleopRecord) -> tuple[str, RowTone]:
    if hand.running:
        return "hand", RowTone.GOOD
    return ("policy", RowTone.WARNING) if hand.hold == LED else ("nobody", RowTone.NORMAL)


def _start(hand: TeleopRecord) -> tuple:
    if hand.running:
        return "done", RowTone.NORMAL, (), ()
    ticks = tuple(float(met) for met in hand.fulfilled[: len(hand.conditions)])
    ticks += (0.0,) * (len(hand.conditions) - len(ticks))
    met = round(sum(ticks))
    tone = RowTone.GOOD if met == len(ticks) else RowTone.NORMAL
    return f"{met} of {len(ticks)} conditions", tone, tuple(hand.conditions), ticks


def _arm(arm: ArmView) -> tuple[str, RowTone]:
    tones = {Mode.STOPPED.value: RowTone.FAULT, Mode.SERVO.value: RowTone.GOOD}
    return f"{arm.mode}: {arm.reason}", tones.get(arm.mode, RowTone.NORMAL)


def _limits(arm: ArmView, hand: TeleopRecord | None) -> tuple[str, RowTone]:
    limits = [*arm.limited_by, *(f"hand's {angle}" for angle in (hand.limits if hand else ()))]
    unknown = [] if hand else ["hand unknown"]
    return ", ".join(limits + unknown) or "none", RowTone.WARNING if limits else RowTone.NORMAL


def _guard(guard: GuardedPair) -> tuple[str, RowTone]:
    far_m = 100.0  # pairs farther apart are not shown
    if not guard.on:
        return "off", RowTone.NORMAL
    if not abs(guard.distance) < far_m:
        return "nothing near", RowTone.NORMAL
    text = f"{1e3 * guard.distance:.0f} mm from {' to '.join(guard.pair)}"
    if guard.distance <= guard.margin or not guard.scale > 0.0:
        return f"{text}, stopped", RowTone.FAULT
    if guard.scale < 1.0:
        return f"{text}, {100 * guard.scale:.0f} % of the speed", RowTone.WARNING
    return text, RowTone.NORMAL


def _fingers(hand: GripView) -> tuple:
    closed_rad = 2.0  # about the angle of a finger on the palm
    closed = tuple(fraction(angle / closed_rad) for angle in hand.angles)
    return f"{100 * sum(closed) / len(closed):.0f} %", RowTone.NORMAL, HAND.fingers, closed


def _delay(delay: DelayView) -> tuple[str, RowTone]:
    known = math.isfinite(delay.milliseconds)
    return f"hand to arm {delay.milliseconds:.0f} ms" if known else NOTHING, RowTone.NORMAL
