"""The simulated controller on the network: one client of the toolbox port, and the control port beside it."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import itertools
import math
import selectors
import socket
import struct
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from common import clock
from common.config import is_number
from common.errors import DeviceError
from common.numbers import SWITCH_INTERVAL_S
from rig_simulation.control_port import ControlPort, listen, within
from rig_simulation.devices.sunrise.application import VERSIONS, Application, ControllerIO
from rig_simulation.devices.sunrise.arm import SimulatedArm
from rig_simulation.devices.sunrise.java_text import JavaLineSplitter, LineSplitter
from rig_simulation.faults.arm import ARM_FAULTS, ArmAnswers, Encoders
from rig_simulation.faults.injection import Faults

SEND_TIMEOUT_S = 1.0
AT_ONCE_S = 0.005  # longest lag that the arm makes up before an answer
GOALS_AND_QUESTIONS = ("jp", "jf", "getJ", "Torques", "Eef_")  # these come many times a second
RESET_ON_CLOSE = struct.pack("ii", 1, 0)


@dataclasses.dataclass(frozen=True)
class ServerSettings:
    """Which inconvenient sides of the real server are simulated."""

    wiped_window: float = 0.0  # after an answer of the main thread, commands for it are lost for this long [s]
    wait_for_client: float = math.inf  # the program exits after this time without a client [s]
    # A client that vanishes without `end` leaves the port bound but deaf and the servo running; otherwise the arm
    # stops and the next client is served
    deaf_after_lost_client: bool = False
    end_exits: bool = False  # `end` exits the program; otherwise the application starts again
    version: str = VERSIONS[-1]  # of the toolbox's server, one of VERSIONS


class SunriseServer:
    """Serves the arm until `stop` is called or the settings end it; port 0 takes any free one, see the attributes.
    Raises DeviceError if a port is taken."""

    def __init__(
        self,
        arm: SimulatedArm,
        settings: ServerSettings,
        host: str,
        port: int,
        control_port: int,
        log: Callable[[str], None] = lambda _: None,  # takes one sentence about each change of state
        now: Callable[[], float] | None = None,  # the arm's time [s]; may run faster, slower or in steps
        at_once: float = AT_ONCE_S,  # longest lag made up in one go [s]; infinite for a clock that waits for the arm
        lock: clock.RLock | None = None,  # of an environment that several arms share
    ) -> None:
        events = 500
        self._arm, self._settings, self._print = arm, settings, log
        self._events: collections.deque[tuple[float, str]] = collections.deque(maxlen=events)
        self._now, self._at_once = now or clock.monotonic, at_once
        self._behind = False
        self._io = ControllerIO()
        self.faults = Faults(ARM_FAULTS)  # may be switched at any time
        self._answers, self._encoders = ArmAnswers(self.faults), Encoders(self.faults)
        self.lock = lock or clock.RLock()  # held while the arm or its environment changes
        self._stop = clock.Event()
        self._client: socket.socket | None = None
        self._lines: LineSplitter = JavaLineSplitter()
        self._deaf = self._missed = False
        self._reported_stops = 0
        self._selector = selectors.DefaultSelector()
        self._listener: socket.socket | None = listen(host, port, "the toolbox port")
        self._listener.setblocking(False)
        self.host, self.port = self._listener.getsockname()[:2]
        self._start_application()
        requests: dict[str, Callable[..., Any]] = {
            "state": self._state,
            "trace": self._trace,
            "release": self._release,
            "back_off": self._back_off,
            "set_external_torque": lambda value: arm.set_external_torque(_numbers(value, 7)),
            "set_enabling": self._set_enabling,
            "set_tcp_force": lambda value: arm.set_tool_force(_numbers(value, 3)),
        }
        handlers = {name: within(self.up_to_date, request) for name, request in requests.items()}
        try:
            self._control = ControlPort({**handlers, **self.faults.requests}, host, control_port)
        except DeviceError:
            self._listener.close()
            raise
        self.control_port = self._control.port

    @contextlib.contextmanager
    def up_to_date(self) -> Iterator[None]:
        """Holds the lock, with the arm and its environment at the clock's time."""
        with self.lock:
            self.advance()
            yield

    def run(self) -> None:
        """Serves until `stop`; then closes everything."""
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        try:
            while not self._stop.is_set():
                self._wait()
                with self.lock:
                    self._follow_faults()
                    self.advance()
                    self._report_stop()
                    self._take_turns()
        finally:
            self.close()

    def close(self) -> None:
        """Closes everything; may be called twice."""
        self._control.close()
        for connection in (self._listener, self._client):
            if connection is not None:
                connection.close()
        self._selector.close()

    def advance(self) -> None:
        """Advances to the clock's time, and sends the answers that are due."""
        with self.lock:
            self._advance()
            self._send()

    def carry(self) -> None:
        """Advances to the clock's time while another arm steps; `run` sends the answers that are due."""
        with self.lock:
            self._advance()

    def stop(self) -> None:
        """Makes `run` return soon; may be called from a signal handler."""
        self._stop.set()

    def _start_application(self) -> None:
        assert self._listener is not None  # an application starts only while the port is open
        self._application = self._new_application()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._waiting_since = clock.monotonic()

    def _new_application(self) -> Application:
        settings, read = self._settings, self._encoders.read
        return Application(self._arm, self._io, settings.wiped_window, read, settings.version, *self._refusals)

    @property
    def _refusals(self) -> Iterator[Callable[[], bool]]:
        """Whether motions are refused, and whether they end tacitly."""
        return (functools.partial(self.faults.is_on, name) for name in ("refused", "unfinished"))

    @property
    def _waits(self) -> bool:
        """Whether it waits for a client."""
        return self._listener is not None and self._listener in self._selector.get_map()

    def _wait(self) -> None:
        moving_tick_s = 0.004
        resting_tick_s = 0.02
        calm = self._arm.asleep and not self._application.busy
        tick = resting_tick_s if calm else moving_tick_s
        if self.faults.is_on("half_open"):
            self._stop.wait(tick)
            return
        with self.lock:
            until_answer = max(0.0, self._answers.next_due() - clock.monotonic())
        for key, _ in self._selector.select(0.0 if self._behind else min(tick, until_answer)):
            if key.fileobj is self._listener:
                self._accept()
            else:
                self._hear(key.fileobj)

    def _accept(self) -> None:
        assert self._listener is not None  # the selector reported it
        try:
            client, address = self._listener.accept()
        except OSError:
            return
        client.settimeout(SEND_TIMEOUT_S)
        self._selector.register(client, selectors.EVENT_READ)
        self._meet(client, f"{address[0]}:{address[1]}")

    def _meet(self, client: socket.socket, name: str) -> None:
        """Takes a new connection."""
        self._serve_client(client, name, JavaLineSplitter())
        assert self._listener is not None  # it accepted the connection
        self._selector.unregister(self._listener)

    def _serve_client(self, client: socket.socket, name: str, lines: LineSplitter) -> None:
        self._client, self._lines = client, lines
        self._delay_small_packets()
        self._log(f"client {name} connected")

    def _hear(self, _: Any) -> None:
        """Reads what a connection has to say."""
        self._receive()

    def _receive(self) -> None:
        assert self._client is not None  # the selector reported it
        try:
            data = self._client.recv(65536)
            lines = self._lines.feed(data)
        except (OSError, ValueError) as error:
            self._lose_client(str(error))
            return
        if not data:
            self._lose_client("it closed the connection without `end`")
        self._take_lines(lines)

    def _take_lines(self, lines: list[str]) -> None:
        for line in lines:
            with self.lock:
                if not line.startswith(GOALS_AND_QUESTIONS):
                    self._note(f"received {line}")
                self._answers.put(self._application.receive(line, self._next_time(0.0)), clock.monotonic())
                self._send()
                if self._application.ended:
                    self._log("the client ended the application")
                    self._reset_waiting_clients()
                    self._close_client()
            if self._client is None:
                return

    def _send(self) -> None:
        for piece in self._answers.take(clock.monotonic()):
            if self._client is None:
                return
            try:
                self._client.sendall(piece)
            except OSError as error:
                self._lose_client(str(error))

    def _report_stop(self) -> None:
        if self._arm.stops != self._reported_stops:
            self._reported_stops = self._arm.stops
            self._log(f"safety stop: {self._arm.safety_stop or 'it is released already'}")

    def _follow_faults(self) -> None:
        for name, value in self.faults.changes().items():
            self._log(f"the fault {name} {'ends' if value is None else 'begins'}")
            if name == "emergency_stop":
                self._arm.press_emergency_stop(value is not None)
            elif name == "nagle":
                self._delay_small_packets()
        cut, restarted = self.faults.is_on("cut"), self.faults.is_on("restarted") or self._window_missed()
        if cut or restarted:
            if self._client is not None and cut:
                self._client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
            self._lose_client("its connection is cut" if cut else "the application stops")
        if restarted and self._listener is not None:
            self._close_port()
        elif not restarted and self._listener is None:
            with contextlib.suppress(DeviceError):  # another program may have taken the port for a moment
                self._listener = listen(self.host, self.port, "the toolbox port")
                self._listener.setblocking(False)
        elif cut and not restarted:
            self._reset_waiting_clients()

    def _close_port(self) -> None:
        self._application.abandon()
        assert self._listener is not None  # it is closed once
        if self._listener in self._selector.get_map():
            self._selector.unregister(self._listener)
        self._listener.close()
        self._listener, self._deaf = None, False

    def _delay_small_packets(self) -> None:
        if self._client is not None:
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, not self.faults.is_on("nagle"))

    def _window_missed(self) -> bool:
        window = self.faults.value("window")
        if window is None:
            self._missed = False
        elif not self._missed and self._waits:
            self._missed = clock.monotonic() - self._waiting_since > window
            if self._missed:
                self._log(f"no client within {window:g} s; the application ends")
        return self._missed

    def _close_client(self) -> None:
        self._answers.drop()
        if self._client is not None:
            self._selector.unregister(self._client)
            self._client.close()
            self._client = None

    def _lose_client(self, reason: str) -> None:
        if self._client is None:
            return
        self._close_client()
        if self._settings.deaf_after_lost_client:
            self._deaf = True
            self._log(f"lost the client: {reason}; the port is deaf from now on")
            return
        with self.lock:
            self._application.abandon()
        self._log(f"lost the client: {reason}; the arm stops")

    def _reset_waiting_clients(self) -> None:
        assert self._listener is not None  # it is closed only while there is no client
        with contextlib.suppress(OSError):
            while True:
                waiting, _ = self._listener.accept()
                waiting.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
                waiting.close()

    def _take_turns(self) -> None:
        if self._client is not None or self._deaf or self._listener is None:
            return
        if self._waits:
            self._give_up_waiting()
        elif self._application.ended and self._settings.end_exits:
            if not self._application.in_motion:
                self._stop.set()
        elif not self._application.in_motion and not self._arm.v.any():
            self._start_application()

    def _give_up_waiting(self) -> None:
        if clock.monotonic() - self._waiting_since > self._settings.wait_for_client:
            self._log(f"no client connected within {self._settings.wait_for_client:g} s")
            self._stop.set()

    def _state(self) -> dict[str, Any]:
        arm = self._arm
        assert arm.time is not None  # it has just advanced
        return {
            "time": arm.time,
            "age": self._now() - arm.time,
            "joints": arm.q.tolist(),
            "velocities": arm.v.tolist(),
            "flange": arm.robot.flange(arm.q).tolist(),
            "tcp_speed": arm.tool_speed,
            "max_tcp_speed": arm.max_tool_speed,
            "mode": self._application.mode,
            "safety_stop": arm.safety_stop,
            "stops": arm.stops,
            "enabling": arm.enabling,
            "goals": self._io.goals,
            "connected": self._client is not None,
            "outputs": dict(self._io.outputs),
        }

    def _trace(self, since: float) -> dict[str, Any]:
        """Returns the state, and the `steps` and `events` after the time `since` [s], as far as they are kept."""
        steps = itertools.takewhile(lambda step: step[0] > since, reversed(self._arm.history))
        kept = [[t, *q.tolist(), *v.tolist(), speed] for t, q, v, speed in steps]
        events = [event for event in self._events if event[0] > since]
        return {**self._state(), "steps": kept[::-1], "events": events}

    def _note(self, sentence: str) -> None:
        self._events.append((self._now(), sentence))

    def _log(self, sentence: str) -> None:
        self._note(sentence)
        self._print(sentence)

    def _release(self) -> None:
        self._arm.release()
        self._log("released")

    def _set_enabling(self, value: bool) -> None:
        if not isinstance(value, bool):
            raise ValueError(f"The value is {value!r}, but must be true or false.")
        self._arm.enabling = value
        self._log(f"the enabling switch is {'pressed' if value else 'released'}")

    def _back_off(self) -> None:
        self._arm.back_off()
        self._log("the arm backs off")

    def _next_time(self, piece: float) -> float:
        """Returns the time to advance to: the clock's, or only `piece` [s] further where the arm lags more."""
        longest_lag_s = 0.2  # a lag beyond this is dropped: the arm moves in slow motion, but the server answers
        now, arm = self._now(), self._arm
        if arm.time is None or arm.asleep or math.isinf(self._at_once):
            self._behind = False
            return now
        arm.time = max(arm.time, now - longest_lag_s)
        self._behind = now - arm.time > self._at_once
        return arm.time + piece if self._behind else now

    def _advance(self) -> None:
        piece_s = 0.002  # of a longer lag it makes up this much before the server looks after its client again
        self._answers.put(self._application.advance(self._next_time(piece_s)), clock.monotonic())


def _numbers(value: Any, count: int) -> np.ndarray:
    """Returns a list of finite numbers from a request as an array; raises ValueError for anything else."""
    if not isinstance(value, list) or not all(map(is_number, value)) or len(value) != count:
        raise ValueError(f"The value is {value!r}, but must be {count} finite numbers.")
    return np.array(value, dtype=float)
