"""Kill a sampling process without mercy, go on, and get the same bits."""

import os
import random
import signal
import subprocess
import sys

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.inference.sample import chain_identity
from structid.inference.sampling.chain_store import ChainStore
from studies import PLAIN, shortened

SCRIPT = """
import sys, numpy as np, structid as si
from structid.inference.target import LogDensity

def density(x):
    return -0.5 * (x**2).sum(axis=1)

target = LogDensity(density, "abc", lambda n, rng: rng.standard_normal((n, 3)))
settings = si.AIES(walkers=20, steps=2000, ensembles=3, differential_evolution=0.3)
def told(done, total):
    print(done, flush=True)
result = si.sample(target, settings, seed=5, store=sys.argv[1], progress=told)
np.save(sys.argv[2], result.history)
"""


def start(script, store, out):
    return subprocess.Popen(
        [sys.executable, script, store, out], stdout=subprocess.PIPE, text=True, env=dict(os.environ)
    )


@pytest.mark.slow
def test_killed_again_and_again_and_resumed_gives_the_same_bits(tmp_path):
    script = tmp_path / "run.py"
    script.write_text(SCRIPT)
    undisturbed = start(script, str(tmp_path / "a.h5"), str(tmp_path / "a.npy"))
    undisturbed.communicate(timeout=300)
    rng = random.Random(3)
    kills = 0
    for _ in range(12):
        process = start(script, str(tmp_path / "b.h5"), str(tmp_path / "b.npy"))
        for _ in range(rng.randrange(1, 7)):
            if process.stdout.readline() == "":
                break
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        process.wait(timeout=60)
        if (tmp_path / "b.npy").exists():
            break
    if not (tmp_path / "b.npy").exists():
        start(script, str(tmp_path / "b.h5"), str(tmp_path / "b.npy")).communicate(timeout=300)
    assert kills >= 5
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), np.load(tmp_path / "b.npy"))


def test_killed_between_rename_and_removal_of_the_journal(tmp_path, short_posterior):
    """Both the finished file and its journal are there: nothing is doubled."""
    settings = si.AIES(walkers=10, steps=100, ensembles=2)
    store = tmp_path / "c.h5"
    expected = si.sample(short_posterior, settings, seed=1).history
    si.sample(short_posterior, si.AIES(walkers=10, steps=50, ensembles=2), seed=1, store=store)
    copy = ChainStore(store, chain_identity(short_posterior, settings, seed=1))
    copy.append(0, copy.blocks()[0])
    np.testing.assert_array_equal(si.sample(short_posterior, settings, seed=1, store=store).history, expected)
    assert not list(tmp_path.glob("*.journal"))


@pytest.mark.slow
def test_a_killed_study_goes_on_to_the_same_draws(tmp_path):
    """`structid run`, killed while it samples, then `--resume`: the bits of an undisturbed run."""
    from structid.study.run import load

    study = tmp_path / "study.toml"
    text = shortened(PLAIN, "9 s")
    text = text.replace("steps = 3000", "steps = 600\nsettling_steps = 100").replace(
        '["pattern_search", "interior_point"]', "[]"
    )
    study.write_text(text.replace("walkers = 32", "walkers = 12"))
    command = [
        sys.executable,
        "-c",
        "from structid.cli.main import main; main()",
        "run",
        str(study),
        "--out",
        str(tmp_path / "out"),
    ]
    journal = tmp_path / "out" / "chains.h5.journal"
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not (journal.exists() and journal.stat().st_size > 200_000):
        pass
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=60)
    assert journal.exists() and not (tmp_path / "out" / "chains.h5").exists()
    resumed = subprocess.run([*command, "--resume"], capture_output=True, text=True, timeout=300)
    assert resumed.returncode in (0, 3), resumed.stderr
    built = load(study)
    undisturbed = si.sample(built.posterior, built.sampler, built.file.seed)
    stored = si.sample(built.posterior, built.sampler, built.file.seed, store=tmp_path / "out" / "chains.h5")
    np.testing.assert_array_equal(stored.history, undisturbed.history)


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.8, 0.97])
def test_a_byte_that_has_flipped_in_a_finished_store(tmp_path, short_posterior, share):
    """Every byte may be the one: the draws are the same, or the file is said to be damaged, and never another's."""
    path, sampler = tmp_path / "chains.h5", si.SMC(particles=40, ensembles=2, steps=5, effective_share=0.5)
    drawn = si.sample(short_posterior, sampler, seed=1, store=path)
    whole = bytearray(path.read_bytes())
    whole[int(share * len(whole))] ^= 0x55
    path.write_bytes(bytes(whole))
    try:
        again = si.sample(short_posterior, sampler, seed=1, store=path)
    except InputError as told:
        assert "it is damaged" in str(told) and "Restore it from a copy" in str(told)
    else:
        np.testing.assert_array_equal(again.history, drawn.history)


def test_a_text_file_is_left_as_it_is(tmp_path, short_posterior):
    (tmp_path / "notes.txt").write_text("not to be removed")
    for read in (si.open_runs, si.load_surrogate, lambda path: si.sample(short_posterior, store=path)):
        with pytest.raises(InputError, match=r"notes.txt: it is not an HDF5 file.*This one is unchanged"):
            read(tmp_path / "notes.txt")
