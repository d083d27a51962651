"""The samplers against reference draws of posteriordb."""

import posteriordb
import pytest

import structid as si

pytestmark = pytest.mark.slow


SAMPLERS = {
    "aies": si.AIES(
        walkers=60, steps=4000, differential_evolution=0.6, discard=0.25, start_candidates=10, settling_steps=500
    ),
    "smc": si.SMC(particles=500, steps=80),
    "nuts": si.NUTS(steps=800),
}


@pytest.mark.parametrize("kind", SAMPLERS)
@pytest.mark.parametrize("folder", posteriordb.POSTERIORS)
def test_reference_draws_of_posteriordb(shared_data, folder, kind, capsys):
    """Means and sds within four combined Monte-Carlo standard errors, theirs and ours."""
    data, reference = posteriordb.load(shared_data / "posteriordb" / folder)
    target, quantities = posteriordb.POSTERIORS[folder](data)
    result = si.sample(target, SAMPLERS[kind], seed=1)
    worst = posteriordb.deviations(result.kept, reference, quantities)
    with capsys.disabled():
        print(f"\n{folder}, {kind}: largest deviation {max(map(abs, worst.values())):.2f} combined standard errors")
    assert max(map(abs, worst.values())) < 4.0, worst
