"""The live view: what it reads beside a running test, that it asks nothing of it, and its page in a browser."""

import json
import shutil
import subprocess
import threading
import urllib.request
from http.client import HTTPConnection

import numpy as np
import pytest

from servers import answer, free_port
from structid.ground_motion.record import GroundMotion
from structid.hybrid.coupling.coupling_benchmark import two_floor_frame
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.programme import store_of
from structid.hybrid.recording.live_points import AT_ONCE, LivePoints
from structid.hybrid.recording.recorder import Following, journal_of
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.report.live import LiveFolder, live

pytestmark = pytest.mark.quick
UPPER, LOWER = cut_frame(two_floor_frame(hysteretic=True), 1)


class Waiting(SimulatedSpecimen):
    """A specimen that stops at a move until it may go on."""

    def __init__(self, *arguments, at, **settings):
        super().__init__(*arguments, **settings)
        self.at, self.moves, self.there, self.go_on = at, 0, threading.Event(), threading.Event()

    def move(self, path, averaged=1):
        self.moves += 1
        if self.moves == self.at:
            self.there.set()
            assert self.go_on.wait(120.0)
        return super().move(path, averaged)


class Running:
    """A test that is held in its middle."""

    def __init__(self, folder, name="1", at=60, duration=1.0):
        self.specimen = Waiting(LOWER.force, at=at, stiffness=LOWER.stiffness)
        record = GroundMotion.synthetic(seed=1).trim(2.0, 2.0 + duration).scale_to_pga(3.0)
        self.test = HybridTest(UPPER, self.specimen, record, dt=0.01, time_scale=50.0, physical=LOWER)
        folder.mkdir(exist_ok=True)
        self.store = store_of(folder, name)
        self.thread = threading.Thread(target=self._run)

    def _run(self):
        self.result = self.test.run(self.store)

    def __enter__(self):
        self.thread.start()
        assert self.specimen.there.wait(60.0)
        return self

    def __exit__(self, *_):
        self.specimen.go_on.set()
        self.thread.join(60.0)


def test_it_sees_every_finished_step_and_no_other(tmp_path):
    with Running(tmp_path / "out") as running:
        following = Following(running.store)
        first = following.new_rows()
        assert len(first) == 58 == following.count  # a move to average the force at rest, one at rest, and 57 steps
        assert len(following.new_rows()) == 0
        running.specimen.at = 80
        running.specimen.there.clear()
        running.specimen.go_on.set()
    assert running.result.finished
    assert not journal_of(running.store).exists() and len(following.new_rows()) == 0


def test_points_are_those_of_the_result(tmp_path):
    with Running(tmp_path / "out") as running:
        points = LivePoints(running.store)
        assert points.since(0, 0) == {}
        points.read()
        seen, later = points.since(0, 0), points.since(50, 50)
    result = running.result
    assert (seen["steps"], seen["moves"], seen["planned"]) == (58, 58, 100)
    (channel,) = seen["channels"]
    np.testing.assert_array_equal(channel["measured"], result.moves.measured[:58, 0])
    np.testing.assert_array_equal(channel["force"], result.moves.force[:58, 0])
    np.testing.assert_array_equal(seen["floors"], result.coarse.u[:58].T)
    np.testing.assert_array_equal(later["channels"][0]["force"], result.moves.force[50:58, 0])
    np.testing.assert_allclose(later["time"], np.arange(50, 58) * 0.01)
    json.dumps(seen, allow_nan=False)


def test_long_histories_are_thinned_out(tmp_path):
    with Running(tmp_path / "out", at=1100, duration=12.0) as running:
        points = LivePoints(running.store)
        points.read()
        seen = points.since(0, 0)
    assert seen["steps"] > 1000
    assert len(seen["time"]) <= AT_ONCE and len(seen["channels"][0]["force"]) <= AT_ONCE


def test_the_folder_says_what_has_ended_and_what_runs(tmp_path):
    out = tmp_path / "out"
    folder = LiveFolder(out)
    assert folder.state("", 0, 0) == {"ended": [], "running": None, "report": False}
    with Running(out, "1a"):
        assert folder.state("", 0, 0)["running"] == "1a"
    with Running(out, "1b"):
        state = folder.state("1a", 1000, 1000)  # a browser that still shows the test before
        assert (state["ended"], state["running"]) == (["1a"], "1b")
        assert len(state["time"]) == 58
    assert folder.state("1b", 0, 0)["running"] is None


def asked(address):
    with urllib.request.urlopen(address, timeout=60.0) as page:
        return page.read().decode()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    out, port = tmp_path_factory.mktemp("live") / "out", free_port()
    with Running(out, "3", at=90) as running, live(out, port) as address:
        answer(lambda: asked(address))
        yield address, running


def test_its_page_and_its_state(page):
    address, _ = page
    text = asked(address)
    assert "structid" in text and "http" not in text.split("<script>")[1]  # nothing from elsewhere
    state = json.loads(asked(f"{address}/state?test=3&moves=80&steps=80"))
    assert state["running"] == "3" and len(state["time"]) == state["steps"] - 80
    assert json.loads(asked(f"{address}/state?test=3&moves=x&steps=-4"))["steps"] == state["steps"]


def test_another_name_for_this_machine_is_refused(page):
    """A page elsewhere could point a name of its own here, and read what this one shows."""
    connection = HTTPConnection(page[0].removeprefix("http://"), timeout=60.0)
    connection.request("GET", "/state", headers={"Host": "laboratory.example"})
    assert connection.getresponse().status == 400


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no browser here")
def test_in_a_browser(page):
    address, _ = page
    found = subprocess.run(
        [
            "chromium",
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--virtual-time-budget=6000",
            "--dump-dom",
            address,
        ],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert "Test 3: 0.87 s of 1.00 s" in found.stdout
    assert 'id="loop0"' in found.stdout and "<td>displacement</td>" in found.stdout
