"""The simulated ReFlex TakkTile hand: four servos, three fingers, and the firmware's handling of modes and targets."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any

from rig_simulation.devices.reflex.mechanics import (
    FINGERS,
    KNUCKLE_FRACTION,
    TAXELS,
    TICK_RAD,
    TURN_TICKS,
    DynamixelServo,
    Mechanics,
)
from rig_simulation.devices.reflex.wire import IDLE, POSITION, VELOCITY, ModeCommand, TargetCommand, pack_state

ENCODER_COUNTS = 16384


class Finger:
    """The electronics of one finger, its knuckle encoder and its taxels, with the effects of the control port."""

    def __init__(self, rng: random.Random) -> None:
        lightest_rest = 110
        heaviest_rest = 170
        self._rng = rng
        self._encoder_zero = rng.randrange(ENCODER_COUNTS)
        self._rest = [rng.randint(lightest_rest, heaviest_rest) for _ in range(TAXELS)]
        self.pressed = [0] * TAXELS  # added to each taxel [counts]
        self._stuck_count: int | None = None
        self.obstacle: float | None = None  # proximal angle [rad]
        self.stiffness = 0.0  # of the obstacle, in 0.1 % of load per rad of the spool

    def resistance(self, spool: float) -> float:
        """Returns the effort against the obstacle [0.1 %]."""
        if self.obstacle is None:
            return 0.0
        return self.stiffness * max(0.0, spool - self.obstacle / KNUCKLE_FRACTION)

    def encoder(self, proximal: float) -> int:
        """Returns the encoder count at a turn of the knuckle [rad]: closing lowers it, with wrap-around."""
        if self._stuck_count is not None:
            return self._stuck_count
        count = self._encoder_zero - proximal / (2 * math.pi) * ENCODER_COUNTS + self._rng.randint(-1, 1)
        return round(count) % ENCODER_COUNTS

    def stick(self, on: bool, proximal: float) -> None:
        """Lets the encoder stick at its count for this turn of the knuckle [rad], or work again."""
        self._stuck_count = None
        if on:
            self._stuck_count = self.encoder(proximal)

    def pressures(self, touch: Sequence[float]) -> list[int]:
        """Returns the counts of the nine taxels; `touch`: additional pressure [counts]."""
        least_count = 56
        most_count = 310
        counts = [
            round(rest + pressed + touched) + self._rng.randint(-1, 1)
            for rest, pressed, touched in zip(self._rest, self.pressed, touch)
        ]
        return [max(least_count, min(most_count, c)) for c in counts]


PERIOD_S = 0.025
_NAMES = ("f1", "f2", "f3", "preshape")
_CLOSING = (1, -1, 1, -1)
_RATIOS = (1.42, 1.42, 1.42, 1.5)
_PRESHAPE = 3


class SimulatedHand:
    """State of the hand; angles are spool angles at the joint [rad], 0 = open with the tendon just tight. `seed`: of
    its individual values (slack, zeros, rest counts of taxels) and of its noise; `mechanics`: driven by the motors, by
    default a hand in free space."""

    def __init__(self, seed: int = 0, mechanics: Mechanics | None = None) -> None:
        least_slack_rad = 0.04
        most_slack_rad = 0.14
        preshape_stops_rad = (-0.3, 2.0)
        loosest_spool_rad = -20.0
        max_spool_rad = 4.0
        self._rng = random.Random(seed)
        self._mechanics = mechanics or Mechanics()
        self._fingers = [Finger(self._rng) for _ in range(FINGERS)]
        # Shaft position of each motor where its angle is 0.
        self._open = [float(self._rng.randrange(TURN_TICKS)) for _ in _NAMES]
        self.servos = []
        for i in range(4):
            slack = self._rng.uniform(least_slack_rad, most_slack_rad) if i != _PRESHAPE else 0.0
            self.servos.append(DynamixelServo(self._shaft(i, -slack)))
        stops = [(loosest_spool_rad, max_spool_rad)] * FINGERS + [preshape_stops_rad]
        self._stops = [sorted(self._shaft(i, stop) for stop in pair) for i, pair in enumerate(stops)]  # [ticks]
        self._forced_loads: list[float | None] = [None] * 4
        self._target_mode = POSITION
        self.modes = [IDLE] * 4
        self._clock = 0.0
        self.silent = False
        self.targets_received = self.modes_received = self.power_cycles = 0

    def step(self, dt: float) -> None:
        """Advances by `dt` [s]."""
        self._clock += dt
        for i, servo in enumerate(self.servos):
            resistance = self._mechanics.resistance(i)
            if i != _PRESHAPE and self._fingers[i].obstacle is not None:
                resistance += self._fingers[i].resistance(self.angle(i))
            low, high = self._stops[i]
            servo.step(dt, low, high, _CLOSING[i] * resistance)
        self._mechanics.pull([self.angle(i) for i in range(4)])

    def angle(self, motor: int) -> float:
        """Returns a motor's spool angle [rad]."""
        return _CLOSING[motor] * (self.servos[motor].shaft - self._open[motor]) * TICK_RAD / _RATIOS[motor]

    def handle(self, command: ModeCommand | TargetCommand) -> None:
        """Executes a command; the mode of the last motor decides the meaning of targets."""
        if isinstance(command, ModeCommand):
            self.modes_received += 1
            self._target_mode = command.modes[_PRESHAPE]
            for i, mode in enumerate(command.modes):
                if mode in (IDLE, VELOCITY, POSITION):
                    self.modes[i] = mode
                    self.servos[i].switch(mode == POSITION)
            return
        self.targets_received += 1
        for servo, value in zip(self.servos, command.values):
            if self._target_mode == VELOCITY:
                servo.speed_setting = value
            else:
                servo.goal = value

    def packet(self) -> bytes:
        servos = self.servos
        return pack_state(
            device_time=int(self._clock * 1e6) % 2**32,
            pressures=[finger.pressures(self._mechanics.touch(i)) for i, finger in enumerate(self._fingers)],
            encoders=[finger.encoder(self._mechanics.proximal(i)) for i, finger in enumerate(self._fingers)],
            errors=[servo.error for servo in servos],
            positions=[servo.position % 65536 if servo.present else 0 for servo in servos],
            speeds=[servo.speed_register() for servo in servos],
            loads=[
                servo.load_register(servo.effort if forced is None else closing * forced)
                for servo, forced, closing in zip(servos, self._forced_loads, _CLOSING)
            ],
            voltages=[self._rng.randint(120, 122) for _ in servos],
            temperatures=[servo.temperature for servo in servos],
        )

    def power_cycle(self) -> None:
        """Switches the power off and on: the servos lose their turns, the clock restarts."""
        self._clock = 0.0
        self.modes = [IDLE] * 4
        self._target_mode = POSITION
        self.power_cycles += 1
        for servo in self.servos:
            servo.power_up()

    def set_load(self, motor: int, value: float | None) -> None:
        """Lets a motor report this closing load [0.1 %]; None restores its own."""
        if value is not None and not -1000 <= value <= 1000:
            raise ValueError(f"The load is {value}, but must lie in -1000..1000.")
        self._forced_loads[_motor(motor)] = value

    def press(self, finger: int, value: int, cell: int | None = None) -> None:
        """Presses a taxel (`cell`) of finger 0, 1 or 2, or all its taxels, by `value` counts."""
        if cell is not None and not 0 <= cell < TAXELS:
            raise ValueError(f"The cell is {cell}, but must lie in 0..{TAXELS - 1}.")
        for taxel in range(TAXELS) if cell is None else [cell]:
            self._fingers[_finger(finger)].pressed[taxel] = int(value)

    def block(self, finger: int, proximal: float | None, stiffness: float = 400.0) -> None:
        """Sets an obstacle at a proximal angle [rad], None removes it; `stiffness` in 0.1 % of load per rad."""
        if proximal is not None and not 0 <= proximal <= math.pi:
            raise ValueError(f"The proximal angle is {proximal}, but must lie in 0..pi.")
        blocked = self._fingers[_finger(finger)]
        blocked.obstacle, blocked.stiffness = proximal, stiffness
        self._mechanics.block(finger, proximal)

    def stick_encoder(self, finger: int, on: bool) -> None:
        self._fingers[_finger(finger)].stick(bool(on), self._mechanics.proximal(finger))

    def unplug_servo(self, motor: int, on: bool) -> None:
        """Unplugs a servo, whose position is then 0, or plugs it in."""
        self.servos[_motor(motor)].present = not on

    def jump(self, motor: int, turns: int) -> None:
        """Shifts a servo's position by whole turns."""
        self.servos[_motor(motor)].jump(int(turns))

    def set_servo(self, motor: int, temperature: int | None = None, error: int | None = None) -> None:
        """Sets the reported temperature [degrees Celsius] and error bits of a servo."""
        servo = self.servos[_motor(motor)]
        for name, value in (("temperature", temperature), ("error", error)):
            if value is not None:
                if not 0 <= value <= 255:
                    raise ValueError(f"The {name} is {value}, but must lie in 0..255.")
                setattr(servo, name, int(value))

    def set_silent(self, on: bool) -> None:
        self.silent = bool(on)

    def state(self) -> dict[str, Any]:
        return {
            "angles": [self.angle(i) for i in range(4)],
            "proximal": [self._mechanics.proximal(i) for i in range(FINGERS)],
            "distal": [self._mechanics.distal(i) for i in range(FINGERS)],
            "touch": [list(self._mechanics.touch(i)) for i in range(FINGERS)],
            "positions": [servo.position for servo in self.servos],
            "goals": [servo.goal for servo in self.servos],
            "speed_settings": [servo.speed_setting for servo in self.servos],
            "efforts": [servo.effort for servo in self.servos],
            "torque": [servo.torque for servo in self.servos],
            "mode": list(self.modes),
            "targets_received": self.targets_received,
            "modes_received": self.modes_received,
            "power_cycles": self.power_cycles,
            "silent": self.silent,
            "time": self._clock,
        }

    def _shaft(self, motor: int, angle: float) -> float:
        return self._open[motor] + _CLOSING[motor] * angle * _RATIOS[motor] / TICK_RAD


def _motor(motor: int) -> int:
    if motor not in range(4):
        raise ValueError(f"The motor is {motor}, but must be 0..3 (f1, f2, f3, preshape).")
    return motor


def _finger(finger: int) -> int:
    if finger not in range(FINGERS):
        raise ValueError(f"The finger is {finger}, but must be 0..2 (f1, f2, f3).")
    return finger
