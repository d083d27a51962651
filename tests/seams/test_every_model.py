"""What every model keeps: one face, rows that do not depend on their neighbours, one posterior.

A new model goes into `MODELS`, with a function that makes it and knows two parameters, ``a`` and ``b``, or what it calls them.
"""

import sys
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import solvers
import structid as si
from package import concrete_subclasses
from servers import serving_waves
from structid.core.errors import InputError
from structid.models.base import Model
from structid.models.drifting_model import DriftingModel

RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 6.0).scale_to_pga(2.0)
OTHER = si.GroundMotion.synthetic(seed=9).lowpass(20.0).trim(3.0, 6.0).scale_to_pga(2.0)

STROKES = tuple(
    si.DisplacementHistory(0.02 * np.sin(pace * RECORD.time), RECORD.dt, f"strokes at {pace}") for pace in (9.0, 7.0)
)

WAVES = si.ParameterSpace(a=si.Uniform(0.2, 1.0), b=si.Normal(5.0, 1.0, low=1.0))
SPRING = si.ParameterSpace(stiffness=si.Uniform(6.5, 8.5, unit="kN/mm"), gamma_ratio=si.Uniform(-0.5, 0.8))
FLAG = si.ParameterSpace(stiffness=si.Uniform(6.5, 8.5, unit="kN/mm"), asymmetry=si.Uniform(0.8, 1.2))
STOREYS = si.ParameterSpace(
    stiffness_1=si.Uniform(15.0, 25.0, unit="kN/mm"), stiffness_2=si.Uniform(15.0, 25.0, unit="kN/mm")
)

PROGRAM = """
import sys, numpy as np
a, b, dt = map(float, sys.argv[1:])
record = np.loadtxt("record.txt")
np.savetxt("out.txt", a * np.sin(b * np.arange(len(record)) * dt) + record)
"""


def oscillator():
    return si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPRING.names)


def flag():
    law = {"yield_force": "60 kN", "hardening": 0.05, "flag_height": 0.6}
    return si.Hysteretic("self_centering", law, mass=12e3, damping_ratio=0.03, free=FLAG.names)


def frame_of_laws():
    laws = {"yield_force_1": "60 kN", "hardening_1": 0.05}
    channels = ("velocity_1", "velocity_2")
    return si.HystereticFrame(
        ["bilinear", "linear"], mass=12e3, values=laws, damping_ratio=0.03, free=STOREYS.names, channels=channels
    )


def frame():
    law = dict(alpha=0.05, beta=63.0, gamma_ratio=0.5)
    return si.ShearFrame(
        storeys=2, mass=12e3, damping_ratio=0.03, **law, free=STOREYS.names, channels=("velocity_1", "velocity_2")
    )


JOINTS = si.ParameterSpace(normal_energy=si.Uniform(4e3, 6e3), tangential_strength=si.Uniform(1e6, 2e6))


def wall():
    joints = dict(normal_strength=1e6, tangential_energy=4e5)
    return si.MasonryWall(**joints, free=JOINTS.names, channels=("ux_top_left", "base_shear"), step=5e-3)


def hybrid_test():
    """The oscillator's spring is the lower storey of a frame, and was moved before."""
    law = dict(alpha=0.05, beta=63.0, gamma_ratio=0.5)
    upper, lower = si.cut_frame(si.ShearFrame(storeys=2, mass=12e3, damping_ratio=0.03, stiffness=8e6, **law), 1)
    return si.VirtualHybridTest(
        upper,
        lower,
        oscillator(),
        0.01,
        si.PrakashHjelmstad(20, "numerical"),
        2,
        [[0.01], [0.001]],
        ("displacement_1", "displacement_2", "restoring_force_1"),
    )


DRIFTING = SPRING.extended(
    stiffness_drift=si.Uniform(0.1, 0.3, unit="kN/mm"),
    gamma_ratio_drift=si.Uniform(0.0, 0.1),
    **{f"{name}_at_{knot}": si.Normal(0.0, 1.0) for name in SPRING.names for knot in (1, 2, 3)},
)


def program(folder):
    (folder / "wave.py").write_text(PROGRAM)
    command = [sys.executable, "{{ folder }}/wave.py", "{{ a }}", "{{ b }}", "{{ record.dt }}"]
    output = si.OutputFile("out.txt", {"velocity": 0})
    return si.ProgramModel(command, WAVES.names, output, record_file="record.txt", folder=folder)


def fitted(settings):
    runs = si.Campaign(oscillator(), RECORD, SPRING.sample(30, seed=1, method="sobol", widen=1.3)).run()
    surrogate = settings.fit(runs)
    surrogate.trust()
    return surrogate


# How each is made, its prior, and whether it knows more records than the one it was fitted to.
MODELS = {
    "BoucWen": (lambda folder: oscillator(), SPRING, True),
    "Hysteretic": (lambda folder: flag(), FLAG, True),
    "HystereticFrame": (lambda folder: frame_of_laws(), STOREYS, True),
    "DriftingModel": (lambda folder: DriftingModel(oscillator(), SPRING, 3, 1.5), DRIFTING, True),
    "ShearFrame": (lambda folder: frame(), STOREYS, True),
    "MasonryWall": (lambda folder: wall(), JOINTS, True),
    "ImposedDisplacements": (lambda folder: si.ImposedDisplacements(oscillator(), pieces=2), SPRING, True),
    "VirtualHybridTest": (lambda folder: hybrid_test(), SPRING, True),
    "CallableModel": (lambda folder: si.CallableModel(solvers.wave, WAVES.names, ("velocity",)), WAVES, True),
    "ProgramModel": (program, WAVES, True),
    "UMBridgeModel": (
        lambda folder: si.UMBridgeModel(serving_waves(), WAVES.names, ("velocity",), "wave", send_record=True),
        WAVES,
        True,
    ),
    "ResponseSpaceSurrogate": (lambda folder: fitted(si.PODPCE()), SPRING, False),
    "ParametricNARX": (lambda folder: fitted(si.PCNARX(degree=1, steps=2)), SPRING, True),
    "NARXBesideKriging": (lambda folder: fitted(si.CorrectedNARX(si.PCNARX(degree=1, steps=2))), SPRING, True),
}


def test_no_model_is_forgotten():
    assert set(MODELS) == {kind.__name__ for kind in concrete_subclasses(Model)}


@pytest.fixture(scope="module", params=MODELS)
def case(request, tmp_path_factory):
    """A model, its prior, whether it takes another record, and two that drive it; made once."""
    if request.param == "UMBridgeModel":
        pytest.importorskip("umbridge")
    make, space, any_record = MODELS[request.param]
    model = make(tmp_path_factory.mktemp("model"))
    assert type(model).__name__ == request.param
    return model, space, any_record, *(STROKES if request.param == "ImposedDisplacements" else (RECORD, OTHER))


class TestEveryModel:
    def test_histories_have_the_shape_that_is_told(self, case):
        model, space, _, record, *_ = case
        found = model.simulate(space.sample(3, seed=2), record)
        assert found.values.shape == (3, len(record), len(model.channels)) and found.channels == model.channels
        assert found.done.all() and np.isfinite(found.values).all() and set(found.reasons) == {""}
        assert found.dt == record.dt
        assert not np.allclose(found.values[0], found.values[1])

    def test_a_row_does_not_depend_on_its_neighbours_and_is_the_same_again(self, case):
        model, space, _, record, *_ = case
        theta = model.parameters(space.sample(3, seed=2))
        together = model.simulate(theta, record).values
        alone = np.concatenate([model.simulate(row[None], record).values for row in theta[::-1]])[::-1]
        np.testing.assert_allclose(alone, together, rtol=1e-9, atol=1e-12 * np.abs(together).max())
        np.testing.assert_array_equal(model.simulate(theta, record).values, together)

    def test_a_design_is_known_by_its_names(self, case):
        model, space, _, record, *_ = case
        turned = si.ParameterSpace(**{name: space.marginals[name] for name in reversed(space.names)})
        design = space.sample(2, seed=3)
        there = model.simulate(si.Design(design.values[:, ::-1], turned), record)
        np.testing.assert_array_equal(there.values, model.simulate(design, record).values)

    def test_progress_goes_up_to_the_number_of_runs(self, case):
        model, space, _, record, *_ = case
        told = []
        model.simulate(space.sample(3, seed=2), record, progress=lambda *done: told.append(done))
        assert told[-1] == (3, 3) and told == sorted(told)

    def test_several_records_are_one_after_another(self, case):
        model, space, any_record, record, other = case
        theta = model.parameters(space.sample(3, seed=4))
        if not any_record:
            with pytest.raises(InputError, match="not fitted to"):
                model.simulate(theta, [record, other, record])
            return
        mixed = model.simulate(theta, [record, other, record]).values
        np.testing.assert_allclose(mixed[1], model.simulate(theta[1:2], other).values[0], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(mixed[::2], model.simulate(theta[::2], record).values, rtol=1e-9, atol=1e-12)
        assert not np.allclose(mixed[1], model.simulate(theta[1:2], record).values[0])

    @pytest.mark.parametrize(
        ("call", "words"),
        [
            (lambda m, s, record: m.simulate(np.ones((2, 5)), record), r"shape \(2, 5\)"),
            (lambda m, s, record: m.simulate(np.ones((0, len(m.free))), record), "no runs"),
            (lambda m, s, record: m.simulate(s.sample(2, seed=1), record.values), r"simulate\(excitation\): an array"),
            (lambda m, s, record: m.simulate(s.sample(3, seed=1), [record, record]), "2 excitations for 3 runs"),
            (
                lambda m, s, record: m.simulate(
                    s.sample(2, seed=1), [record, replace(record, values=record.values[:99])]
                ),
                "different time steps or lengths",
            ),
            (
                lambda m, s, record: m.simulate(si.ParameterSpace(c=si.Uniform(0, 1)).sample(2, seed=1), record),
                "has no prior",
            ),
        ],
    )
    def test_what_makes_no_sense_is_refused(self, case, call, words):
        model, space, _, record, *_ = case
        with pytest.raises(InputError, match=words):
            call(model, space, record)

    def test_it_says_what_it_is(self, case):
        model, space, *_ = case
        assert model.content_hash == model.content_hash and len(model.content_hash) >= 16
        assert model.free == space.names and set(model.channel_units) == set(model.channels)
        assert model.recording(*model.channels).channels == model.channels
        assert model.traceable <= model.batched and not (model.batched and model.guarded)
        if model.stand_in is not None:
            outside = model.stand_in.outside(model.parameters(space.sample(3, seed=2)))
            assert outside.shape == (3,) and not outside.any() and model.stand_in.relative_error >= 0.0
            assert set(model.stand_in.search_range()) == set(model.free)

    def test_its_posterior_is_prior_times_likelihood(self, case):
        """Written out again: log π(θ) − ½ T log 2πσ² − ‖y − M(θ)‖²/(2σ²)."""
        model, space, _, record, *_ = case
        points = space.sample(4, seed=5)
        simulated = model.simulate(points, record).values
        measured = simulated[0] + 0.01 * np.random.default_rng(1).standard_normal(simulated[0].shape)
        posterior = si.Posterior(
            space, model, si.Observation(record, measured, channels=model.channels), si.IID(variance=1e-2)
        )
        expected = space.log_density(points.values) + scipy.stats.norm.logpdf(measured - simulated, scale=0.1).sum(
            axis=(1, 2)
        )
        np.testing.assert_allclose(posterior.log_density(points.values), expected, rtol=1e-6)
