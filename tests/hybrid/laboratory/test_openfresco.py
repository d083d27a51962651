"""The bridge to OpenFresco's generic dialect, against a site server written from the byte layout of its public sources."""

import socket
import struct
import threading
import time

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.ground_motion.record import GroundMotion
from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.openfresco import OpenFrescoSpecimen
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import SpecimenChannel, SpecimenDescription, SpecimenError
from structid.hybrid.programme import Programme
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.mechanics.restoring_forces import LinearForce

pytestmark = pytest.mark.quick
UPPER, LOWER = cut_frame(two_floor_frame(hysteretic=True), 1)


class SiteServer:
    """One session: 11 integers of 4 bytes; then messages of D doubles, which it obeys as a site server does."""

    def __init__(self, structure, wrong=None):
        self.structure, self.memory, self.wrong = structure, structure.at_rest(np.zeros(structure.dofs)), wrong
        self.place = np.zeros(structure.dofs)
        self.codes, self.sizes, self.ended, self.answered = [], (), False, 0
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self.listening.getsockname()[1]}"
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def exactly(self, connection, count):
        content = b""
        while len(content) < count:
            piece = connection.recv(count - len(content))
            if not piece:
                raise EOFError
            content += piece
        return content

    def serve(self):
        connection, _ = self.listening.accept()
        self.listening.close()
        with connection:
            try:
                self.sizes = struct.unpack("<11i", self.exactly(connection, 44))
                self.obey(connection, self.sizes[10])
            except (EOFError, OSError):
                return

    def obey(self, connection, length):
        count = self.sizes[0]
        while True:
            message = struct.unpack(f"<{length}d", self.exactly(connection, 8 * length))
            code = int(message[0])
            self.codes.append(code)
            if code == 3:
                self.place = np.array(message[1 : 1 + count])
                self.force, self.memory = self.structure.at(self.memory, self.place)
            elif code == 6:
                self.answered += 1
                if self.wrong is not None and self.answered > 5:
                    if self.wrong == "silence":
                        time.sleep(3.0)
                        return
                    if self.wrong == "closed":
                        return
                answer = np.full(length, np.nan)  # what lies behind the acquired quantities is nobody's
                answer[: 2 * count] = [*self.place, *self.force]
                if self.wrong == "nan" and self.answered > 5:
                    answer[count] = np.nan
                connection.sendall(answer.astype("<f8").tobytes())
            elif code == 99:
                self.ended = True
                return


def description(**limits):
    return SpecimenDescription(name="storey", channels=(SpecimenChannel(name="drift", **limits),))


def hybrid_test(specimen, duration=0.6):
    record = GroundMotion(pulse(np.arange(0.0, duration + 0.0005, 1e-3)), 1e-3, name="pulse")
    return HybridTest(UPPER, specimen, record, dt=0.01, time_scale=1.0, physical=LOWER)


def test_a_test_over_the_bridge_is_a_local_one():
    server = SiteServer(LOWER.force)
    bridge = OpenFrescoSpecimen(server.address, description(stroke=0.2))
    result = hybrid_test(bridge).run()
    bridge.close()
    server.thread.join(5.0)
    local = hybrid_test(SimulatedSpecimen(LOWER.force)).run()
    assert result.finished and server.ended
    # A site server goes to the target in one move, a simulated specimen along its path.
    np.testing.assert_allclose(result.coarse.u, local.coarse.u, atol=1e-5 * np.abs(local.coarse.u).max())


def test_what_goes_over_the_wire():
    server = SiteServer(LOWER.force)
    bridge = OpenFrescoSpecimen(server.address, description())
    bridge.move(np.array([[0.001], [0.002]]))
    bridge.move(np.array([[0.003]]))
    bridge.close()
    server.thread.join(5.0)
    assert server.sizes == (1, 0, 0, 0, 0, 1, 0, 0, 1, 0, 256)
    assert server.codes == [3, 6, 5, 3, 6, 5, 99]
    assert server.place == 0.003


@pytest.mark.parametrize(
    ("wrong", "said"), [("silence", "silent"), ("closed", "server closed the connection"), ("nan", "not finite")]
)
def test_what_goes_wrong_ends_the_test_and_keeps_its_steps(wrong, said):
    server = SiteServer(LOWER.force, wrong)
    bridge = OpenFrescoSpecimen(server.address, description(), silence=0.3)
    began = time.monotonic()
    result = hybrid_test(bridge).run()
    assert time.monotonic() - began < 20.0
    assert not result.finished and 1 <= result.steps <= 5
    assert said in result.events[-1].what
    with pytest.raises(SpecimenError, match="A test is never resumed"):
        bridge.move(np.zeros((1, 1)))
    if wrong == "nan":
        server.thread.join(5.0)
        assert server.ended  # it was told, and does not wait for ever


def test_a_programme_ends_in_order_after_its_first_test():
    """The dialect cannot say that a specimen was unloaded: its operator must, and a second programme goes on."""
    server = SiteServer(LOWER.force)
    bridge = OpenFrescoSpecimen(server.address, description())
    found = Programme({name: hybrid_test(bridge, 0.2) for name in ("1", "2")}).run()
    assert list(found.tests) == ["1"] and found.tests["1"].finished and not found.finished
    assert "after test 1" in str(found) and "by its operator" in found.ended_by


def test_limits_are_held_on_this_side():
    server = SiteServer(LOWER.force)
    bridge = OpenFrescoSpecimen(server.address, description(stroke=0.01))
    bridge.move(np.array([[0.005]]))
    with pytest.raises(SpecimenError, match=r"exceeds its limit of 0\.01"):
        bridge.move(np.array([[0.02]]))
    server.thread.join(5.0)
    assert server.place == 0.005 and server.ended


def test_addresses():
    with pytest.raises(InputError, match="no authentication"):
        OpenFrescoSpecimen("laboratory.example:8090", description())
    OpenFrescoSpecimen("laboratory.example:8090", description(), unprotected=True)
    with pytest.raises(SpecimenError, match="No site server answers"):
        OpenFrescoSpecimen("127.0.0.1:1", description()).move(np.zeros((1, 1)))


def test_many_channels_make_longer_messages():
    count = 60
    server = SiteServer(LinearForce(np.diag(np.arange(1.0, count + 1))))
    told = SpecimenDescription(name="many", channels=tuple(SpecimenChannel(name=f"c{k}") for k in range(count)))
    bridge = OpenFrescoSpecimen(server.address, told)
    place = np.linspace(0.0, 1.0, count)
    reading = bridge.move(place[None])
    np.testing.assert_array_equal(reading.displacement, place)
    np.testing.assert_allclose(reading.force, np.arange(1.0, count + 1) * place)
    bridge.close()
