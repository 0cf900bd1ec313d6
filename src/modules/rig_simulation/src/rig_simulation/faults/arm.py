"""Faults of the simulated Sunrise controller on its TCP wire, and their effect on its answers."""

from __future__ import annotations

import math
import random

import numpy as np

from rig_simulation.faults.injection import DelayLine, Fault, Faults, FaultValue, fraction_of, garbled

ARM_FAULTS = (
    Fault("cut", "the connection is reset, and so is every new one; the arm brakes"),
    Fault("half_open", "cable unplugged: nothing is read or answered, the connection stays, the arm moves on"),
    Fault("silent", "commands are followed, but answers are lost", fraction_of("answers")),
    Fault("slow", "every answer comes late", FaultValue("delay [s]", 0.2, 0.001, 60.0)),
    Fault("garbled", "answers are garbage that ends like a line", fraction_of("answers")),
    Fault("torn", "answers come byte by byte", FaultValue("time between two bytes [s]", 0.0005, 0.0001, 1.0)),
    Fault("bursts", "answers are held back, then arrive all at once", FaultValue("their period [s]", 0.03, 0.001, 1.0)),
    Fault("nagle", "short answers wait until the one before is acknowledged: the socket is without TCP_NODELAY"),
    Fault("restarted", "the application stops and its port closes; it starts again when the fault ends"),
    Fault(
        "window",
        "an application that gets no client for this time ends, and its port closes; it starts again as the fault ends",
        FaultValue("time [s]", 60.0, 0.1, 600.0),
    ),
    Fault("refused", "motions are answered `done`, `nak`: the arm stays, the tool is detached"),
    Fault("unfinished", "the end of a PTP motion is not answered"),
    Fault("emergency_stop", "the button is pressed: a safety stop, which lasts until `release` after its end"),
    Fault("frozen", "the joint angles in answers stay the same while the arm moves"),
    Fault(
        "shifted", "the joint angles in answers are wrong", FaultValue("offset of every joint [rad]", 0.1, -1.0, 1.0)
    ),
)


class ArmAnswers:
    """Delays, drops and garbles the answers on their way out. Time is handed in."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._random = random.Random(0)
        self._waiting: DelayLine[bytes] = DelayLine()

    def put(self, text: str, now: float) -> None:
        """Takes the answers, complete lines, that the application gives at the time `now` [s]."""
        faults = self._faults.active()
        due = now + faults.get("slow", 0.0)
        if "bursts" in faults:
            due = math.ceil(due / faults["bursts"]) * faults["bursts"]
        for answer in text.encode("ascii").splitlines(keepends=True):
            if self._random.random() < faults.get("silent", 0.0):
                continue
            if self._random.random() < faults.get("garbled", 0.0):
                answer = garbled(answer[:-1], self._random).replace(b"\n", b"\r") + b"\n"
            if "torn" in faults:
                for i, byte in enumerate(answer):
                    self._waiting.put(bytes([byte]), due + i * faults["torn"])
            else:
                self._waiting.put(answer, due)

    def take(self, now: float) -> list[bytes]:
        """Returns the bytes due by the time `now` [s], in pieces for one send each."""
        if self._faults.is_on("half_open"):
            return []
        pieces = self._waiting.take(now)
        return pieces if self._faults.is_on("torn") else [b"".join(pieces)] if pieces else []

    def next_due(self) -> float:
        """Returns when the next answer is due [s]; infinity without one."""
        return self._waiting.next_due()

    def drop(self) -> None:
        """Drops all waiting answers: their connection is gone."""
        self._waiting.clear()


class Encoders:
    """The joint angles that the answers report, shape (7,) [rad]."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._frozen: np.ndarray | None = None

    def read(self, q: np.ndarray) -> np.ndarray:
        """Returns the reported angles for the true angles `q`; a frozen encoder keeps the first ones."""
        faults = self._faults.active()
        if "frozen" not in faults or self._frozen is None:
            self._frozen = q
        return self._frozen + faults.get("shifted", 0.0)
