"""Measures how far a person opens and closes the hand, for the finger mapping: open and closed twice in turn. A phase
ends when the hand was still for HOLD_S, with the medians of its angles [deg]; repetitions that differ come again. The
less open and the less closed one, each a margin inwards, become [open, closed]. A finger that moves by less than
MIN_RANGE_DEG gets the width of the default; the spread starts where neither hand spreads the robot hand."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from common.hand_tracking import FrameWatch
from common.simulated import SIMULATED
from leap_hand.config import FINGERS, HandConfig
from leap_hand.flexion import flexion
from leap_hand.numbers import HOLD_S, LEAST_REACH_M, MAX_GAP_S, MAX_SILENCE_S, MOST_REACH_M
from leap_motion.frames import TrackedHand, TrackingFrame

OPEN, CLOSED = "open", "closed"
INSTRUCTIONS = {
    OPEN: "Hold your hand flat and open above the Leap, fingers together.",
    CLOSED: "Close your hand as far as is comfortable, as around a thin handle.",
}
REPETITIONS = 2
MIN_RANGE_DEG = 15.0  # of a finger: a narrower one would show the tracker's noise


@dataclass(frozen=True)
class WizardStep:
    """What the person reads."""

    instruction: str  # one sentence
    hint: str  # one sentence: what hinders; or empty
    progress: float  # 0 to 1
    done: bool


@dataclass(frozen=True)
class HandCalibration:
    """The result: keys and values above those of leap_hand.yaml, and sentences about what is unusual."""

    values: dict[str, list[float]]
    remarks: tuple[str, ...]


class HandWizard:
    """The measurement with its state; `default` has the mapping without calibration."""

    def __init__(self, default: HandConfig) -> None:
        self._default = default
        self._watch = FrameWatch(MAX_SILENCE_S)
        self._window: deque[tuple[float, np.ndarray]] = deque()
        self._levels: dict[str, list[np.ndarray]] = {OPEN: [], CLOSED: []}  # medians, shape (4,) each
        self._is_left: bool | None = None
        self._repetitions = REPETITIONS
        self._hint = "No tracking frames come in: is the Leap running?"

    @property
    def done(self) -> bool:
        """Whether `result` has what it needs."""
        return len(self._levels[CLOSED]) >= self._repetitions and not self._difference()

    @property
    def failed(self) -> str:
        if len(self._levels[CLOSED]) < 2 * REPETITIONS or self.done:
            return ""
        return f"{self._difference()} Start again and hold the hand alike each time."

    @property
    def _phase(self) -> str:
        return OPEN if len(self._levels[OPEN]) == len(self._levels[CLOSED]) else CLOSED

    def step(self, frame: TrackingFrame, now: float) -> WizardStep:
        """Takes a frame that arrived at `now` on a monotonic clock [s]."""
        arrival = self._watch.arrived(frame.id, frame.age, now)
        if arrival.broken:
            self._window.clear()
        if arrival.usable and not self.done and not self.failed:
            self._hint = self._take(frame.hands, arrival.stamp)
        return self.look(now)

    def look(self, now: float) -> WizardStep:
        silence = self._watch.silence(now)
        hint = f"{silence[0].upper()}{silence[1:]}: is the Leap running?" if silence else self._hint
        counted = len(self._levels[OPEN]) + len(self._levels[CLOSED])
        return WizardStep(INSTRUCTIONS[self._phase], hint, min(1.0, counted / (2 * self._repetitions)), self.done)

    def _take(self, hands: Iterable[TrackedHand], stamp: float) -> str:
        hand, reason = self._hand(tuple(hands))
        try:
            angles = (
                None
                if hand is None or hand.fingers is None
                else np.degrees(flexion(hand.palm, hand.normal, hand.fingers))
            )
        except ValueError as error:
            angles, reason = None, f"The tracker reports invalid numbers: {error}."
        if angles is None:
            if not self._window or stamp - self._window[-1][0] > MAX_GAP_S:
                self._window.clear()
                return reason
            return ""  # a short gap
        if self._window and stamp - self._window[-1][0] > MAX_GAP_S:
            self._window.clear()
        self._window.append((stamp, angles))
        while len(self._window) > 1 and stamp - self._window[1][0] >= HOLD_S:
            self._window.popleft()
        if stamp - self._window[0][0] < HOLD_S:
            return self._hint
        seen = np.sort([angles for _, angles in self._window], axis=0)
        tenth = len(seen) // 10  # single outliers do not matter
        max_still_deg = 6.0
        if (seen[-1 - tenth] - seen[tenth]).max() > max_still_deg:
            return "Hold still for a moment."
        assert hand is not None
        return self._level(seen[len(seen) // 2], hand)

    def _hand(self, hands: tuple[TrackedHand, ...]) -> tuple[TrackedHand | None, str]:
        if not hands:
            return None, "The Leap sees no hand: hold it 15 to 40 cm above the device."
        if len(hands) > 1:
            return None, "The Leap sees two hands: take the other one away."
        hand = hands[0]
        if self._is_left is not None and hand.is_left != self._is_left:
            return None, f"This is the other hand: continue with the {_side(self._is_left)} one."
        if hand.fingers is None:
            return None, "The Leap does not see all five fingers: turn the palm down."
        min_confidence = 0.2
        if not hand.confidence >= min_confidence:
            return None, f"The Leap is unsure of the hand (confidence {hand.confidence:.2f}): bare it, palm down."
        return hand, ""

    def _level(self, level: np.ndarray, hand: TrackedHand) -> str:
        """Ends the phase with the angles of a still hand, unless the hand is in the other one."""
        min_closing_deg = 15.0  # by which one finger must close
        if self._phase == OPEN:
            if not level[:3].mean() >= self._least_open:
                return "Open your hand further."
            assert hand.fingers is not None
            reach = float(np.linalg.norm(hand.fingers.middle_tip - hand.palm))
            if not LEAST_REACH_M <= reach <= MOST_REACH_M:
                size = f"{1e3 * reach:.0f} mm from the palm's centre to the tip of the middle finger"
                must = f"{1e3 * LEAST_REACH_M:.0f} to {1e3 * MOST_REACH_M:.0f} mm"
                return f"The Leap sees {size}, not {must}: bare the hand, fingers straight."
            self._is_left = hand.is_left
        elif (self._levels[OPEN][-1] - level)[:3].max() < min_closing_deg:
            return "Close your hand further."
        self._levels[self._phase].append(level)
        self._window.clear()
        if len(self._levels[CLOSED]) >= self._repetitions and self._difference():
            self._repetitions += 1
        return ""

    @property
    def _least_open(self) -> float:
        """Mean flexion above which a hand counts as open."""
        opened, closed = self._levels[OPEN], self._levels[CLOSED]
        min_open_deg = 45.0  # without a closed one
        return min_open_deg if not closed else float((opened[-1] + closed[-1])[:3].mean() / 2.0)

    def _difference(self) -> str:
        max_difference_deg = 15.0
        for phase, levels in self._levels.items():
            newest = np.array(levels[-REPETITIONS:])[:, :3]
            differences = np.ptp(newest, axis=0)
            if differences.max() > max_difference_deg:
                worst = int(differences.argmax())
                return f"The {phase} hands differ by {differences[worst]:.0f} deg at the {FINGERS[worst]}."
        return ""

    def result(self) -> HandCalibration:
        opened = np.min(self._levels[OPEN][-REPETITIONS:], axis=0)
        closed = np.max(self._levels[CLOSED][-REPETITIONS:], axis=0)
        least = np.min(self._levels[CLOSED][-REPETITIONS:], axis=0)
        values: dict[str, list[float]] = {}
        remarks: list[str] = []
        for i, (finger, high, low) in enumerate(zip(FINGERS[:3], opened.tolist(), closed.tolist())):
            moves = high - low
            if moves < MIN_RANGE_DEG:
                width = max(abs(math.degrees(float(np.diff(self._default.human[i])[0]))), MIN_RANGE_DEG)
                high = max(high, MIN_RANGE_DEG)
                low = max(high - width, 0.0)
            margin = 0.05 * (high - low)
            high, low = math.floor(10.0 * (high - margin)) / 10.0, round(low + margin + 0.05, 1)
            values[f"{finger}_human"] = [high, low]
            if moves < MIN_RANGE_DEG:
                part = min(max(high - float(least[i]), 0.0) / (high - low), 1.0)
                will = f"the robot's opens fully, and closes by {math.ceil(100.0 * part)} % at most"
                remarks.append(f"The {finger} moves by only {max(moves, 0.0):.0f} deg: {will}.")
        rest = float(np.max([level[3] for levels in self._levels.values() for level in levels[-REPETITIONS:]]))
        max_spread_deg = 40.0  # of a hand whose fingers are together
        if rest > max_spread_deg:
            remarks.append(f"The fingers were {rest:.0f} deg apart: the spread keeps its default.")
        else:
            rest += 2.0  # a margin, as above
            values["spread_human"] = [round(rest, 1), round(rest + float(np.diff(self._default.spread_human)[0]), 1)]
        return HandCalibration(values, tuple(remarks))


def as_yaml(name: str, calibration: HandCalibration, simulated: bool | None) -> str:
    """Returns the text of a person's file, measured with a simulated tracker or not; None: it is not known."""
    lines = [f"# The hand of {name}: values above those of leap_hand.yaml, written by hand_wizard.py."]
    lines += [f"# {remark}" for remark in calibration.remarks]
    lines += [f"{key}: [{first:g}, {second:g}]    # [deg]" for key, (first, second) in calibration.values.items()]
    lines += [] if simulated is None else [f"{SIMULATED}: {str(simulated).lower()}"]
    return "\n".join(lines) + "\n"


def _side(is_left: bool) -> str:
    return "left" if is_left else "right"
