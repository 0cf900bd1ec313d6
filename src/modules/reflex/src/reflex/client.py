"""The hand for a program: sockets, state machine and calibration files behind one object, with a receive thread.

with ReflexHand(interface="eth0") as hand:
    hand.close()
    print(hand.state.joint_angles)"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from reflex.calibration_files import CalibrationFiles
from reflex.errors import CalibrationFileError, CommandRefused, HandSilent, WireFault
from reflex.hand import HandLogic, HandStatus, HandUpdate
from reflex.motion import HandNote
from reflex.reading import HandReading
from reflex.runtime import HandRuntime
from reflex.settings import HandSettings
from reflex.status import status
from reflex.transport import LOOPBACK, HandTransport

PORT = 11333
RECEIVE_TIMEOUT_S = 0.005
REOPEN_S = 2.0
REMIND_S = 5.0
CLOSED_RAD = 2.5
STILL_RAD = 0.01  # motors that turn less than this between two packets stand still [rad]


class ReflexHand:
    """One hand; also a context manager, which connects at its beginning and lets the fingers go at its end.

    Angles are turns of the tendon spools [rad], 0 open, of f1 (index), f2 (middle), f3 (thumb) and preshape (spread).

    Any thread may call any method. A command that the hand cannot follow raises CommandRefused, with the reason; what
    waits raises HandSilent if the hand falls silent. The constructor raises WireFault if the interface does not exist
    or has no IPv4 address, or the port is taken, CalibrationFileError if a calibration file cannot be read or holds
    something else."""

    def __init__(
        self,
        interface: str,  # network interface of the hand, such as eth0; lo for the simulated hand
        port: int = PORT,  # UDP port of hand and host
        settings: HandSettings | None = None,
        files: CalibrationFiles | None = None,  # calibration; None: in ~/.ros/reflex/<interface>, as for ROS
        # `on_reading` runs in the receive thread, `on_note` in any calling one; neither may call a method that waits.
        on_reading: Callable[[HandReading], None] = lambda reading: None,
        on_note: Callable[[HandNote], None] = lambda note: None,
        hold_at_exit: bool = False,  # keep torque and goals at the end, instead of letting the fingers go
        runtime: Any = HandRuntime,  # time and threads, with the names of HandRuntime
    ) -> None:
        self._runtime = runtime
        self._monotonic = runtime.monotonic
        self._interface = interface
        self._port = port
        self._settings = HandSettings() if settings is None else settings
        self._transport = HandTransport(interface, port)
        self._files = (
            CalibrationFiles(f"~/.ros/reflex/{interface}", simulated=interface == LOOPBACK) if files is None else files
        )
        self._on_reading = on_reading
        self._on_note = on_note
        self._hold_at_exit = hold_at_exit
        try:
            self._logic = HandLogic(self._settings, *self._files.load())
        except BaseException:
            self._transport.close()
            raise
        self._lock = runtime.RLock()
        self._news = runtime.Condition()
        self._packets = 0
        self._stopped = runtime.Event()
        self._wire_fault = ""
        self._made_at = self._monotonic()
        self._reopen_at, self._reminded_at = self._made_at + REOPEN_S, -REMIND_S
        self._thread = runtime.Thread(target=self._run, name="reflex hand", daemon=True)

    def __enter__(self) -> ReflexHand:
        self.connect()
        try:
            self.wait_for_packet()
        except BaseException:
            self.disconnect()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self.disconnect()

    def connect(self) -> None:
        """Switches torque on and starts to listen; raises CommandRefused once the connection is closed."""
        self._request(lambda now: self._logic.start())
        self._thread.start()

    def disconnect(self) -> None:
        """Ends the thread and the connection; the fingers let go or hold. Any thread may call it, also twice."""
        self._let_go()
        if self._thread.is_alive() and self._runtime.current_thread() is not self._thread:
            self._thread.join()
        self._transport.close()

    @property
    def state(self) -> HandReading:
        """The newest reading; raises HandSilent if no packet came for the silence time."""
        with self._lock:
            now, reading = self._monotonic(), self._logic.reading
            if reading is None or not self._logic.link.alive(now):
                seconds = min(self._logic.link.age(now), now - self._made_at)
                raise HandSilent(self._interface, seconds, self._logic.link.foreign(now))
            return reading

    @property
    def status(self) -> HandStatus:
        with self._lock:
            return self._logic.state(self._monotonic())

    @property
    def listening(self) -> bool:
        return self._thread.is_alive()

    @property
    def calibrated(self) -> bool:
        with self._lock:
            return self._logic.calibrated

    def diagnosis(self) -> tuple[str, str, dict[str, object]]:
        """Returns level ("ok", "warning", "error"), one sentence and the values behind it."""
        with self._lock:
            level, sentence, values = status(self._logic, self._wire_fault, self._monotonic())
        return level, sentence, {**values, "interface": self._interface}

    def open(self, timeout: float = 5.0) -> None:
        """Opens the fingers and keeps the spread; waits as `move` does."""
        self.close(0.0, timeout)

    def close(self, angle: float = CLOSED_RAD, timeout: float = 5.0) -> None:
        """Closes the fingers to `angle` [rad] and keeps the spread; waits as `move` does, also for a held object."""
        self.move((angle, angle, angle, self.state.joint_angles[3]), timeout)

    def move(self, angles: Sequence[float], timeout: float = 5.0) -> None:
        """Moves the motors to four angles [rad], clamped to their travel; returns when they stand still, wherever
        that is, and after `timeout` seconds at the latest."""
        still_packets = 4
        self._wait_while(lambda: self.status is HandStatus.CHANGING_SPEED, timeout)
        self.command(angles)
        last, still, deadline = self.state.joint_angles, 0, self._monotonic() + timeout
        while still < still_packets and self._monotonic() < deadline:
            self.wait_for_packet()
            present = self.state.joint_angles
            still = still + 1 if max(abs(a - b) for a, b in zip(present, last)) < STILL_RAD else 0
            last = present

    def command(self, angles: Sequence[float]) -> None:
        """Sends the motors to four angles [rad], clamped to their travel, without waiting."""
        self._request(lambda now: self._logic.command(angles, now))

    def command_raw(self, positions: Sequence[int]) -> None:
        """Sends the servos to four positions [ticks] as they are; for tests of the hand."""
        self._request(lambda now: self._logic.command_raw(positions, now))

    def set_speed(self, speeds: Sequence[float]) -> None:
        """Sets the joint speeds [rad/s], switches torque on, and waits until that is done, about 0.1 s."""
        speed_timeout_s = 2.0
        self._request(lambda now: self._logic.set_speed(speeds, now))
        if not self._wait_while(lambda: self.status is HandStatus.CHANGING_SPEED, speed_timeout_s):
            raise CommandRefused(f"The speed was not set within {speed_timeout_s:g} s.")
        if self.status not in (HandStatus.READY, HandStatus.CALIBRATING):
            raise CommandRefused(f"The speed was not set: the hand is {self.status.value}.")

    def disable_torque(self) -> None:
        """Lets all motors go; `set_speed` switches torque on again."""
        self._request(lambda now: self._logic.disable_torque())

    def calibrate_fingers(self, wait: bool = True) -> None:
        """Calibrates the fingers, which must be open and free, and saves the result; with `wait`, a calibration that
        failed raises CommandRefused."""
        self._request(self._logic.calibrate_fingers)
        if not wait:
            return
        limit = self._settings.calibration_max_time + 2.0 * self._settings.request_time
        self._wait_while(lambda: self._logic.calibrating, limit)
        _ = self.state  # raises HandSilent
        if self._logic.calibration_outcome != "succeeded":
            raise CommandRefused(f"The finger calibration {self._logic.calibration_outcome}")

    def calibrate_tactile(self) -> None:
        """Zeroes the taxels over the next packets, while nothing touches them, and saves the result."""
        self._request(self._logic.calibrate_tactile)

    def zero_pose(self) -> None:
        """Makes the pose of the next packet the open one, with the fingers' tendons let out."""
        self._request(self._logic.zero_pose)

    def set_thresholds(self, thresholds: Sequence[Sequence[int]]) -> None:
        """Sets the contact thresholds, three times nine counts."""
        self._request(lambda now: self._logic.set_thresholds(thresholds))

    def wait_for_packet(self, timeout: float = 3.0) -> None:
        """Waits for the next packet, `timeout` seconds at most; raises HandSilent, or CommandRefused once closed."""
        before = self._packets
        if not self._wait_while(lambda: self._packets == before, timeout):
            self._require_open()
            raise HandSilent(self._interface, timeout, self._logic.link.foreign(self._monotonic()))

    def _let_go(self) -> None:
        with self._lock:
            if self._stopped.is_set():
                return
            notes = self._send(self._logic.stop(self._hold_at_exit))
            self._stopped.set()
        self._report(notes)

    def _wait_while(self, condition: Callable[[], bool], timeout: float) -> bool:
        deadline = self._monotonic() + timeout
        while condition():
            if self._monotonic() > deadline or self._stopped.is_set():
                return False
            with self._news:
                self._news.wait(RECEIVE_TIMEOUT_S)
        return True

    def _require_open(self) -> None:
        if self._stopped.is_set():
            raise CommandRefused("The connection to the hand is closed; nothing was sent. Make a new ReflexHand.")

    def _request(self, step: Callable[[float], HandUpdate]) -> None:
        self._require_open()
        refusal = self._act(step).refusal
        if refusal:
            raise CommandRefused(refusal)

    def _run(self) -> None:
        try:
            while not self._stopped.is_set():
                self._receive()
                self._act(self._logic.tick)
                self._watch_silence()
        finally:
            self._let_go()

    def _receive(self) -> None:
        try:
            datagram = self._transport.receive(RECEIVE_TIMEOUT_S)
        except WireFault as error:
            self._report(self._wire_failed(error))
            self._stopped.wait(RECEIVE_TIMEOUT_S)
            return
        if datagram is None:
            return
        data, source = datagram
        update = self._act(lambda now: self._logic.receive(data, source, now))
        if update.reading:
            with self._news:
                self._packets += 1
                self._news.notify_all()
            self._on_reading(update.reading)
        for calibration in (update.zeros, update.offsets):
            if calibration is None:
                continue
            try:
                self._on_note(HandNote("info", f"Calibration saved in {self._files.save(calibration)}."))
            except CalibrationFileError as error:
                self._on_note(HandNote("error", str(error)))

    def _act(self, step: Callable[[float], HandUpdate]) -> HandUpdate:
        """Lets the state machine do a step and sends its packets in order, whichever thread asks."""
        with self._lock:
            update = step(self._monotonic())
            if self._stopped.is_set():
                return update
            notes = self._send(update)
        self._report(notes)
        return update

    def _send(self, update: HandUpdate) -> list[HandNote]:
        """Sends the packets of an update and returns what there is to report, once the lock is released."""
        notes = []
        for packet in update.send:
            try:
                self._transport.send(packet)
                self._wire_fault = ""
            except WireFault as error:
                notes += self._wire_failed(error)
        return [*notes, *update.notes]

    def _wire_failed(self, error: WireFault) -> list[HandNote]:
        if str(error) == self._wire_fault:
            return []
        self._wire_fault = str(error)
        return [HandNote("error", str(error))]

    def _report(self, notes: list[HandNote]) -> None:
        # Never under the lock: a callback may call `disconnect`, which waits for the receive thread.
        for note in notes:
            self._on_note(note)

    def _watch_silence(self) -> None:
        """Opens the sockets again while the hand is silent: a cable or an address may have come after the start."""
        now = self._monotonic()
        if self._logic.link.age(now) < REOPEN_S or now < self._reopen_at or self._stopped.is_set():
            return
        self._reopen_at = now + REOPEN_S
        if now - self._reminded_at >= REMIND_S:
            self._reminded_at = now
            foreign = self._logic.link.foreign(now)
            why = f". {foreign}" if foreign else ": is it on and its cable in?"
            self._on_note(HandNote("warning", f"No packet from the hand on {self._interface}{why}"))
        try:
            fresh = HandTransport(self._interface, self._port)
        except WireFault as error:
            self._report(self._wire_failed(error))
            return
        with self._lock:
            old, self._transport = self._transport, fresh
        old.close()
