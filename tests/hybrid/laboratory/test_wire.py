"""A specimen in its own process or thread: equal to one in this, refusing whatever is not signed, in order and finite."""

import contextlib
import gc
import hmac
import os
import resource
import secrets
import socket
import struct
import threading
import time

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.transfer_system import Actuator, Sensor
from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.remote import RemoteSpecimen
from structid.hybrid.laboratory.server import SpecimenServer, parsed_address
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import SpecimenError
from structid.hybrid.laboratory.wire import (
    HEADER,
    MAGIC,
    VERSION,
    Frame,
    Hello,
    Kind,
    Welcome,
    WireError,
    greeting_key,
    packed,
    packed_move,
    read_json,
    received,
    session_key,
)
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.mechanics.restoring_forces import LinearForce

pytestmark = pytest.mark.quick
SECRET = "a secret of both sides"
GREETING_KEY = greeting_key(SECRET.encode())
RECORD = GroundMotion(pulse(np.arange(0.0, 1.0005, 1e-3)), 1e-3)


def specimen(**settings):
    return SimulatedSpecimen(LinearForce(np.array([[2.0]])), Actuator(stroke=1.0), **settings)


@pytest.fixture
def said():
    return []


@pytest.fixture
def server(said):
    with SpecimenServer(specimen(), SECRET, watchdog=0.3, log=said.append) as running:
        yield running


class Client:
    """A client that may say anything."""

    def __init__(self, server):
        self.socket = socket.create_connection(parsed_address(server.address), 2.0)
        self.sequence = 0

    def greet(self):
        nonce = secrets.token_bytes(16)
        self.socket.sendall(
            packed(Frame(Kind.HELLO, 0, Hello(nonce=nonce.hex()).model_dump_json().encode()), GREETING_KEY)
        )
        welcome = read_json(Welcome, received(self.socket, GREETING_KEY, 2.0).payload)
        self.key = session_key(SECRET.encode(), nonce, bytes.fromhex(welcome.nonce))
        return self

    def ask(self, kind, payload=b""):
        self.sequence += 1
        self.socket.sendall(packed(Frame(kind, self.sequence, payload), self.key))
        return received(self.socket, self.key, 2.0)

    def is_dropped(self):
        """Whether the other side ends the connection, and says nothing more."""
        self.socket.settimeout(2.0)
        try:
            return self.socket.recv(1) == b""
        except ConnectionError:
            return True


# --- the same as one in this process --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "coupling", [PrakashHjelmstad(10), PrakashHjelmstad(100, "physical")], ids=["ramps", "continuous"]
)
def test_remote_equals_local_to_the_last_bit(coupling):
    upper, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    noisy = Actuator(delay=0.004, displacement_sensor=Sensor(5e-6), force_sensor=Sensor(20.0))

    def run(one):
        settings = {"dt": 0.01, "time_scale": 10.0, "coupling": coupling, "physical": lower, "duration": 0.3}
        return HybridTest(upper, one, RECORD, **settings).run()

    local = run(SimulatedSpecimen(lower.force, noisy, seed=3))
    patient = 20.0  # on a busy machine, the first step of either side may take longer than a second
    with SpecimenServer(SimulatedSpecimen(lower.force, noisy, seed=3), SECRET, watchdog=patient) as server:
        remote = run(RemoteSpecimen(server.address, SECRET, silence=patient))
    assert remote.finished
    np.testing.assert_array_equal(remote.coarse.u, local.coarse.u)
    np.testing.assert_array_equal(remote.moves.force, local.moves.force)


def test_a_session_ends_in_order(server):
    remote = RemoteSpecimen(server.address, SECRET)
    assert remote.describe() == server.specimen.describe()
    np.testing.assert_array_equal(remote.move(np.array([[0.25]])).force, [0.5])
    remote.close()
    assert "closed" in server.specimen.held
    with pytest.raises(SpecimenError, match="The session is over"):
        remote.move(np.array([[0.1]]))
    with pytest.raises(SpecimenError, match="holds its position"):
        RemoteSpecimen(server.address, SECRET).move(np.array([[0.1]]))


def test_asking_what_it_is_does_not_hold_it(server):
    for _ in range(3):
        assert RemoteSpecimen(server.address, SECRET).describe().name == "simulated specimen"
    assert not server.specimen.held


# --- what is not obeyed ---------------------------------------------------------------------------------------------


def test_another_secret(server, said):
    with pytest.raises(SpecimenError, match="same secret and version"):
        RemoteSpecimen(server.address, "the secret of somebody else").describe()
    assert any("tag is wrong" in line for line in said)
    assert RemoteSpecimen(server.address, SECRET).describe()


def test_another_version(server, said):
    client = Client(server)
    head = HEADER.pack(MAGIC, VERSION + 1, Kind.HELLO, 0, 0, 0)
    client.socket.sendall(head + hmac.digest(GREETING_KEY, head, "sha256"))
    assert client.is_dropped()
    assert any("uses version 2 of the protocol, this side version 1" in line for line in said)


def test_a_second_test_is_told_that_the_specimen_has_one(server):
    first = RemoteSpecimen(server.address, SECRET)
    first.move(np.array([[0.1]]))
    with pytest.raises(SpecimenError, match="Another test uses this specimen"):
        RemoteSpecimen(server.address, SECRET).move(np.array([[0.5]]))
    np.testing.assert_array_equal(first.move(np.array([[0.2]])).force, [0.4])


MOVE = packed_move(np.array([[0.2]]), 1)
BAD = {
    "forged": lambda c: c.socket.sendall(packed(Frame(Kind.MOVE, 2, MOVE), b"another key")),
    "replayed": lambda c: c.socket.sendall(packed(Frame(Kind.MOVE, 1, MOVE), c.key)),
    "from the future": lambda c: c.socket.sendall(packed(Frame(Kind.MOVE, 3, MOVE), c.key)),
    "not a number": lambda c: c.socket.sendall(
        packed(Frame(Kind.MOVE, 2, packed_move(np.array([[np.nan]]), 1)), c.key)
    ),
    "infinite": lambda c: c.socket.sendall(packed(Frame(Kind.MOVE, 2, packed_move(np.array([[np.inf]]), 1)), c.key)),
    "an answer": lambda c: c.socket.sendall(packed(Frame(Kind.READING, 2, MOVE), c.key)),
    "a greeting": lambda c: c.socket.sendall(packed(Frame(Kind.HELLO, 2, MOVE), c.key)),
    "an unknown kind": lambda c: c.socket.sendall(HEADER.pack(MAGIC, VERSION, 99, 2, 0, 0) + bytes(32)),
    "too few values": lambda c: c.socket.sendall(packed(Frame(Kind.MOVE, 2, MOVE[:-8]), c.key)),
    "no values": lambda c: c.socket.sendall(packed(Frame(Kind.MOVE, 2, struct.pack("<III", 0, 1, 1)), c.key)),
    "too long": lambda c: c.socket.sendall(HEADER.pack(MAGIC, VERSION, Kind.MOVE, 2, 2**31, 0)),
    "noise": lambda c: c.socket.sendall(os.urandom(64)),
    "cut off": lambda c: (
        c.socket.sendall(packed(Frame(Kind.MOVE, 2, MOVE), c.key)[:30]),
        c.socket.shutdown(socket.SHUT_WR),
    ),
    "silence": lambda c: None,
    "a closed connection": lambda c: c.socket.shutdown(socket.SHUT_WR),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_message_ends_the_session_and_the_position_is_held(server, what):
    client = Client(server).greet()
    assert client.ask(Kind.MOVE, packed_move(np.array([[0.5]]), 1)).kind is Kind.READING
    BAD[what](client)
    assert client.is_dropped()
    assert server.specimen.held
    assert server.specimen.position == 0.5
    assert RemoteSpecimen(server.address, SECRET).describe()  # it serves on
    with pytest.raises(SpecimenError, match="holds its position"):
        RemoteSpecimen(server.address, SECRET).move(np.array([[0.4]]))


def test_a_limit_is_refused_in_words(server):
    client = Client(server).greet()
    client.ask(Kind.MOVE, packed_move(np.array([[0.5]]), 1))
    answer = client.ask(Kind.MOVE, packed_move(np.array([[1.5]]), 1))
    assert answer.kind is Kind.REFUSED
    assert b"exceeds its limit of 1" in answer.payload
    assert server.specimen.position == 0.5


def test_a_session_of_before_cannot_be_played_again(server):
    nonce = secrets.token_bytes(16)
    hello = packed(Frame(Kind.HELLO, 0, Hello(nonce=nonce.hex()).model_dump_json().encode()), GREETING_KEY)
    recorded = []
    for take in range(2):
        client = Client(server)
        client.socket.sendall(hello)
        welcome = read_json(Welcome, received(client.socket, GREETING_KEY, 2.0).payload)
        if not take:
            key = session_key(SECRET.encode(), nonce, bytes.fromhex(welcome.nonce))
            recorded = [packed(Frame(Kind.PING, 1), key), packed(Frame(Kind.CLOSE, 2), key)]
            for message in recorded:
                client.socket.sendall(message)
                assert received(client.socket, key, 2.0).kind in (Kind.PONG, Kind.CLOSED)
            client.socket.close()
            time.sleep(0.05)
        else:
            client.socket.sendall(recorded[0])
            assert client.is_dropped()


def test_a_thousand_random_and_mutated_frames(server):
    """Strangers' noise, and a true greeting with a byte changed: nothing moves, memory stays, the server serves on."""
    rng = np.random.default_rng(5)
    whole = packed(Frame(Kind.HELLO, 0, Hello(nonce=bytes(16).hex()).model_dump_json().encode()), GREETING_KEY)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for trial in range(1000):
        if trial % 2:
            message = rng.bytes(int(rng.integers(1, 400)))
        else:
            changed = bytearray(whole)
            changed[int(rng.integers(len(whole)))] ^= int(rng.integers(1, 256))
            message = bytes(changed)
        with socket.create_connection(parsed_address(server.address), 2.0) as stranger, contextlib.suppress(OSError):
            stranger.sendall(message)
            stranger.shutdown(socket.SHUT_WR)
            assert stranger.recv(1) == b""
    gc.collect()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kilobytes
    assert not server.specimen.held
    np.testing.assert_array_equal(RemoteSpecimen(server.address, SECRET).move(np.array([[0.5]])).force, [1.0])


@pytest.mark.slow
@pytest.mark.parametrize("moved", [False, True], ids=["before it has moved", "after it has moved"])
def test_a_session_s_own_messages_with_a_byte_changed(moved):
    """Whatever byte of a signed move it is: the session ends, and the specimen holds its last accepted position if it has moved."""
    rng = np.random.default_rng(6)
    whole = HEADER.size + len(packed_move(np.array([[0.7]]), 1)) + 32
    places = [*range(0, whole, 7), *map(int, rng.integers(whole, size=30))]
    for place in places:
        with SpecimenServer(specimen(), SECRET, watchdog=0.3) as server:
            client = Client(server).greet()
            if moved:
                client.ask(Kind.MOVE, packed_move(np.array([[0.25]]), 1))
            message = bytearray(
                packed(Frame(Kind.MOVE, client.sequence + 1, packed_move(np.array([[0.7]]), 1)), client.key)
            )
            message[place] ^= int(rng.integers(1, 256))
            client.socket.sendall(message)
            assert client.is_dropped()
        assert server.specimen.position == (0.25 if moved else 0.0)
        assert bool(server.specimen.held) == moved


def test_what_a_process_holds_already_is_no_pause_in_a_session():
    """A full collection of garbage looks at what was made since; to look at everything takes longer than a client waits."""
    held = len(gc.get_objects(generation=2))
    with SpecimenServer(specimen(), SECRET) as server:
        RemoteSpecimen(server.address, SECRET).close()
        assert len(gc.get_objects(generation=2)) < 0.1 * held
    assert gc.get_freeze_count() == 0 and len(gc.get_objects(generation=2)) > 0.5 * held


def test_a_crowd_of_strangers_takes_no_memory(server):
    """Hundreds of connections that announce megabytes: those beyond a number are closed, nothing is reserved for the rest."""
    head = HEADER.pack(MAGIC, VERSION, Kind.HELLO, 0, 4 * 2**20, 0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    crowd = [socket.create_connection(parsed_address(server.address), 2.0) for _ in range(200)]
    for stranger in crowd:
        with contextlib.suppress(OSError):
            stranger.sendall(head + bytes(1000))
    threads = threading.active_count()
    for stranger in crowd:
        stranger.close()
    assert threads < 50
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kilobytes
    np.testing.assert_array_equal(RemoteSpecimen(server.address, SECRET).move(np.array([[0.5]])).force, [1.0])


# --- what a client does not take ------------------------------------------------------------------------------------


class Rogue:
    """A server that answers as it is told."""

    def __init__(self, answer):
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.answer = answer

    @property
    def address(self):
        return f"127.0.0.1:{self.listening.getsockname()[1]}"

    def serve(self):
        while True:
            try:
                connection, _ = self.listening.accept()
            except OSError:
                return
            with connection:
                hello = read_json(Hello, received(connection, GREETING_KEY, 2.0).payload)
                nonce = bytes(16)
                welcome = Welcome(
                    client_nonce=hello.nonce, nonce=nonce.hex(), watchdog=1.0, description=specimen().describe()
                )
                connection.sendall(packed(Frame(Kind.WELCOME, 0, welcome.model_dump_json().encode()), GREETING_KEY))
                key = session_key(SECRET.encode(), bytes.fromhex(hello.nonce), nonce)
                frame = received(connection, key, 2.0)
                if frame is not None and frame.kind is Kind.CLOSE:
                    connection.sendall(packed(Frame(Kind.CLOSED, frame.sequence), key))
                elif frame is not None:
                    self.answer(connection, key, frame)


READING, NO_NUMBER = np.array([0.1, 0.2]).tobytes(), np.array([0.0, np.nan]).tobytes()
ANSWERS = {
    "silence": (lambda c, key, f: time.sleep(0.4), "silent"),
    "a wrong tag": (lambda c, key, f: c.sendall(packed(Frame(Kind.READING, 1, READING), b"wrong")), "tag is wrong"),
    "an old number": (
        lambda c, key, f: c.sendall(packed(Frame(Kind.READING, 0, READING), key)),
        "answer to MOVE 1 was READING 0",
    ),
    "another kind": (lambda c, key, f: c.sendall(packed(Frame(Kind.PONG, 1), key)), "was PONG"),
    "not a number": (lambda c, key, f: c.sendall(packed(Frame(Kind.READING, 1, NO_NUMBER), key)), "not finite"),
    "too long": (lambda c, key, f: c.sendall(packed(Frame(Kind.READING, 1, READING + READING), key)), "32 bytes"),
    "a closed door": (lambda c, key, f: None, "closed the connection"),
    "garbage": (lambda c, key, f: c.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n"), "does not use this protocol"),
}


@pytest.mark.parametrize("what", ANSWERS)
def test_a_client_takes_nothing_else_for_an_answer(what):
    answer, message = ANSWERS[what]
    rogue = Rogue(answer)
    threading.Thread(target=rogue.serve, daemon=True).start()
    remote = RemoteSpecimen(rogue.address, SECRET)
    began = time.perf_counter()
    remote.describe()
    with pytest.raises(WireError, match=message):
        remote.move(np.array([[0.1]]))
    with pytest.raises(SpecimenError, match="The session is over"):
        remote.move(np.array([[0.1]]))
    assert time.perf_counter() - began < 10.0
    rogue.listening.close()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RemoteSpecimen("127.0.0.1", SECRET), "a host and a port"),
        (lambda: RemoteSpecimen("127.0.0.1:77000", SECRET), "a host and a port"),
        (lambda: RemoteSpecimen("127.0.0.1:7700", "short"), "16 or more"),
    ],
)
def test_addresses_and_secrets_that_are_none(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_nobody_there():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(SpecimenError, match="No specimen answers"):
        RemoteSpecimen(f"127.0.0.1:{port}", SECRET).describe()


def test_a_port_that_is_taken(server):
    with pytest.raises(InputError, match="a free port"):
        SpecimenServer(specimen(), SECRET, port=parsed_address(server.address)[1])
