"""Which page of the cockpit may do what, and what it holds. Times are seconds of a monotonic clock.

A page watches until it has sent the code (or its key, where its connection was lost); then it may stop the arms, and
take control if no other page has it. What it holds, it says in each heartbeat:

event                                    control            enabling                      clutch
---------------------------------------  -----------------  ----------------------------  --------------------------
a heartbeat with focus holds it          stays              pressed, if it was seen       pressed
                                                            released since the last loss
a heartbeat with focus does not hold it  stays              released                      released, if it was seen
                                                                                          pressed since the last loss
a heartbeat without focus                stays              released: a loss              as it is: a loss
none for HEARTBEAT_S, or an old one      stays              released: a loss              as it is: a loss
the page gives control, or is gone       free               released: a loss              as it is: a loss

So each loss goes to the side on which the tool stays: who lets go by accident moves nothing, and a clutch that was held
then stays pressed until somebody presses and releases it.

leap_kuka hears of both only while a page with control is live, or a clutch is pressed (DeviceReports): silence releases
enabling and presses the clutch there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from leap_kuka.numbers import DEVICE_PERIOD_S
from leap_motion.service.access import HeadsetAccess

HEARTBEAT_S = 0.5
FRESH_S = 0.5  # from what a page heard last of the server to what it says with it, on the way here
ENABLE, CLUTCH = "enable", "clutch"


@dataclass
class CockpitPage:
    """A page that is open. `key` is empty until it has sent the code."""

    name: str
    key: str = ""


@dataclass
class HeldSwitches:
    """What is held of one arm, and what was seen since the last loss."""

    enable: bool = False
    clutch: bool = False
    may_enable: bool = False
    may_release: bool = False

    def lose(self) -> None:
        self.enable = self.may_enable = self.may_release = False

    def take(self, held: frozenset[str]) -> None:
        pressed = CLUTCH in held
        self.may_enable |= ENABLE not in held
        self.enable = ENABLE in held and self.may_enable
        self.may_release |= pressed
        self.clutch = pressed or (self.clutch and not self.may_release)

    @property
    def stuck(self) -> bool:
        """Whether the clutch is pressed although no page holds it, since its page was lost."""
        return self.clutch and not self.may_release


class DeviceReports:
    """When the state of one arm's switches is sent, as a device of the operator."""

    def __init__(self) -> None:
        self._sent, self._at = (False, False), -math.inf

    def due(self, enable: bool, clutch: bool, live: bool, now: float) -> bool:
        """Returns whether to send now: each change at once, else regularly while the page lives or the clutch is
        pressed."""
        if (enable, clutch) == self._sent and not ((live or clutch) and now - self._at >= DEVICE_PERIOD_S):
            return False
        self._sent, self._at = (enable, clutch), now
        return True


@dataclass
class ControllingPage:
    """The page that has control, since when, and its last heartbeat."""

    page: CockpitPage
    since: float
    heard: float = -math.inf
    focused: bool = False


@dataclass
class CockpitControl:
    """The states of the table above, for the arms by their namespaces."""

    arms: tuple[str, ...]
    access: HeadsetAccess = field(default_factory=HeadsetAccess)
    controller: ControllingPage | None = None
    fresh_s: float = FRESH_S
    switches: dict[str, HeldSwitches] = field(init=False)

    def __post_init__(self) -> None:
        self.switches = {arm: HeldSwitches() for arm in self.arms}

    def admit(self, page: CockpitPage, secret: object, address: str, now: float) -> str:
        """Lets a page in by the code or its key; returns why not, a sentence, or nothing."""
        wait = self.access.wait(address, now)
        key = self.access.admit(secret, address, now)
        if key is not None:
            page.key = key
            return ""
        if wait > 0.0:
            return f"A wrong code came from this address: try again in {math.ceil(wait)} s."
        return "That is not the code that stands on the rig's terminal."

    def take(self, page: CockpitPage, now: float) -> str:
        """Gives a page control; returns why not, a sentence, or nothing."""
        if not page.key:
            return "Only a page that has sent the code can take control."
        other = self.controller
        if other is not None and other.page is not page and other.page.key != page.key:
            return f"{other.page.name} has had control for {now - other.since:.0f} s. Ask there to give it back."
        if other is None or other.page is not page:
            self.give(other.page if other else page)
            self.controller = ControllingPage(page, now)
        return ""

    def give(self, page: CockpitPage) -> None:
        """Takes control from a page that has it, also because it is gone."""
        if self.controller is not None and self.controller.page is page:
            self.controller = None
            self._lose()

    def beat(
        self, page: CockpitPage, focused: bool, held: Mapping[str, Iterable[str]], now: float, age: float = 0.0
    ) -> None:
        """Takes a heartbeat: whether the page has focus, and what it holds of each arm. `age`: how long ago the
        page had heard the server when it sent it [s]; what waited in a slow connection is a loss."""
        controller = self.controller
        if controller is None or controller.page is not page:
            return
        self.watch(now)
        controller.heard, controller.focused = now, focused and 0.0 <= age <= self.fresh_s
        if not controller.focused:
            self._lose()
            return
        for arm, switches in self.switches.items():
            switches.take(frozenset(held.get(arm, ())))

    def watch(self, now: float) -> None:
        """Lets go what is held if the heartbeat stays away."""
        if self.controller is not None and now - self.controller.heard > HEARTBEAT_S:
            self._lose()

    def live(self, now: float) -> bool:
        """Whether the page with control has focus and is heard."""
        controller = self.controller
        return controller is not None and controller.focused and now - controller.heard <= HEARTBEAT_S

    def refusal(self, page: CockpitPage, now: float, age: float = 0.0) -> str:
        """Returns why a page may not command now, a sentence; empty if it may. `age`: as of a heartbeat."""
        if not page.key:
            return "Only a page that has sent the code can do that."
        controller = self.controller
        if controller is None or controller.page is not page:
            return "Take control first."
        if not (self.live(now) and 0.0 <= age <= self.fresh_s):
            return "The page has no focus, or its connection is slow: nothing was sent."
        return ""

    def _lose(self) -> None:
        for switches in self.switches.values():
            switches.lose()
