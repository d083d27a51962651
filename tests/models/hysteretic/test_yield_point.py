"""Where a spring yields: the corner of its loading, against the loop itself and closed forms."""

import numpy as np
import pytest

import structid as si
from structid.models.base import Model

KNOWN = dict(mass=12_000.0, damping_ratio=0.03, stiffness=7.6e6, alpha=0.05)


@pytest.mark.parametrize(("exponent", "beta", "amplitude"), [(1.0, 60.0, 1.0), (2.0, 9000.0, 1.0), (3.0, 1e6, 0.8)])
def test_the_lines_of_both_stiffnesses_meet_there(exponent, beta, amplitude):
    """Far beyond yielding the force lies on F_y + α k (u − u_y), and near zero on F_y/u_y u."""
    spring = si.BoucWen(
        **KNOWN, beta=beta, gamma_ratio=0.5, exponent=exponent, amplitude=amplitude, channels=("restoring_force",)
    )
    yields = spring.derived_quantities(np.zeros((1, 0)))
    displacement, force = yields["yield displacement"].values[0], yields["yield force"].values[0]
    assert yields["yield displacement"].unit == "mm" and yields["yield force"].unit == "kN"
    u = displacement * np.linspace(0.0, 40.0, 40_001)
    found = spring.simulate(np.zeros((1, 0)), si.DisplacementHistory(u, 0.01)).channel("restoring_force")[0]
    assert found[1] == pytest.approx(force / displacement * u[1], rel=2e-3)
    assert found[-1] == pytest.approx(force + 0.05 * 7.6e6 * (u[-1] - displacement), rel=1e-6)


def test_it_follows_from_free_parameters_run_by_run():
    spring = si.BoucWen(**KNOWN, gamma_ratio=1.0, free=("beta",))
    found = spring.derived_quantities(np.array([[50.0], [100.0]]))
    assert found["yield displacement"].values == pytest.approx([0.01, 0.005])
    assert found["yield force"].values == pytest.approx([76e3, 38e3])


def test_a_spring_that_stiffens_has_none():
    spring = si.BoucWen(**KNOWN, beta=60.0, gamma_ratio=-1.0)
    assert np.isinf(spring.derived_quantities(np.zeros((1, 0)))["yield force"].values).all()


def test_every_storey_has_its_own():
    known = dict(KNOWN, stiffness=(2e7, 1e7), beta=50.0)
    frame = si.ShearFrame(storeys=2, **known, free=("gamma_ratio_1", "gamma_ratio_2"), channels=("displacement_2",))
    found = frame.derived_quantities(np.array([[1.0, 0.0], [0.0, 1.0]]))
    assert found["yield drift of storey 1"].values == pytest.approx([0.01, 0.02])
    assert found["yield force of storey 2"].values == pytest.approx([200e3, 100e3])


def test_other_models_say_nothing():
    class Plain(Model):
        free, channels, content_hash = ("k",), ("y",), "plain"

        def run(self, theta, excitation, progress=None):
            raise NotImplementedError

    assert Plain().derived_quantities(np.ones((1, 1))) == {}


def test_the_lowest_natural_frequency_is_that_of_the_initial_stiffness():
    """√(k/m)/2π of one storey; of a frame the lowest of its modes, for every run by its own stiffness."""
    shape = dict(alpha=0.05, beta=50.0, gamma=50.0)
    one = si.BoucWen(mass=12e3, free=("stiffness",), **shape)
    stiffness = np.array([[7.6e6], [3.0e6]])
    assert one.natural_frequency(stiffness) == pytest.approx(np.sqrt(stiffness[:, 0] / 12e3) / (2.0 * np.pi))
    frame = si.ShearFrame(storeys=2, mass=12e3, free=("stiffness_1", "stiffness_2"), **shape)
    each = [
        si.ShearFrame(storeys=2, mass=12e3, stiffness=list(k), **shape).frequencies()[0]
        for k in ((7e6, 5e6), (3e6, 9e6))
    ]
    assert frame.natural_frequency(np.array([[7e6, 5e6], [3e6, 9e6]])) == pytest.approx(each)
