"""A programme of hybrid tests through the command line: checked, run, resumed, reported again, against a server; mistakes."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from commands import structid
from servers import free_port, listening
from structid.core.errors import InputError
from structid.hybrid.laboratory.server import SpecimenServer
from structid.hybrid.recording.result_file import open_hybrid
from structid.study import packaged
from structid.study.programmes.programme_file import is_programme
from structid.study.programmes.run_programme import (
    check_programme,
    load_programme,
    programme_report_again,
    run_programme,
)

pytestmark = pytest.mark.quick
SECRET = "a secret of both sides"
PACKAGED = packaged.template("hybrid")
_TESTS, _AFTER = PACKAGED.index("[[test]]"), PACKAGED.index("[online]")
SMALL = (
    PACKAGED[:_TESTS]
    + "\n".join(f'[[test]]\nname = "{n}"\npga = {pga}\ntime_scale = 100\n' for n, pga in (("1", 2.0), ("2", 4.0)))
    + PACKAGED[_AFTER:]
).replace('trim = ["4 s", "9 s"]', 'trim = ["4 s", "5.5 s"]')
SMALL = SMALL.replace('from_test = "3"\npredict = "5"', 'from_test = "1"\npredict = "2"\ndraws = 60')
DEGRADATION, SURROGATE = SMALL.index("[parameters.delta_nu]"), SMALL.index("[surrogate]")
CERTIFIED = (SMALL[:DEGRADATION] + SMALL[SURROGATE:]).replace(
    "[model] ", "[model]\ndelta_nu = 1.2\ndelta_eta = 0.6\n# "
)
"""Of four parameters: how the specimen degrades is known."""
SMALL = SMALL[: SMALL.index("[surrogate]")] + '[sampler]\nkind = "smc"\nparticles = 100\nsteps = 20\n'
ALONE = SMALL[: SMALL.index("[online]")]
"""Without anything that is learnt."""
FACADE = """
name = "facade"
dt = 0.01

[record]
synthetic = { seed = 8 }
lowpass = "20 Hz"
trim = [5.0, 5.4]

[structure]
type = "facade"

[structure.wall]
type = "masonry_wall"
joint_law = "damage-friction"
normal_energy = 15
normal_strength = "0.2 MPa"
tangential_energy = 150
tangential_strength = "0.3 MPa"
friction = 0.65

[specimen.model]
type = "masonry_wall"
joint_law = "damage-friction"
normal_energy = 12
normal_strength = "0.18 MPa"
tangential_energy = 130
tangential_strength = "0.27 MPa"
friction = 0.6

[coupling]
substeps = 20

[[test]]
name = "1"
pga = 1.0
time_scale = 200
modes = 4
"""


def written(folder, text, name="programme.toml"):
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("programme")
    return run_programme(written(folder, SMALL), folder / "out"), folder / "out"


@pytest.mark.rendered
def test_a_programme_from_its_file_to_its_report(run):
    outcome, folder = run
    assert outcome.programme.finished
    for name in ("study.toml", "test_1.h5", "test_2.h5", "learnt.h5", "posterior.nc", "report.html", "timings.json"):
        assert (folder / name).is_file(), name
    drawn = {path.stem for path in (folder / "figures").glob("*.svg")}
    assert drawn == {"loops_drift", "histories", "tracking", "learnt_loops", "predicted_test", "filtered_path"}
    page = outcome.report.read_text()
    assert "All 2 tests were completed." in page and "Online filter" in page
    seen = outcome.learnt.prediction
    assert seen.name == "2" and seen.drifts.shape == (60, 151)
    assert f"Measured: {1e3 * seen.peak:.4g} mm" in page


def test_the_specimen_is_found_again(run):
    learnt = run[0].learnt
    truth = {"stiffness": 7.2e6, "alpha": 0.19, "beta": 58.0, "gamma_ratio": 0.2}
    for name, value in truth.items():
        at = learnt.result.names.index(name)
        assert abs(learnt.result.mean[at] - value) < 5.0 * learnt.result.sd[at], name
    low, high = learnt.prediction.band
    assert low * 0.995 < learnt.prediction.peak < high * 1.005


@pytest.mark.slow
def test_a_certified_posterior(tmp_path):
    """By a surrogate, and runs of the model itself at fresh draws."""
    outcome = run_programme(written(tmp_path, CERTIFIED), tmp_path / "out")
    learnt = outcome.learnt
    assert learnt.calibration.certificate.certified and learnt.trusted
    at = learnt.result.names.index("stiffness")
    assert abs(learnt.result.mean[at] - 7.2e6) < 5.0 * learnt.result.sd[at]
    assert "A surrogate replaced the model in the sampling." in outcome.report.read_text()
    again = programme_report_again(tmp_path / "out").learnt
    np.testing.assert_array_equal(again.result.flat, learnt.result.flat)


def test_the_report_again(run):
    outcome, folder = run
    again = programme_report_again(folder)
    np.testing.assert_array_equal(again.learnt.result.flat, outcome.learnt.result.flat)
    np.testing.assert_array_equal(again.learnt.prediction.drifts, outcome.learnt.prediction.drifts)
    assert again.programme.tests["2"].online.names == outcome.programme.tests["2"].online.names
    with pytest.raises(InputError, match="an output folder of structid hybrid"):
        programme_report_again(_emptied(folder.parent / "empty", folder))


def _emptied(target, folder):
    target.mkdir()
    (target / "study.toml").write_text((folder / "study.toml").read_text())
    (target / "inputs").mkdir()
    return target


def test_folders_are_not_written_over(run, tmp_path):
    _, folder = run
    same = written(tmp_path, SMALL)
    with pytest.raises(InputError, match="--resume"):
        run_programme(same, folder)
    with pytest.raises(InputError, match="another programme"):
        run_programme(written(tmp_path, ALONE, "other.toml"), folder)
    with pytest.raises(InputError, match="not empty"):
        run_programme(same, tmp_path)


def test_a_programme_goes_on(tmp_path):
    path, out = written(tmp_path, ALONE), tmp_path / "out"
    whole = run_programme(path, out)
    (out / "test_2.h5").unlink()
    again = run_programme(path, out, resume=True)
    for name, test in whole.programme.tests.items():
        np.testing.assert_array_equal(again.programme.tests[name].moves.force, test.moves.force)
    assert again.learnt is None


@pytest.mark.slow
@pytest.mark.parametrize("name", packaged.PROGRAMMES)
def test_a_packaged_programme_can_work(name):
    found = check_programme(Path(packaged.__file__).parent / "templates" / f"{name}.toml")
    assert list(found) == ["1a", "1b", "2", "3", "4", "5"]
    assert all(each.can_work for each in found.values())


def test_a_facade(tmp_path):
    outcome = run_programme(written(tmp_path, FACADE), tmp_path / "out")
    test = outcome.programme.tests["1"]
    assert test.finished and [channel.name for channel in test.description.channels] == ["u_x", "u_y", "theta"]
    assert test.coarse.u.shape == (41, 7)  # the beam's motions, and four modes
    assert 0.5 < test.stiffness_ratio < 1.0  # K₀ is 1.2 times that of the wall it is taken for
    assert "All 1 tests" in outcome.report.read_text()


def test_over_a_server_it_is_the_same(tmp_path):
    path = written(tmp_path, ALONE)
    local = run_programme(path, tmp_path / "local")
    with SpecimenServer(load_programme(path).specimen(), SECRET, releases=True) as server:
        remote = run_programme(path, tmp_path / "remote", address=server.address, secret=SECRET)
    for name, test in local.programme.tests.items():
        np.testing.assert_array_equal(remote.programme.tests[name].moves.measured, test.moves.measured)


MISTAKES = {
    "storeys = 2": ("storeys = 1", "structure.storeys"),
    'type = "shear_frame"': ('type = "shear"', "structure.type"),
    'stiffness = "7.6 kN/mm"         # st': ('stiffness = "7.6 kN"         # st', "structure.stiffness"),
    'delay = "17 ms"': ('dealy = "17 ms"', "Did you mean 'delay'"),
    'fine = "numerical"': ('fine = "none"', "coupling.fine"),
    'name = "2"': ('name = "1"', "different names"),
    'predict = "2"': ('predict = "1"', "a test after 1"),
    'from_test = "1"': ('from_test = "7"', "learning.from_test"),
    'predict = "2"\ndraws': ('predict = "2"\nsd = ["1 kN", "1 kN"]\ndraws', "one number for each of"),
    'predict = "2"\ndraws = 60': ('predict = "2"\nsd = ["1 mm"]\ndraws = 60', "learning.sd"),
    "force_noise = ": ("noise = ", "online"),
    "update = false": ('update = false\ndrift = "x"', "online.drift"),
    "substeps = 10": ("substeps = 10\nalpha = -0.5", "-1/3"),
    'type = "bouc_wen"\nmass = "12 t"\n\n[parameters': (
        'type = "shear_frame"\n\n[parameters',
        "'bouc_wen', 'hysteretic', 'masonry_wall'",
    ),
}


@pytest.mark.parametrize("right", MISTAKES)
def test_mistakes_are_told_before_anything_moves(tmp_path, right):
    wrong, said = MISTAKES[right]
    assert SMALL.count(right) >= 1
    with pytest.raises(InputError, match=re.escape(said)):
        load_programme(written(tmp_path, SMALL.replace(right, wrong))).programme()


def test_what_a_test_cannot_do_is_told_before_anything_moves(tmp_path):
    weak = ALONE.replace('stroke = "250 mm"', 'stroke = "3 mm"')
    with pytest.raises(InputError, match=r"test 1: .*displacement"):
        run_programme(written(tmp_path, weak), tmp_path / "out")


def test_files_of_programmes_are_known():
    assert is_programme({"test": []}) and is_programme({"specimen": {}, "structure": {}})
    assert not is_programme({"model": {}, "parameters": {}})


@pytest.mark.slow
def test_a_filter_that_is_too_sure_is_called_so(tmp_path):
    """Told that forces are a hundred times less noisy than they are, it is many of its own standard deviations off."""
    right = 'force_noise = "'
    at = SMALL.index(right)
    end = SMALL.index("\n", at)
    sure = SMALL[:at] + 'force_noise = "1 N"' + SMALL[end:]
    page = run_programme(written(tmp_path, sure), tmp_path / "out").report.read_text()
    assert "It is overconfident in" in page


# --- the command line -----------------------------------------------------------------------------------------------


def test_a_programme_that_ends_before_its_time_says_so_to_scripts(tmp_path):
    """The specimen stops at a force that the check does not expect, since its noise is not in it."""
    noisy = ALONE.replace('force_sensor = { noise = "0.5 kN" }', 'force_sensor = { noise = "400 kN" }')
    noisy = noisy.replace('force = "500 kN"', 'force = "150 kN"')
    written(tmp_path, noisy)
    told = structid("hybrid", "programme.toml", "--out", "out", cwd=tmp_path)
    assert told.returncode == 1, told.stdout + told.stderr
    assert "exceeds its limit of 150000" in told.stdout


def test_a_new_programme_and_its_check(tmp_path):
    assert structid("new", "mine", "--like", "hybrid", cwd=tmp_path).returncode == 0
    text = (tmp_path / "mine.toml").read_text()
    assert 'name = "mine"' in text
    written(tmp_path, ALONE, "mine.toml")
    told = structid("check", "mine.toml", cwd=tmp_path)
    assert told.returncode == 0 and "test 2" in told.stdout and "critical delay" in told.stdout
    assert "specimen.actuator.delay" in told.stdout  # as it was understood
    written(tmp_path, ALONE.replace('stroke = "250 mm"', 'stroke = "3 mm"'), "weak.toml")
    told = structid("hybrid", "weak.toml", "--check", cwd=tmp_path)
    assert told.returncode == 2 and "not feasible" in told.stdout
    assert structid("hybrid", "mine.toml", cwd=tmp_path).returncode == 2  # --out is missing


@pytest.mark.slow
def test_two_terminals(tmp_path):
    """A server of its own, the tests against it, and its thirty checks."""
    path, secret, port = written(tmp_path, ALONE), written(tmp_path, SECRET, "secret"), free_port()
    arguments = [sys.executable, "-m", "structid", "specimen", path, "--secret-file", secret, "--port", str(port)]
    with listening(list(map(str, arguments)), port):
        address = f"127.0.0.1:{port}"
        told = structid("hybrid", path, "--out", "out", "--specimen", address, "--secret-file", secret, cwd=tmp_path)
        assert told.returncode == 0, told.stderr
        assert "The programme is finished." in told.stdout
        assert not open_hybrid(tmp_path / "out" / "test_1.h5").events
        told = structid("conformance", address, "--secret-file", secret, cwd=tmp_path)
        assert told.returncode == 0 and "30 of 30 passed." in told.stdout
        wrong = written(tmp_path, "another secret than theirs", "wrong")
        told = structid("hybrid", path, "--out", "no", "--specimen", address, "--secret-file", wrong, cwd=tmp_path)
        assert told.returncode == 1 and "same secret" in told.stderr
    told = structid("hybrid", path, "--out", "no", "--specimen", address, "--secret-file", "missing", cwd=tmp_path)
    assert told.returncode == 2 and "secrets.token_hex" in told.stderr
