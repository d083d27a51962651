#!/usr/bin/env bash
# gmprocess 2.8.0: a RENADIC file (University of Chile) is read only if a byte of it is not valid UTF-8, such as the Ñ of a station.
#
# Guess before the run: gmprocess has a reader for RENADIC, so it reads these files; at most an accent in Latin-1 is a problem.
# Seen: the opposite. A file in plain ASCII is claimed by two formats, "renadic" and "dmg" (CSMIP), and refused; the message
# advises to name the format, and a named format is refused in the same way. The test for "dmg" opens the file as UTF-8. If that
# fails, it does not claim the file, which is then read. Of 28 files of the 2009 and 2010 earthquakes, the five of Peñalolén and
# Viña are read. Their step is the length divided by the number of intervals, 0.00501 s, and not the 0.005 s of the printed times.
set -eu
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "gmprocess==2.8.0"
cat > "$work/renadic.py" <<'PY'
import logging
import sys
import warnings
from pathlib import Path

warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)

import numpy as np
from gmprocess.io.read import read_data

HEAD = """UNCORRECTED ACCELEROGRAM DATA              PROCESSED: 01/02/2020
A RECORD
01/01/2020 3:05:27 (GMT)                (ORIGIN: 01/01/2020 3:05:27 GMT)
                                   TRIGGER TIME: 01/01/2020 3:06:17.600 GMT
STATION NO.         30.000S   70.000W  ETNA      S/N  999 (3  CHNS OF 3  AT STA)
{station} S/N 999
CHAN  {n}: {name:8s} (STA CHN:  {n})
UNIVERSIDAD DE CHILE - RENADIC
HYPOCENTER:   0.000N    0.000E  H=   0.0KM   ML= 0.00
INSTR PERIOD = 0.0195 SEC,  DAMPING =0.6500,  SENSITIVITY =2.508 VDC/G
NO. OF POINTS =    500  RECORD LENGTH =  2.500 SEC
UNITS OF UNCOR ACCEL ARE SEC AND G/10.     MAX  =  0.100 G, AT   1.000 SEC
RMS ACCEL OF COMPLETE RECORD = 0.005 G
"""
INTEGERS = ("    0" * 16 + "\n") * 6 + "    0" * 4 + "\n"
REALS = ("     0.000" * 8 + "\n") * 6 + "     0.000" * 2 + "\n"


def renadic(station):
    """A file of three channels at 200 samples per second: pairs of time and acceleration."""
    times = 0.005 * np.arange(500)
    pairs = np.stack([times, np.sin(6.0 * times)], axis=1).reshape(-1, 10)
    body = "".join("".join(f"{value:7.3f}" for value in row) + "\n" for row in pairs)
    return "".join(
        HEAD.format(station=station, n=n, name=name) + INTEGERS + REALS + body + f"/&  ---  END OF DATA FOR CHANNEL {n}  ---\n"
        for n, name in enumerate(("NS", "V", "EW"), start=1)
    )


def read(path, **how):
    """What gmprocess makes of a file."""
    try:
        traces = [trace for stream in read_data(path, **how) for trace in stream]
    except Exception as problem:
        return str(problem).split(".")[0].split(": ", 1)[1]
    return f"{len(traces)} channels at {traces[0].stats.delta:.5f} s"


path = Path(sys.argv[1]) / "record.v1"
seen = []
for station, how in (("ARICA", {}), ("VI\u00d1A", {}), ("ARICA", {"read_format": "renadic"})):
    path.write_text(renadic(station), encoding="latin-1")
    seen.append(read(path, **how))
print(*seen, sep=" | ")
assert seen == ["['renadic', 'dmg']", "3 channels at 0.00501 s", "['renadic', 'dmg']"]
PY
"$work/venv/bin/python" "$work/renadic.py" "$work"
# Output: ['renadic', 'dmg'] | 3 channels at 0.00501 s | ['renadic', 'dmg']
