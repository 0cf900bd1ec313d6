"""The WebSocket to the Leap service: websockets' own client hands each message from its reading thread to the caller's,
and waits until that has taken it. To another machine it goes by TLS in memory, whose certificate must have the
fingerprint that the user knows."""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import socket
import ssl
import time
from collections import deque
from urllib.parse import urlencode

from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidHeader, InvalidStatus, WebSocketException
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import parse_uri

OPEN_TIMEOUT_S = 2.0
CLOSE_TIMEOUT_S = 0.5
READ_BYTES = 65536
HEARD_BYTES = 256  # of a service's first ones are kept
OPENS, OPENS_TLS = (b"HTTP/1.1 101",), (b"\x16\x03", b"\x15\x03")  # how an expected answer begins
OWN_HELLO = b"\x01"  # the sixth byte of what a client says first by TLS; a service says 2


class UnknownService(Exception):
    """The service has another fingerprint than the one that is expected; `found` is its own."""

    def __init__(self, found: str) -> None:
        super().__init__(f"The service has the fingerprint {found}.")
        self.found = found


class ForeignAnswer(Exception):
    """What answers is not the expected service: `first` are its first bytes, and `by_tls` whether TLS was expected."""

    def __init__(self, first: bytes, by_tls: bool) -> None:
        super().__init__(f"The first bytes are {first!r}.")
        self.first = first
        self.by_tls = by_tls


class LeapSocket(contextlib.AbstractContextManager):
    """An open connection. Raises OSError, EOFError, ValueError or WebSocketException if nobody opens one within
    OPEN_TIMEOUT_S, of them InvalidStatus if the service refuses; ForeignAnswer if something else answers. With
    the `fingerprint` of the service, 64 hexadecimal digits, by TLS; raises UnknownService, before anything is sent,
    if it has another one. `code`: what the service asks clients of other machines for."""

    def __init__(self, host: str, port: int, code: str = "", fingerprint: str = "") -> None:
        refusals = (401, 403, 429)  # by which a service refuses a client
        self.ponged = False  # whether the newest ping was answered
        self._heard = b""
        self._opens = OPENS_TLS if fingerprint else OPENS
        self._messages: deque[str | bytes] = deque()
        self._parts: list[bytes] = []  # of a message that is not complete
        self._is_text = False
        query = f"?{urlencode({'code': code})}" if code else ""
        self._protocol = ClientProtocol(parse_uri(f"ws://{host}:{port}/v6.json{query}"))
        self._tls = _Tls() if fingerprint else None
        deadline = time.monotonic() + OPEN_TIMEOUT_S
        self._socket = socket.create_connection((host, port), OPEN_TIMEOUT_S)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
            if self._tls is not None:
                self._greet(self._tls, fingerprint, deadline)
                self._heard = b""
                self._opens = OPENS
            self._protocol.send_request(self._protocol.connect())
            while self._protocol.state is State.CONNECTING and self._protocol.handshake_exc is None:
                self._read(deadline)
            if self._protocol.handshake_exc is not None:
                raise self._protocol.handshake_exc
        except BaseException as error:
            self._socket.close()
            refused = isinstance(error, InvalidStatus) and error.response.status_code in refusals
            failed = isinstance(error, (OSError, EOFError, ValueError, WebSocketException)) and not refused
            opens = self._heard.startswith(self._opens) and self._heard[5:6] != OWN_HELLO
            opens = opens and not isinstance(error, InvalidHeader)  # of a service that upgrades to something else
            if failed and self._heard and not opens:
                raise ForeignAnswer(self._heard, self._opens == OPENS_TLS) from error
            raise

    def recv(self, timeout: float) -> str | bytes:
        """Returns the next message; raises TimeoutError if none comes within `timeout` [s], ConnectionClosed if the
        service has ended the connection."""
        deadline = time.monotonic() + timeout
        while not self._messages:
            self._require_open()
            try:
                self._read(deadline)
            except TimeoutError:
                raise
            except OSError as error:
                raise self._closed() from error
        return self._messages.popleft()

    def send(self, text: str) -> None:
        """Sends a message; raises ConnectionClosed if the service has ended the connection."""
        self._require_open()
        self._protocol.send_text(text.encode())
        self._flush()

    def ping(self) -> None:
        """Sends a ping; `ponged` says whether its answer came. Raises as `send` does."""
        self._require_open()
        self.ponged = False
        self._protocol.send_ping(b"")
        self._flush()

    def __exit__(self, *_exception: object) -> None:
        deadline = time.monotonic() + CLOSE_TIMEOUT_S
        with self._socket, contextlib.suppress(OSError):
            if self._protocol.state is State.OPEN:
                self._protocol.send_close(1000)
            while self._protocol.state is not State.CLOSED:
                self._read(deadline)

    def _greet(self, tls: _Tls, fingerprint: str, deadline: float) -> None:
        while not tls.shake():
            self._socket.sendall(tls.outgoing())
            data = self._receive(deadline)
            self._heard = (self._heard + data)[:HEARD_BYTES]
            tls.take(data)
        if not hmac.compare_digest(tls.fingerprint(), fingerprint):
            raise UnknownService(tls.fingerprint())

    def _receive(self, deadline: float) -> bytes:
        rest = deadline - time.monotonic()
        if rest <= 0.0:
            raise TimeoutError
        self._socket.settimeout(rest)
        try:
            return self._socket.recv(READ_BYTES)
        except socket.timeout:
            raise TimeoutError from None  # the two are one from Python 3.10 on

    def _read(self, deadline: float) -> None:
        self._flush()
        data = self._receive(deadline)
        ended = not data
        if self._tls is not None:
            self._tls.take(data)
            data, ended = self._tls.incoming()
        if data:
            self._heard = self._heard or data[:HEARD_BYTES]
            self._protocol.receive_data(data)
        if ended:
            self._protocol.receive_eof()
        for event in self._protocol.events_received():
            if isinstance(event, Frame):
                self._take(event)
        self._flush()

    def _take(self, frame: Frame) -> None:
        if frame.opcode is Opcode.PONG:
            self.ponged = True
        elif frame.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            self._is_text = frame.opcode is Opcode.TEXT if not self._parts else self._is_text
            self._parts.append(frame.data)
            if frame.fin:
                self._messages.append(self._message())

    def _message(self) -> str | bytes:
        """Returns the complete message; a text that is not UTF-8 stays as it is, to be refused."""
        data, self._parts = b"".join(self._parts), []
        with contextlib.suppress(UnicodeDecodeError):
            return data.decode() if self._is_text else data
        return data

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data if self._tls is None else self._tls.outgoing(data))
            else:
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)

    def _require_open(self) -> None:
        if self._protocol.state is not State.OPEN:
            raise self._closed()

    def _closed(self) -> ConnectionClosed:
        protocol = self._protocol
        return ConnectionClosed(protocol.close_rcvd, protocol.close_sent, protocol.close_rcvd_then_sent)


class _Tls:
    """The client's half of a TLS connection, in memory. The certificate is nobody's but the service's, so that its
    fingerprint alone can tell whose it is. That the service has the key to it the handshake proves in any case."""

    def __init__(self) -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        self._in = ssl.MemoryBIO()
        self._out = ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._in, self._out)

    def shake(self) -> bool:
        """Goes on with the handshake; returns whether it is done."""
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        return True

    def fingerprint(self) -> str:
        """Returns the SHA-256 of the service's certificate, as 64 hexadecimal digits."""
        return hashlib.sha256(self._tls.getpeercert(True) or b"").hexdigest()

    def take(self, data: bytes) -> None:
        """Takes what the service sent; nothing at its end."""
        self._in.write(data) if data else self._in.write_eof()

    def incoming(self) -> tuple[bytes, bool]:
        """Returns what it said, and whether that was the end."""
        parts = []
        try:
            while part := self._tls.read(READ_BYTES):
                parts.append(part)
            return b"".join(parts), True
        except ssl.SSLWantReadError:
            return b"".join(parts), False
        except (ssl.SSLZeroReturnError, ssl.SSLEOFError):
            return b"".join(parts), True

    def outgoing(self, data: bytes = b"") -> bytes:
        """Returns what is to be sent for it, encrypted."""
        if data:
            self._tls.write(data)
        return self._out.read()
