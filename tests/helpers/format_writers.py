"""Small files of every record format, written from the public descriptions of the formats, with what they must be read as."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

G = 9.80665


class Truth(NamedTuple):
    """What a file holds: accelerations in m/s² by component, and the step in s."""

    components: dict[str, np.ndarray]
    dt: float


def motion(samples: int, seed: int, peak: float = 1.3) -> np.ndarray:
    """A smooth acceleration [m/s²] with a peak."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples)
    a = sum(rng.normal() * np.sin(0.07 * (k + 1) * t + rng.uniform(0, 6)) for k in range(6)) * np.sin(
        np.pi * t / samples
    )
    return peak * a / np.abs(a).max()


def rows_of(values: np.ndarray, per_line: int, form: str) -> str:
    """Numbers of one Fortran format, several in a line."""
    return "\n".join("".join(form.format(v) for v in values[n : n + per_line]) for n in range(0, len(values), per_line))


def fixed_e(value: float, width: int, digits: int, exponent_digits: int = 2) -> str:
    """A number with an exponent of few digits, as SMC's (1P8E10.4E1)."""
    mantissa, exponent = f"{value:.{digits}E}".split("E")
    return f"{mantissa}E{int(exponent):+0{exponent_digits + 1}d}".rjust(width)


def knet(direction: str = "E-W", seed: int = 1) -> tuple[str, Truth]:
    counts = np.round(motion(1600, seed) * 100.0 / 3920.0 * 6182761).astype(int) + 12085
    a = counts * 3920.0 / 6182761
    a = a - a.mean()
    name = {"E-W": "EW", "N-S": "NS", "U-D": "UD", "1": "borehole NS", "5": "surface EW"}[direction]
    header = [
        ("Origin Time", "2018/01/24 19:51:00"), ("Lat.", "41.0"), ("Long.", "142.5"), ("Depth. (km)", "30"), ("Mag.", "6.2"),
        ("Station Code", "AOM001"), ("Station Lat.", "41.5"), ("Station Long.", "140.9"), ("Station Height(m)", "39"),
        ("Record Time", "2018/01/24 19:51:43"), ("Sampling Freq(Hz)", "100Hz"), ("Duration Time(s)", "16"), ("Dir.", direction),
        ("Scale Factor", "3920(gal)/6182761"), ("Max. Acc. (gal)", f"{np.abs(a).max():.3f}"),
        ("Last Correction", "2018/01/24 19:51:43"), ("Memo.", ""),
    ]  # fmt: skip
    text = "\n".join(f"{key:18s}{value}" for key, value in header) + "\n" + rows_of(counts, 8, "{:8d} ") + "\n"
    return text, Truth({name: a / 100.0}, 0.01)


V1_HEAD = """{first}
NAME OF EARTHQUAKE
JUNE 28, 1992 08:05 PDT                 (ORIGIN: 06/28/92, 15:05:30.5 UTC)
13160-S1690-92184.03
STATION NO. 13160   33.634N, 117.902W     SMA-1  S/N 1690
NAME OF STATION
CHAN  {number}: {name:10s}
{network}
HYPOCENTER: 34.201N,116.826W, H=7KM.     MS=6.6(NEIC)
INSTR PERIOD =  .0388 SEC,  DAMPING =  .561,  SENSITIVITY = 1.77 CM/G.
NO. OF POINTS =  {points:5d}  RECORD LENGTH ={length:7.3f} SEC{rate}
{units}
RMS ACCEL OF COMPLETE RECORD =  .006 G.
"""
INTEGERS = "\n".join(["    0" * 16] * 6 + ["    0" * 4]) + "\n"


def reals(values: dict[int, float], lines: int = 13, count: int = 100) -> str:
    numbers = [f"{values.get(n, 0.0):10.7f}" if n == 60 else f"{values.get(n, 0.0):10.3f}" for n in range(count)]
    return "\n".join("".join(numbers[8 * n : 8 * n + 8]) for n in range(lines)) + "\n"


def csmip_v1() -> tuple[str, Truth]:
    text, components = "", {}
    for number, (name, samples) in enumerate((("90 DEG", 803), ("UP", 800), ("360 DEG", 797)), start=1):
        a = np.round(motion(samples, number) / G, 6)
        text += V1_HEAD.format(
            first="Uncorrected Accelerogram Data             Processed: 02/13/12, CGS", number=number, name=name, network="X",
            points=samples, length=samples / 200, rate="   AT 200 SAMPLES/SEC",
            units=f"Units of uncor data are sec and g .        Max  = {a[np.abs(a).argmax()]:7.3f} g , at  1.000 sec.",
        ) + INTEGERS + reals({}, 7, 50)  # fmt: skip
        text += f"{samples:6d} Accelerogram points at 200 pts/sec in units of g .      Format: (8f9.6)\n"
        text += rows_of(a, 8, "{:9.6f}") + f"\n/&  ----------  End of Data for Channel  {number}  ----------\n"
        components[name] = a * G
    return text, Truth(components, 0.005)


def csmip_v2() -> tuple[str, Truth]:
    text, components, dt = "", {}, 0.0125
    for number, (name, samples) in enumerate((("90 Deg", 640), ("Up", 641)), start=1):
        a = np.round(100.0 * motion(samples, 10 + number), 5)
        others = [np.round(30.0 * motion(samples, k), 5) for k in (20, 30)]
        peak = a[np.abs(a).argmax()]
        text += f"Corrected accelerogram   89146-L2500-12044.02       Chan  {number}: {name:8s}    from\n"
        text += "Uncorrected Accelerogram Data             Processed: 02/13/12, CGS  146be002\n" + "x\n" * 5
        text += f"Chan  {number}: {name}\n" + "x\n" * 7
        text += f"{samples:6d} points of instrument- and baseline-corrected accel, veloc and displ data\n"
        text += f"At equally-spaced intervals of    .012  sec.\nPeak acceleration ={peak:10.3f}    cm/sec/sec  at   1.0   sec.\n"
        text += "x\n" * 7 + INTEGERS + reals({60: dt})
        for values, quantity, unit in zip(
            (a, *others), ("accel", "veloc", "displ"), ("cm/sec2.", "cm/sec. ", "cm.     "), strict=True
        ):
            text += f"{samples:6d} points of {quantity} data equally spaced at  .012 sec, in {unit} (8f10.5)\n"
            text += rows_of(values, 8, "{:10.5f}") + "\n"
        text += f"/&  ----------  End of data for channel  {number}  ----------\n"
        components[name] = a / 100.0
    return text, Truth(components, dt)


def pairs_text(times: np.ndarray, values: np.ndarray) -> str:
    return rows_of(np.stack([times, values], axis=1).reshape(-1), 10, "{:7.3f}") + "\n"


def renadic() -> tuple[str, Truth]:
    text, components = "", {}
    for number, name in enumerate(("NS", "V", "EW"), start=1):
        a = np.round(10.0 * motion(500, 40 + number) / G, 3)
        text += V1_HEAD.format(
            first="UNCORRECTED ACCELEROGRAM DATA              PROCESSED: 06/30/2011", number=number, name=name,
            network="UNIVERSIDAD DE CHILE - RENADIC", points=500, length=2.5, rate="",
            units="UNITS OF UNCOR ACCEL ARE SEC AND G/10.     MAX  =  0.052 G, AT  14.100 SEC",
        ) + INTEGERS + reals({}, 7, 50)  # fmt: skip
        text += (
            pairs_text(0.005 * np.arange(500), a) + f"/&  ----------  END OF DATA FOR CHANNEL {number}  ----------\n"
        )
        components[name] = 0.1 * a * G
    return text, Truth(components, 0.005)


def film(first: str, names: tuple[str, ...], indent: str, end: bool) -> tuple[str, Truth]:
    """Points digitised from a film: no constant step."""
    text, components = "", {}
    rng = np.random.default_rng(9)
    for number, name in enumerate(names, start=1):
        times = np.round(np.cumsum(np.r_[0.0, rng.choice([0.004, 0.005, 0.006], 599)]), 3)
        a = np.round(10.0 * motion(600, 50 + number) / G, 3)
        peak = 0.1 * a[np.abs(a).argmax()]
        head = V1_HEAD.format(
            first=first, number=number, name=name, network="X", points=600, length=3.0, rate="",
            units=f"UNITS OF UNCOR ACCEL ARE SEC AND G/10.     MAX  = {peak:6.3f} G, AT  1.0 SEC.",
        )  # fmt: skip
        body = pairs_text(times, a)
        if indent:
            head = head.replace(f"CHAN  {number}: {name:10s}", f"COMP {name}      9").replace(
                "UNITS OF UNCOR ACCEL", "UNITS"
            )
            body = "".join(indent + line + "\n" for line in body.splitlines())
        text += head + INTEGERS + reals({}, 7, 50) + body
        text += f"/&  ----------  END OF DATA FOR CHANNEL  {number}  ----------\n" if end else ""
        grid = 0.005 * np.arange(int(times[-1] / 0.005) + 1)
        components[name] = 0.1 * G * np.interp(grid, times, a)
    return text, Truth(components, 0.005)


def csmip_film() -> tuple[str, Truth]:
    return film(
        "UNCORRECTED ACCELEROGRAM DATA              PROCESSED: 07/16/98, CDMG 13160", ("90 DEG", "UP"), "", True
    )


def usc() -> tuple[str, Truth]:
    return film("FILE     0 OF UNCORRECTED ACCELEROGRAM DATA OF VOLUME I:", ("N90E",), " ", False)


def bhrc() -> tuple[str, Truth]:
    text, components = "", {}
    for number, name in enumerate(("L1", "V2", "T3"), start=1):
        a = np.array([float(f"{v:.6E}") for v in 10.0 * motion(512, 60 + number) / G])
        text += "* VOL1DS FILE:  5522/01\nInst Type = SSA-2\nOrigin Time : 2012/08/11   12:23:16\n\nL\n\n"
        text += f"COMP {name}\nStation   37.485 N 45.891 E\nEpicenter 38.520 N\nINSTR PERIOD =  .019 SEC   DAMPING =  .640\n"
        text += "NO. OF POINTS =    512      DURATION =   2.560\nUNITS ARE SECONDS AND G/10\n\n"
        text += "    0" * 14 + "\n" + ("    0" * 14 + "\n") * 6
        text += "  .193424E-01  .640000E+00  .256000E+01\n  .200000E+03  .000000E+00\n" + "  .000000E+00\n" * 5
        text += rows_of(a, 10, "{:13.6E}") + "\n/&\n"
        components[name] = 0.1 * a * G
    return text, Truth(components, 0.005)


def cosmos(unit: str = "cm/sec2", code: int = 4, factor: float = 0.01) -> tuple[str, Truth]:
    text, components, dt = "", {}, 0.005
    for number, name in enumerate(("90 Deg", "Up"), start=1):
        a = np.array([float(f"{v:.6E}") for v in motion(700, 70 + number) / factor])
        peak = a[np.abs(a).argmax()]
        header = ["x"] * 12
        header[7] = f"Sta Chan  {number}: {name} (Rcrdr Chan  {number}) Location:Ground"
        integers = [-999] * 100
        integers[:3] = [1, 1, code]
        reals_ = [-999.0] * 100
        reals_[33], reals_[61], reals_[62], reals_[63] = 0.02, 1e3 * dt, 700 * dt, peak
        text += "Corrected acceleration    (Format v01.20 with 13 text lines)\n" + "\n".join(header) + "\n"
        text += " 100 Integer-header values follow on  10 lines, Format= (10I8)\n" + rows_of(
            np.array(integers), 10, "{:8d}"
        )
        text += "\n 100 Real-header values follow on  20 lines, Format= (5F15.6)\n" + rows_of(
            np.array(reals_), 5, "{:15.6f}"
        )
        text += '\n   1 Comment line(s) follow, each starting with a "|":\n| comment\n'
        text += f"     700 acceleration pts, approx    3 secs, units={unit}({code:02d}),Format=(5E15.6)\n"
        text += rows_of(a, 5, "{:15.6E}") + f"\nEnd-of-data for Chan  {number} acceleration\n"
        components[name] = a * factor
    return text, Truth(components, dt)


def geonet() -> tuple[str, Truth]:
    text, components = "", {}
    for number, name in enumerate(("N10E", "N80W", "Up"), start=1):
        a = np.round(1000.0 * motion(400, 80 + number), 1)
        velocity, displacement = np.round(50.0 * motion(400, 5), 2), np.round(9.0 * motion(400, 6), 3)
        peak = a[np.abs(a).argmax()]
        text += "Corrected accelerogram 20161113_110256_HSES_20 GNS Science\nSite HSES\nName\nInstrument Basalt_2430\n"
        text += "Resolution: 24-bit\nAccelerogram\nplace\n2016 November 13         11:02:56 UT\nEpicentre\n"
        text += "Number of points  400    Duration   8.00 sec\nInstrument corrected data at 0.020 sec intervals\nBand-pass\n"
        text += f"Component {name}  Longitudinal Accelerometer Axis\n"
        text += f"Acceleration:  peak  {peak:8.1f} mm/s/s at  48.14 sec     rms    292.2 mm/s/s\n"
        text += f"Velocity:      peak {np.abs(velocity).max():8.2f} mm/s   at  59.02 sec     rms    46.28 mm/s\n"
        text += f"Displacement:  peak {np.abs(displacement).max():8.3f} mm     at  53.60 sec     rms   14.626 mm\n"
        integers = np.zeros(40, dtype=int)
        integers[33:36] = 400
        numbers = np.zeros(60)
        numbers[24], numbers[25] = 0.005, 0.02
        text += rows_of(integers, 10, "{:8d}") + "\n" + rows_of(numbers, 10, "{:8.4f}") + "\n"
        for values, form in ((a, "{:8.1f}"), (velocity, "{:8.2f}"), (displacement, "{:8.3f}")):
            text += rows_of(values, 10, form) + "\n"
        components[name] = a / 1000.0
    return text, Truth(components, 0.02)


def smc() -> tuple[str, Truth]:
    a = np.array([float(fixed_e(v, 10, 4, 1)) for v in 100.0 * motion(603, 90)])
    integers = np.full(48, -32768)
    integers[[12, 13, 15, 16]] = 90, 360, 2, 603
    numbers = np.full(50, 1.7e38)
    numbers[[1, 29, 31]] = 200.0, a.max(), a.min()
    text = "2 CORRECTED ACCELEROGRAM\n*\nSAF0A\n" + "x\n" * 5 + "*\n*\n*\n" + rows_of(integers, 8, "{:10d}") + "\n"
    text += rows_of(numbers, 5, "{:15.7E}") + "\n| comment\n| comment\n"
    text += "\n".join("".join(fixed_e(v, 10, 4, 1) for v in a[n : n + 8]) for n in range(0, 603, 8)) + "\n"
    return text, Truth({"360 deg": a / 100.0}, 0.005)


def nsmn() -> tuple[str, Truth]:
    values = np.round(np.stack([100.0 * motion(600, k) for k in (101, 102, 103)], axis=1), 6)
    peaks = np.abs(values).max(axis=0)
    text = "STRONG GROUND MOTION RECORDS OF TURKIYE\nPLACE                   : AYDIN\nNUMBER OF DATA          : 600\n"
    text += "SAMPLING INTERVAL (sec) : 0.01\n"
    text += f"RAW PGA VALUES (gal)    : (N-S) {peaks[0]:.6f} (E-W) {peaks[1]:.6f} (U-D) {peaks[2]:.6f}\n"
    text += (
        "       N-S          E-W          U-D\n"
        + "\n".join("".join(f"{v:13.6f}" for v in row) for row in values)
        + "\n"
    )
    return text, Truth({name: values[:, k] / 100.0 for k, name in enumerate(("N-S", "E-W", "U-D"))}, 0.01)


def unam() -> tuple[str, Truth]:
    values = np.round(np.stack([100.0 * motion(500, k) for k in (111, 112, 113)], axis=1), 3)
    names = ("V", "N90E", "N00E")
    peaks = "/".join(f"{values[np.abs(values[:, k]).argmax(), k]:.2f}" for k in range(3))
    dashes = "---------+" * 8 + "\n"
    text = "*" * 80 + "\nINSTITUTO DE INGENIERIA, UNAM\nARCHIVO ESTANDAR DE ACELERACION:\nVERSION DEL FORMATO  : 2.0\n"
    text += "NUMERO DE CANALES                      : 3\nORIENTACION C1-C6 (rumbo;orientacion)  : /V/N90E/N00E\n"
    text += "ORIENTACION C7-C12 (rumbo;orientacion) :\nINTERVALO DE MUESTREO, C1-C6 (s)       : /0.004/0.004/0.004\n"
    text += "NUM. TOTAL DE MUESTRAS, C1-C6          : /500/500/500\n"
    text += f"ACEL. MAX.(Gal), C1-C6                 : /{peaks}\nACEL. MAX., C1-C6, EN LA MUESTRA       : /1/2/3\n"
    text += "UNIDADES DE LOS DATOS                  : Gal (cm/s/s)\nFACTOR DE DECIMACION                   : 1\n"
    text += "FORMATO DATOS (FORTRAN,10 campos/dato) : 3F10.3\n" + "=" * 80 + "\nDATOS DE ACELERACION:\n" + dashes
    text += "   CANAL-1   CANAL-2   CANAL-3\n" + "".join(f"{name:>10s}" for name in names) + "\n" + dashes
    text += "\n".join("".join(f"{v:10.3f}" for v in row) for row in values) + "\n"
    return text, Truth({name: values[:, k] / 100.0 for k, name in enumerate(names)}, 0.004)


def cwa() -> tuple[str, Truth]:
    values = np.round(np.stack([100.0 * motion(1000, k) for k in (121, 122, 123)], axis=1), 3)
    text = "#Earthquake Information\n#StationCode: EAS\n#RecordLength(sec): 20\n#SampleRate(Hz): 50\n"
    text += "#AmplitudeUnit:  gal. DCoffset(corr)\n"
    for k, name in enumerate("UNE"):
        text += f"#AmplitudeMAX. {name}: {values[:, k].max():8.3f}~ {values[:, k].min():8.3f}\n"
    text += "#DataSequence: Time U(+); N(-); E(+)\n#Data: 4F10.3\n"
    rows = np.column_stack([0.02 * np.arange(1000), values])
    text += "\n".join("".join(f"{v:10.3f}" for v in row) for row in rows) + "\n"
    signs = (1.0, -1.0, 1.0)
    return text, Truth({name: signs[k] * values[:, k] / 100.0 for k, name in enumerate("UNE")}, 0.02)


def csmnc() -> tuple[str, Truth]:
    a = np.array([float(fixed_e(v, 12, 6, 1)) for v in 100.0 * motion(1600, 171)])
    peak = a[np.abs(a).argmax()]
    text = "065JZC120103153901\n0120103153957 2012-01-03 15:39:57 BTM\nEARTHQUAKE\nEPICENTER  39.9N 77.3E DEPTH 9 KM\n"
    text += "MAGNITUDE  4.0(Ms)\nSTATION: 65JZC 39.7N 77.6E\nSITE CONDITION: SOIL\nINSTRUMENT TYPE: ETNA/ES-T\n"
    text += "OBSERVING POINT: GROUND\nCOMP. EW\nUNCORRECTED ACCELERATION          UNIT: CM/SEC/SEC\n"
    text += "NO. OF POINTS:   1600  EQUALLY SPACED INTERVALS OF:  0.005  SEC\n"
    text += f"PEAK VALUE: {peak:10.3f}   AT    4.00 SEC    DURATION:   8 SEC\n"
    text += "PRE-EVENT TIME:  20  SEC  RECORDER TIME:  2012-01-3 15:39:44.000 BTM\nCSMNC\n\n"
    text += "\n".join("".join(fixed_e(v, 12, 6, 1) + " " for v in a[n : n + 8]) for n in range(0, 1600, 8)) + "\n"
    return text, Truth({"EW": a / 100.0}, 0.005)


def esm() -> tuple[str, Truth]:
    a = np.round(100.0 * motion(800, 131), 6)
    text = "EVENT_NAME: GREECE\nSTATION_NAME: Fire unit of Athens\nSAMPLING_INTERVAL_S: 0.005000\nNDATA: 800\n"
    text += f"STREAM: HNE\nUNITS: cm/s^2\nPGA_CM/S^2: {np.abs(a).max():.6f}\nDATA_TYPE: ACCELERATION\nUSER5:\n"
    return text + "\n".join(f"{v:.6f}" for v in a) + "\n", Truth({"HNE": a / 100.0}, 0.005)


def peer() -> tuple[str, Truth]:
    a = np.array([float(f"{v:.7E}") for v in motion(803, 141) / G])
    text = "PEER NGA STRONG MOTION DATABASE RECORD\nImperial Valley-02, 5/19/1940, El Centro Array #9, 180\n"
    text += "ACCELERATION TIME SERIES IN UNITS OF G\nNPTS=    803, DT=   .0100 SEC\n" + rows_of(a, 5, "{:15.7E}") + "\n"
    return text, Truth({"acceleration": a * G}, 0.01)


def sigma() -> tuple[str, Truth]:
    a = np.array([float(f"{v:.7E}") for v in motion(802, 151)])
    text = "Event Date & Time             : 2009-04-06 01:32:39\nStation Code / Name           : 2987 / L Aquila\n"
    text += "Network                       : DPC\nOrientation                   : NS\nProcessing Info               : filtered\n"
    text += "Filter Cut-off Frequency (Hz) : 0.100 - 50.000\nTime Increment (s)            : 0.005\n"
    text += f"Number of Data                : 802\nPGA (m/s/s)                   : {np.abs(a).max():.7E}\n"
    text += "Accelaration time series in m/s/s\n" + rows_of(a, 5, "{:14.7E}") + "\n"
    return text, Truth({"NS": a}, 0.005)


def bbp() -> tuple[str, Truth]:
    values = np.array([[float(f"{100.0 * v:.7e}") for v in motion(400, k)] for k in (161, 162, 163)]).T
    text = "# Sim stat=s01\n#    time(sec)      N-S(cm/s/s)      E-W(cm/s/s)      U-D(cm/s/s)\n"
    text += "\n".join("\t".join(f"{v:.7e}" for v in (0.025 * n, *row)) for n, row in enumerate(values)) + "\n"
    return text, Truth({name: values[:, k] / 100.0 for k, name in enumerate(("N-S", "E-W", "U-D"))}, 0.025)


class Case(NamedTuple):
    """A writer, the name of the format, and arguments without which the file is not complete."""

    write: Callable[[], tuple[str, Truth]]
    format: str
    arguments: dict[str, object]


CASES = {
    "K-NET": Case(knet, "K-NET", {}),
    "KiK-net, borehole": Case(lambda: knet("1"), "K-NET", {}),
    "KiK-net, surface": Case(lambda: knet("5"), "K-NET", {}),
    "CSMIP V1": Case(csmip_v1, "CSMIP V1", {}),
    "CSMIP V1, film": Case(csmip_film, "CSMIP V1", {"dt": 0.005}),
    "CSMIP V2": Case(csmip_v2, "CSMIP V1 or V2", {}),
    "COSMOS, cm/s²": Case(cosmos, "COSMOS", {}),
    "COSMOS, g": Case(lambda: cosmos("g", 2, G), "COSMOS", {}),
    "GeoNet": Case(geonet, "GeoNet", {}),
    "SMC": Case(smc, "SMC", {}),
    "RENADIC": Case(renadic, "RENADIC", {}),
    "USC": Case(usc, "USC", {"dt": 0.005}),
    "BHRC": Case(bhrc, "BHRC", {}),
    "NSMN": Case(nsmn, "NSMN", {}),
    "UNAM": Case(unam, "UNAM", {}),
    "CWA": Case(cwa, "CWA", {}),
    "CSMNC": Case(csmnc, "CSMNC", {}),
    "ESM": Case(esm, "ESM", {}),
    "PEER": Case(peer, "PEER", {}),
    "SIGMA": Case(sigma, "SIGMA", {}),
    "BBP": Case(bbp, "Broadband", {}),
}
