"""Every built-in model, channel, excitation and likelihood runs in lanes with JAX's numbers, or is listed as an exception."""

import jax
import numpy as np
import pytest

import structid as si
from oscillators import DEGRADING
from package import concrete_subclasses
from structid.engine.device import over_runs
from structid.engine.lanes import machine
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.vector_code.translation import LONGEST_UNROLLED
from structid.models.hysteretic.bouc_wen import CHANNELS
from structid.models.hysteretic.hysteretic import CHANNELS as LAW_CHANNELS
from structid.models.hysteretic.hysteretic_frame import STOREY_CHANNELS as FRAME_CHANNELS
from structid.models.hysteretic.shear_frame import STOREY_CHANNELS
from structid.models.masonry.equations.wall_channels import CHANNELS as WALL_CHANNELS
from structid.models.traceable import TraceableModel

pytestmark = [pytest.mark.quick, pytest.mark.skipif(bool(machine.why_not()), reason="no lanes here")]

RNG = np.random.default_rng(5)
TIME = 0.02 * np.arange(150)
GROUND = si.GroundMotion(2.0 * np.sin(9.0 * TIME) * np.exp(-0.5 * TIME), 0.02, "a burst")
EXCITATIONS = {
    "ground motion": GROUND,
    "periodic": si.ForceHistory(2e4 * np.sin(6 * np.pi * TIME / 3.0), 0.02, "three periods", "periodic", 1),
    "force": si.ForceHistory(2e4 * np.sin(9.0 * TIME), 0.02, "a push"),
    "displacement": si.DisplacementHistory(0.004 * np.sin(9.0 * TIME), 0.02, "a stroke"),
}
ACCELERATIONS = {"relative_acceleration", "absolute_acceleration"}
PINCHED = dict(zeta0=0.9, p=10.0, q=0.1, psi0=0.002, delta_psi=0.0005, lambda_=0.5)
LAWS = {
    "plain": {},
    "degrading": dict(delta_a=0.1, delta_nu=2.43, delta_eta=6.5),
    "pinching": PINCHED,
    "exponent 2": dict(exponent=2.0),
    "everything": dict(delta_a=0.1, delta_nu=2.43, delta_eta=6.5, exponent=1.5, **PINCHED),
}
PLAIN = {name: value for name, value in DEGRADING.items() if not name.startswith("delta")}
ALL_FREE = (
    "stiffness",
    "alpha",
    "beta",
    "gamma_ratio",
    "exponent",
    "delta_a",
    "delta_nu",
    "delta_eta",
    "zeta0",
    "p",
    "q",
)


def compared(model, excitation, theta, agree=1e-12):
    """Histories in lanes, held against JAX's."""
    traced = model.traced(excitation)
    (ours, finite), (theirs, fine) = (kind(model.response, (2, 0))(theta, traced) for kind in (InLanes, over_runs))
    assert InLanes(model.response, (2, 0)).compiled(theta.shape[1], (traced,)) is not None
    assert (finite == fine).all() and fine.any()
    scale = np.abs(theirs[..., fine]).max(axis=(0, 2), keepdims=True)
    assert (np.abs(ours - theirs)[..., fine] <= agree * scale).all()


@pytest.mark.parametrize("excitation", EXCITATIONS)
def test_every_channel_of_the_oscillator(excitation):
    channels = [c for c in CHANNELS if excitation != "displacement" or c not in ACCELERATIONS]
    model = si.BoucWen(**PLAIN | {"stiffness": None}, free=("stiffness",), channels=channels)
    compared(model, EXCITATIONS[excitation], RNG.uniform(7e6, 8e6, (5, 1)))


PIER = si.Wall(width=1.2, height=0.8, openings=(), courses=(2,))
JOINTS = ("normal_energy", "normal_strength", "tangential_energy", "tangential_strength")
STRENGTHS = np.array([5.5e3, 1.05e6, 4e5, 2e6]) * RNG.uniform(0.8, 1.2, (3, 4))


@pytest.mark.parametrize("law", ["smc-np2", "damage-friction"])
def test_every_channel_of_a_wall(law):
    """Both find the jumps to 1e-13 m, so that sums of forces and energies over them differ by more than rounding."""
    wall = si.MasonryWall(free=JOINTS, joint_law=law, wall=PIER, channels=("ux_top_left", "uy_node_6", *WALL_CHANNELS))
    traced = wall.traced(GROUND.trim(0.0, 0.6))
    ours, theirs = (kind(wall.response, (2, 0))(STRENGTHS, traced) for kind in (InLanes, over_runs))
    assert InLanes(wall.response, (2, 0)).compiled(4, (traced,)) is not None and ours[1].all()
    scale = np.abs(theirs[0]).max(axis=(0, 2), keepdims=True)
    energies = [channel.endswith("_energy") for channel in wall.channels]
    scale[:, energies] = scale[:, energies].max()  # some are sums in which larger ones vanish
    assert (np.abs(ours[0] - theirs[0]) <= 1e-9 * scale).all()


@pytest.mark.parametrize("law", LAWS)
def test_every_law(law):
    model = si.BoucWen(
        **PLAIN | LAWS[law] | {"stiffness": None}, free=("stiffness",), channels=("displacement", "restoring_force")
    )
    compared(model, GROUND, RNG.uniform(7e6, 8e6, (5, 1)))


@pytest.mark.parametrize("excitation", EXCITATIONS)
def test_every_channel_of_a_hysteretic_law(excitation):
    channels = [c for c in LAW_CHANNELS if excitation != "displacement" or c not in ACCELERATIONS]
    law = {"yield_force": 4e4, "sharpness": 1.2, "peak_damage": 0.05}
    model = si.Hysteretic("masing", law, mass=12e3, damping_ratio=0.03, free=("stiffness",), channels=channels)
    compared(model, EXCITATIONS[excitation], RNG.uniform(7e6, 8e6, (5, 1)), agree=1e-9)


def test_everything_free():
    given = {k: v for k, v in (PLAIN | LAWS["everything"]).items() if k not in ALL_FREE}
    values = PLAIN | LAWS["everything"]
    theta = np.array([values[name] for name in ALL_FREE]) * RNG.uniform(0.95, 1.05, (5, len(ALL_FREE)))
    compared(si.BoucWen(**given, free=ALL_FREE, channels=("velocity",)), GROUND, theta)


@pytest.mark.parametrize("damping", ["modal", "rayleigh"])
@pytest.mark.parametrize("excitation", ["ground motion", "force"])
def test_every_channel_of_a_frame(damping, excitation):
    channels = ["base_shear", *(f"{channel}_{storey}" for channel in STOREY_CHANNELS for storey in (1, 2))]
    frame = si.ShearFrame(
        storeys=2,
        mass=12_000.0,
        damping_ratio=0.03,
        alpha=0.05,
        beta=63.0,
        gamma_ratio=0.5,
        delta_nu=1.0,
        damping=damping,
        free=("stiffness",),
        channels=channels,
    )
    signal = EXCITATIONS[excitation]
    compared(frame, signal, RNG.uniform(7e6, 8e6, (3, 1)))


@pytest.mark.parametrize("damping", ["modal", "rayleigh"])
@pytest.mark.parametrize("excitation", ["ground motion", "force"])
def test_every_channel_of_a_frame_of_laws(damping, excitation):
    channels = ["base_shear", *(f"{channel}_{storey}" for channel in FRAME_CHANNELS for storey in (1, 2))]
    frame = si.HystereticFrame(
        ["masing", "linear"],
        mass=12e3,
        values={"yield_force_1": 4e4, "sharpness_1": 1.2},
        damping_ratio=0.03,
        damping=damping,
        free=("stiffness",),
        channels=channels,
    )
    compared(frame, EXCITATIONS[excitation], RNG.uniform(7e6, 8e6, (3, 1)), agree=1e-9)


# --- likelihoods ----------------------------------------------------------------------------------------------------

MODEL = si.BoucWen(**PLAIN | {"stiffness": None}, free=("stiffness",))
SPACE = si.ParameterSpace(stiffness=si.LogNormal(mean=7.6e6, sd=5e5))
MEASURED = MODEL.simulate(np.array([[7.5e6]]), GROUND).values[0, :, 0] + 0.002 * RNG.normal(size=150)
LAWS_OF_ERROR = {
    "IID": si.IID(),
    "known variance": si.IID(variance=4e-6),
    "AR1": si.AR1(),
    "Matern32": si.Matern32(),
    "DampedCosine": si.DampedCosine(),
    "Drifting": si.Drifting(),
    "Drifting beside AR1": si.Drifting(0.7, si.AR1()),
}
NUISANCES = {"gain": dict(gain=si.LogNormal(mean=1.0, sd=0.1)), "offset": dict(offset=si.Normal(0.0, 0.01))}


def posterior(law=None, observations=1, **nuisances):
    measured = [
        si.Observation(GROUND, MEASURED * (1.0 + 1e-3 * i), name=f"test {i}", **nuisances) for i in range(observations)
    ]
    return si.Posterior(SPACE, MODEL, measured, discrepancy=law)


POSTERIORS = {
    **{name: posterior(law) for name, law in LAWS_OF_ERROR.items()},
    **{name: posterior(**given) for name, given in NUISANCES.items()},
    "both": posterior(**NUISANCES["gain"], **NUISANCES["offset"]),
    "two records": posterior(observations=2),
}


def densities_compared(of, count, monkeypatch, agree=1e-11, slopes_agree=1e-9):
    """Densities in lanes at some points, and their gradients, held against JAX's."""
    phi = of.initial(count, np.random.default_rng(1))
    assert of.in_lanes
    with monkeypatch.context() as without:
        without.setattr("structid.engine.lanes.in_lanes.why_not", lambda: "asked not to")
        again = of._like()
        expected, slopes = again.evaluate_parts(phi), gradient_of(again, phi) if slopes_agree else None
    for ours, theirs in zip(of.evaluate_parts(phi), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=agree)
    if slopes is not None:
        assert of._differentiable_in_lanes is not None
        np.testing.assert_allclose(gradient_of(of, phi), slopes, rtol=0, atol=slopes_agree * np.abs(slopes).max())


def gradient_of(of, phi):
    """Each point's own, which JAX asks for one by one, and gets for all in one call."""
    density, data = of.traceable()
    return np.asarray(jax.jit(jax.vmap(jax.grad(lambda point: density(point[None], data)[0])))(phi))


@pytest.mark.parametrize("name", POSTERIORS)
def test_every_likelihood(name, monkeypatch):
    densities_compared(POSTERIORS[name], 5, monkeypatch)


def test_a_shift_in_time_is_left_to_jax():
    """A shifted history is made of the whole one: there is nothing to fold."""
    assert not posterior(time_shift=si.Normal(0.0, 0.01)).in_lanes


# --- surrogates -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs():
    return si.Campaign(MODEL, GROUND, SPACE.sample(40, seed=1)).run()


@pytest.mark.parametrize("settings", [si.PCNARX(degree=2), si.KrigingNARX(degree=2)])
def test_every_recursion(settings, runs):
    compared(settings.fit(runs), GROUND, SPACE.sample(5, seed=2).values)


POD = {
    "Kriging": si.PODKriging(left_out_energy=1e-4),
    "a quadratic trend": si.PODKriging(kriging=si.Kriging(trend="quadratic"), left_out_energy=1e-4),
    "lengths of each score": si.PODKriging(kriging=si.Kriging(shared=False, separable=True), left_out_energy=1e-4),
    "PC-Kriging": si.PODKriging(kriging=si.Kriging(trend=si.PCE(degree=2)), left_out_energy=1e-4),
    "PCE": si.PODPCE(),
    "Kriging beside a NARX": si.CorrectedNARX(si.PCNARX(degree=1, steps=0), si.PODKriging(left_out_energy=1e-4)),
}


@pytest.mark.parametrize("name", POD)
def test_the_posterior_of_every_sum_of_components(name, runs, monkeypatch):
    densities_compared(posterior().on(POD[name].fit(runs), refuse_unfit=False), 20, monkeypatch)


def test_several_channels_in_the_space_of_the_scores(monkeypatch):
    """With more components than a loop unrolls."""
    model = si.BoucWen(**PLAIN | {"stiffness": None}, free=("stiffness",), channels=("velocity", "displacement"))
    measured = model.simulate(np.array([[7.5e6]]), GROUND).values[0] + 1e-3 * RNG.normal(size=(150, 2))
    # Without a nugget, weights of millions would hide the agreement in their rounding errors.
    settings = si.PODKriging(kriging=si.Kriging(nugget=1e-6), left_out_energy=1e-10)
    surrogate = settings.fit(si.Campaign(model, GROUND, SPACE.sample(40, seed=1)).run())
    of = si.Posterior(SPACE, surrogate, si.Observation(GROUND, measured, model.channels), refuse_unfit=False)
    assert of.data[0].shortcut.inner.shape[0] == 2 and of.data[0].shortcut.inner.shape[1] > LONGEST_UNROLLED
    densities_compared(of, 20, monkeypatch, agree=1e-9, slopes_agree=1e-7)


@pytest.mark.parametrize("settings", [si.PODKriging(), si.PODPCE()])
def test_a_response_that_is_a_product_is_numpys(settings, runs):
    surrogate, theta = settings.fit(runs), SPACE.sample(5, seed=2).values
    expected, _ = over_runs(surrogate.response, (2, 0))(theta, surrogate.traced(GROUND))
    found = surrogate.run(theta, GROUND).values.transpose(1, 2, 0)
    # The weights of a Kriging are thousands of times its outputs, and so are the rounding errors.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize(("law", "slopes_agree"), [(si.IID(), 1e-7), (si.AR1(), None)], ids=["iid", "ar1"])
def test_the_likelihood_of_a_wall(law, slopes_agree, monkeypatch):
    """The gradient is compiled for one of them: that takes a minute on JAX."""
    space = si.ParameterSpace(normal_energy=si.Uniform(2e3, 8e3), tangential_strength=si.Uniform(1e6, 3e6))
    wall = si.MasonryWall(
        free=space.names,
        normal_strength=1e6,
        tangential_energy=4e5,
        wall=PIER,
        channels=("ux_top_left", "uy_top_right"),
    )
    record = GROUND.trim(0.0, 0.3)
    measured = wall.simulate([[5e3, 2e6]], record).values[0]
    of = si.Posterior(
        space, wall, si.Observation(record, measured + 1e-4 * RNG.normal(size=measured.shape), wall.channels), law
    )
    densities_compared(of, 5, monkeypatch, 1e-8, slopes_agree)


def strokes(*amplitudes):
    return si.DisplacementHistory(amplitudes[0] * np.sin(9.0 * TIME) * (1.0 + TIME), 0.02, "strokes")


def test_springs_and_walls_that_are_moved():
    spring = si.BoucWen(**PLAIN | {"stiffness": None}, free=("stiffness",))
    compared(si.ImposedDisplacements(spring, pieces=3), strokes(0.004), RNG.uniform(7e6, 8e6, (5, 1)))
    mortar = dict(normal_strength=0.2e6, tangential_energy=150.0, tangential_strength=0.3e6, friction=0.6)
    wall = si.MasonryWall(
        **mortar,
        joint_law="damage-friction",
        free=("normal_energy",),
        wall=PIER,
        masonry=si.Masonry(vertical_load=60e3),
    )
    still = np.zeros(len(TIME))
    moves = si.CombinedExcitation(
        [strokes(2e-5), si.DisplacementHistory(still, 0.02), si.RotationHistory(still, 0.02)], "strokes"
    )
    compared(si.ImposedDisplacements(wall, pieces=1), moves, RNG.uniform(10.0, 20.0, (5, 1)), agree=1e-6)


@pytest.mark.parametrize("coupling", [si.PrakashHjelmstad(20, "numerical"), si.GravouilCombescure(20, "physical")])
def test_the_whole_of_a_hybrid_test(coupling):
    """Of more substeps than a loop unrolls, after moves before the test."""
    storeys = si.ShearFrame(
        storeys=2, mass=12e3, damping_ratio=0.03, stiffness=8e6, alpha=0.05, beta=63.0, gamma_ratio=0.5
    )
    upper, lower = si.cut_frame(storeys, 1)
    spring = si.BoucWen(**PLAIN | {"stiffness": None}, free=("stiffness",))
    channels = ("displacement_1", "displacement_2", "restoring_force_1")
    test = si.VirtualHybridTest(upper, lower, spring, 0.02, coupling, 2, [[0.01], [0.002]], channels)
    compared(test, GROUND, RNG.uniform(7e6, 8e6, (5, 1)))


def test_no_model_is_forgotten():
    tried = {
        *("BoucWen", "Hysteretic", "HystereticFrame", "MasonryWall", "ShearFrame", "DriftingModel"),
        *("ImposedDisplacements", "VirtualHybridTest"),
        *("ParametricNARX", "NARXBesideKriging", "ResponseSpaceSurrogate"),
    }
    assert {kind.__name__ for kind in concrete_subclasses(TraceableModel)} == tried
