"""The state of the hand as one level, one sentence and the values behind it."""

from __future__ import annotations

from dataclasses import asdict

from reflex.conversions import MOTORS
from reflex.hand import HandLogic, HandStatus

ERROR_BITS = ("voltage", "angle limit", "overheating", "range", "checksum", "overload", "instruction")


def status(hand: HandLogic, wire_fault: str, now: float) -> tuple[str, str, dict[str, object]]:
    """Returns level ("ok", "warning", "error"), one sentence, and the values at `now` [s]; `wire_fault` is a fault
    of the sockets, or empty."""
    state = hand.state(now)
    reading, guard, errors = hand.reading, hand.motion.guard, []
    values: dict[str, object] = {
        **asdict(hand.link.counts),
        "commands": hand.commands,
        "refused": hand.refused,
        "state": state.value,
        "calibration": hand.calibration_outcome,
        **{name: ", ".join(getattr(guard, name)) for name in ("overloaded", "hot", "bounded")},
    }
    if reading:
        packet = reading.packet
        values.update(
            age=f"{hand.link.age(now):.3f}",
            loads=", ".join(f"{load:.0f}" for load in reading.loads),
            temperatures=", ".join(map(str, packet.temperatures)),
            voltages=", ".join(f"{v / 10:.1f}" for v in packet.voltages),
            dead_cells=", ".join(reading.dead_taxels),
        )
        for name, bits in zip(MOTORS, packet.errors):
            named = [error for i, error in enumerate(ERROR_BITS) if bits >> i & 1]
            if bits:
                errors.append(f"Servo {name} reports {', '.join(named) or 'an unknown error'}.")
    if state in (HandStatus.WAITING, HandStatus.SILENT):
        return "error", f"{hand.silence(now)} {wire_fault}".strip(), values
    if wire_fault or errors:
        return "error", " ".join([wire_fault, *errors]).strip(), values
    for what, motors in (("overloaded", guard.overloaded), ("hot", guard.hot)):
        if motors:
            return "warning", f"Motor {', '.join(motors)} is {what}.", values
    if hand.calibration_outcome.startswith("failed"):
        return "warning", f"The last finger calibration {hand.calibration_outcome}", values
    if state is HandStatus.TORQUE_OFF:
        return "warning", "Torque is off.", values
    if reading and reading.dead_taxels:
        return "warning", "Some tactile sensors do not answer.", values
    return "ok", f"The hand is {state.value}.", values
