"""Hold-to-enable and clutch of the operator: by a device on leap_kuka/operator_input, or by the second hand.

Each switch has a safe side, on which the tool stays: enabling released, clutch pressed. It acts at once, the other side
after DEBOUNCE_S. What is lost goes to the safe side until the operator has used it again:

enabling device: silence is a release; afterwards and at the start only a press after a release counts.
clutch device: silence is a press, and ends the engagement.
a refused message acts to the safe side only.
second hand that enables: out of view or unsure it has released; after more than GAP_S it must open and close.
second hand that clutches: out of view it stays as it was.

An arm that is not chosen (arm_choice.py) stays likewise. Times are seconds of a monotonic clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from common.reasons import Reason, ReasonCode
from leap_kuka.config import DEVICE, NONE, LeapConfig
from leap_kuka.engagement import EngagementTrigger
from leap_kuka.numbers import CLOSED, DEBOUNCE_S, DEVICE_SILENCE_S, GAP_S, LEFT_S, OPENED
from leap_kuka.start_gate import CHOSEN, ENABLED, RELEASED
from leap_motion.frames import TrackedHand


class DeviceSwitch:
    """The newest message of one program that reports the operator's device."""

    def __init__(self) -> None:
        self._at = -math.inf
        self._enabled = self.released = False  # whether it enables now, and has not since it was silent
        self.clutched = self._was_clutched = False  # now, and in any message since `clutch` was asked
        self.source = ""

    def take(self, enabled: bool, clutched: bool, source: str, age: float, now: float) -> str | None:
        """Takes a message that is `age` [s] old; returns why it is refused, or None."""
        self._was_clutched |= clutched
        if not abs(age) <= DEVICE_SILENCE_S:
            self._enabled &= enabled
            self.clutched |= clutched
            whose = source or "the operator input"
            return f"the stamp of {whose} is {age:.2f} s old, and must be within {DEVICE_SILENCE_S:g} s"
        self.released = not enabled or (self.released and not self.silent(now))
        self._at, self._enabled, self.clutched, self.source = now - max(age, 0.0), enabled, clutched, source
        return None

    def clutch(self, now: float) -> bool:
        """Returns whether the clutch is pressed, was since the last call, or the device is silent."""
        pressed, self._was_clutched = self.clutched or self._was_clutched or self.silent(now), False
        return pressed

    def silent(self, now: float, time: float = DEVICE_SILENCE_S) -> bool:
        """Returns whether the device has been silent for longer than a time [s]."""
        return now - self._at > time

    def enabled(self, now: float) -> bool:
        """Returns whether the device enables: pressed after it was seen released, and not silent since."""
        return self._enabled and self.released and not self.silent(now)


class DeviceSwitches:
    """The messages of all programs that report a device: all of them must enable, and any of them clutches. A
    program that falls silent keeps the tool until LEFT_S; afterwards it has left, and what the others enable counts
    after a release."""

    def __init__(self) -> None:
        self._devices: dict[str, DeviceSwitch] = {}  # by the program's name

    @property
    def source(self) -> str:
        """What the programs call their devices."""
        return " and ".join(dict.fromkeys(device.source for device in self._devices.values() if device.source))

    def take(self, enabled: bool, clutched: bool, source: str, age: float, now: float, program: str = "") -> str | None:
        """Takes a message of a program that is `age` [s] old; returns why it is refused, or None."""
        device = self._devices.setdefault(program, DeviceSwitch())
        refused = device.take(enabled, clutched, source, age, now)
        for name in [name for name, other in self._devices.items() if name != program and other.silent(now, LEFT_S)]:
            del self._devices[name]
            for other in self._devices.values():
                other.released = False
        return refused

    def clutch(self, now: float) -> bool:
        """Returns whether any program clutches, did since the last call, or is silent."""
        return self.silent(now) | any([device.clutch(now) for device in self._devices.values()])

    def silent(self, now: float) -> bool:
        """Returns whether a program is silent, or no program reports."""
        return not self._devices or any(device.silent(now) for device in self._devices.values())

    def enabled(self, now: float) -> bool:
        return bool(self._devices) and all(device.enabled(now) for device in self._devices.values())


class SecondHandSwitch:
    """A switch that the fist or pinch of the second hand presses; `gesture` is "second_hand_fist" or "..._pinch".
    `pressed_is_safe` for a clutch, not for enabling. A hand without `min_confidence` never acts towards motion."""

    def __init__(self, gesture: str, pressed_is_safe: bool, min_confidence: float) -> None:
        self._strength = "grab" if gesture.endswith("fist") else "pinch"
        self._clutch = pressed_is_safe
        self._min_confidence = min_confidence
        self._since: float | None = None  # when the hand began to ask for motion
        self._seen = -math.inf
        self._opened = False
        self.pressed = False

    def update(self, hands: Sequence[TrackedHand], now: float, latched: bool) -> None:
        """Updates `pressed` from the second hands in view; `latched`: what is out of view stays pressed."""
        values = [value for hand in hands if math.isfinite(value := getattr(hand, self._strength))]
        sure = len(values) == len(hands) > 0 and all(hand.confidence > self._min_confidence for hand in hands)
        closed, opened = any(value >= CLOSED for value in values), any(value <= OPENED for value in values)
        if self._clutch:
            asks = sure and all(value <= OPENED for value in values)
            if closed or (not hands and not latched):
                self.pressed = closed
        else:
            if now - self._seen > GAP_S:
                self._opened = False
            self._opened |= opened
            asks = sure and closed and not opened and self._opened
            if not values or opened or not sure:
                self.pressed = False
        if values:
            self._seen = now
        self._since = None if not asks else now if self._since is None else self._since
        if self._since is not None and now - self._since >= DEBOUNCE_S:
            self.pressed = not self._clutch


class OperatorSwitches:
    """Both switches as the parameters leap/enabling and leap/clutch choose them. `device` takes the messages; after
    `update`, `enabled` and `clutched` hold, `lost` says whether the clutch's device is silent, so that the engagement
    must end, and `source` names what enables or clutches. `elsewhere` says why another arm is steered, or is None."""

    def __init__(self, leap: LeapConfig) -> None:
        self._enabling = leap.enabling
        self._clutch = leap.clutch
        self.device = DeviceSwitches()
        self._hands = {
            name: SecondHandSwitch(kind, name == "clutch", leap.min_confidence)
            for name, kind in (("enabling", leap.enabling), ("clutch", leap.clutch))
            if kind not in (NONE, DEVICE)
        }
        self.enabled = leap.enabling == NONE
        self.clutched = False
        self.lost = False
        self.elsewhere = None if leap.arm_choice == NONE else "no arm is chosen yet"
        self.source = ""

    @property
    def enabling_needed(self) -> bool:
        """Whether something must be pressed for a hand to steer."""
        return self._enabling != NONE

    def update(self, others: Sequence[TrackedHand], stamp: float, now: float, latched: bool) -> None:
        """Updates the switches at a frame that shows the second hands `others`, `stamp` [s], arrived `now` [s]."""
        for switch in self._hands.values():
            switch.update(others, stamp, latched)
        device = self.device
        if self._enabling == DEVICE:
            self.enabled = device.enabled(now)
        elif self.enabling_needed:
            self.enabled = self._hands["enabling"].pressed
        self.lost = self._clutch == DEVICE and device.silent(now)
        if self._clutch == DEVICE:
            self.clutched = device.clutch(now)
        elif self._clutch != NONE:
            self.clutched = self._hands["clutch"].pressed
        kinds = [self._enabling if self.enabling_needed and self.enabled else NONE]
        kinds.append(self._clutch if self.clutched else NONE)
        names = [device.source if kind == DEVICE else "second hand" for kind in kinds if kind != NONE]
        self.source = " and ".join(dict.fromkeys(names))

    @property
    def stops(self) -> dict[str, Reason]:
        """Why the hand must not steer now, by condition of a start; the first one is the one to say."""
        stops = {}
        if self.lost:
            stops[RELEASED] = EngagementTrigger.CLUTCH_LOST.reason()
        if self.elsewhere:
            stops[CHOSEN] = Reason(self.elsewhere, (ReasonCode.ELSEWHERE,))
        if self.clutched:
            stops.setdefault(RELEASED, Reason("the clutch is pressed", (ReasonCode.CLUTCHED,)))
        if not self.enabled:
            stops[ENABLED] = Reason("the enabling device is not pressed", (ReasonCode.NOT_ENABLED,))
        return stops

    @property
    def stop(self) -> Reason | None:
        """The first of `stops`, or None."""
        return next(iter(self.stops.values()), None)
