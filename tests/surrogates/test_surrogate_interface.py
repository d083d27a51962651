"""One contract for every surrogate of histories: a model with a face like any other, that knows what it is worth."""

import dataclasses
import inspect
import warnings

import numpy as np
import pytest

import structid as si
from package import modules
from structid.campaign.runs import StoredInMemory
from structid.core.errors import InputError, Status, StructidWarning
from structid.models.base import Model
from structid.surrogates.surrogate_list import load_surrogate
from structid.surrogates.surrogate_validation import relative_errors

KINDS = {
    "PODKriging": si.PODKriging(),
    "PODPCE": si.PODPCE(),
    "PCNARX": si.PCNARX(degree=2, steps=6),
    "KrigingNARX": si.KrigingNARX(degree=1, steps=6),
    "CorrectedNARX": si.CorrectedNARX(si.PCNARX(degree=2, steps=6)),
}


def test_no_kind_is_forgotten():
    """What a study may name, what can be fitted to runs, and what comes of it."""

    def fits_runs(settings):
        fit = getattr(settings, "fit", None)
        return inspect.isfunction(fit) and "runs" in inspect.signature(fit).parameters

    found = {
        thing.__name__
        for module in modules()
        for thing in vars(module).values()
        if module.__name__.startswith("structid.surrogates.")
        and inspect.isclass(thing)
        and dataclasses.is_dataclass(thing)
        and fits_runs(thing)
    }
    assert set(KINDS) == found


@pytest.fixture(scope="module")
def space():
    return si.ParameterSpace(
        stiffness=si.Normal(7.42, 0.5, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-0.5, 1.0)
    )


@pytest.fixture(scope="module")
def model(space):
    return si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=space.names)


@pytest.fixture(scope="module")
def record():
    return si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(3.0)


@pytest.fixture(scope="module")
def other_record():
    return si.GroundMotion.synthetic(seed=9).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(3.0)


@pytest.fixture(scope="module")
def runs(model, space, record):
    return si.Campaign(model, record, space.sample(80, seed=1, method="sobol", widen=1.4)).run()


@pytest.fixture(scope="module")
def unseen(model, space, record):
    return si.Campaign(model, record, space.sample(60, seed=2, method="random")).run()


@pytest.fixture(scope="module")
def told():
    """What each fit says of its progress."""
    return {name: [] for name in KINDS}


@pytest.fixture(scope="module")
def fitted(runs, told):
    return {name: kind.fit(runs, lambda *of, name=name: told[name].append(of)) for name, kind in KINDS.items()}


@pytest.fixture(params=KINDS)
def surrogate(request, fitted):
    return fitted[request.param]


def test_it_is_a_model(surrogate, model, space, record):
    assert isinstance(surrogate, Model) and surrogate.free == space.names and surrogate.channels == ("velocity",)
    design = space.sample(12, seed=3)
    histories = surrogate.simulate(design, record)
    assert histories.values.shape == (12, len(record), 1) and histories.done.all()
    assert relative_errors(model.simulate(design, record).values, histories.values).mean() < 1e-3


def test_validation_is_a_gate(surrogate, unseen, space, record, model):
    validation = surrogate.validate(unseen)
    print(validation)
    assert validation.mean < 1e-3 and validation.worst < 2e-2 and validation.diverged == 0
    assert validation.median <= validation.q95 <= validation.worst
    assert validation.per_channel["velocity"]["mean"] == pytest.approx(validation.mean)
    assert validation.peak_error < 0.02
    # Standard deviations confirmed by runs that chose nothing: not far below 95 %.
    assert 0.85 < validation.coverage <= 1.0
    measured = si.Observation(record, unseen.values[0, :, 0])
    si.Posterior(space, surrogate, measured)
    poor = _with_limit(surrogate, 1e-12)
    poor.validate(unseen)
    with pytest.raises(InputError, match=r"mean relative error of .* \(on the validation runs\).*trust\(\)"):
        si.Posterior(space, poor, measured)
    poor.trust()
    si.Posterior(space, poor, measured)


def _with_limit(surrogate, limit):
    plain, arrays = surrogate.to_plain()
    return type(surrogate).from_plain(dataclasses.replace(surrogate.fitted, limit=limit), plain, arrays)


def test_a_posterior_on_it_is_that_of_the_model(surrogate, model, space, record):
    truth = model.simulate(np.array([[7.2e6, 0.3]]), record).values[0, :, 0]
    noise = 0.1 * truth.std() * np.random.default_rng(1).normal(size=truth.shape)
    measured = si.Observation(record, truth + noise)
    discrepancy = si.IID(variance=float(noise.var()))
    points = np.array([7.2e6, 0.3]) + np.array([1e4, 0.01]) * np.random.default_rng(2).normal(size=(20, 2))
    ours = si.Posterior(space, surrogate, measured, discrepancy).log_density(points)
    theirs = si.Posterior(space, model, measured, discrepancy).log_density(points)
    # A recursion of degree two errs by 1e-4 here, a fiftieth of the noise's variance; a hundred times what the others err by.
    atol = 0.1 if surrogate.fitted.kind.startswith("POD") else 2.5
    np.testing.assert_allclose(ours - ours.max(), theirs - theirs.max(), rtol=0.05, atol=atol)


def test_gradients_go_through_it(surrogate, record, space):
    import jax

    from structid.engine.device import jnp

    excitation = surrogate.traced(record)
    point = np.array([7.4e6, 0.2])

    @jax.jit
    @jax.value_and_grad
    def energy(theta):
        return jnp.sum(surrogate.response(theta[None], excitation)[0] ** 2)

    slope = np.asarray(energy(point)[1])
    for j, step in enumerate((10.0, 1e-5)):
        move = step * np.eye(2)[j]
        difference = (energy(point + move)[0] - energy(point - move)[0]) / (2 * step)
        np.testing.assert_allclose(slope[j], difference, rtol=2e-3)


def test_its_own_runs_do_not_validate_it(surrogate, runs, unseen):
    with pytest.raises(InputError, match="80 of the runs are training runs"):
        surrogate.validate(runs)
    with pytest.raises(InputError, match="1 of the runs are training runs"):
        surrogate.validate(unseen + runs[:1])


def test_its_own_runs_show_what_the_fit_leaves_of_them(surrogate, runs, unseen):
    """Asked for, they are compared, and decide nothing."""
    before = surrogate.validation
    found = surrogate.validate(runs, fitted=True)
    assert len(found.errors) == len(runs) and found.mean < 1e-3
    assert surrogate.validation is before


@pytest.mark.parametrize("name", ["PCNARX", "KrigingNARX"])
def test_the_structure_of_a_narx_is_judged_by_coefficients_of_each_run(name, fitted, runs):
    """Its own coefficients do at least as well as those of the surrogate; a coefficient of another run does not."""
    surrogate = fitted[name]
    own, plain = surrogate.validate_structure(runs), surrogate.validate_structure(runs, refined=False)
    assert own.median <= 1.01 * surrogate.validate(runs, fitted=True).median
    assert np.isfinite(plain.median)
    coefficients = surrogate.own_coefficients(runs)
    rolled = surrogate.run_with(np.roll(coefficients, 1, axis=0), runs.records[0])
    np.testing.assert_allclose(
        relative_errors(runs.values, surrogate.run_with(coefficients, runs.records[0]).values), own.errors, rtol=1e-6
    )
    assert np.median(relative_errors(runs.values, rolled.values)) > 100.0 * own.median


def test_points_that_are_no_numbers(surrogate, record):
    with pytest.raises(InputError, match="1 points are not finite"):
        surrogate.simulate(np.array([[np.nan, 0.2], [7e6, 0.2]]), record)


def test_a_stronger_record_is_warned_of(fitted, space, record):
    strong = record.scale_to_pga(4.5)
    with pytest.warns(StructidWarning, match="1.5 times as strong"):
        fitted["PCNARX"].simulate(space.sample(3, seed=6), strong)


def test_a_posterior_warns_of_a_surrogate_too_coarse_for_its_data(fitted, model, space, record):
    rng = np.random.default_rng(5)
    truth = model.simulate(np.array([[7.2e6, 0.3]]), record).values[0, :, 0]
    settings = si.SMC(particles=300, ensembles=2, steps=20, effective_share=0.3, correlation=0.5)

    def warned(noise):
        measured = si.Observation(record, truth + noise * truth.std() * rng.normal(size=truth.shape))
        verdict = si.sample(si.Posterior(space, fitted["PCNARX"], measured), settings, seed=1).verdict()
        return any("the surrogate's error (" in w for w in verdict.warnings)

    assert warned(1e-3) and not warned(0.3)


@pytest.mark.quick
def test_it_is_saved_and_read_to_the_same_bits(surrogate, unseen, space, record, tmp_path):
    surrogate.validate(unseen)
    again = load_surrogate(surrogate.save(tmp_path / "surrogate.h5"))
    design = space.sample(9, seed=4)
    np.testing.assert_array_equal(surrogate.simulate(design, record).values, again.simulate(design, record).values)
    assert again.content_hash == surrogate.content_hash and str(again) == str(surrogate)
    first, second = (s.predict(design, record, return_std=True)[1] for s in (surrogate, again))
    np.testing.assert_allclose(first, second, rtol=1e-12)
    assert b"pickle" not in (tmp_path / "surrogate.h5").read_bytes()


def test_what_is_no_surrogate_is_not_read(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_surrogate(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("hello")
    with pytest.raises(InputError, match="not an HDF5 file"):
        load_surrogate(tmp_path / "text.h5")


def test_outside_the_range_it_says_so_and_stays_at_the_edge(surrogate, record):
    beyond = np.array([[9.99e6, 0.2], [7e6, 0.2]])
    with pytest.warns(StructidWarning, match=r"1 of 2 points are outside the range of the 80 training runs.*kN/mm"):
        far = surrogate.simulate(beyond, record)
    assert list(surrogate.outside(beyond)) == [True, False]
    edge = beyond.copy()
    edge[0, 0] = surrogate.fitted.high[0]
    np.testing.assert_allclose(surrogate.simulate(edge, record).values, far.values, rtol=1e-12)
    plain, arrays = surrogate.to_plain()
    strict = type(surrogate).from_plain(dataclasses.replace(surrogate.fitted, outside="refuse"), plain, arrays)
    with pytest.raises(InputError, match="outside the range"):
        strict.simulate(beyond, record)


def test_refused_points_have_no_density_and_do_not_stop_a_validation(surrogate, space, record, unseen):
    plain, arrays = surrogate.to_plain()
    narrow = dataclasses.replace(surrogate.fitted, outside="refuse", high=np.array([7.4e6, 0.9]))
    strict = type(surrogate).from_plain(narrow, plain, arrays)
    assert strict.content_hash != surrogate.content_hash
    assert strict.validate(unseen).outside > 0
    strict.trust()  # much of the validation lies outside
    posterior = si.Posterior(space, strict, si.Observation(record, unseen.values[0, :, 0]))
    density = posterior.log_density(np.array([[7.3e6, 0.2, 1e-3], [7.5e6, 0.2, 1e-3]]))
    assert np.isfinite(density[0]) and density[1] == -np.inf


def test_another_record(surrogate, model, space, record, other_record):
    design = space.sample(5, seed=5)
    if type(surrogate).__name__ == "ResponseSpaceSurrogate":
        with pytest.raises(InputError, match=r"was not fitted to.*PCNARX"):
            surrogate.simulate(design, other_record)
    else:
        found = surrogate.simulate(design, other_record).values
        assert relative_errors(model.simulate(design, other_record).values, found).mean() < 2e-2
        coarse = dataclasses.replace(other_record, dt=0.02)
        with pytest.raises(InputError, match=r"step of 0\.02 s.*Resample"):
            surrogate.simulate(design, coarse)
    with pytest.raises(InputError):
        surrogate.simulate(design, si.ForceHistory(record.values, record.dt, "force"))


@pytest.mark.parametrize("name", KINDS)
def test_failed_runs_are_left_out_and_counted(name, runs):
    status = runs.status.copy()
    status[:7] = Status.FAILED
    values = runs.values.copy()
    values[:7] = np.nan
    settings = dataclasses.replace(KINDS[name], **({"steps": 0} if hasattr(KINDS[name], "steps") else {}))
    surrogate = settings.fit(dataclasses.replace(runs, status=status, stored=StoredInMemory(values)))
    assert surrogate.fitted.runs == 73 and surrogate.fitted.left_out == 7
    assert "7 other runs left out" in str(surrogate)


@pytest.mark.parametrize("name", KINDS)
def test_what_a_fit_refuses(name, runs):
    settings = KINDS[name]
    with pytest.raises(InputError, match=r"fit\(runs\): an array\. Expected: a structid\.Runs"):
        settings.fit(runs.values)
    with pytest.raises(InputError, match="5 finished runs and 0 other runs"):
        settings.fit(runs[:5])
    values = runs.values.copy()
    values[3, 5] = np.nan
    with pytest.raises(InputError, match="histories of finished runs have values that are not finite"):
        settings.fit(dataclasses.replace(runs, stored=StoredInMemory(values)))
    with pytest.raises(InputError, match="'velocity' is constant in every run"):
        settings.fit(dataclasses.replace(runs, stored=StoredInMemory(np.zeros_like(values))))


def test_a_narx_wants_runs_enough_for_its_coefficients(runs):
    with pytest.raises(InputError, match=r"coefficients of 15 chaos terms \(degree 4\).*Lower the degree"):
        si.PCNARX(degree=4).fit(runs[:20])


@pytest.mark.slow
def test_the_thesis_way_by_one_word(runs, unseen):
    """Coefficients of each experiment by itself, as published: it works here, on two parameters and its own terms."""
    from structid.surrogates.narx.structure.candidate_terms import absolute_terms

    surrogate = si.PCNARX(terms=absolute_terms(), training="per-experiment", selection="lars").fit(runs)
    validation = surrogate.validate(unseen)
    other = si.KrigingNARX(training="per-experiment").fit(runs).validate(unseen)
    assert np.isfinite(other.median)
    joint = si.PCNARX(terms=absolute_terms(), degree=2, steps=8).fit(runs).validate(unseen)
    print(f"per experiment: median {validation.median:.1e}; joint: {joint.median:.1e}")
    assert joint.median < validation.median


@pytest.mark.parametrize(
    ("settings", "limit"),
    [
        (si.PODKriging(kriging=si.Kriging(separable=False)), 1e-3),
        pytest.param(si.PCNARX(degree=2, steps=6), 2e-2, marks=pytest.mark.slow),
    ],
    ids=["PODKriging", "PCNARX"],
)
def test_several_records_and_channels(settings, limit, space, record, other_record):
    model = si.BoucWen(
        mass=12_000.0,
        damping_ratio=0.03,
        beta=60.0,
        alpha=0.06,
        free=space.names,
        channels=("velocity", "displacement"),
    )
    design = space.sample(80, seed=1, method="sobol", widen=1.4)
    both = si.Design(np.repeat(design.values, 2, axis=0), space)
    runs = si.Campaign(model, [record, other_record], both, assignment="cycle").run()
    unseen = si.Campaign(model, [record, other_record], space.sample(40, seed=2), assignment="cycle").run()
    surrogate = settings.fit(runs)
    validation = surrogate.validate(unseen)
    print(validation)
    assert validation.mean < limit and set(validation.per_channel) == {"velocity", "displacement"}
    if isinstance(settings, si.PODKriging):
        _same_density_by_scores_and_by_histories(surrogate, unseen, (record, other_record))


def _same_density_by_scores_and_by_histories(surrogate, unseen, records):
    """Two channels of one record and one of another: the misfit in the space of the scores is that of the histories."""
    channels = surrogate.channels
    first, second = (unseen.on(i).values[0] for i in (0, 1))
    observations = [
        si.Observation(records[0], first, channels=channels),
        si.Observation(records[1], second[:, 1], channels=channels[1:]),
    ]
    discrepancy = si.IID(variance={"velocity": 1e-3, "displacement": 1e-6})
    density = si.Posterior(surrogate.space, surrogate, observations, discrepancy)
    points = surrogate.space.sample(6, seed=9).values
    predicted = [surrogate.simulate(points, r).values for r in records]
    misfits = [
        np.sum((predicted[0] - first) ** 2, axis=1) / [1e-3, 1e-6],
        np.sum((predicted[1][:, :, 1:] - second[:, 1:]) ** 2, axis=1) / 1e-6,
    ]
    by_hand = -0.5 * sum(m.sum(axis=1) for m in misfits) + surrogate.space.log_density(points)
    found = density.log_density(points)
    np.testing.assert_allclose(found - found[0], by_hand - by_hand[0], rtol=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        si.PODKriging(kriging=si.Kriging(separable=False)),
        si.PODPCE(),
        pytest.param(si.PCNARX(degree=2, steps=6), marks=pytest.mark.slow),
    ],
    ids=["PODKriging", "PODPCE", "PCNARX"],
)
def test_correlated_and_derived_parameters_and_records_of_different_lengths(settings, record, other_record):
    space = si.ParameterSpace(
        stiffness=si.Normal(7.42, 0.5, low=5.0, high=10.0, unit="kN/mm"),
        gamma_ratio=si.Uniform(-0.5, 1.0),
        derived={"gamma": "gamma_ratio * 60"},
        correlation={("stiffness", "gamma_ratio"): 0.7},
    )
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=("stiffness", "gamma"))
    records = [record, other_record.trim(0.0, 4.0)]
    both = lambda design: si.Design(np.repeat(design.values, 2, axis=0), space)  # noqa: E731
    runs = si.Campaign(model, records, both(space.sample(80, seed=1, widen=1.4)), assignment="cycle").run()
    unseen = si.Campaign(model, records, both(space.sample(20, seed=2)), assignment="cycle").run()
    assert len({len(r) for r in runs.records}) == 2
    surrogate = settings.fit(runs)
    assert surrogate.validate(unseen).mean < 2e-3 and len(surrogate.validation.errors) == 40


@pytest.mark.rendered
def test_a_validation_figure(fitted, unseen, tmp_path):
    fitted["PCNARX"].validate(unseen).plot(save=tmp_path / "validation")
    assert (tmp_path / "validation.png").stat().st_size > 20_000 and (tmp_path / "validation.pdf").is_file()


def test_a_record_that_is_there_twice_is_one(runs, record):
    twice = dataclasses.replace(
        runs, records=(record, dataclasses.replace(record, name="again")), record_of_run=np.arange(len(runs)) % 2
    )
    surrogate = si.PODKriging().fit(twice)
    assert len(surrogate.records) == 1
    np.testing.assert_allclose(
        surrogate.simulate(runs.design[:3], record).values, runs.values[:3], atol=1e-4 * np.abs(runs.values).max()
    )


@pytest.mark.rendered
def test_a_figure_of_coefficients(fitted, unseen, tmp_path):
    fitted["PCNARX"].plot_coefficients(unseen, save=tmp_path / "coefficients")
    assert (tmp_path / "coefficients.png").stat().st_size > 20_000


@pytest.mark.parametrize("name", KINDS)
def test_progress_is_told(name, fitted, told):
    assert {of for _, of in told[name]} == {100} and told[name][-1][0] == 100
    assert [done for done, _ in told[name]] == sorted(done for done, _ in told[name])
    assert len({done for done, _ in told[name]}) > (10 if "NARX" in name else 0)


def test_nothing_is_said_where_all_is_well(fitted, space, record):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fitted["PODPCE"].simulate(np.array([[7.4e6, 0.2]]), record)
