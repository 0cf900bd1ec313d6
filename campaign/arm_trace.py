"""The truth about the simulated arm, from its control port: its state at about 50 Hz, and every step of 1 ms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common import clock
from common.errors import DeviceError
from common.poses import translation
from rig_simulation.control_port import ControlClient

PERIOD_S = 0.02
PAUSE_S = 0.1
T_FLANGE_TOOL = translation(0.0, 0.0, 0.106)


@dataclass(frozen=True)
class Sample:
    """One answer of the control port: time [s], joints [rad], their speeds [rad/s], tool pose and its speed [m/s]."""

    time: float
    q: np.ndarray
    v: np.ndarray
    T_base_tool: np.ndarray
    tool_speed: float
    mode: str
    safety_stop: str | None
    stops: int
    goals: int
    connected: bool

    @property
    def speed(self) -> float:
        """Speed of the fastest joint [rad/s]."""
        return float(np.max(np.abs(self.v)))


class ArmTrace:
    """What the arm did since the last `forget`, and requests to its control port, answered within `patience` [s].

    Attributes:
        samples: its states; `now` is the last.
        steps: rows of its steps of 1 ms, without those in which it stood still anyway: time [s], joints [rad], their
            speeds [rad/s], speed of the tool point [m/s], shape (16,).
        events: what its controller received besides goals and questions, and said of itself, as (time, text).
        pauses: when this process did not run or the arm did not answer for more than 0.1 s, as (end, duration) [s].
        heard: when the arm last answered [s]."""

    def __init__(self, host: str, port: int, patience: float = 2.0) -> None:
        self._client = ControlClient(host, port, patience)
        self.samples: list[Sample] = []
        self.steps: list[list[float]] = []
        self.events: list[tuple[float, str]] = []
        self.pauses: list[tuple[float, float]] = []
        self.now: Sample | None = None
        self.heard = clock.monotonic()
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, do: str, **fields):
        """Asks the control port."""
        return self._client.ask(do, **fields)

    def forget(self) -> None:
        """Begins the trace anew."""
        self.samples, self.steps, self.events, self.pauses = [self.now], [], [], []

    def since(self, time: float) -> list[Sample]:
        """Returns the samples from a time of the arm's clock on."""
        return [sample for sample in list(self.samples) if sample.time >= time]

    def way(self, since: float = 0.0) -> float:
        """Returns how far a joint was, at most, from where it stood at that time, or when the trace began [rad]."""
        q = np.array([sample.q for sample in self.since(since)])
        return float(np.max(np.abs(q - q[0])))

    def close(self) -> None:
        """Ends the sampling."""
        self._stop.set()
        self._thread.join(5.0)
        self._client.close()

    def _run(self) -> None:
        seen, reported = 0.0, 0.0
        while not self._stop.wait(PERIOD_S):
            try:
                answer = self._client.ask("trace", since=seen)
            except DeviceError:
                continue
            before, self.heard = self.heard, clock.monotonic()
            if self.heard - before > PAUSE_S:
                self.pauses.append((self.heard, self.heard - before))
            self.now = _sample(answer)
            seen = self.now.time
            self.samples.append(self.now)
            self.steps += answer["steps"]
            self.events += [(when, text) for when, text in answer["events"] if when > reported]
            reported = max([reported, *(when for when, _ in answer["events"])])


def _sample(state: dict) -> Sample:
    return Sample(
        time=state["time"],
        q=np.array(state["joints"]),
        v=np.array(state["velocities"]),
        T_base_tool=np.array(state["flange"]) @ T_FLANGE_TOOL,
        tool_speed=state["tcp_speed"],
        mode=state["mode"],
        safety_stop=state["safety_stop"],
        stops=state["stops"],
        goals=state["goals"],
        connected=state["connected"],
    )
