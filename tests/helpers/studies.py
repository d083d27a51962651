"""The packaged study as other studies are made of it: without a surrogate, on five or six seconds of its record."""

import contextlib
import dataclasses

import pytest

from structid.study import packaged
from structid.study.stages import stage_list

PACKAGED = packaged.template("bouc_wen").replace('kind = "auto"', 'kind = "iid"').replace("particles = 500\n", "")
"""With an error model that need not be chosen, and the sampler as it comes."""


def _without(text: str, table: str) -> str:
    begin = text.index(f"\n[{table}]") + 1
    return text[:begin] + text[text.index("\n[", begin) + 1 :]


PLAIN = (
    _without(PACKAGED, "calibration")
    .replace('kind = "pod_kriging"', 'kind = "none"')
    .replace(
        'kind = "smc"',
        'kind = "aies"\nwalkers = 32\nensembles = 4\nsteps = 3000\ndiscard = 0.3\ndifferential_evolution = 0.8\n#',
    )
)
"""The model itself is sampled, by AIES."""


def shortened(text: str, end: str = "8 s") -> str:
    """The same on a part of the record."""
    return text.replace('lowpass = "20 Hz"', f'lowpass = "20 Hz"\ntrim = ["3 s", "{end}"]', 1)


SMALL = (
    PLAIN.replace('lowpass = "20 Hz"', 'lowpass = "20 Hz"\ntrim = ["3 s", "9 s"]', 1)
    .replace("steps = 3000", "steps = 80\nsettling_steps = 0\nstart_candidates = 2")
    .replace("walkers = 32", "walkers = 12")
    .replace("ensembles = 4", "ensembles = 2")
    .replace("starts = 4", "starts = 2")
)
"""Six seconds of record and eighty steps, which do not converge."""


@contextlib.contextmanager
def without_pages():
    """Studies that are looked at by their draws alone; half of a short study's time is its page."""
    with pytest.MonkeyPatch.context() as patch:
        nothing = dataclasses.replace(stage_list.PAGE_STAGE, run=lambda found, place: found)
        patch.setattr(stage_list, "PAGE_STAGE", nothing)
        yield
