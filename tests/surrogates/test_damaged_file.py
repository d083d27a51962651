"""A flipped bit in a file: named, or without effect; never another answer."""

import h5py
import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError, StructidWarning
from structid.surrogates.surrogate_list import load_surrogate

RECORD = si.GroundMotion.synthetic(seed=3).trim(3.0, 5.0)
SPACE = si.ParameterSpace(stiffness=si.Normal(7.4, 0.5, low=5.0, high=10.0, unit="kN/mm"))
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, gamma_ratio=0.5, free=SPACE.names)


def flipped(path, good, rng):
    data = bytearray(good)
    data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    path.write_bytes(bytes(data))


def test_of_a_surrogate(tmp_path):
    rng = np.random.default_rng(1)
    surrogate = si.PODKriging().fit(si.Campaign(MODEL, RECORD, SPACE.sample(12, seed=1)).run())
    path = surrogate.save(tmp_path / "surrogate.h5")
    good, points = path.read_bytes(), SPACE.sample(3, seed=2)
    expected, named = surrogate.simulate(points, RECORD).values, 0
    for _ in range(150):
        flipped(path, good, rng)
        try:
            found = load_surrogate(path)
        except InputError as refusal:
            assert "surrogate.h5" in str(refusal)
            named += 1
            continue
        np.testing.assert_array_equal(found.simulate(points, RECORD).values, expected)
    assert named > 20


def test_of_true_runs(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "runs.h5"
    expected = si.Campaign(MODEL, RECORD, SPACE.sample(12, seed=1), path).run().values.copy()
    good, named = path.read_bytes(), 0
    for _ in range(80):
        flipped(path, good, rng)
        try:
            found = si.open_runs(path).values
        except InputError as refusal:
            assert "runs.h5" in str(refusal)
            named += 1
            continue
        np.testing.assert_array_equal(found, expected)
    assert named > 20


def test_a_text_file_holds_no_runs(tmp_path):
    (tmp_path / "runs.h5").write_text("run,value\n1,2\n")
    with pytest.raises(InputError, match=r"runs.h5: it is not an HDF5 file"):
        si.open_runs(tmp_path / "runs.h5")


def test_the_checksum_is_of_the_content(tmp_path):
    """A number changed by hand in a file that is sound otherwise."""
    path = si.PODKriging().fit(si.Campaign(MODEL, RECORD, SPACE.sample(12, seed=1)).run()).save(tmp_path / "one.h5")
    with h5py.File(path, "r+") as file:
        names = []
        file["arrays"].visititems(
            lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) and item.size else None
        )
        file["arrays"][names[0]][...] = file["arrays"][names[0]][...] * 1.001
    with pytest.raises(InputError, match="checksum is wrong"):
        load_surrogate(path)


def test_only_damaged_runs_are_done_again(tmp_path):
    """The compressed history of one run is overwritten: reading names it, and the campaign does it again, to the same bits."""
    path, design = tmp_path / "runs.h5", SPACE.sample(12, seed=1)
    expected = si.Campaign(MODEL, RECORD, design, path).run().values.copy()
    with h5py.File(path, "r+") as file:
        chunk = file["values"].id.get_chunk_info(5)
    data = bytearray(path.read_bytes())
    middle = chunk.byte_offset + chunk.size // 2
    data[middle : middle + 8] = bytes(8)
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"1 of 12 runs are damaged \(run 5\); the others are intact.*repeated"):
        _ = si.open_runs(path).values
    with pytest.warns(StructidWarning, match="1 of 12 runs are damaged"):
        mended = si.Campaign(MODEL, RECORD, design, path).run()
    np.testing.assert_array_equal(mended.values, expected)
    assert (mended.finished[np.arange(12) != 5] < mended.finished[5]).all()
    np.testing.assert_array_equal(si.open_runs(path).values, expected)
