"""The wire format between a hybrid test and a specimen: frames, their authentication and their contents.

A frame is a header of 24 bytes, a payload, and a tag of 32 bytes, all little-endian::

    offset  size  content
         0     4  magic "SIDH"
         4     2  version of the protocol, 1
         6     2  kind
         8     8  sequence number
        16     4  length n of the payload
        20     4  zero
        24     n  payload
    24 + n    32  HMAC-SHA256 of all bytes before it

For HELLO and its answer, the key of the tag depends only on the shared secret. In the following session, it depends on
the secret and the nonces of both sides. The requests of a session have the numbers 1, 2, 3, …; each has one answer with
its number. All other messages end the session. `docs/reference/specimen_protocol.md` describes the whole protocol.
"""

from __future__ import annotations

import hmac
import json
import socket
import struct
import time
from enum import IntEnum
from typing import Annotated, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from structid.core.errors import InputError
from structid.hybrid.laboratory.specimen import Reading, SpecimenDescription, SpecimenError

MAGIC, VERSION = b"SIDH", 1
HEADER = struct.Struct("<4sHHQII")
MOVE_HEAD = struct.Struct("<III")
TAG, NONCE = 32, 16
LARGEST_PAYLOAD, LARGEST_GREETING = 4 * 2**20, 4096
"""Largest payload of a frame in a session, and of a HELLO [byte]; a longer frame is refused before it is read."""
SHORTEST_SECRET = 16
"""Minimum length of a secret [byte]."""


class Kind(IntEnum):
    """Kind of a frame; requests are odd, answers even."""

    HELLO = 1
    WELCOME = 2
    MOVE = 3
    READING = 4
    HOLD = 5
    HELD = 6
    CLOSE = 7
    CLOSED = 8
    PING = 9
    PONG = 10
    REFUSED = 12


Message = TypeVar("Message", bound=BaseModel)


class WireError(SpecimenError):
    """A message is invalid or does not arrive in time; the session is over."""


class Frame(NamedTuple):
    """A message."""

    kind: Kind  # kind of the frame
    sequence: int  # sequence number
    payload: bytes = b""  # content of the frame


# --- keys -----------------------------------------------------------------------------------------------------------


def checked_secret(secret: str | bytes) -> bytes:
    """Convert a shared secret to bytes, and check its length."""
    given = secret.encode() if isinstance(secret, str) else bytes(secret)
    if len(given) < SHORTEST_SECRET:
        raise InputError(
            "secret",
            f"{len(given)} bytes",
            f"{SHORTEST_SECRET} or more bytes (letters and digits are one byte each)",
            'Generate a secret with: python -c "import secrets; print(secrets.token_hex(32))"',
        )
    return given


def greeting_key(secret: bytes) -> bytes:
    """Return the key of HELLO and WELCOME."""
    return hmac.digest(secret, b"structid specimen greeting", "sha256")


def session_key(secret: bytes, client: bytes, server: bytes) -> bytes:
    """Return the key of a session; a new nonce of the server in every session prevents replays."""
    return hmac.digest(secret, b"structid specimen session" + client + server, "sha256")


# --- frames ---------------------------------------------------------------------------------------------------------


def packed(frame: Frame, key: bytes) -> bytes:
    """Serialise a frame."""
    body = HEADER.pack(MAGIC, VERSION, frame.kind, frame.sequence, len(frame.payload), 0) + frame.payload
    return body + hmac.digest(key, body, "sha256")


def received(connection: socket.socket, key: bytes, patience: float, largest: int = LARGEST_PAYLOAD) -> Frame | None:
    """Wait for a frame, and check everything that does not depend on the session."""
    until = time.monotonic() + patience
    head = _exactly(connection, HEADER.size, until, may_end=True)
    if head is None:
        return None
    magic, version, kind, sequence, length, zero = HEADER.unpack(head)
    if magic != MAGIC:
        raise WireError(
            f"The other side does not use this protocol: its first bytes are {magic!r} instead of {MAGIC!r}."
        )
    if version != VERSION:
        raise WireError(
            f"The other side uses version {version} of the protocol, this side version {VERSION}. Update the older side."
        )
    if zero or kind not in Kind.__members__.values() or length > largest:
        raise WireError(f"The header of a message is malformed: kind {kind}, {length} bytes.")
    rest = _exactly(connection, length + TAG, until)
    assert rest is not None  # _exactly raises an error if the connection ends here
    if not hmac.compare_digest(hmac.digest(key, head + rest[:length], "sha256"), rest[length:]):
        raise WireError(
            "The tag is wrong: the message is forged, or it uses another secret. Use the same secret on both sides."
        )
    return Frame(Kind(kind), sequence, rest[:length])


def _exactly(connection: socket.socket, count: int, until: float, may_end: bool = False) -> bytes | None:
    """Read a number of bytes; memory grows only with the bytes received."""
    got = bytearray()
    while len(got) < count:
        left = until - time.monotonic()
        if left <= 0.0:
            raise WireError(_silence(len(got)))
        connection.settimeout(left)
        try:
            part = connection.recv(min(count - len(got), 65536))
        except TimeoutError:
            raise WireError(_silence(len(got))) from None
        except OSError as error:
            raise WireError(f"The connection failed: {error.strerror or error}.") from None
        if not part:
            if may_end and not got:
                return None
            raise WireError("The connection was closed in the middle of a message.")
        got += part
    return bytes(got)


def _silence(received: int) -> str:
    return "The other side is silent." if not received else "The other side stopped sending in the middle of a message."


def send(connection: socket.socket, frame: Frame, key: bytes, patience: float) -> None:
    """Send a frame."""
    connection.settimeout(patience)
    try:
        connection.sendall(packed(frame, key))
    except OSError as error:
        raise WireError(f"The connection failed: {error.strerror or error}.") from None


# --- payloads -------------------------------------------------------------------------------------------------------


class Hello(BaseModel):
    """First message of a client."""

    model_config = ConfigDict(extra="forbid")

    nonce: Annotated[str, Field(pattern=f"^[0-9a-f]{{{2 * NONCE}}}$")]  # nonce of the client, 16 bytes in hexadecimal
    software: Annotated[str, Field(max_length=200)] = ""  # software of the client


class Welcome(BaseModel):
    """Answer of a server."""

    model_config = ConfigDict(extra="forbid")

    client_nonce: str  # the client's nonce, so that an old answer is invalid
    nonce: Annotated[str, Field(pattern=f"^[0-9a-f]{{{2 * NONCE}}}$")]  # nonce of the server
    # Silence after which the server ends a session and the specimen holds its position [s]
    watchdog: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    description: SpecimenDescription  # description of its specimen


def read_json(what: type[Message], payload: bytes) -> Message:
    """Read a control message."""
    try:
        return what.model_validate(json.loads(payload))
    except (ValidationError, ValueError) as error:
        raise WireError(f"A {what.__name__} message is invalid: {str(error).splitlines()[0]}.") from None


def packed_move(path: Float[np.ndarray, "sample channel"], averaged: int) -> bytes:
    """Serialise a path: 32-bit counts of samples, channels and averaged samples, then float64 values by sample."""
    return MOVE_HEAD.pack(*path.shape, averaged) + np.ascontiguousarray(path, dtype="<f8").tobytes()


def read_move(payload: bytes) -> tuple[np.ndarray, int]:
    """Read a path."""
    if len(payload) < MOVE_HEAD.size:
        raise WireError("A MOVE is too short.")
    samples, channels, averaged = MOVE_HEAD.unpack_from(payload)
    if (
        samples * channels * 8 != len(payload) - MOVE_HEAD.size
        or not samples
        or not channels
        or not 1 <= averaged <= samples
    ):
        raise WireError(
            f"A MOVE is malformed: {samples} samples of {channels} channels, {averaged} averaged, {len(payload)} bytes."
        )
    path = np.frombuffer(payload, dtype="<f8", offset=MOVE_HEAD.size).reshape(samples, channels)
    if not np.isfinite(path).all():
        raise WireError("A MOVE contains a number that is not finite.")
    return path, averaged


def packed_reading(reading: Reading) -> bytes:
    """Serialise a reading: displacements, then forces, as float64 values."""
    return np.concatenate(reading).astype("<f8").tobytes()


def read_reading(payload: bytes, channels: int) -> Reading:
    """Read a reading."""
    if len(payload) != 16 * channels:
        raise WireError(f"A READING has {len(payload)} bytes instead of {16 * channels} for {channels} channels.")
    values = np.frombuffer(payload, dtype="<f8")
    if not np.isfinite(values).all():
        raise WireError("A READING contains a number that is not finite.")
    return Reading(values[:channels], values[channels:])
