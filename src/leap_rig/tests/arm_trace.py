"""The truth about the simulated arm, sampled at about 100 Hz from its control port."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from common.errors import DeviceError
from common.poses import translation
from rig_simulation.control_port import ControlClient

PERIOD_S = 0.01
T_FLANGE_TOOL = translation(0.0, 0.0, 0.106)


@dataclass(frozen=True)
class Sample:
    """One answer of the control port: time [s], joints [rad] and their speeds [rad/s], tool pose and its speed [m/s]."""

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
    """Samples of the arm since the last `forget`, and requests to its control port."""

    def __init__(self, host: str, port: int) -> None:
        self._client = ControlClient(host, port)
        self.samples: list[Sample] = []
        self.now: Sample | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, do: str, **fields):
        """Asks the control port."""
        return self._client.ask(do, **fields)

    def forget(self) -> None:
        """Begins the trace anew."""
        self.samples = [self.now]

    def since(self, time: float) -> list[Sample]:
        """Returns the samples from a time of the arm's clock on."""
        return [sample for sample in list(self.samples) if sample.time >= time]

    def way(self, since: float) -> float:
        """Returns how far a joint was from where it stood at that time, at most [rad]."""
        q = np.array([sample.q for sample in self.since(since)])
        return float(np.max(np.abs(q - q[0])))

    def close(self) -> None:
        """Ends the sampling."""
        self._stop.set()
        self._thread.join(5.0)
        self._client.close()

    def _run(self) -> None:
        while not self._stop.wait(PERIOD_S):
            try:
                self.now = _sample(self._client.ask("state"))
            except DeviceError:
                continue
            self.samples.append(self.now)


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
