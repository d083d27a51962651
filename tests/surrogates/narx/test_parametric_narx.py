"""Fitted NARX: of one system, of several inputs and outputs, ahead of a measurement, with runs that count for more."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError

DT = 0.01


def test_narx_of_one_measured_system():
    """A linear oscillator, its force and displacement: the free run on another force is exact to rounding's order."""
    rng = np.random.default_rng(6)
    model = si.BoucWen(
        mass=2.0, damping_ratio=0.05, stiffness=3553.0, alpha=1.0, beta=1.0, gamma=0.0, channels=("displacement",)
    )
    forces = [
        si.ForceHistory(np.pad(np.convolve(rng.normal(size=1500), np.ones(5) / 5, "same"), (3, 0)), 0.01, n)
        for n in "ab"
    ]
    responses = [model.simulate(np.zeros((1, 0)), f).values[0, :, 0] for f in forces]
    terms = [*(f"x(t-{k})" if k else "x(t)" for k in range(3)), "y(t-1)", "y(t-2)"]
    surrogate = si.NARX(terms=terms).fit(forces[0], responses[0])
    assert surrogate.free == ()
    predicted = surrogate.simulate(np.zeros((1, 0)), forces[1]).values[0, :, 0]
    assert np.mean((predicted - responses[1]) ** 2) / responses[1].var() < 1e-6
    with pytest.raises(InputError, match=r"1 values that are not finite.*repair the measurement"):
        si.NARX(terms=terms).fit(forces[0], np.where(np.arange(len(responses[0])) == 5, np.nan, responses[0]))
    with pytest.raises(InputError, match="a response of shape"):
        si.NARX(terms=terms).fit(forces[0], responses[0][:-1])


@pytest.mark.parametrize(
    "wrong", [dict(terms=("sinh(x(t))",)), dict(memories=("z is y",)), dict(steps=-3), dict(degree=(1, 2))]
)
def test_settings_are_checked_before_any_run(wrong):
    with pytest.raises(InputError):
        si.PCNARX(**wrong)


@pytest.fixture(scope="module")
def two_forces():
    """Velocity and displacement of a linear oscillator that two forces drive, one of them with half its weight."""
    rng = np.random.default_rng(8)
    smooth = lambda: np.pad(np.convolve(rng.normal(size=1200), np.ones(5) / 5, "same"), (3, 0))  # noqa: E731
    a, b = (si.ForceHistory(smooth(), DT, n) for n in "ab")
    both = si.ForceHistory(a.values + 0.5 * b.values, DT)
    channels = ("velocity", "displacement")
    model = si.BoucWen(
        mass=2.0, damping_ratio=0.05, stiffness=2000.0, alpha=1.0, beta=1.0, gamma=0.0, channels=channels
    )
    return si.CombinedExcitation((a, b)), model.simulate(np.zeros((1, 0)), both).values[0], channels


def linear_terms(channels):
    """Two samples of both inputs' past and of each output's own."""
    past = [f"x{i}(t-{k})" if k else f"x{i}(t)" for i in (1, 2) for k in range(3)]
    return {c: [*past, f"y{i}(t-1)", f"y{i}(t-2)"] for i, c in enumerate(channels, 1)}


def test_a_narx_of_two_inputs_and_terms_of_each_output(two_forces):
    excitation, response, channels = two_forces
    terms = linear_terms(channels)
    surrogate = si.NARX(terms=terms).fit(excitation, response, channels)
    assert surrogate.terms == tuple(f"y{i}: {t}" for i, c in enumerate(channels, 1) for t in terms[c])
    predicted = surrogate.simulate(np.zeros((1, 0)), excitation).values[0]
    error = np.mean((predicted - response) ** 2, axis=0) / response.var(axis=0)
    assert error.max() < 1e-6
    # The second force enters with half the weight of the first.
    ones = surrogate.coefficients.predict(np.zeros((1, 0)))[0]
    scales = surrogate.recursion.scales
    assert ones[3] / scales["x2"] == pytest.approx(0.5 * ones[0] / scales["x1"], rel=1e-3)


def test_several_inputs_are_kept_with_their_runs_and_their_surrogate(two_forces, tmp_path):
    excitation, response, channels = two_forces
    surrogate = si.NARX(terms=linear_terms(channels), horizons=(8,), steps=2).fit(excitation, response, channels)
    assert surrogate.recursion.inputs == ("x1", "x2")
    again = si.load_surrogate(surrogate.save(tmp_path / "two.h5"))
    nothing = np.zeros((1, 0))
    np.testing.assert_array_equal(
        again.simulate(nothing, excitation).values, surrogate.simulate(nothing, excitation).values
    )

    def respond(theta, record):
        return np.cumsum(record.values @ np.array([theta["gain"], 1.0]))

    space = si.ParameterSpace(gain=si.Uniform(0.0, 1.0))
    model = si.CallableModel(respond, free=space.names, channels=("velocity",))
    runs = si.Campaign(model, excitation, space.sample(3, seed=1), tmp_path / "runs.h5").run()
    (record,) = si.open_runs(tmp_path / "runs.h5").records
    assert record.content_hash == excitation.content_hash and record.kind == "force+force"
    assert runs.to_xarray()["excitation"].shape == (1, len(excitation), 2)
    single = excitation.parts[0]
    with pytest.raises(InputError, match="records with 1 and 2 signals"):
        si.Campaign(model, [single, excitation], space.sample(3, seed=1))
    oscillator = si.BoucWen(mass=2.0, damping_ratio=0.05, stiffness=2000.0, alpha=1.0, beta=1.0, gamma=0.0)
    with pytest.raises(InputError, match="2 signals at once"):
        oscillator.simulate(np.zeros((1, 0)), excitation)
    with pytest.raises(InputError, match=r"one list: CombinedExcitation"):
        si.CombinedExcitation(single, single)
    with pytest.raises(InputError, match="two or more signals with equal properties"):
        si.CombinedExcitation((single, si.ForceHistory(single.values, 2 * DT)))


def test_predictions_ahead_of_what_was_measured(two_forces):
    excitation, response, channels = two_forces
    # Too few terms to be exact, so that there is something to go wrong.
    few = {c: ["x1(t)", "x2(t)", f"y{i}(t-1)", f"y{i}(t-2)"] for i, c in enumerate(channels, 1)}
    surrogate = si.NARX(terms=few, steps=0).fit(excitation, response, channels)
    wrong = response + 0.05 * response.std(axis=0) * np.random.default_rng(9).normal(size=response.shape)
    nothing = np.zeros((1, 0))
    error = lambda h: np.mean((h.values[0] - wrong) ** 2)  # noqa: E731
    free = surrogate.simulate(nothing, excitation)
    whole = surrogate.predict_ahead(nothing, excitation, wrong, horizon=len(excitation))
    # Never started again it is the free run, but for the measured first sample.
    assert error(whole) == pytest.approx(error(free), rel=0.05)
    # One step ahead of a measurement without noise, the recursion has less time to go wrong than when it is free.
    clean = lambda horizon: np.mean(  # noqa: E731
        (surrogate.predict_ahead(nothing, excitation, response, horizon).values[0] - response) ** 2
    )
    assert clean(1) < clean(50) <= 1.5 * np.mean((free.values[0] - response) ** 2)
    with pytest.raises(InputError, match="horizon"):
        surrogate.predict_ahead(nothing, excitation, response, 0)
    with pytest.raises(InputError, match=r"measured.*shape \(5, 2\)"):
        surrogate.predict_ahead(nothing, excitation, response[:5])


def test_the_lead_in_of_a_periodic_record_is_run_through():
    """The coefficients of a linear recursion, from the steady state alone: found only if what goes before is known."""
    rng = np.random.default_rng(10)
    force = si.ForceHistory(rng.normal(size=300), DT, interpolation="periodic", lead_in_periods=2)
    y = np.zeros(900)
    for t in range(1, 900):
        y[t] = 0.9 * y[t - 1] + 0.5 * force.values[t % 300] - 0.2 * force.values[(t - 1) % 300]
    surrogate = si.NARX(terms=["x(t)", "x(t-1)", "y(t-1)"], held_out=0.0).fit(force, y[600:])
    recursion = surrogate.recursion
    found = surrogate.coefficients.predict(np.zeros((1, 0)))[0]
    gain = recursion.scales["x"] / recursion.scales["y"]
    np.testing.assert_allclose(found, [0.5 * gain, -0.2 * gain, 0.9], rtol=1e-6)
    np.testing.assert_allclose(surrogate.simulate(np.zeros((1, 0)), force).values[0, :, 0], y[600:], atol=1e-9)


CYCLE = np.arange(800) * 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("channel", "excitation", "limit"),
    [
        ("displacement", None, 1e-3),
        ("relative_acceleration", None, 1e-3),
        ("restoring_force", si.DisplacementHistory(0.02 * np.sin(1.5 * CYCLE) * CYCLE / 16.0, 0.02), 1e-3),
    ],
)
def test_the_default_terms_suit_the_channel(channel, excitation, limit):
    record = excitation or si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 12.0).scale_to_pga(3.0)
    space = si.ParameterSpace(gamma_ratio=si.Uniform(-0.5, 1.0))
    model = si.BoucWen(
        mass=12_000.0, damping_ratio=0.03, stiffness=7e6, beta=60.0, alpha=0.06, free=space.names, channels=(channel,)
    )
    runs = si.Campaign(model, record, space.sample(30, seed=1)).run()
    surrogate = si.PCNARX(degree=2, steps=6).fit(runs)
    assert surrogate.validate(si.Campaign(model, record, space.sample(20, seed=2)).run()).mean < limit


def test_what_too_few_runs_or_unlike_records_would_cost_is_said_before_they_are_made():
    space = si.ParameterSpace(a=si.Uniform(0, 1), b=si.Uniform(0, 1))
    record = si.GroundMotion.synthetic(seed=1)
    with pytest.raises(InputError, match=r"18 runs.*10 chaos terms.*at least 20 runs"):
        si.PCNARX().check(space.sample(20, seed=1), [record], ("velocity",))
    si.PCNARX(training="per-experiment").check(space.sample(20, seed=1), [record], ("velocity",))
    coarse = si.GroundMotion(record.values[::2], 2 * record.dt)
    for settings in (si.PCNARX(), si.PODKriging(), si.PODPCE()):
        with pytest.raises(InputError, match="one kind and one time step"):
            settings.check(space.sample(100, seed=1), [record, coarse], ("velocity",))
    with pytest.raises(InputError, match="9 runs on each of 2 records"):
        si.PODKriging().check(space.sample(18, seed=1), [record, record.trim(0.0, 10.0)], ("velocity",))


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [si.PCNARX(degree=1, steps=4), si.KrigingNARX(degree=1, steps=6, refinements=1)],
    ids=["PCNARX", "KrigingNARX"],
)
def test_a_surrogate_too_plain_for_all_runs_suits_those_that_weigh(kind):
    record = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 8.0).scale_to_pga(3.0)
    space = si.ParameterSpace(gamma_ratio=si.Uniform(-0.8, 1.0), stiffness=si.Uniform(5.0, 9.0, unit="kN/mm"))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=space.names)
    runs = si.Campaign(model, record, space.sample(60, seed=1)).run()
    unseen = space.sample(100, seed=2)
    near = unseen[np.flatnonzero(distance(unseen) < 0.3)]
    there = si.Campaign(model, record, near).run()
    weights = np.exp(-((distance(runs.design) / 0.3) ** 2)) + 1e-3
    plain, weighted = kind.fit(runs), kind.fit(runs, weights=weights)
    assert weighted.validate(there).mean < 0.8 * plain.validate(there).mean
    np.testing.assert_allclose(
        kind.fit(runs, weights=np.full(60, 7.0)).simulate(near, record).values, plain.simulate(near, record).values
    )


def distance(design):
    """From the middle of the prior, in units of its width."""
    low, high = design.space.bounds.T
    return np.linalg.norm((design.values - low) / (high - low) - 0.5, axis=1)


@pytest.mark.parametrize("wrong", [np.ones(5), np.zeros(20), np.full(20, np.nan)])
def test_weights_that_are_none(wrong):
    record = si.GroundMotion.synthetic(seed=8).trim(3.0, 4.0)
    space = si.ParameterSpace(gamma_ratio=si.Uniform(-0.5, 1.0))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, stiffness=7e6, beta=60.0, alpha=0.06, free=space.names)
    runs = si.Campaign(model, record, space.sample(20, seed=1)).run()
    with pytest.raises(InputError, match="20 positive numbers"):
        si.PCNARX(degree=1).fit(runs, weights=wrong)


def test_a_free_run_after_a_measured_beginning():
    """Free vibrations of a linear system: from rest there are none, after a measured beginning they are exact."""
    rng = np.random.default_rng(3)
    a, b, samples = (1.9, -0.95), 0.01, 600

    def respond(force, start=()):
        y = np.zeros(len(force) + 1)  # and one sample of rest before
        y[1 : 1 + len(start)] = start
        for t in range(1 + max(len(start), 1), len(y)):
            y[t] = a[0] * y[t - 1] + a[1] * y[t - 2] + b * force[t - 1]
        return y[1:]

    force = si.ForceHistory(rng.normal(size=samples), DT)
    terms = {"displacement": ["x(t)", "y(t-1)", "y(t-2)"]}
    surrogate = si.NARX(terms=terms).fit(force, respond(force.values))
    still, nothing = si.ForceHistory(np.zeros(samples), DT), np.zeros((1, 0))
    expected = respond(still.values, (1.0, 0.97))
    found = surrogate.simulate_after(nothing, still, expected[:5]).values[0, :, 0]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_array_equal(found[:5], expected[:5])
    assert np.abs(surrogate.simulate(nothing, still).values).max() < 1e-6
    with pytest.raises(InputError, match="1 to 599"):
        surrogate.simulate_after(nothing, still, expected)
    wild = surrogate.simulate_after(nothing, still, 1e9 * expected[:5])
    assert not wild.done[0] and wild.failure_time[0] == 0.0
