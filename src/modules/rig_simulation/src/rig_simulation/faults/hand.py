"""Faults of the simulated ReFlex hand: on its UDP wire, in its power supply, servos and sensors."""

from __future__ import annotations

import random
from typing import Callable, Mapping

from rig_simulation.devices.reflex.hand import SimulatedHand
from rig_simulation.faults.injection import DelayLine, Fault, Faults, FaultValue, fraction_of, garbled

FINGER = FaultValue("finger, 1 to 3", 1.0, 1.0, 3.0, whole=True)
MOTOR = FaultValue("motor, 1 to 4: f1, f2, f3, preshape", 1.0, 1.0, 4.0, whole=True)
HAND_FAULTS = (
    Fault("cut", "cable unplugged: no packets, and commands are lost"),
    Fault("silent", "packets are lost, commands are followed", fraction_of("packets")),
    Fault("deaf", "commands are lost, packets arrive: half of the cable is broken", fraction_of("commands")),
    Fault("slow", "packets arrive late", FaultValue("delay [s]", 0.2, 0.001, 60.0)),
    Fault("garbled", "packets are garbage, too short, too long, or of another format", fraction_of("packets")),
    Fault("reordered", "of every two packets the second arrives first"),
    Fault("doubled", "every packet arrives twice"),
    Fault("frozen", "the same packet arrives again and again"),
    Fault("restarted", "the power is off; when the fault ends, the servos have no torque and have lost their turns"),
    Fault("encoder_stuck", "the knuckle encoder of a finger sticks", FINGER),
    Fault("servo_lost", "a servo does not answer the firmware: its position is 0", MOTOR),
    Fault("overloaded", "a motor reports its full load", MOTOR),
    Fault("touch_stuck", "all taxels of a finger report pressure", FINGER),
)
FULL_LOAD = 1000
STUCK_PRESSURE = 100


EFFECTS: Mapping[str, Callable[[SimulatedHand, int, bool], None]] = {
    "restarted": lambda hand, _, on: None if on else hand.power_cycle(),
    "encoder_stuck": lambda hand, finger, on: hand.stick_encoder(finger, on),
    "servo_lost": lambda hand, motor, on: hand.unplug_servo(motor, on),
    "overloaded": lambda hand, motor, on: hand.set_load(motor, FULL_LOAD if on else None),
    "touch_stuck": lambda hand, finger, on: hand.press(finger, STUCK_PRESSURE if on else 0),
}
"""Effect of an internal fault when it begins and ends, with the index of its finger or motor."""


class HandWire:
    """Delays, drops and garbles packets and commands on their way. Time is handed in."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._random = random.Random(0)
        self._waiting: DelayLine[bytes] = DelayLine()
        self._frozen: bytes | None = None
        self._held: bytes | None = None
        self._inside: dict[str, float] = {}

    def follow(self, hand: SimulatedHand) -> None:
        active = self._faults.active()
        for name, effect in EFFECTS.items():
            before, now = self._inside.get(name), active.get(name)
            if before != now and before is not None:
                effect(hand, int(before) - 1, False)
            if before != now and now is not None:
                effect(hand, int(now) - 1, True)
        self._inside = active

    def outgoing(self, packet: bytes, now: float) -> list[bytes]:
        """Takes the packet of the time `now` [s]; returns the packets to send now, in order."""
        faults = self._faults.active()
        self._frozen = (self._frozen or packet) if "frozen" in faults else None
        if not self._lost(faults, "silent"):
            packet = self._frozen or packet
            if self._random.random() < faults.get("garbled", 0.0):
                packet = broken(packet, self._random)
            for one in self._in_order(packet, faults):
                self._waiting.put(one, now + faults.get("slow", 0.0))
        return self._waiting.take(now)

    def incoming(self, commands: list[bytes]) -> list[bytes]:
        faults = self._faults.active()
        return [command for command in commands if not self._lost(faults, "deaf")]

    def _lost(self, faults: dict[str, float], name: str) -> bool:
        return "cut" in faults or "restarted" in faults or self._random.random() < faults.get(name, 0.0)

    def _in_order(self, packet: bytes, faults: dict[str, float]) -> list[bytes]:
        if "reordered" in faults and self._held is None:
            self._held = packet
            return []
        packets = [packet] if self._held is None else [packet, self._held]
        self._held = None
        return [one for one in packets for _ in range(2 if "doubled" in faults else 1)]


def broken(packet: bytes, rng: random.Random) -> bytes:
    """Returns an invalid state packet, broken in one of several ways."""
    other_format = 2
    ways: list[Callable[[], bytes]] = [
        lambda: garbled(packet, rng),
        lambda: packet[: rng.randrange(1, len(packet))],
        lambda: packet + garbled(packet[:9], rng),
        lambda: bytes([other_format]) + packet[1:],
    ]
    return rng.choice(ways)()
