"""Thirty checks of a server that implements the specimen protocol: required answers, and requests it must refuse.

The well-formed moves go to zero, or beyond a limit; the server must refuse the latter. The move beyond a limit is
omitted if no channel declares a stroke limit. At the end, the specimen holds its position permanently, as required
after a refused move. Restart the server before a test.
"""

from __future__ import annotations

import hmac
import secrets
import socket
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from structid.core.validation import check_arguments
from structid.hybrid.laboratory.server import parsed_address
from structid.hybrid.laboratory.specimen import SpecimenError
from structid.hybrid.laboratory.wire import (
    HEADER,
    LARGEST_PAYLOAD,
    MAGIC,
    NONCE,
    VERSION,
    Frame,
    Hello,
    Kind,
    Welcome,
    WireError,
    checked_secret,
    greeting_key,
    packed,
    packed_move,
    read_json,
    read_reading,
    received,
    session_key,
)

PATIENCE = 3.0
"""Time limit for an answer, or for the end of a connection [s]."""
GRACE = 0.5
"""Largest allowed delay in ending a session, beyond the watchdog time [s]."""


class Finding(NamedTuple):
    """Result of one check."""

    what: str  # requirement
    passed: bool  # whether it is met
    came: str = ""  # observed behaviour; empty if the check passed


class _Failed(Exception):
    """A failed check; the message gives the behaviour of the server."""


class _Peer:
    """A client that can send arbitrary bytes."""

    def __init__(self, where: tuple[str, int], secret: bytes) -> None:
        self.where, self.secret, self.key = where, secret, greeting_key(secret)
        self.connection = socket.create_connection(where, PATIENCE)
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.sequence = 0
        self.welcome: Welcome | None = None

    def __enter__(self) -> _Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.connection.close()

    def send(self, message: bytes) -> None:
        """Send bytes."""
        self.connection.sendall(message)

    def receive(self, key: bytes | None = None) -> Frame:
        """Wait for a frame."""
        frame = received(self.connection, key or self.key, PATIENCE)
        if frame is None:
            raise _Failed("it closed the connection")
        return frame

    def greet(self, nonce: bytes | None = None) -> _Peer:
        """Open a session."""
        own_nonce = nonce or secrets.token_bytes(NONCE)
        self.send(hello(own_nonce, greeting_key(self.secret)))
        frame = self.receive()
        if frame.kind is not Kind.WELCOME:
            raise _Failed(f"it answered {frame.kind.name}: {frame.payload.decode('utf-8', 'replace')}")
        self.welcome = read_json(Welcome, frame.payload)
        self.key = session_key(self.secret, own_nonce, bytes.fromhex(self.welcome.nonce))
        return self

    def request(self, kind: Kind, payload: bytes = b"") -> Frame:
        """Send the next request of a session, and wait for its answer."""
        self.sequence += 1
        self.send(packed(Frame(kind, self.sequence, payload), self.key))
        answer = self.receive()
        if answer.sequence != self.sequence:
            raise _Failed(f"the answer to request {self.sequence} has the sequence number {answer.sequence}")
        return answer

    def expect_end(self, patience: float = PATIENCE) -> None:
        """Require that the server sends nothing more, and ends the connection."""
        self.connection.settimeout(patience)
        try:
            if self.connection.recv(1):
                raise _Failed("it answered")
        except TimeoutError:
            raise _Failed(f"the connection is still open after {patience:g} s") from None
        except OSError:
            return


def hello(nonce: bytes, key: bytes, sequence: int = 0) -> bytes:
    """Build a HELLO."""
    return packed(
        Frame(Kind.HELLO, sequence, Hello(nonce=nonce.hex(), software="conformance").model_dump_json().encode()), key
    )


_Open = Callable[[], _Peer]
_Check = tuple[str, Callable[[], None]]
_Message = Callable[[_Peer], bytes]


def _headed(key: bytes, *fields: object) -> bytes:
    """Build a frame with an arbitrary header, a valid tag and no payload."""
    head = HEADER.pack(*fields)
    return head + hmac.digest(key, head, "sha256")


def _dropped_at_once(new: _Open, message: _Message) -> Callable[[], None]:
    """Check that a server ends a connection whose first message is `message`."""

    def check() -> None:
        with new() as peer:
            peer.send(message(peer))
            peer.expect_end()

    return check


def _dropped_in_session(new: _Open, message: _Message) -> Callable[[], None]:
    """Check that a server ends a session whose second request is `message`."""

    def check() -> None:
        with new() as peer:
            peer.greet().request(Kind.PING)
            peer.send(message(peer))
            peer.expect_end()

    return check


def _greeting(new: _Open) -> Iterator[_Check]:
    """Checks of the start of a session."""

    def welcomed() -> None:
        new().greet()

    def nonce_repeated() -> None:
        nonce = secrets.token_bytes(NONCE)
        with new() as peer:
            peer.greet(nonce)
            if peer.welcome is None or peer.welcome.client_nonce != nonce.hex():
                raise _Failed("it repeats another nonce")

    def nonces_differ() -> None:
        nonce, result = secrets.token_bytes(NONCE), []
        for _ in range(2):
            with new() as peer:
                peer.greet(nonce)
                result.append(peer.welcome.nonce if peer.welcome else "")
                peer.request(Kind.CLOSE)
        if result[0] == result[1]:
            raise _Failed("the nonces of two sessions are equal")

    yield "answers HELLO with WELCOME and a valid description", welcomed
    yield "repeats the client's nonce in its WELCOME", nonce_repeated
    yield "generates a new nonce for every session", nonces_differ


def _false_greetings() -> Iterator[tuple[str, _Message]]:
    """Messages that must not start a session."""
    nonce = bytes(NONCE)
    yield "drops a HELLO with another secret", lambda p: hello(nonce, b"another")
    yield "drops a HELLO with another protocol version", lambda p: _headed(p.key, MAGIC, VERSION + 1, 1, 0, 0, 0)
    yield "drops another protocol", lambda p: b"GET / HTTP/1.1\r\nHost: specimen\r\n\r\n"
    yield "drops a HELLO with a sequence number other than 0", lambda p: hello(nonce, p.key, 1)
    yield "drops a HELLO that is not JSON", lambda p: packed(Frame(Kind.HELLO, 0, b"\xff\xfe"), p.key)
    yield "drops a request before a HELLO", lambda p: packed(Frame(Kind.PING, 1), p.key)
    yield "drops an unknown kind", lambda p: _headed(p.key, MAGIC, VERSION, 77, 0, 0, 0)
    yield "drops a header whose last field is not 0", lambda p: _headed(p.key, MAGIC, VERSION, 1, 0, 0, 1)
    yield (
        "drops a frame that is too long, before its payload arrives",
        lambda p: _headed(p.key, MAGIC, VERSION, 1, 0, LARGEST_PAYLOAD + 1, 0),
    )
    yield "drops a silent connection", lambda p: b""


def _second_client(new: _Open) -> Iterator[_Check]:
    """Check that only one client can control a specimen."""

    def one_at_a_time() -> None:
        with new() as first, new() as second:
            first.greet()
            second.send(hello(bytes(NONCE), second.key))
            answer = second.receive()
            if answer.kind is not Kind.REFUSED:
                raise _Failed(f"it answered {answer.kind.name}")
            if first.request(Kind.PING).kind is not Kind.PONG:
                raise _Failed("the first session ended")
            first.request(Kind.CLOSE)

    yield "refuses a second client and keeps the first session", one_at_a_time


def _false_requests() -> Iterator[tuple[str, _Message]]:
    """Messages that a server must refuse as the second request of a session."""

    def not_finite(peer: _Peer) -> bytes:
        assert peer.welcome is not None
        path = np.full((1, len(peer.welcome.description.channels)), np.nan)
        return packed(Frame(Kind.MOVE, 2, packed_move(path, 1)), peer.key)

    def one_bit(peer: _Peer) -> bytes:
        message = bytearray(packed(Frame(Kind.PING, 2), peer.key))
        message[-1] ^= 1
        return bytes(message)

    yield "drops a forged request", lambda p: packed(Frame(Kind.PING, 2), b"another key")
    yield "drops a request with one bit changed", one_bit
    yield "drops a replayed request", lambda p: packed(Frame(Kind.PING, 1), p.key)
    yield "drops a request out of order", lambda p: packed(Frame(Kind.PING, 3), p.key)
    yield "drops an answer instead of a request", lambda p: packed(Frame(Kind.READING, 2), p.key)
    yield "drops a second HELLO", lambda p: packed(Frame(Kind.HELLO, 2), p.key)
    yield "drops a move with inconsistent sizes", lambda p: packed(Frame(Kind.MOVE, 2, bytes(13)), p.key)
    yield "drops a move without a position", lambda p: packed(Frame(Kind.MOVE, 2, bytes(12)), p.key)
    yield "drops a move that is not finite", not_finite


def _session(new: _Open) -> Iterator[_Check]:
    """Checks of a session in which nothing moves."""

    def ponged() -> None:
        with new() as peer:
            peer.greet()
            for _ in range(3):
                if (answer := peer.request(Kind.PING)).kind is not Kind.PONG:
                    raise _Failed(f"it answered {answer.kind.name}")
            peer.request(Kind.CLOSE)

    def replayed() -> None:
        own_nonce = secrets.token_bytes(NONCE)
        with new() as peer:
            recorded = packed(Frame(Kind.PING, 1), peer.greet(own_nonce).key)
            peer.request(Kind.PING)
            peer.request(Kind.CLOSE)
        with new() as peer:
            peer.greet(own_nonce)
            peer.send(recorded)
            peer.expect_end()

    def in_pieces() -> None:
        with new() as peer:
            peer.greet()
            message = packed(Frame(Kind.PING, 1), peer.key) + packed(Frame(Kind.PING, 2), peer.key)
            for k in range(0, len(message), 7):
                peer.send(message[k : k + 7])
            if [peer.receive().sequence for _ in range(2)] != [1, 2]:
                raise _Failed("the answers are out of order")
            peer.sequence = 2
            peer.request(Kind.CLOSE)

    def watched() -> None:
        with new() as peer:
            peer.greet()
            assert peer.welcome is not None
            began, watchdog = time.monotonic(), peer.welcome.watchdog
            peer.expect_end(watchdog + GRACE)
            if time.monotonic() - began < 0.5 * watchdog:
                raise _Failed(
                    f"it ended after {time.monotonic() - began:.2f} s, but its watchdog time is {watchdog:g} s"
                )

    yield "answers PING with PONG and the same sequence number", ponged
    yield "drops a replayed session", replayed
    yield "accepts requests that arrive in pieces", in_pieces
    yield "ends a silent session after its watchdog time", watched


def _motion(new: _Open) -> Iterator[tuple[str, Callable[[], None]]]:
    """Checks of a move to zero, and of a move beyond a limit."""

    def move(peer: _Peer, place: float) -> Frame:
        assert peer.welcome is not None
        channels = peer.welcome.description.channels
        return peer.request(Kind.MOVE, packed_move(np.full((1, len(channels)), place), 1))

    def stays() -> None:
        with new() as peer:
            answer = move(peer.greet(), 0.0)
            if answer.kind is not Kind.READING:
                raise _Failed(f"it answered {answer.kind.name}: {answer.payload.decode('utf-8', 'replace')}")
            assert peer.welcome is not None
            read_reading(answer.payload, len(peer.welcome.description.channels))
            if not any(channel.stroke for channel in peer.welcome.description.channels):
                raise _Failed("no channel of its description has a stroke limit")
            beyond = move(peer, 1e9)
            if beyond.kind is not Kind.REFUSED:
                raise _Failed(f"it answered a move of 1e9 m with {beyond.kind.name}")
            peer.expect_end()

    def holds() -> None:
        with new() as peer:
            answer = move(peer.greet(), 0.0)
            if answer.kind is not Kind.REFUSED:
                raise _Failed(f"it answered {answer.kind.name}")

    def serves() -> None:
        with new() as peer:
            peer.greet()
            if (answer := peer.request(Kind.CLOSE)).kind is not Kind.CLOSED:
                raise _Failed(f"it answered {answer.kind.name}")
            peer.expect_end()

    yield "returns a reading at zero, and refuses a move beyond its limits", stays
    yield "holds its position in every later session", holds
    yield "continues to serve", serves


@check_arguments
def conformance(address: str, secret: str | bytes) -> list[Finding]:
    """Check a server of the specimen protocol.

    Parameters
    ----------
    address : str
        Host and port.
    secret : str or bytes
        Secret shared with the server.

    Returns
    -------
    list of Finding
        Thirty results, in the order of the checks.

    Raises
    ------
    InputError
        If the address or the secret is invalid.
    SpecimenError
        If no server answers at the address.

    Examples
    --------
    >>> import structid as si
    >>> findings = si.conformance("tcp://127.0.0.1:7007", secret="...")  # doctest: +SKIP
    """
    where, key = parsed_address(address), checked_secret(secret)
    try:
        socket.create_connection(where, PATIENCE).close()
    except OSError as error:
        raise SpecimenError(f"No specimen answers at {address}: {error.strerror or error}.") from None

    def new() -> _Peer:
        return _Peer(where, key)

    checks = (
        *_greeting(new),
        *((what, _dropped_at_once(new, message)) for what, message in _false_greetings()),
        *_second_client(new),
        *((what, _dropped_in_session(new, message)) for what, message in _false_requests()),
        *_session(new),
        *_motion(new),
    )
    findings = []
    for what, check in checks:
        try:
            check()
            findings.append(Finding(what, True))
        except (_Failed, WireError, OSError) as error:
            findings.append(Finding(what, False, str(error)))
    return findings
