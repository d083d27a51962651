"""NARX: terms that read as they are written, recursions against plain loops, training that finds what made the data."""

import itertools

import numpy as np
import pytest

import structid as si
from structid.errors import InputError
from structid.surrogates.narx.candidate_terms import (
    absolute_terms,
    exponential_terms,
    hysteretic_terms,
    polynomial_terms,
    prony_terms,
)
from structid.surrogates.narx.experiments import Experiments, Signals
from structid.surrogates.narx.free_run import FreeRun
from structid.surrogates.narx.one_step_regression import first_coefficients, joint_solution
from structid.surrogates.narx.recursion import Recursion
from structid.surrogates.narx.structure import build_recursion
from structid.surrogates.narx.term_selection import select_terms
from structid.surrogates.narx.terms import Memory, Term, as_memories, as_terms
from structid.surrogates.narx.training import train_free_run
from structid.surrogates.narx.training_set import TrainingSet, training_set

DT = 0.01


# --- terms ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("x(t-3)*|y(t-1)|", 2.0 * 3.0),
        ("y(t-1)^2", 9.0),
        ("exp(x(t))", np.e),
        ("|y(t-1) - y(t-2)|", 8.0),
        ("x(t)*exp(2*t)*cos(2*pi*t + 0.5)", np.exp(1.0) * np.cos(np.pi + 0.5)),
        ("1", 1.0),
        ("exp(t)*x(t)", np.exp(0.5)),
    ],
)
def test_a_term_says_what_it_means(text, value):
    values = {("x", 0): 1.0, ("x", 3): 2.0, ("y", 1): -3.0, ("y", 2): 5.0}
    np.testing.assert_allclose(Term(text).evaluate(values, 0.5), value, rtol=1e-12)
    assert str(Term(text)) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x*y(t-1)", r"'x'.*lagged signal such as x\(t-1\)"),
        ("x(t-1) if y(t-1) else 2", "term"),
        ("sinh(x(t))", "sinh"),
        ("x(t-1", "arithmetic expression"),
        ("y(t+1)", r"'y\(t\+1\)'.*y\(t-1\) or earlier"),
    ],
)
def test_a_term_that_cannot_be_read(text, words):
    with pytest.raises(InputError, match=words):
        Term(text)


def test_generators():
    assert len(absolute_terms()) == 19  # the thesis's 18 products and |y(t-1)|
    assert len(polynomial_terms(1, 1, 2)) == 1 + 3 + 6
    assert {str(t) for t in exponential_terms(1)} == {"x(t)^2", "x(t-1)^2", "exp(x(t))", "exp(x(t-1))"}
    assert len(prony_terms()) == 60
    terms, memories = hysteretic_terms(("y1", "y2"), ("x",), (1, 0))
    assert [str(m) for m in memories] == ["u1 = integral(y1)", "z1 = hysteresis(u1)", "z2 = hysteresis(y2)"]
    assert "z2(t-1)*|y2(t-1) - y2(t-2)|" in {str(t) for t in terms}


@pytest.mark.parametrize(
    ("terms", "memories", "words"),
    [
        (("v(t-1)",), (), r"the signal 'v'.*x, y"),
        (("y(t)",), (), r"y\(t\).*not known yet"),
        (("y(t-1)",), ("u = integral(w)",), "the signal 'w'"),
        (("y(t-1)",), ("u = mean(y)",), "integral"),
        (("y(t-1)",), ("u is y",), "u = integral"),
        ((), (), "one term or more"),
    ],
)
def test_a_structure_that_does_not_fit(terms, memories, words):
    experiments = Experiments(
        np.ones((1, 9, 1)), np.ones((1, 9, 1)), np.ones((1, 9), dtype=bool), DT, Signals(("x",), ("velocity",))
    )
    with pytest.raises(InputError, match=words):
        build_recursion(experiments, terms, memories)


# --- recursion ------------------------------------------------------------------------------------------------------

TERMS = as_terms(["x(t)", "x(t-2)", "y(t-1)", "y(t-2)*|y(t-1)|", "u(t-1)", "z(t-2)"])
MEMORIES = as_memories(["u = integral(y)", "z = hysteresis(u)"])


@pytest.fixture(scope="module")
def recursion():
    return Recursion((TERMS,), MEMORIES, ("x",), ("y",), DT, {"x": 1.0, "y": 2.0, "u": 0.1, "z": 1.0}, np.array([0.0]))


def by_hand(c, x):
    """The same recursion as a plain loop."""
    n, b, g = len(x), c[6], c[7]
    y, u, z = np.zeros(n), np.zeros(n), np.zeros(n)
    back = lambda s, t, k: s[t - k] if t >= k else 0.0  # noqa: E731
    for t in range(1, n):
        y[t] = (
            c[0] * x[t] + c[1] * back(x, t, 2) + c[2] * y[t - 1] + c[3] * back(y, t, 2) * abs(y[t - 1]) + c[4] * u[t - 1]
            + c[5] * back(z, t, 2)
        )  # fmt: skip
        u[t] = u[t - 1] + 2.0 * DT / 0.1 * 0.5 * (y[t] + y[t - 1])
        du = u[t] - u[t - 1]
        slope = lambda m: du - b * abs(du) * m - g * du * abs(m)  # noqa: B023, E731
        z[t] = z[t - 1] + slope(z[t - 1] + 0.5 * slope(z[t - 1]))
    return y


@pytest.fixture(scope="module")
def coefficients():
    rng = np.random.default_rng(1)
    base = np.array([0.4, 0.2, 0.9, -0.05, -0.3, -0.2, 0.5, 0.2])
    return base + 0.02 * rng.normal(size=(5, 8))


@pytest.fixture(scope="module")
def signals():
    rng = np.random.default_rng(2)
    return np.cumsum(rng.normal(size=(5, 300)), axis=1) * 0.05


def test_the_free_run_is_the_plain_loop(recursion, coefficients, signals):
    from structid.device import jnp

    x = jnp.asarray(signals[0])[:, None]
    found = np.asarray(recursion.free_run(jnp.asarray(coefficients.T), x, 1e3))[:, 0].T
    for k in range(5):
        np.testing.assert_allclose(found[k], by_hand(coefficients[k], signals[0]), rtol=1e-9, atol=1e-12)


@pytest.fixture(scope="module")
def data(coefficients, signals):
    y = np.stack([by_hand(c, x) for c, x in zip(coefficients, signals, strict=True)])
    return TrainingSet(signals[:, :, None], y[:, :, None], np.ones(y.shape, dtype=bool), np.ones(len(y)))


def test_one_step_terms_reproduce_the_outputs(recursion, coefficients, data):
    """Along outputs it made itself the recursion's terms sum to them, so that regression returns the coefficients."""
    square, inner = FreeRun(recursion, 1e3).regression_equations(coefficients, data)
    for k in range(5):
        found = np.linalg.solve(square[k, 0, :6, :6], inner[k, 0, :6])
        np.testing.assert_allclose(found, coefficients[k, :6], rtol=1e-6)


@pytest.mark.parametrize("horizon", [None, 1, 7, 1000])
def test_a_free_run_of_the_true_coefficients_has_no_error(recursion, coefficients, data, horizon):
    assert FreeRun(recursion, 1e3, horizon).errors(coefficients, data).max() < 1e-20


@pytest.mark.parametrize("horizon", [None, 20])
def test_sensitivities_are_exact(recursion, coefficients, data, horizon):
    """Jᵀr is minus half the gradient of Σ r², by central differences."""
    run = FreeRun(recursion, 1e3, horizon)
    moved = coefficients + 0.01
    _, inner = run.normal_equations(moved, data)
    for j in range(8):
        up, down = moved.copy(), moved.copy()
        up[:, j] += 1e-6
        down[:, j] -= 1e-6
        slope = (run.errors(up, data) - run.errors(down, data)) / 2e-6
        np.testing.assert_allclose(inner[:, :, j], -0.5 * slope, rtol=1e-4, atol=1e-7 * np.abs(inner).max())


def test_training_on_the_free_run_returns_to_what_made_the_data(recursion, coefficients, data):
    run = FreeRun(recursion, 50.0)
    features = np.ones((5, 1))
    shared = coefficients.mean(axis=0)
    from structid.device import jnp

    y = np.asarray(
        recursion.free_run(jnp.asarray(np.tile(shared, (5, 1)).T), jnp.asarray(data.x).transpose(1, 2, 0), 50.0)
    )
    own = TrainingSet(data.x, y.transpose(2, 0, 1), data.counted, data.weights)
    start = (shared * (1 + 0.03 * np.random.default_rng(3).normal(size=8)))[:, None]
    trained = train_free_run(run, start, features, own, None, 30, 1e-3)
    losses = [h["loss"] for h in trained.history]
    assert all(b < a for a, b in itertools.pairwise(losses))
    np.testing.assert_allclose(trained.coefficients[:, 0], shared, rtol=1e-3, atol=1e-4)


def test_the_joint_solution_is_the_stacked_regression():
    rng = np.random.default_rng(4)
    features, a = rng.normal(size=(20, 3)), rng.normal(size=(4, 3))
    regressors = rng.normal(size=(20, 50, 4))
    response = np.einsum("rti,ip,rp->rt", regressors, a, features)
    square, inner = np.einsum("rti,rtj->rij", regressors, regressors), np.einsum("rti,rt->ri", regressors, response)
    np.testing.assert_allclose(joint_solution(square, inner, features, np.ones(20), 0.0), a, rtol=1e-9)


def test_a_run_that_diverges_is_a_large_number(recursion, data):
    wild = np.tile([1.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.5, 0.0], (5, 1))
    errors = FreeRun(recursion, 10.0).errors(wild, data)
    assert np.isfinite(errors).all() and (errors > 10).all()


def test_selection_finds_the_terms_that_are_there(signals):
    rng = np.random.default_rng(5)
    y = np.zeros((5, 300))
    for t in range(1, 300):
        y[:, t] = 0.7 * y[:, t - 1] + 0.5 * signals[:, t] - 0.2 * signals[:, t] * np.abs(y[:, t - 1])
    y += 1e-6 * rng.normal(size=y.shape)
    experiments = Experiments(
        signals[:, :, None], y[:, :, None], np.ones(y.shape, dtype=bool), DT, Signals(("x",), ("velocity",))
    )
    recursion = build_recursion(experiments, absolute_terms(2, 2), ())
    for method in ("lars", "orthogonal"):
        kept = select_terms(FreeRun(recursion, 50.0), training_set(experiments, recursion), method, 5)
        assert {"x(t)", "y(t-1)", "x(t)*|y(t-1)|"} <= {str(t) for t in kept.terms[0]}
        assert len(kept.terms[0]) <= 5


def test_the_first_coefficients_choose_the_shape_of_a_hysteresis():
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 12.0).scale_to_pga(3.0)
    space = si.ParameterSpace(gamma_ratio=si.Uniform(-0.5, 0.8))
    model = si.BoucWen(mass=12_000.0, stiffness=7e6, alpha=0.05, beta=60.0, damping_ratio=0.03, free=space.names)
    design = space.sample(20, seed=1)
    runs = si.Runs.from_histories(design, model.simulate(design, record), record)
    experiments = Experiments.of(runs, record.dt)
    recursion = build_recursion(experiments, None, ())
    found = first_coefficients(FreeRun(recursion, 20.0), np.ones((20, 1)), training_set(experiments, recursion))
    assert found[-2, 0] > 0 and found[-1, 0] == 0


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


def test_memories_are_named_once():
    with pytest.raises(InputError, match="that of a function"):
        Memory("exp", "integral", "y")


@pytest.mark.parametrize(
    "wrong", [dict(terms=("sinh(x(t))",)), dict(memories=("z is y",)), dict(steps=-3), dict(degree=(1, 2))]
)
def test_settings_are_checked_before_any_run(wrong):
    with pytest.raises(InputError):
        si.PCNARX(**wrong)


# --- several inputs, several outputs, what is predicted ahead -------------------------------------------------------


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
    with pytest.raises(InputError, match="records of 1 and 2 signals"):
        si.Campaign(model, [single, excitation], space.sample(3, seed=1))
    oscillator = si.BoucWen(mass=2.0, damping_ratio=0.05, stiffness=2000.0, alpha=1.0, beta=1.0, gamma=0.0)
    with pytest.raises(InputError, match="2 signals at once"):
        oscillator.simulate(np.zeros((1, 0)), excitation)
    with pytest.raises(InputError, match=r"one list: CombinedExcitation"):
        si.CombinedExcitation(single, single)
    with pytest.raises(InputError, match="agree in all of these"):
        si.CombinedExcitation((single, si.ForceHistory(single.values, 2 * DT)))


def test_predictions_ahead_of_what_was_measured(two_forces):
    excitation, response, channels = two_forces
    surrogate = si.NARX(steps=0).fit(excitation, response, channels)
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


@pytest.mark.parametrize(
    ("text", "value"), [("|x(t) - |y(t-1)||", 2.0), ("||y(t-1)| - |x(t-3)||*x(t-3)", 2.0), ("| y(t-1) | * 2", 6.0)]
)
def test_bars_within_bars(text, value):
    assert Term(text).evaluate({("x", 0): 1.0, ("x", 3): 2.0, ("y", 1): -3.0}) == value


def test_bars_that_are_no_pairs():
    with pytest.raises(InputError, match="bars in pairs"):
        Term("|x(t)*y(t-1)")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(terms={"speed": ["x(t)"]}), "those of speed.*velocity"),
        (dict(memories=["z = hysteresis(y)"]), "none without terms"),
    ],
)
def test_structures_that_say_too_little(settings, words):
    experiments = Experiments(
        np.ones((1, 9, 1)), np.ones((1, 9, 1)), np.ones((1, 9), dtype=bool), DT, Signals(("x",), ("velocity",))
    )
    with pytest.raises(InputError, match=words):
        build_recursion(experiments, settings.get("terms"), settings.get("memories", ()))


def test_what_too_few_runs_or_unlike_records_would_cost_is_said_before_they_are_made():
    space = si.ParameterSpace(a=si.Uniform(0, 1), b=si.Uniform(0, 1))
    record = si.GroundMotion.synthetic(seed=1)
    with pytest.raises(InputError, match=r"18 runs.*10 chaos terms.*20 runs or more"):
        si.PCNARX().check(space.sample(20, seed=1), [record], ("velocity",))
    si.PCNARX(training="per-experiment").check(space.sample(20, seed=1), [record], ("velocity",))
    coarse = si.GroundMotion(record.values[::2], 2 * record.dt)
    for settings in (si.PCNARX(), si.PODKriging(), si.PODPCE()):
        with pytest.raises(InputError, match="one kind and one step"):
            settings.check(space.sample(100, seed=1), [record, coarse], ("velocity",))
    with pytest.raises(InputError, match="9 runs on each of 2 records"):
        si.PODKriging().check(space.sample(18, seed=1), [record, record.trim(0.0, 10.0)], ("velocity",))


# --- runs that count for more ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [si.PCNARX(degree=1, steps=6), si.KrigingNARX(degree=1, steps=6, refinements=1)])
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
