"""Server of a specimen: it serves one test at a time and accepts only authenticated requests in order."""

from __future__ import annotations

import contextlib
import gc
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.hybrid.laboratory.specimen import Specimen, SpecimenError
from structid.hybrid.laboratory.wire import (
    LARGEST_GREETING,
    NONCE,
    Frame,
    Hello,
    Kind,
    Welcome,
    WireError,
    checked_secret,
    greeting_key,
    packed_reading,
    read_json,
    read_move,
    received,
    send,
    session_key,
)

WATCHDOG = 1.0
"""Silence [s] after which a session ends."""
GREETING = 1.0
"""Time limit for a client's HELLO [s]."""
CHANGE_OVER = 0.2
"""Time for which a new client waits for the end of the previous session [s]."""
MOST_CONNECTIONS = 32
"""Largest number of simultaneous connections, with or without authentication; further connections are closed."""
LOOPBACK = "127.0.0.1"

Log = Callable[[str], None]


def parsed_address(address: str) -> tuple[str, int]:
    """Split an address into host and port."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise InputError("address", f"'{address}'", "a host and a port, such as 127.0.0.1:7700")
    return host, int(port)


@dataclass
class _Session:
    """One session: connection, key, last request, whether the specimen has moved in it, and whether it is still reserved."""

    connection: socket.socket
    key: bytes
    last: int = 0
    moved: bool = False
    reserved: bool = True


@contextlib.contextmanager
def _without_long_pauses() -> Iterator[None]:
    """Exclude the process's current objects from Python's garbage collection.

    Scanning all objects of JAX takes 50 ms or more; a client would treat this pause as silence and end the test.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@check_arguments
class SpecimenServer:
    """Server of a specimen for hybrid tests, by default on the loopback interface.

    A frame that is late, malformed, forged, out of order or not finite ends the session; so does a closed connection.
    A specimen moved in that session then holds its last accepted position permanently. Refused clients have no effect.

    Parameters
    ----------
    specimen : Specimen
        Specimen to serve.
    secret : str or bytes
        Secret shared with the client, 16 bytes or more.
    host : str
        Address on which the server listens.
    port : int
        Port of the server; 0 selects a free port.
    watchdog : float
        Duration of silence after which a session ends [s].
    releases : bool
        Whether a simulated specimen is unloaded and zeroed for the next test after a client has closed its session in order.
        After an error, it always holds its position.
    log : callable, optional
        Called with one sentence for every event.

    Examples
    --------
    >>> import structid as si
    >>> import numpy as np
    >>> from structid.mechanics.restoring_forces import LinearForce
    >>> secret = "a secret of both sides"
    >>> with si.SpecimenServer(si.SimulatedSpecimen(LinearForce(np.array([[2.0]]))), secret) as server:
    ...     remote = si.RemoteSpecimen(server.address, secret)
    ...     print(remote.move(np.array([[0.5]])).force)
    [1.]
    """

    def __init__(
        self,
        specimen: Specimen,
        secret: str | bytes,
        *,
        host: str = LOOPBACK,
        port: int = 0,
        watchdog: float = WATCHDOG,
        releases: bool = False,
        log: Log | None = None,
    ) -> None:
        self.specimen, self.watchdog, self.releases = specimen, watchdog, releases
        if releases and not specimen.describe().simulated:
            raise InputError("server: releases", "a structure as specimen", "a simulated specimen, or releases=False")
        self._secret, self._log = checked_secret(secret), log or (lambda message: None)
        self._busy, self._stopping = threading.Lock(), threading.Event()
        try:
            self._listening = socket.create_server((host, port))
        except OSError as error:
            raise InputError("server", f"{host}:{port} is not available: {error.strerror}", "a free port") from None
        self._listening.settimeout(0.2)
        self._threads: list[threading.Thread] = []

    @property
    def address(self) -> str:
        """Address on which the server listens, such as ``"127.0.0.1:7700"``."""
        host, port = self._listening.getsockname()[:2]
        return f"{host}:{port}"

    def __enter__(self) -> Self:
        self._threads.append(threading.Thread(target=self.serve, daemon=True))
        self._threads[0].start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        for thread in self._threads:
            thread.join()

    def stop(self) -> None:
        """Stop serving; a session in progress ends at its next request or silence."""
        self._stopping.set()

    def serve(self) -> None:
        """Accept clients until `stop`."""
        with self._listening, _without_long_pauses():
            while not self._stopping.is_set():
                try:
                    connection, peer = self._listening.accept()
                except TimeoutError:
                    continue
                except OSError:
                    return
                self._threads = [t for t in self._threads if t.is_alive()]
                if len(self._threads) > MOST_CONNECTIONS:
                    connection.close()  # too many connections: close it without using memory
                    continue
                thread = threading.Thread(target=self._client, args=(connection, f"{peer[0]}:{peer[1]}"), daemon=True)
                self._threads.append(thread)
                thread.start()

    def _client(self, connection: socket.socket, peer: str) -> None:
        """Handle one connection from HELLO to its end."""
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with connection:
            session = None
            try:
                session = self._greeted(connection)
                if session is not None:
                    self._log(f"{peer}: the session has started")
                    self._obey(session)
                    self._log(f"{peer}: the session has ended")
            except Exception as error:
                # After any error, also in the specimen's own program, the session is over and nothing moves.
                self._log(f"{peer}: {error}")
                if session is not None and session.moved:
                    self.specimen.hold(str(error))
            finally:
                if session is not None:
                    self._release(session)

    def _release(self, session: _Session) -> None:
        """Let the next session use the specimen."""
        if session.reserved:
            session.reserved = False
            self._busy.release()

    def _greeted(self, connection: socket.socket) -> _Session | None:
        """Answer a HELLO; return None after a refusal. The specimen is reserved for this session until it ends."""
        key = greeting_key(self._secret)
        frame = received(connection, key, GREETING, LARGEST_GREETING)
        if frame is None:
            return None
        if frame.kind is not Kind.HELLO or frame.sequence != 0:
            raise WireError("The first message of a session is not HELLO.")
        hello = read_json(Hello, frame.payload)
        if not self._busy.acquire(timeout=CHANGE_OVER):
            send(connection, Frame(Kind.REFUSED, 0, b"Another test uses this specimen."), key, GREETING)
            return None
        try:
            nonce = secrets.token_bytes(NONCE)
            welcome = Welcome(
                client_nonce=hello.nonce,
                nonce=nonce.hex(),
                watchdog=self.watchdog,
                description=self.specimen.describe(),
            )
            send(connection, Frame(Kind.WELCOME, 0, welcome.model_dump_json().encode()), key, GREETING)
        except BaseException:
            self._busy.release()
            raise
        return _Session(connection, session_key(self._secret, bytes.fromhex(hello.nonce), nonce))

    def _obey(self, session: _Session) -> None:
        """Answer requests until the session is over."""
        while not self._stopping.is_set():
            frame = received(session.connection, session.key, self.watchdog)
            if frame is None:
                raise WireError("The client closed the connection without closing the session.")
            if frame.sequence != session.last + 1:
                raise WireError(
                    f"Request {frame.sequence} came instead of {session.last + 1}: a request was replayed or lost."
                )
            session.last = frame.sequence
            answer = self._answer(session, frame)
            if answer.kind in (Kind.CLOSED, Kind.REFUSED):
                self._release(session)  # before the answer, so that the client's next test finds the specimen free
            send(session.connection, answer._replace(sequence=frame.sequence), session.key, self.watchdog)
            if answer.kind in (Kind.CLOSED, Kind.REFUSED):
                return
        if session.moved:
            self.specimen.hold("the server was stopped")

    def _answer(self, session: _Session, frame: Frame) -> Frame:
        """Execute a request."""
        match frame.kind:
            case Kind.PING:
                return Frame(Kind.PONG, 0)
            case Kind.HOLD:
                self.specimen.hold(frame.payload.decode("utf-8", "replace") or "the client requested it")
                return Frame(Kind.HELD, 0)
            case Kind.CLOSE:
                if session.moved:
                    self._close()
                return Frame(Kind.CLOSED, 0)
            case Kind.MOVE:
                path, averaged = read_move(frame.payload)
                session.moved = True
                try:
                    return Frame(Kind.READING, 0, packed_reading(self.specimen.move(path, averaged)))
                except SpecimenError as error:
                    self._log(str(error))
                    self.specimen.hold(str(error))
                    return Frame(Kind.REFUSED, 0, str(error).encode())
            case _:
                raise WireError(f"{frame.kind.name} is not a request.")

    def _close(self) -> None:
        """End a session that has moved the specimen."""
        self.specimen.close()
        if self.releases:
            self.specimen = self.specimen.released()
            self._log("The specimen was unloaded and zeroed for the next test.")
