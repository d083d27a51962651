"""A specimen in another process, with the interface of a local one."""

from __future__ import annotations

import secrets
import socket

import numpy as np

from structid.core.validation import check_arguments
from structid.hybrid.laboratory.server import parsed_address
from structid.hybrid.laboratory.specimen import Reading, Specimen, SpecimenDescription, SpecimenError
from structid.hybrid.laboratory.wire import (
    NONCE,
    Frame,
    Hello,
    Kind,
    Welcome,
    WireError,
    checked_secret,
    greeting_key,
    packed_move,
    read_json,
    read_reading,
    received,
    send,
    session_key,
)

SILENCE = 0.05
"""Longest allowed time from the end of a move to its answer [s]."""
CONNECTING = 5.0
"""Time limit for opening a connection, and for each message of a greeting [s]."""


@check_arguments
class RemoteSpecimen(Specimen):
    """A specimen behind a socket, served by `SpecimenServer` or by a laboratory's own program.

    A short separate session requests the description of the specimen. The session for the moves begins with the first
    move and cannot be repeated: after any error it is over, and the specimen holds its position.

    Parameters
    ----------
    address : str
        Host and port, such as ``"127.0.0.1:7700"``.
    secret : str or bytes
        Secret shared with the server, 16 bytes or more.
    silence : float
        Longest allowed time from the end of a move to its answer [s]; if the answer comes later, the test ends.

    Examples
    --------
    >>> import structid as si
    >>> specimen = si.RemoteSpecimen("tcp://192.0.2.7:7007", secret="...")  # doctest: +SKIP
    """

    def __init__(self, address: str, secret: str | bytes, silence: float = SILENCE) -> None:
        self.address, self.silence = address, silence
        self._where, self._secret = parsed_address(address), checked_secret(secret)
        self._connection: socket.socket | None = None
        self._description: SpecimenDescription | None = None
        self._key, self._sent = b"", 0
        self._over = ""

    # --- the session --------------------------------------------------------------------------------------------

    def _open(self) -> tuple[socket.socket, bytes, SpecimenDescription]:
        """Connect and greet."""
        try:
            connection = socket.create_connection(self._where, CONNECTING)
        except OSError as error:
            raise SpecimenError(
                f"No specimen answers at {self.address}: {error.strerror or error}. Start its server, or check the address."
            ) from None
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            nonce, key = secrets.token_bytes(NONCE), greeting_key(self._secret)
            hello = Hello(nonce=nonce.hex(), software="structid")
            send(connection, Frame(Kind.HELLO, 0, hello.model_dump_json().encode()), key, CONNECTING)
            answer = received(connection, key, CONNECTING)
            if answer is None:
                raise WireError(
                    f"{self.address} closed the connection without a greeting. Use the same secret and version on both sides."
                )
            if answer.kind is Kind.REFUSED:
                raise SpecimenError(answer.payload.decode("utf-8", "replace"))
            welcome = read_json(Welcome, answer.payload)
            if answer.kind is not Kind.WELCOME or welcome.client_nonce != nonce.hex():
                raise WireError("The answer to HELLO is not a WELCOME, or belongs to another HELLO.")
        except BaseException:
            connection.close()
            raise
        return connection, session_key(self._secret, nonce, bytes.fromhex(welcome.nonce)), welcome.description

    def _asked(self, kind: Kind, payload: bytes, patience: float) -> Frame:
        """Send a request and wait for its answer; any other message ends the session."""
        if self._over:
            raise SpecimenError(f"The session is over: {self._over} A test is never resumed.")
        try:
            if self._connection is None:
                self._connection, self._key, self._description = self._open()
            self._sent += 1
            send(self._connection, Frame(kind, self._sent, payload), self._key, CONNECTING)
            answer = received(self._connection, self._key, patience)
            if answer is None:
                raise WireError("The server closed the connection.")
            if answer.kind is Kind.REFUSED:
                raise SpecimenError(answer.payload.decode("utf-8", "replace"))
            if answer.sequence != self._sent or answer.kind != kind + 1:
                raise WireError(f"The answer to {kind.name} {self._sent} was {answer.kind.name} {answer.sequence}.")
        except SpecimenError as error:
            self._end(str(error))
            raise
        return answer

    def _end(self, reason: str) -> None:
        self._over = self._over or reason
        if self._connection is not None:
            self._connection.close()

    # --- specimen interface -------------------------------------------------------------------------------------

    def describe(self) -> SpecimenDescription:
        """Request the description once; see `Specimen.describe`."""
        if self._description is None:
            connection, key, self._description = self._open()
            with connection:
                send(connection, Frame(Kind.CLOSE, 1), key, CONNECTING)
                received(connection, key, CONNECTING)
        return self._description

    def move(self, path: np.ndarray, averaged: int = 1) -> Reading:
        """Send a path and wait for the reading; see `Specimen.move`."""
        description = self.describe()
        path = np.atleast_2d(np.asarray(path, dtype=np.float64))
        patience = len(path) * description.controller_step + self.silence
        answer = self._asked(Kind.MOVE, packed_move(path, averaged), patience)
        try:
            return read_reading(answer.payload, len(description.channels))
        except WireError as error:
            self._end(str(error))
            raise

    def hold(self, reason: str) -> None:
        """Command the specimen to hold its position, as it also does without a connection; see `Specimen.hold`."""
        if self._connection is not None and not self._over:
            try:
                self._asked(Kind.HOLD, reason.encode(), self.silence)
            except SpecimenError:
                return  # without a connection, the specimen holds its position
        self._end(reason)

    def close(self) -> None:
        """End the session; see `Specimen.close`."""
        if self._connection is not None and not self._over:
            try:
                self._asked(Kind.CLOSE, b"", self.silence)
            except SpecimenError:
                return
        self._end("The test closed it.")

    def released(self) -> RemoteSpecimen:
        """Return a client for a new session with the released specimen at the same address; see `Specimen.released`."""
        return RemoteSpecimen(self.address, self._secret, self.silence)
