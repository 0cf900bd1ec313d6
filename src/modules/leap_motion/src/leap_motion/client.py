"""WebSocket client of the Leap service: always the newest frame, and always a sentence about the link. A thread
keeps only the newest message, as a queue would be delay; the caller's thread decodes it. The service sends frames at
about 110 Hz, also without hands, so silence is a fault. After a reconnect the policies are sent again."""

from __future__ import annotations

import copy
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException

from leap_motion.codec import (
    POLICY_MESSAGES,
    DeviceEvent,
    LeapProtocolError,
    UnknownVersion,
    is_simulated,
    read_header,
    read_message,
)
from leap_motion.frames import LeapFrame
from leap_motion.plausibility import HandBounds, PlausibleHands
from leap_motion.runtime import LeapRuntime
from leap_motion.service.access import is_loopback
from leap_motion.stranger import stranger
from leap_motion.transport import CLOSE_TIMEOUT_S, OPEN_TIMEOUT_S, ForeignAnswer, LeapSocket, UnknownService

UNUSABLE_S = 0.5  # unusable frames for so long are a state of the link
HEADER_TIMEOUT_S = 2.0
PING_S = 2.0
RETRY_S = 0.5
MAX_REASONS = 20
FINGERPRINT = re.compile("[0-9a-f]{64}")
CLOSED = "it closes the connection without a word, as one that expects TLS does"
PLAIN = "check address and port."
BY_TLS = "here a service with TLS is expected, because `fingerprint` is set."
ADVICE = {
    401: "Its `code` is another one: set it to the one that the service was started with.",
    403: "It serves under its address and its own name alone: set `host` to one of these.",
    429: "It compares no code of this computer for a while, as wrong ones came from here.",
}
"""What to do about an answer."""
UNKNOWN_CAUSE = "is the controller plugged in, is tracking paused, or does another program have the focus?"


class LeapLink(Enum):
    """State of the link to the service."""

    CONNECTING = "connecting"
    NO_SERVICE = "no service"
    REFUSED = "refused"
    STREAMING = "streaming"
    UNUSABLE = "unusable frames"
    SILENT = "silent"
    CLOSED = "closed"


@dataclass
class LeapCounts:
    """Counts since the client was made."""

    received: int = 0  # frames read from the socket
    superseded: int = 0  # frames that a newer one replaced before anybody asked for them
    dropped: Counter[str] = field(default_factory=Counter)  # unusable frames, by reason
    hands_dropped: Counter[str] = field(default_factory=Counter)  # left-out hands and fingers of used frames, by reason
    connections: int = 0  # headers received; all but the first are reconnects


@dataclass(frozen=True)
class LeapStatus:
    """State of the link and one sentence about it."""

    link: LeapLink
    sentence: str
    service: str = ""  # its version, if known
    serial: str = ""  # of the device that sends the frames, if the service gives one
    simulated: bool = False  # the service says that its hands are simulated or recorded


@dataclass(frozen=True)
class StampedFrame:
    """A frame and the clock's value at the receipt of its message."""

    frame: LeapFrame
    stamp: object


class LeapClient:
    """Reads the Leap service until it is closed, through missing services, restarts and broken messages.

    `port` is its plain WebSocket port. The value of `clock` at the receipt of a message is the stamp of the frame; None
    is the time since 1970 [s].
    A service on another machine is known by the `fingerprint` of its certificate, and knows this client by the `code`.
    `trust_network` allows one that has neither, such as the real one. Raises ValueError for what `wire_fault` says.
    `tap` gets each text after the header as it came, with its
    stamp, in the thread that reads: it must not wait. `runtime`: time and threads, with the names of LeapRuntime.
    `bounds`: hands and fingers that no hand can be are left out of the frames."""

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 6437,
        clock: Callable[[], object] | None = None,
        code: str = "",
        fingerprint: str = "",
        trust_network: bool = False,
        tap: Callable[[str, object], None] | None = None,
        runtime: Any = LeapRuntime,
        bounds: HandBounds | None = None,
    ) -> None:
        fault = wire_fault(host, code, fingerprint, trust_network)
        if fault is not None:
            raise ValueError(fault)
        self._runtime = runtime
        self._monotonic = runtime.monotonic
        self._host = host
        self._port = port
        self._address = f"{host}:{port}"
        self._code = code
        self._fingerprint = fingerprint.replace(":", "").lower()
        self._clock = clock or runtime.time
        self._tap = tap
        self._closing = runtime.Event()
        self._changed = runtime.Condition()
        self._newest: tuple[str | bytes, object] | None = None
        self._last: tuple[int, int] | None = None
        self._plausible = PlausibleHands(bounds or HandBounds())
        self._unusable: tuple[float, str] | None = None  # since when no frame was usable [s], and the first reason
        self._counts = LeapCounts()
        self._status = LeapStatus(LeapLink.CONNECTING, f"Connecting to the Leap service on {self._address}.")
        self._thread = runtime.Thread(target=self._run, name="leap client", daemon=True)
        self._thread.start()

    @property
    def status(self) -> LeapStatus:
        with self._changed:
            status, unusable = self._status, self._unusable
        if status.link is not LeapLink.STREAMING or unusable is None or self._monotonic() - unusable[0] <= UNUSABLE_S:
            return status
        sentence = f"No frame of the Leap service on {self._address} was usable for {UNUSABLE_S:g} s: {unusable[1]}"
        return replace(status, link=LeapLink.UNUSABLE, sentence=sentence)

    @property
    def counts(self) -> LeapCounts:
        with self._changed:
            return copy.deepcopy(self._counts)

    def next_frame(self, timeout: float) -> StampedFrame | None:
        """Returns the newest frame that was not returned before, or None if none came within `timeout` [s]. Unusable
        frames are counted by their reason, and the wait continues."""
        deadline = self._monotonic() + timeout
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._newest is not None or self._closing.is_set(), deadline - self._monotonic()
                )
                newest, self._newest = self._newest, None
            if newest is None:
                return None
            text, stamp = newest
            try:
                frame = read_message(text)
                if not isinstance(frame, LeapFrame):
                    raise LeapProtocolError("A device event came as a frame.")
                if (frame.id, frame.timestamp_us) == self._last:
                    raise LeapProtocolError("A frame came twice.")
            except LeapProtocolError as error:
                self._drop(str(error))
                self._judge(str(error))
                continue
            frame = self._plausible.step(frame, self._monotonic())
            for reason in frame.left_out:
                self._drop(reason, hand=True)
            self._judge(frame.left_out[0] if frame.left_out and not frame.hands else None)
            self._last = (frame.id, frame.timestamp_us)
            return StampedFrame(frame, stamp)

    def close(self) -> None:
        """Closes the link and waits for its thread, a few seconds at most; any thread may call it, also twice."""
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        if self._runtime.current_thread() is not self._thread:
            self._thread.join(OPEN_TIMEOUT_S + HEADER_TIMEOUT_S + CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        retry_factor = 1.6
        retry_max_s = 3.0
        retry = RETRY_S
        while not self._closing.is_set():
            connections = self._counts.connections
            try:
                self._converse()
            except _LinkFault as fault:
                self._set_status(fault.link, str(fault))
            except Exception as error:  # a defect of one connection must not be the last one
                reason = f"{type(error).__name__}: {error}"
                self._set_status(LeapLink.REFUSED, f"The link to {self._address} failed ({reason}). Trying again.")
            if self._counts.connections > connections:
                retry = RETRY_S
            self._closing.wait(retry)
            retry = min(retry * retry_factor, retry_max_s)
        self._set_status(LeapLink.CLOSED, f"The link to the Leap service on {self._address} is closed.")

    def _converse(self) -> None:
        try:
            connection = LeapSocket(self._host, self._port, self._code, self._fingerprint)
        except UnknownService as error:
            found = f"The service on {self._address} has the fingerprint {error.found}, not the one that is set."
            cure = "Nothing was sent to it. Set `fingerprint` to this one only if the service itself shows it."
            raise _LinkFault(LeapLink.REFUSED, f"{found} {cure} Trying again.") from error
        except InvalidStatus as error:
            status = error.response.status_code
            answer = f"The program on {self._address} refuses the connection (HTTP {status})."
            raise _LinkFault(LeapLink.REFUSED, f"{answer} {ADVICE[status]} Trying again.") from error
        except ForeignAnswer as error:
            cure = BY_TLS if error.by_tls else PLAIN
            raise _LinkFault(LeapLink.REFUSED, f"{self._stranger(error.first)}; {cure} Trying again.") from error
        except (OSError, EOFError, ValueError, WebSocketException) as error:
            advice = "start it: `sudo leapd` (2.3), or Ultraleap's tracking service and its WebSocket server."
            ended = isinstance(error, (EOFError, ConnectionResetError, BrokenPipeError))
            reason = CLOSED if ended and not self._fingerprint else _reason(error)
            sentence = f"No Leap service answers on {self._address} ({reason}); {advice} Trying again."
            raise _LinkFault(LeapLink.NO_SERVICE, sentence) from error
        with connection:
            try:
                self._greet(connection)
                self._read(connection)
            except ConnectionClosed as error:
                code = error.rcvd.code if error.rcvd else "no close frame"
                sentence = f"The Leap service on {self._address} ended the connection ({code}). Trying again."
                raise _LinkFault(LeapLink.REFUSED, sentence) from error
            except OSError as error:
                sentence = f"The Leap service on {self._address} is lost: {_reason(error)}."
                raise _LinkFault(LeapLink.NO_SERVICE, sentence) from error

    def _greet(self, connection: LeapSocket) -> None:
        try:
            text = connection.recv(HEADER_TIMEOUT_S)
            version = read_header(text)
        except TimeoutError as error:
            silent = f"The program on {self._address} sent no header within {HEADER_TIMEOUT_S:g} s"
            sentence = f"{silent}, so it is not a Leap service; check address and port. Trying again."
            raise _LinkFault(LeapLink.REFUSED, sentence) from error
        except LeapProtocolError as error:
            first = text.encode() if isinstance(text, str) else text
            who = "" if isinstance(error, UnknownVersion) else f"{self._stranger(first)}; {PLAIN} "
            raise _LinkFault(LeapLink.REFUSED, f"{who}{error} Trying again.") from error
        for message in POLICY_MESSAGES:
            connection.send(message)
        with self._changed:
            self._counts.connections += 1
        service = f"Leap service {version or 'of unknown version'} on {self._address}"
        self._set_status(LeapLink.CONNECTING, f"Connected to {service}; no frame yet.", version, is_simulated(text))

    def _stranger(self, first: bytes) -> str:
        what = stranger(self._address, "a Leap service", first)
        return what[0].upper() + what[1:]

    def _read(self, connection: LeapSocket) -> None:
        silence_s = 0.1
        next_ping, pinged = self._monotonic() + PING_S, False
        cause = UNKNOWN_CAUSE
        while not self._closing.is_set():
            try:
                text = connection.recv(silence_s)
            except TimeoutError:
                self._set_status(LeapLink.SILENT, f"The Leap service on {self._address} sends no frames; {cause}")
                if self._monotonic() >= next_ping:
                    if pinged and not connection.ponged:
                        raise OSError(f"no answer to a ping for {PING_S:g} s") from None
                    next_ping, pinged = self._monotonic() + PING_S, True
                    connection.ping()
                continue
            stamp = self._clock()
            next_ping, pinged = self._monotonic() + PING_S, False
            if isinstance(text, str) and '"event"' in text:
                cause = self._take_event(text)
            else:
                self._take_frame(text, stamp)
            if self._tap is not None and isinstance(text, str):
                self._tap(text, stamp)

    def _take_frame(self, text: str | bytes, stamp: object) -> None:
        with self._changed:
            if self._status.link is not LeapLink.STREAMING:  # before somebody gets the frame
                self._set_status(LeapLink.STREAMING, f"The Leap service on {self._address} sends frames.")
            self._counts.received += 1
            self._counts.superseded += self._newest is not None
            self._newest = (text, stamp)
            self._changed.notify_all()

    def _take_event(self, text: str) -> str:
        """Returns the cause that the event gives for a silence that may follow."""
        try:
            event = read_message(text)
        except LeapProtocolError as error:
            self._drop(str(error))
            return UNKNOWN_CAUSE
        if not isinstance(event, DeviceEvent):
            return UNKNOWN_CAUSE
        with self._changed:
            if event.streaming:
                self._status = replace(self._status, serial=event.serial)
            elif not event.attached and event.serial == self._status.serial:
                self._status = replace(self._status, serial="")
        if event.streaming:
            return UNKNOWN_CAUSE
        return "tracking is paused." if event.attached else "the controller is not plugged in."

    def _drop(self, reason: str, hand: bool = False) -> None:
        with self._changed:
            dropped = self._counts.hands_dropped if hand else self._counts.dropped
            dropped[reason if reason in dropped or len(dropped) < MAX_REASONS else "other reasons"] += 1

    def _judge(self, reason: str | None) -> None:
        with self._changed:
            self._unusable = None if reason is None else self._unusable or (self._monotonic(), reason)

    def _set_status(self, link: LeapLink, sentence: str, service: str | None = None, simulated: bool = False) -> None:
        with self._changed:
            self._status = replace(self._status, link=link, sentence=sentence)
            if service is not None:
                self._status = replace(self._status, service=service, serial="", simulated=simulated)
            self._unusable = None


def wire_fault(host: str, code: str, fingerprint: str, trust_network: bool) -> str | None:
    """Returns why the hands of a service may not be taken like this, in a sentence; None if they may."""
    if bool(code) != bool(fingerprint):
        given, missing = ("code", "fingerprint") if code else ("fingerprint", "code")
        return f"{given} is set, but {missing} is not; a service on another machine shows both."
    if fingerprint and not FINGERPRINT.fullmatch(fingerprint.replace(":", "").lower()):
        return f"fingerprint is {fingerprint!r}, but must be 64 hexadecimal digits."
    if not (fingerprint or trust_network or is_loopback(host)):
        proof = "set the code and the fingerprint that its service shows"
        own = "A tracker's own service has neither: set trust_network, on a network that only the two machines share."
        return f"host is {host!r}, another machine: {proof}. {own}"
    return None


class _LinkFault(Exception):
    """A connection failed or ended; the text is one sentence for the user."""

    def __init__(self, link: LeapLink, sentence: str) -> None:
        super().__init__(sentence)
        self.link = link


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
