"""Client for site servers with OpenFresco's generic TCP protocol. It has no authentication: use the loopback or a tunnel only.

Public source code (OpenFresco 2.8 and GenericClient of OpenSees) defines these messages, all little-endian:

* The client connects and sends eleven 32-bit integers. Five give the numbers of commanded displacements, velocities, accelerations,
  forces and times, and five the numbers of acquired quantities. The last integer, D, is the length of every later message.
* Every later message, in both directions, has D 64-bit floating-point numbers. A request contains its code and the
  commanded quantities; an answer begins with the acquired quantities. All other numbers in a message have no meaning.
* Code 3 sends commands, 5 commits a step, and 99 ends the session, all without an answer. Code 6 requests the acquired
  quantities, and the server answers.

The protocol has no secret, sequence number, checksum, limit or time-out. This client checks limits of stroke and
velocity before it sends a command, has a time-out for every answer, and by default refuses addresses of other machines.
A site server does not detect a broken connection: it waits forever and holds its last command.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time

import numpy as np

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.hybrid.laboratory.server import parsed_address
from structid.hybrid.laboratory.specimen import Reading, Specimen, SpecimenDescription, SpecimenError

SIZES = struct.Struct("<11i")
LEAST_LENGTH = 256
"""Smallest message length D that every site server accepts."""
COMMAND, COMMIT, ACQUIRE, DIE = 3.0, 5.0, 6.0, 99.0
CONNECTING = 5.0
"""Time limit for a connection [s]."""
SILENCE = 1.0
"""Longest allowed time from the end of a move to its answer [s]."""
LOOPBACKS = ("127.0.0.1", "::1", "localhost")


@check_arguments
class OpenFrescoSpecimen(Specimen):
    """A specimen behind a site server with OpenFresco's generic TCP protocol.

    The server itself moves the specimen to a target, so only the end of each path is sent. The session begins with the first
    move and cannot be repeated.

    Parameters
    ----------
    address : str
        Host and port on this machine; use a tunnel (``ssh -L``) to a server on another machine.
    description : SpecimenDescription
        Description of the specimen, which the protocol does not send. Its limits are checked before a command is sent.
    silence : float
        Longest allowed time from the end of a move to its answer [s]; if the answer comes later, the test ends.
    unprotected : bool
        Whether another machine is allowed; for networks with trusted users only.

    Raises
    ------
    InputError
        If the address is on another machine and `unprotected` is not set.

    Examples
    --------
    >>> import structid as si
    >>> specimen = si.OpenFrescoSpecimen("tcp://127.0.0.1:8090", description)  # doctest: +SKIP
    """

    def __init__(
        self, address: str, description: SpecimenDescription, silence: float = SILENCE, unprotected: bool = False
    ) -> None:
        self._where = parsed_address(address)
        if self._where[0] not in LOOPBACKS and not unprotected:
            raise InputError(
                "OpenFrescoSpecimen.address",
                f"'{address}'",
                "an address of this machine, such as 127.0.0.1:8090",
                "This protocol has no authentication: anyone who reaches the server can move the specimen. Use a tunnel, such as "
                f"ssh -L {self._where[1]}:127.0.0.1:{self._where[1]} {self._where[0]}.",
            )
        self.address, self.silence, self._description = address, silence, description
        count = len(description.channels)
        self._length = max(LEAST_LENGTH, 2 * count + 1)
        self._connection: socket.socket | None = None
        self._last, self._over = np.zeros(count), ""

    def describe(self) -> SpecimenDescription:
        """Return the description given by the user; see `Specimen.describe`."""
        return self._description

    def move(self, path: np.ndarray, averaged: int = 1) -> Reading:
        """Command the end of a path, acquire the response, and commit the state; see `Specimen.move`."""
        if self._over:
            raise SpecimenError(f"The session is over: {self._over} A test is never resumed.")
        path = np.atleast_2d(np.asarray(path, dtype=np.float64))
        if refusal := self._description.refusal(self._last, path):
            self.hold(refusal)
            raise SpecimenError(f"The move was refused before it was sent: {refusal}.")
        began = time.monotonic()
        patience = len(path) * self._description.controller_step + self.silence
        try:
            if self._connection is None:
                self._connection = self._opened()
            self._send(COMMAND, path[-1])
            self._send(ACQUIRE)
            acquired = self._received(began + patience)
            self._send(COMMIT)
        except OSError as error:
            self._end(f"the connection to {self.address} failed: {error.strerror or error}.")
            raise SpecimenError(f"The session is over: {self._over}") from None
        self._last, count = path[-1], len(self._last)
        if not np.isfinite(acquired[: 2 * count]).all():
            self.hold("the answer of the server is not finite")
            raise SpecimenError("The answer of the server is not finite.")
        return Reading(acquired[:count], acquired[count : 2 * count])

    def hold(self, reason: str) -> None:
        """Send no further command; the server holds its last command; see `Specimen.hold`."""
        self._end(f"{reason}.")

    def close(self) -> None:
        """End the session with code 99; see `Specimen.close`."""
        self._end("the test closed it.")

    # --- messages -----------------------------------------------------------------------------------------------

    def _opened(self) -> socket.socket:
        """Connect, and declare the commanded and the acquired quantities."""
        try:
            connection = socket.create_connection(self._where, CONNECTING)
        except OSError as error:
            header = (
                f"No site server answers at {self.address}: {error.strerror or error}. Start the server, "
                "or check the address."
            )
            raise SpecimenError(header) from None
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        count = len(self._last)
        connection.sendall(SIZES.pack(count, 0, 0, 0, 0, count, 0, 0, count, 0, self._length))
        return connection

    def _send(self, code: float, commanded: np.ndarray | None = None) -> None:
        assert self._connection is not None  # opened by move
        message = np.zeros(self._length, dtype="<f8")
        message[0] = code
        if commanded is not None:
            message[1 : 1 + len(commanded)] = commanded
        self._connection.settimeout(CONNECTING)
        self._connection.sendall(message.tobytes())

    def _received(self, deadline: float) -> np.ndarray:
        """Wait for an answer."""
        assert self._connection is not None  # opened by move
        content = b""
        while len(content) < 8 * self._length:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise OSError("the server is silent")
            self._connection.settimeout(left)
            try:
                piece = self._connection.recv(8 * self._length - len(content))
            except TimeoutError:
                raise OSError("the server is silent") from None
            if not piece:
                raise OSError("the server closed the connection")
            content += piece
        return np.frombuffer(content, dtype="<f8").astype(np.float64)

    def _end(self, reason: str) -> None:
        """End the session with code 99, so that the server does not wait forever."""
        self._over = self._over or reason
        if self._connection is not None:
            with contextlib.suppress(OSError):
                self._send(DIE)
            self._connection.close()
            self._connection = None
