"""The control port of a simulated device: what a test or the simulation's own nodes may see and do behind its back.

TCP on loopback, one JSON object per line in each direction: `{"do": "state"}` is answered by `{"ok": true, ...}` with
what the handler of that name returns, anything else by `{"ok": false, "error": "one sentence"}`. No part of a real rig
has such a port.
"""

from __future__ import annotations

import contextlib
import inspect
import ipaddress
import json
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from common.errors import DeviceError, RigError

MAX_LINE_BYTES = 65536
MAX_CLIENTS = 16
POLL_S = 0.5
HALF_LINE_TIMEOUT_S = 5.0
CLOSE_TIMEOUT_S = 10.0
"""Longest wait for a request that is being answered; to build another world takes seconds on a busy machine."""


class NobodyListens(DeviceError):
    """The simulated device is not there: its control port is closed."""


class ControlPort:
    """Serves the handlers from threads of its own until `close`.

    Args:
        handlers: for each request name a function that takes the request's other fields by name and returns the fields
            of the answer (or None). A ValueError or RigError becomes the answer's error sentence.
        host: a loopback address.
        port: 0 takes any free port; see `port`.

    Raises:
        DeviceError: the address is not a loopback address, or the port is not to be had.
    """

    def __init__(self, handlers: Mapping[str, Callable[..., Any]], host: str = "127.0.0.1", port: int = 0) -> None:
        self._handlers = {name: (handler, inspect.signature(handler)) for name, handler in handlers.items()}
        self._closed = threading.Event()
        self._clients: dict[socket.socket, threading.Thread] = {}
        self._lock = threading.Lock()
        self._listener = listen(host, port, "the control port", backlog=MAX_CLIENTS)
        self._listener.settimeout(POLL_S)
        self.host, self.port = self._listener.getsockname()[:2]
        self._acceptor = threading.Thread(target=self._accept, name="control port", daemon=True)
        self._acceptor.start()

    def close(self) -> None:
        """Ends all connections and frees the port; may be called twice.

        Requests that are being answered come to their end first: a thread that is still inside the physics when the
        program ends would crash it.
        """
        self._closed.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        with self._lock:
            serving = list(self._clients.values())
            for client in self._clients:
                with contextlib.suppress(OSError):
                    client.shutdown(socket.SHUT_RDWR)
        deadline = time.monotonic() + CLOSE_TIMEOUT_S
        for thread in (self._acceptor, *serving):
            thread.join(max(0.0, deadline - time.monotonic()))
        self._listener.close()

    def __enter__(self) -> ControlPort:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _accept(self) -> None:
        while not self._closed.is_set():
            try:
                client, _ = self._listener.accept()
            except socket.timeout:
                continue
            except OSError:
                return
            with self._lock:
                if self._closed.is_set() or len(self._clients) >= MAX_CLIENTS:
                    client.close()
                    continue
                thread = threading.Thread(target=self._serve, args=(client,), name="control client", daemon=True)
                self._clients[client] = thread
                thread.start()  # in the lock: nobody is to wait for its end before it has begun

    def _serve(self, client: socket.socket) -> None:
        try:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.settimeout(POLL_S)
            lines = _Lines(client)
            while not self._closed.is_set():
                try:
                    line = lines.next()
                except DeviceError as error:
                    _send(client, {"ok": False, "error": str(error)})
                    return
                if line is None:
                    if lines.half_line_age() > HALF_LINE_TIMEOUT_S:
                        return
                elif line.strip():
                    _send(client, self._answer(line))
        except (OSError, EOFError):
            pass
        finally:
            with self._lock:
                self._clients.pop(client)
            client.close()

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line.decode("utf-8"), parse_constant=_refuse_constant)
        except ValueError as error:
            return {"ok": False, "error": f"The request is not JSON: {error}."}
        if not isinstance(request, dict) or not isinstance(request.get("do"), str):
            return {"ok": False, "error": 'The request must be a JSON object with a text "do".'}
        name = request.pop("do")
        if name not in self._handlers:
            known = ", ".join(sorted(self._handlers))
            return {"ok": False, "error": f"The request {name!r} is not known; known are {known}."}
        handler, signature = self._handlers[name]
        try:
            signature.bind(**request)
        except TypeError as error:
            return {"ok": False, "error": f"The fields of the request {name!r} do not fit: {error}."}
        try:
            return {"ok": True, **(handler(**request) or {})}
        except (RigError, ValueError) as error:
            return {"ok": False, "error": str(error)}
        except Exception as error:  # a defect of one handler must not silence the port
            return {"ok": False, "error": f"The request {name!r} failed: {type(error).__name__}: {error}."}


class ControlClient:
    """Asks a control port; connects at the first question, and again at the next one after a failure.

    Args:
        host: address of the simulated device.
        port: its control port.
        timeout: longest time for connecting and for one answer [s].
    """

    def __init__(self, host: str, port: int, timeout: float = 2.0) -> None:
        self._address = (host, port)
        self._timeout = timeout
        self._lines: _Lines | None = None
        self._lock = threading.Lock()

    def ask(self, do: str, **fields: Any) -> dict[str, Any]:
        """Returns the fields of the answer to the request `do`, without "ok".

        Raises:
            NobodyListens: the port is closed.
            DeviceError: nobody answers there in time, or the request is refused; with the reason.
        """
        with self._lock:
            answer = self._exchange({"do": do, **fields})
        if not isinstance(answer, dict) or answer.pop("ok", None) is not True:
            reason = answer.get("error") if isinstance(answer, dict) else None
            raise DeviceError(str(reason or f"The control port {self._name()} answered {answer!r}."))
        return answer

    def close(self) -> None:
        """Closes the connection; the next question opens it again."""
        with self._lock:
            self._disconnect()

    def __enter__(self) -> ControlClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _exchange(self, request: dict[str, Any]) -> Any:
        try:
            if self._lines is None:
                self._lines = _Lines(socket.create_connection(self._address, self._timeout))
                self._lines.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._lines.connection.settimeout(self._timeout)
            _send(self._lines.connection, request)
            line = self._lines.next()
            if line is None:
                raise socket.timeout("timed out")
            return json.loads(line.decode("utf-8"))
        except (OSError, EOFError, DeviceError, ValueError) as error:
            self._disconnect()
            kind = NobodyListens if isinstance(error, ConnectionRefusedError) else DeviceError
            raise kind(f"The control port {self._name()} does not answer: {error}.") from None

    def _disconnect(self) -> None:
        if self._lines is not None:
            self._lines.connection.close()
        self._lines = None

    def _name(self) -> str:
        return f"{self._address[0]}:{self._address[1]}"


def listen(host: str, port: int, what: str, backlog: int) -> socket.socket:
    """Returns a listening TCP socket on a loopback address.

    Args:
        host: a loopback address; a simulator is not to be reached from other machines.
        port: 0 takes any free port.
        what: names the port in the error sentence, such as "the control port".
        backlog: how many clients may wait to be accepted.

    Raises:
        DeviceError: the address is not a loopback address, or the port is not to be had.
    """
    try:
        loopback = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        raise DeviceError(f"The address {host!r} of {what} is not a loopback address such as 127.0.0.1.")
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(backlog)
    except (OSError, OverflowError) as error:
        listener.close()
        raise DeviceError(f"Cannot listen on {host}:{port} for {what}: {error}.") from None
    return listener


class _Lines:
    """Cuts what a socket with a time-out receives into lines of bounded length."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self._buffer = bytearray()
        self._half_line_since: float | None = None

    def next(self) -> bytes | None:
        """Returns the next line without its end, or None if none was complete within the socket's time-out.

        Raises:
            EOFError: the peer closed the connection.
            DeviceError: the line is longer than MAX_LINE_BYTES.
        """
        timeout = self.connection.gettimeout()
        assert timeout is not None  # whoever made the connection has set one
        deadline = time.monotonic() + timeout
        while True:
            line, newline, rest = self._buffer.partition(b"\n")
            if newline:
                self._buffer = rest
                self._half_line_since = time.monotonic() if rest else None
                return bytes(line)
            if len(self._buffer) > MAX_LINE_BYTES:
                raise DeviceError(f"A line is longer than {MAX_LINE_BYTES} bytes.")
            if time.monotonic() >= deadline:
                return None
            try:
                chunk = self.connection.recv(65536)
            except socket.timeout:
                return None
            if not chunk:
                raise EOFError("the connection was closed")
            if self._half_line_since is None:
                self._half_line_since = time.monotonic()
            self._buffer += chunk

    def half_line_age(self) -> float:
        """Returns how long the beginning of a line has been waiting for its end [s]."""
        return 0.0 if self._half_line_since is None else time.monotonic() - self._half_line_since


def _send(connection: socket.socket, record: dict[str, Any]) -> None:
    connection.sendall(json.dumps(record, allow_nan=False).encode("utf-8") + b"\n")


def _refuse_constant(text: str) -> None:
    raise ValueError(f"the number {text} is not finite")
