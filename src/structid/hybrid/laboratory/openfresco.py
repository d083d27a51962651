"""A bridge to laboratories whose site server speaks OpenFresco's generic TCP dialect. No authentication: loopback or tunnel only.

What its public sources (OpenFresco 2.8 and OpenSees' GenericClient) put on the wire, all in the byte order of x86, little-endian:

* the client connects, and sends eleven 32-bit integers: numbers of displacements, velocities, accelerations, forces and times that
  it commands, the same five that it wants to acquire, and D, the length of every later message;
* every message, in both directions, is D 64-bit floating-point numbers. A request begins with its code, then the commanded
  quantities; an answer has the acquired quantities from its first number on. What lies behind them is nobody's;
* code 3 commands (no answer), 6 acquires (answered), 5 commits a step (no answer), 99 ends the session (no answer).

There is no secret, no sequence number, no checksum, no limit and no time-out in it. This client adds what can be added on its side:
limits of stroke and velocity that are checked before a command goes out, a time-out for every answer, and a refusal of addresses
that are not this machine's own. A site server does not notice a connection that is cut: it waits for ever, and holds its last
command.
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
"""Smallest D that every site server accepts."""
COMMAND, COMMIT, ACQUIRE, DIE = 3.0, 5.0, 6.0, 99.0
CONNECTING = 5.0
"""Time limit for a connection [s]."""
SILENCE = 1.0
"""Time beyond its motion within which an answer must come [s]."""
LOOPBACKS = ("127.0.0.1", "::1", "localhost")


@check_arguments
class OpenFrescoSpecimen(Specimen):
    """A specimen behind a site server of OpenFresco's generic dialect.

    The server brings the specimen to a target by itself, so only the end of each path is sent. The session begins with the first
    move, and is the only one.

    Parameters
    ----------
    address : str
        Host and port, of this machine: a server elsewhere is reached through a tunnel (``ssh -L``).
    description : SpecimenDescription
        What it is: the dialect does not say. Its limits are checked here, before a command goes out.
    silence : float
        How much longer than its motion an answer may take [s]. Then the test ends.
    unprotected : bool
        Whether another machine may be addressed, on a network on which everybody is trusted.

    Raises
    ------
    InputError
        If the address is not this machine's, and `unprotected` is not set.

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
                "This dialect has no authentication: whoever reaches the server moves the specimen. Use a tunnel, such as "
                f"ssh -L {self._where[1]}:127.0.0.1:{self._where[1]} {self._where[0]}.",
            )
        self.address, self.silence, self._description = address, silence, description
        count = len(description.channels)
        self._length = max(LEAST_LENGTH, 2 * count + 1)
        self._connection: socket.socket | None = None
        self._last, self._over = np.zeros(count), ""

    def describe(self) -> SpecimenDescription:
        """Say what it is, as it was told; see `Specimen.describe`."""
        return self._description

    def move(self, path: np.ndarray, averaged: int = 1) -> Reading:
        """Command the end of a path, acquire, and commit; see `Specimen.move`."""
        if self._over:
            raise SpecimenError(f"The session is over: {self._over} A test is not resumed.")
        path = np.atleast_2d(np.asarray(path, dtype=np.float64))
        if refusal := self._description.refusal(self._last, path):
            self.hold(refusal)
            raise SpecimenError(f"Refused before it was sent: {refusal}.")
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
            self.hold("its answer is not finite")
            raise SpecimenError("Its answer is not finite.")
        return Reading(acquired[:count], acquired[count : 2 * count])

    def hold(self, reason: str) -> None:
        """Command nothing more; the server holds its last command; see `Specimen.hold`."""
        self._end(f"{reason}.")

    def close(self) -> None:
        """End the session by its code; see `Specimen.close`."""
        self._end("it was closed.")

    # --- the wire -----------------------------------------------------------------------------------------------

    def _opened(self) -> socket.socket:
        """Connect, and declare what will be commanded and acquired."""
        try:
            connection = socket.create_connection(self._where, CONNECTING)
        except OSError as error:
            header = (
                f"No site server answers at {self.address}: {error.strerror or error}. Start it, or check the address."
            )
            raise SpecimenError(header) from None
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        count = len(self._last)
        connection.sendall(SIZES.pack(count, 0, 0, 0, 0, count, 0, 0, count, 0, self._length))
        return connection

    def _send(self, code: float, commanded: np.ndarray | None = None) -> None:
        assert self._connection is not None  # move has opened it
        message = np.zeros(self._length, dtype="<f8")
        message[0] = code
        if commanded is not None:
            message[1 : 1 + len(commanded)] = commanded
        self._connection.settimeout(CONNECTING)
        self._connection.sendall(message.tobytes())

    def _received(self, deadline: float) -> np.ndarray:
        """Wait for an answer."""
        assert self._connection is not None  # move has opened it
        content = b""
        while len(content) < 8 * self._length:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise OSError("it is silent")
            self._connection.settimeout(left)
            try:
                piece = self._connection.recv(8 * self._length - len(content))
            except TimeoutError:
                raise OSError("it is silent") from None
            if not piece:
                raise OSError("it was closed by the server")
            content += piece
        return np.frombuffer(content, dtype="<f8").astype(np.float64)

    def _end(self, reason: str) -> None:
        """End the session by its code, so that the server does not wait forever."""
        self._over = self._over or reason
        if self._connection is not None:
            with contextlib.suppress(OSError):
                self._send(DIE)
            self._connection.close()
            self._connection = None
