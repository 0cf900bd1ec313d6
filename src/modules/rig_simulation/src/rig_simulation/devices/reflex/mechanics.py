"""The servos of the hand, and its mechanics: spools wind tendons, tendons turn the links of the fingers. Fingers count
from 0 (f1, f2, f3), motors too (f1, f2, f3, preshape). Angles in rad, 0 = open. Effort and motion of a servo are
positive in the direction of rising positions."""

from __future__ import annotations

import math
from collections.abc import Sequence

TURN_TICKS = 1024
TICK_RAD = 2 * math.pi / TURN_TICKS
SPEED_UNIT_RAD_S = 0.114 * 2 * math.pi / 60
NO_LOAD_SPEED_RAD_S = 55 * 2 * math.pi / 60
MAX_EFFORT = 1000
MAX_TORQUE_NM = 2.5  # at 12 V
OVERLOAD_TIME_S = 2.0
OVERLOAD_BIT = 1 << 5
_RISING_BIT = 1024
_SPEED_MASK = 1023


class DynamixelServo:
    """A Dynamixel MX-28 as the firmware uses it: multi-turn positions of 1024 ticks a turn, speed, load, torque.
    `shaft`: its position [ticks], of any turn; after power-up the servo reports the position within one turn."""

    def __init__(self, shaft: float) -> None:
        self.shaft = shaft
        self.temperature = 34
        self.error = 0
        self.present = True
        self.power_up()

    def power_up(self) -> None:
        """Powers up: the turn is lost, torque is off, no speed is set."""
        power_up_ticks = 13000
        self._reported_minus_shaft = power_up_ticks + self.shaft % TURN_TICKS - self.shaft
        self.goal = self.position
        self.torque = False
        self.error &= ~OVERLOAD_BIT
        self._overload_time = 0.0
        self.speed_setting = 0
        self.velocity = 0.0
        self.effort = 0.0

    @property
    def position(self) -> int:
        """The reported position [ticks]."""
        return round(self.shaft + self._reported_minus_shaft)

    def jump(self, turns: int) -> None:
        """Shifts the reported position by whole turns."""
        self._reported_minus_shaft += turns * TURN_TICKS

    def switch(self, torque: bool) -> None:
        """Switches torque on or off; after an overload it stays off until a power cycle."""
        self.torque = torque and self._overload_time < OVERLOAD_TIME_S

    def step(self, dt: float, low: float, high: float, resistance: float) -> None:
        """Moves for `dt` [s] towards the goal, between the stops `low` and `high` [ticks of the shaft]. Resistance, the
        effort against the load [0.1 %], slows it down, to a standstill at its largest torque; too long near that, it
        switches its torque off."""
        overload_effort = 950
        stall_effort_per_tick = 10
        friction = 25
        before = self.shaft
        if not self.torque:
            self.velocity, self.effort = 0.0, 0.0
            return
        wanted = self.goal - self._reported_minus_shaft
        way = wanted - before
        if way:
            opposing = math.copysign(1.0, way) * resistance
            speed = NO_LOAD_SPEED_RAD_S * max(0.0, min(1.0, 1.0 - opposing / MAX_EFFORT))
            if self.speed_setting & _SPEED_MASK:
                speed = min(speed, (self.speed_setting & _SPEED_MASK) * SPEED_UNIT_RAD_S)
            reach = speed / TICK_RAD * dt
            way = max(-reach, min(reach, way))
        self.shaft = max(low, min(high, before + way))
        self.velocity = (self.shaft - before) * TICK_RAD / dt
        self.effort = resistance + math.copysign(friction, self.velocity) * (self.velocity != 0)
        if self.shaft in (low, high):
            self.effort += stall_effort_per_tick * (wanted - self.shaft)
        self.effort = max(-MAX_EFFORT, min(MAX_EFFORT, self.effort))
        self._overload_time = self._overload_time + dt if abs(self.effort) >= overload_effort else 0.0
        if self._overload_time >= OVERLOAD_TIME_S:
            self.error |= OVERLOAD_BIT
            self.torque = False

    def speed_register(self) -> int:
        units = min(_SPEED_MASK, round(abs(self.velocity) / SPEED_UNIT_RAD_S))
        return units + _RISING_BIT * (self.velocity > 0)

    def load_register(self, effort: float) -> int:
        """The present-load register for an effort [0.1 %] in the direction of rising positions."""
        return min(_SPEED_MASK, round(abs(effort))) + _RISING_BIT * (effort > 0)


KNUCKLE_FRACTION = 1 / 1.4  # of the tendon's turn; the outer link takes the rest, or all once the inner link is blocked
TAXELS = 9
FINGERS = 3


class Mechanics:
    """The moving parts of one hand: here in free space, with kinematics alone and massless links; the physical world
    has one with masses and contacts."""

    def __init__(self) -> None:
        self._ends: list[float | None] = [None] * FINGERS
        self._proximal, self._distal = [0.0] * FINGERS, [0.0] * FINGERS

    def pull(self, spools: Sequence[float]) -> None:
        """Takes the spool angles of the four motors; below 0 a finger's tendon is slack."""
        for finger, end in enumerate(self._ends):
            tendon = max(0.0, spools[finger])
            self._proximal[finger] = min(tendon * KNUCKLE_FRACTION, math.pi if end is None else end)
            self._distal[finger] = tendon - self._proximal[finger]

    def resistance(self, motor: int) -> float:
        """Returns the closing effort [0.1 %] that a motor needs to hold its position."""
        return 0.0

    def proximal(self, finger: int) -> float:
        """Returns the turn of a knuckle."""
        return self._proximal[finger]

    def distal(self, finger: int) -> float:
        """Returns the bend of a finger's outer link."""
        return self._distal[finger]

    def touch(self, finger: int) -> Sequence[float]:
        """Returns the pressure on the nine taxels of a finger [counts]."""
        return (0.0,) * TAXELS

    def block(self, finger: int, proximal: float | None) -> None:
        """Limits the turn of a knuckle; None removes the limit."""
        self._ends[finger] = proximal
