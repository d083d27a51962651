"""Files of loggers and programs that are no text: each is written by its own library, and read to the same numbers."""

import datetime

import numpy as np
import pytest
import scipy

import structid as si
from structid.core.errors import InputError
from structid.data_files.read_file import read_file, read_signal, read_table

TIMES = np.arange(60) * 0.005
VALUES = np.sin(TIMES * 40.0)


def check(file, **arguments):
    record = si.GroundMotion.read(file, **arguments)
    assert record.dt == 0.005
    np.testing.assert_allclose(record.values, VALUES, rtol=1e-12)


def test_numpy_arrays(tmp_path):
    np.save(tmp_path / "a.npy", np.stack([TIMES, VALUES], axis=1))
    check(tmp_path / "a.npy", unit="m/s^2")
    np.save(tmp_path / "b.npy", VALUES)
    check(tmp_path / "b.npy", unit="m/s^2", dt=0.005)
    structured = np.array(list(zip(TIMES, VALUES, strict=True)), dtype=[("time", float), ("floor", float)])
    np.save(tmp_path / "c.npy", structured)
    check(tmp_path / "c.npy", unit="m/s^2", column="floor")
    np.savez(tmp_path / "d.npz", time=TIMES, floor=VALUES)
    check(tmp_path / "d.npz", unit="m/s^2")
    np.savez(tmp_path / "e.npz", dt=0.005, floor=VALUES)
    check(tmp_path / "e.npz", unit="m/s^2")
    np.savez(tmp_path / "f.npz", one=VALUES, two=VALUES[:-1])
    with pytest.raises(InputError, match=r"different lengths: one \(60\), two \(59\)"):
        read_table(tmp_path / "f.npz")
    np.save(tmp_path / "g.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(InputError, match="NumPy cannot read it"):
        read_table(tmp_path / "g.npy")


def test_matlab_files(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"t": TIMES, "floor": VALUES})
    check(tmp_path / "a.mat", unit="m/s^2")
    scipy.io.savemat(tmp_path / "b.mat", {"fs": 200.0, "data": np.stack([VALUES, 2.0 * VALUES], axis=1)})
    check(tmp_path / "b.mat", unit="m/s^2", column=0)
    check(tmp_path / "b.mat", unit="m/s^2", column="data[0]")
    with pytest.raises(InputError, match=r"a time step of 0\.005 s, but dt=0\.01"):
        read_signal(tmp_path / "b.mat", "m/s^2", 0.01, 0)


def test_matlab_73(tmp_path):
    pytest.importorskip("mat73")
    import h5py

    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(116) + b"\0" * 8 + b"\x00\x02IM"
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, values in (("time", TIMES), ("floor", VALUES)):
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(header)
    check(tmp_path / "a.mat", unit="m/s^2")


def test_excel(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Shaking table, run 7"])
    sheet.append(["Time", "Floor 1", "Force"])
    sheet.append(["s", "m/s^2", "kN"])
    for t, a in zip(TIMES, VALUES, strict=True):
        sheet.append([float(t), float(a), 1.0])
    book.create_sheet("Notes").append(["nothing here"])
    book.save(tmp_path / "a.xlsx")
    check(tmp_path / "a.xlsx", column="Floor 1")
    with pytest.raises(InputError, match="but unit='g' is given"):
        si.GroundMotion.read(tmp_path / "a.xlsx", unit="g", column="Floor 1")
    sheet.cell(row=20, column=2).value = None
    book.save(tmp_path / "b.xlsx")
    with pytest.raises(InputError, match="line 20: an empty cell or no finite number in column 1"):
        si.GroundMotion.read(tmp_path / "b.xlsx", column="Floor 1")
    second = book.create_sheet("Second")
    for t in TIMES:
        second.append([float(t), 1.0])
    book.save(tmp_path / "c.xlsx")
    with pytest.raises(InputError, match="2 sheets with numbers"):
        read_table(tmp_path / "c.xlsx")
    third = openpyxl.Workbook()
    for n, a in enumerate(VALUES):
        third.active.append([datetime.datetime(2026, 1, 1, 0, 0, n % 60), float(a)])
    third.save(tmp_path / "d.xlsx")
    with pytest.raises(InputError, match="a date or a time of day"):
        read_signal(tmp_path / "d.xlsx", "m/s^2")
    check(tmp_path / "d.xlsx", unit="m/s^2", dt=0.005, column=1)


def test_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    waveform = {"wf_increment": 0.005, "wf_start_offset": 0.0, "unit_string": "g"}
    channels = [
        nptdms.ChannelObject("table", "a1", VALUES / 9.80665, properties=waveform),
        nptdms.ChannelObject("table", "force", VALUES, properties={**waveform, "unit_string": "kN"}),
        nptdms.ChannelObject("other", "time", TIMES),
        nptdms.ChannelObject("other", "a2", VALUES, properties={"unit_string": "m/s^2"}),
        nptdms.ChannelObject("none", "a3", VALUES),
    ]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(channels[:4])
    check(tmp_path / "a.tdms", component="a1")
    check(tmp_path / "a.tdms", component="a2")
    force = read_signal(tmp_path / "a.tdms", si_unit="N")
    np.testing.assert_allclose(force.values[:, 0], 1000.0 * VALUES)
    with nptdms.TdmsWriter(tmp_path / "b.tdms") as writer:
        writer.write_segment(channels[4:])
    with pytest.raises(InputError, match="no time step in the file"):
        read_signal(tmp_path / "b.tdms", "m/s^2")
    check(tmp_path / "b.tdms", unit="m/s^2", dt=0.005)


def test_a_time_axis_of_a_tdms_file_in_milliseconds(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    waveform = {"wf_increment": 5.0, "wf_xunit_string": "ms", "unit_string": "m/s^2"}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("g", "a", VALUES, properties=waveform)])
    check(tmp_path / "a.tdms")
    times = nptdms.ChannelObject("g", "Time", 1000.0 * TIMES, properties={"unit_string": "ms"})
    with nptdms.TdmsWriter(tmp_path / "b.tdms") as writer:
        writer.write_segment([times, nptdms.ChannelObject("g", "a", VALUES, properties={"unit_string": "m/s^2"})])
    check(tmp_path / "b.tdms")
    waveform["wf_xunit_string"] = "Hz"
    with nptdms.TdmsWriter(tmp_path / "c.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("g", "a", VALUES, properties=waveform)])
    with pytest.raises(InputError, match="an axis in 'Hz'"):
        read_file(tmp_path / "c.tdms")


def test_a_transposed_matrix_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.stack([TIMES, VALUES]))
    with pytest.raises(InputError, match=r"the shape \(2, 60\).*Transpose"):
        read_table(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", np.empty(0))
    with pytest.raises(InputError, match="is empty"):
        si.look(tmp_path / "b.npy")


def test_opensees_recorders(tmp_path):
    """As OpenSees writes them: XML with one element per column, and binary rows that end in a line feed."""
    rows = "".join(f"        {t:g} {a:.17g} \n" for t, a in zip(TIMES, VALUES, strict=True))
    (tmp_path / "a.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n <OpenSees\n  xmlns:xsi = "http://www.w3.org/2001/XMLSchema-instance">\n'
        "    <TimeOutput>\n        <ResponseType>time</ResponseType>\n    </TimeOutput>\n"
        '    <NodeOutput nodeTag="2" coord1="0" coord2="0" coord3="0">\n        <ResponseType>A1</ResponseType>\n'
        f"    </NodeOutput>\n    <Data>\n{rows}        </Data>\n</OpenSees>\n"
    )
    check(tmp_path / "a.xml", unit="m/s^2")
    assert read_table(tmp_path / "a.xml").titles == ["time", "node 2 A1"]
    table = np.stack([TIMES, VALUES], axis=1)
    (tmp_path / "b.bin").write_bytes(b"".join(row.astype("<f8").tobytes() + b"\n" for row in table))
    check(tmp_path / "b.bin", unit="m/s^2")
    (tmp_path / "c.bin").write_bytes(b"".join(np.float64(a).tobytes() + b"\n" for a in VALUES))
    check(tmp_path / "c.bin", unit="m/s^2", dt=0.005)
    (tmp_path / "d.bin").write_bytes((tmp_path / "b.bin").read_bytes()[:-3])
    with pytest.raises(InputError, match="a binary file of a format that structid does not know"):
        read_table(tmp_path / "d.bin")
    (tmp_path / "f.xml").write_text((tmp_path / "a.xml").read_text().replace("0.05 ", "0.05 -nan(ind) ", 1))
    with pytest.raises(InputError):
        read_table(tmp_path / "f.xml")
    (tmp_path / "e.xml").write_text((tmp_path / "a.xml").read_text()[:900])
    with pytest.raises(InputError, match="the XML is damaged"):
        read_table(tmp_path / "e.xml")


def test_opensees_itself(tmp_path):
    ops = pytest.importorskip("openseespy.opensees")
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(1, 0.0)
    ops.node(2, 0.0)
    ops.fix(1, 1)
    ops.mass(2, 1.0)
    ops.uniaxialMaterial("Elastic", 1, 100.0)
    ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
    ops.timeSeries("Path", 1, "-dt", 0.005, "-values", *map(float, VALUES))
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    for kind, name in (("-file", "a.txt"), ("-xml", "b.xml"), ("-binary", "c.bin")):
        ops.recorder("Node", kind, str(tmp_path / name), "-precision", 16, "-time", "-node", 2, "-dof", 1, "disp")
    for order in (
        ("system", "BandGeneral"), ("numberer", "Plain"), ("constraints", "Plain"), ("integrator", "Newmark", 0.5, 0.25),
        ("algorithm", "Linear"), ("analysis", "Transient"), ("analyze", 50, 0.005),
    ):  # fmt: skip
        getattr(ops, order[0])(*order[1:])
    ops.wipe()
    signals = [read_signal(tmp_path / name, "m") for name in ("a.txt", "b.xml", "c.bin")]
    for signal in signals:
        assert signal.dt == 0.005 and signal.start == pytest.approx(0.005)
        np.testing.assert_allclose(signal.values, signals[2].values, rtol=1e-9, atol=1e-15)


def test_sac_and_miniseed(tmp_path):
    obspy = pytest.importorskip("obspy")
    trace = obspy.Trace(VALUES.astype(np.float32), {"delta": 0.005, "channel": "HNE", "station": "ABC"})
    for name, form in (("a.sac", "SAC"), ("a.mseed", "MSEED")):
        trace.write(str(tmp_path / name), format=form)
        record = si.GroundMotion.read(tmp_path / name, unit="m/s^2")
        assert record.dt == pytest.approx(0.005, rel=1e-6)
        np.testing.assert_allclose(record.values, VALUES.astype(np.float32))
        with pytest.raises(InputError, match="does not state a unit"):
            si.GroundMotion.read(tmp_path / name)
    pieces = obspy.Stream([trace, trace.copy()])
    pieces[1].stats.starttime += 0.005 * (len(VALUES) + 40)
    pieces.write(str(tmp_path / "gap.mseed"), format="MSEED")
    with pytest.raises(InputError, match=r"40 of .* values of the channel 'HNE' are missing.*missing = 'leave_out'"):
        si.GroundMotion.read(tmp_path / "gap.mseed", unit="m/s^2")
    (channel,) = read_file(tmp_path / "gap.mseed").channels
    assert np.flatnonzero(np.isnan(channel.values)).tolist() == list(range(len(VALUES), len(VALUES) + 40))
    record = si.GroundMotion(np.sin(np.arange(2 * len(VALUES) + 40)), 0.005)
    measured = si.Observation.read(
        record, tmp_path / "gap.mseed", "m/s^2", "absolute_acceleration", missing="leave_out"
    )
    assert measured.missing == 40 and measured.dt == 0.005
    pieces[1].stats.starttime -= 0.005 * 60
    pieces.write(str(tmp_path / "overlap.mseed"), format="MSEED")
    with pytest.raises(InputError, match=r"pieces of the channel .* that overlap"):
        si.GroundMotion.read(tmp_path / "overlap.mseed", unit="m/s^2")


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    import importlib

    def absent(name):
        raise ImportError(name)

    (tmp_path / "a.tdms").write_bytes(b"TDSm" + b"\0" * 40)
    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(InputError, match=r"the package nptdms is not installed.*pip install 'structid\[laboratory\]'"):
        read_file(tmp_path / "a.tdms")
