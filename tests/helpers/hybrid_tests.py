"""A hybrid test in processes that tests kill, stop and starve: a server, and a client that counts its finished steps."""

import mmap
import multiprocessing
import os
import resource
import struct
import time
from pathlib import Path

import numpy as np

from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.transfer_system import Actuator, Sensor
from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.remote import RemoteSpecimen
from structid.hybrid.laboratory.server import SpecimenServer
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.substructures.frame_parts import cut_frame

SECRET = "a secret of both sides"
DT, SCALE, SUBSTEPS = 0.01, 1.0, 10
PATIENCE = 0.4
"""Of a client [s]: a machine that does other work answers late, and that is not the fault that is tried."""


def storey(seed=1):
    """A specimen with noise, which a second one has alike."""
    _, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    return SimulatedSpecimen(
        lower.force, Actuator(displacement_sensor=Sensor(5e-6), force_sensor=Sensor(20.0)), seed=seed
    )


def test_on(specimen, duration=1.0):
    """The test that every process runs."""
    upper, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    record = GroundMotion(pulse(np.arange(0.0, duration + 0.0005, 1e-3)), 1e-3, name="pulse")
    coupling = PrakashHjelmstad(SUBSTEPS, "physical")
    return HybridTest(upper, specimen, record, dt=DT, time_scale=SCALE, coupling=coupling, physical=lower)


def serve(port_file):
    """Serve a storey until killed."""
    server = SpecimenServer(storey(), SECRET)
    Path(port_file).write_text(server.address)
    server.serve()


def run(address, store, counter, limit):
    """Run the test, and count in a mapped file how many rows have been recorded; after `limit` rows, if any, no file may grow."""
    from structid.hybrid.recording import recorder

    recorder.TAIL_ROOM, recorder.ROWS_IN_TAIL = 2**18, 16
    with Path(counter).open("r+b") as file:
        counted = mmap.mmap(file.fileno(), 8)
    add = recorder.Recorder.add

    def counting(self, row):
        add(self, row)
        rows = struct.unpack("<q", counted[:8])[0] + 1
        counted[:8] = struct.pack("<q", rows)
        if rows == int(limit):
            size = recorder.journal_of(Path(store)).stat().st_size
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        elif rows > int(limit) > 0:  # the recorder asks the disk now, and not a block later
            self._due.set()
            while not self.failed:
                time.sleep(0.001)

    recorder.Recorder.add = counting
    specimen = RemoteSpecimen(address, SECRET, PATIENCE) if address != "local" else storey()
    result = test_on(specimen).run(store)
    print(result, flush=True)


def _work(function, arguments, said):
    """What a child does; what it says goes into files."""
    for stream, kind in ((1, "out"), (2, "err")):
        os.dup2(os.open(f"{said}.{kind}", os.O_WRONLY | os.O_CREAT), stream)
    function(*arguments)


class Processes:
    """Server and client, each a process. They come from one that has imported the package, which takes seconds.

    It does not import this module, which it could not find: Python 3.11's server of forks does not look where its parent does.
    """

    children = multiprocessing.get_context("forkserver")
    children.set_forkserver_preload(
        [
            "structid.hybrid.coupling.coupling_benchmark",
            "structid.hybrid.experiment",
            "structid.hybrid.laboratory.server",
        ]
    )

    def __init__(self, folder, limit=0, remote=True):
        self.folder, self.store = folder, folder / "test.h5"
        self.said = folder.parent / f"said by {folder.name}"
        self.server, address = None, "local"
        if remote:
            port = folder / "port"
            self.server = self._started(serve, port)
            while not port.exists() or not port.read_text():
                time.sleep(0.01)
            address = port.read_text()
        self.counter = folder / "counter"
        self.counter.write_bytes(bytes(8))
        self.client = self._started(run, address, self.store, self.counter, limit)

    def _started(self, function, *arguments):
        child = self.children.Process(target=_work, args=(function, arguments, f"{self.said} {function.__name__}"))
        child.start()
        return child

    @property
    def recorded(self):
        """Rows that the client has been told are safe."""
        return struct.unpack("<q", self.counter.read_bytes())[0]

    def wait_for(self, rows, patience=60.0):
        """Wait until so many rows have been recorded."""
        until = time.monotonic() + patience
        while self.recorded < rows:
            if not self.client.is_alive():
                raise AssertionError(self.ended()[1])
            if time.monotonic() > until:
                raise AssertionError(f"{self.recorded} rows after {patience} s")
            time.sleep(0.001)

    def ended(self, patience=30.0):
        """Wait for the client; what it said, as results and as errors."""
        self.client.join(patience)
        assert not self.client.is_alive(), f"not ended after {patience} s"
        return tuple(Path(f"{self.said} run.{kind}").read_text() for kind in ("out", "err"))

    def stop(self):
        """Kill what is left."""
        for process in (self.client, self.server):
            if process is not None:
                process.kill()
                process.join()
