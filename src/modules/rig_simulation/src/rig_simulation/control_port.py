"""The control port of a simulated device: its true state, and physical interventions by users and tests. Loopback TCP,
one JSON object a line in each direction. `{"do": "state"}` is answered by `{"ok": true, ...}` with what the handler of
that name returns, a request that fails by `{"ok": false, "error": "one sentence"}`. The handbook offers this wire form
(docs/decisions/control-ports.md), so no RPC library replaces it. A real rig has no such port."""

from __future__ import annotations

import contextlib
import functools
import inspect
import ipaddress
import json
import socket
from collections.abc import Mapping
from typing import Any, Callable

from common import clock
from common.errors import DeviceError, RigError
from leap_motion.stranger import stranger

MAX_LINE_BYTES = 65536
RETRY_S = 0.2  # until a connection is accepted that could not be
Handler = Callable[..., Any]  # takes the other fields of a request by name; returns the fields of the answer or None


class PortClosedError(DeviceError):
    """Nothing listens on the control port: the simulated device does not run."""


class ControlPort(contextlib.AbstractContextManager):
    """Serves the requests of `handlers`, by name, from its own threads until `close`; a handler's ValueError or
    RigError becomes the error of the answer. Port 0 takes any free one, see the attribute. Raises DeviceError if the
    address is not a loopback address, or the port is taken."""

    def __init__(self, handlers: Mapping[str, Handler], host: str = "127.0.0.1", port: int = 0) -> None:
        self._handlers = {name: (handler, inspect.signature(handler)) for name, handler in handlers.items()}
        self._closed = False
        self._clients: dict[socket.socket, clock.Thread] = {}
        self._lock = clock.Lock()
        self._listener = listen(host, port, "the control port")
        self.host, self.port = self._listener.getsockname()[:2]
        self._acceptor = clock.Thread(target=self._accept, name="control port", daemon=True)
        self._acceptor.start()

    def close(self) -> None:
        """Closes all connections and frees the port; may be called twice. Running requests finish first: a thread still
        inside the physics would crash the program at its exit."""
        close_timeout_s = 10.0  # longest wait for a running request; to build a world takes seconds on a busy machine
        with self._lock:
            self._closed = True
            clients = dict(self._clients)
        for connection in (self._listener, *clients):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        deadline = clock.monotonic() + close_timeout_s
        for thread in (self._acceptor, *clients.values()):
            thread.join(max(0.0, deadline - clock.monotonic()))
        self._listener.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                if self._closed:  # the listener was shut down
                    return
                clock.sleep(RETRY_S)  # the system has no descriptor for it at present
                continue
            with self._lock:
                if self._closed:
                    client.close()
                    return
                thread = clock.Thread(target=self._serve, args=(client,), name="control client", daemon=True)
                self._clients[client] = thread
                thread.start()  # under the lock: `close` may only join a started thread

    def _serve(self, client: socket.socket) -> None:
        try:
            with client, contextlib.suppress(OSError):
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                lines = client.makefile("rb")
                for line in iter(lambda: lines.readline(MAX_LINE_BYTES + 1), b""):
                    if len(line) > MAX_LINE_BYTES:
                        client.sendall(_refusal(f"The line is longer than {MAX_LINE_BYTES} bytes; send a shorter one."))
                        return
                    if line.strip():
                        client.sendall(self._answer(line))
                        if not line.lstrip().startswith(b"{"):
                            return  # a web page can send requests too, but only behind the first lines of HTTP
        finally:
            with self._lock:
                self._clients.pop(client)

    def _answer(self, line: bytes) -> bytes:
        try:
            request = json.loads(line.decode("utf-8"), parse_constant=_refuse_constant)
        except (ValueError, RecursionError) as error:
            return _refusal(f"The request is not JSON: {error}.")
        if not isinstance(request, dict) or not isinstance(request.get("do"), str):
            return _refusal('The request must be a JSON object whose "do" is a string.')
        name = request.pop("do")
        if name not in self._handlers:
            return _refusal(f"Unknown request {name!r}; the requests are {', '.join(sorted(self._handlers))}.")
        handler, signature = self._handlers[name]
        try:
            signature.bind(**request)
        except TypeError as error:
            return _refusal(f"The fields of the request {name!r} do not fit: {error}.")
        try:
            return _encoded({"ok": True, **(handler(**request) or {})})
        except (RigError, ValueError) as error:
            return _refusal(str(error))
        except Exception as error:  # a defect of one handler must not silence the port
            return _refusal(f"The request {name!r} failed: {type(error).__name__}: {error}.")


def within(context: Callable[[], contextlib.AbstractContextManager[Any]], handler: Callable[..., Any]) -> Handler:
    """Returns the handler with the same fields that runs within a context, such as a lock."""

    @functools.wraps(handler)  # the port checks the fields of a request against the signature
    def answer(**fields: Any) -> Any:
        with context():
            return handler(**fields)

    return answer


class ControlClient(contextlib.AbstractContextManager):
    """Asks a control port within `timeout` [s]. Connects at the first request, and anew after a failure."""

    def __init__(self, host: str, port: int, timeout: float = 2.0) -> None:
        self._address, self._name = (host, port), f"{host}:{port}"
        self._timeout = timeout
        self._connection: socket.socket | None = None
        self._lock = clock.Lock()

    def ask(self, do: str, **fields: Any) -> dict[str, Any]:
        """Returns the fields of the answer to the request `do`, without "ok"; raises PortClosedError if nothing listens
        there, DeviceError if no answer came in time or the device refused the request."""
        with self._lock:
            answer = self._exchange({"do": do, **fields})
        if answer.pop("ok") is not True:
            raise DeviceError(str(answer.get("error") or f"The control port {self._name} answered {answer!r}."))
        return answer

    def close(self) -> None:
        """Closes the connection; the next request opens it again."""
        with self._lock:
            self._disconnect()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _exchange(self, request: dict[str, Any]) -> dict[str, Any]:
        heard = b""
        try:
            if self._connection is None:
                self._connection = socket.create_connection(self._address, self._timeout)
                self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connection.settimeout(self._timeout)
            self._connection.sendall(_encoded(request))
            deadline = clock.monotonic() + self._timeout
            while not heard.endswith(b"\n"):
                rest = deadline - clock.monotonic()
                if rest <= 0.0:
                    raise TimeoutError("timed out")
                self._connection.settimeout(rest)
                data = self._connection.recv(MAX_LINE_BYTES)
                if not data:
                    raise EOFError("the connection was closed")
                heard += data
            answer = json.loads(heard.decode("utf-8"))
            if not isinstance(answer, dict) or "ok" not in answer:
                raise ValueError("no answer of a control port")
            return answer
        except (OSError, EOFError, ValueError, RecursionError) as error:
            self._disconnect()
            if heard and not heard.startswith(b'{"ok"'):
                what = stranger(self._name, "the control port of a simulated device", heard)
                raise DeviceError(f"W{what[1:]}; check the port.") from None
            kind = PortClosedError if isinstance(error, ConnectionRefusedError) else DeviceError
            raise kind(f"The control port {self._name} does not answer: {error}.") from None

    def _disconnect(self) -> None:
        if self._connection is not None:
            with contextlib.suppress(OSError):
                self._connection.close()
        self._connection = None


def listen(host: str, port: int, purpose: str) -> socket.socket:
    """Returns a listening TCP socket on a loopback address, since other machines must not reach a simulator; port 0
    takes any free one. Raises DeviceError, with the port's `purpose`, such as "the control port", if the address is not
    a loopback address, or the port is taken."""
    backlog = 50  # clients that may wait for acceptance; Java's default, as of the toolbox's server
    require_loopback(host, purpose)
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(backlog)
    except (OSError, OverflowError) as error:
        listener.close()
        cure = "Stop the other program, or choose another port."
        raise DeviceError(f"Cannot listen on {host}:{port} for {purpose}: {error}. {cure}") from None
    return listener


def require_loopback(host: str, purpose: str) -> None:
    """Raises DeviceError, with the port's `purpose`, if other machines reach an address."""
    try:
        loopback = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        raise DeviceError(f"The address {host!r} of {purpose} is not a loopback address; use 127.0.0.1.")


def _encoded(record: dict[str, Any]) -> bytes:
    return json.dumps(record, allow_nan=False).encode("utf-8") + b"\n"


def _refusal(reason: str) -> bytes:
    return _encoded({"ok": False, "error": reason})


def _refuse_constant(text: str) -> None:
    raise ValueError(f"the number {text} is not finite")
