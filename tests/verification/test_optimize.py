"""Pattern search and interior point on closed forms, and on the benchmark study's inverse problem."""

import json

import numpy as np
import pytest

import structid as si
from oscillators import DEGRADING
from structid.core.errors import InputError

METHODS = (si.optimize.pattern_search, si.optimize.interior_point)
BOX = {"x": si.Uniform(-2.0, 2.0), "y": si.Uniform(-2.0, 3.0)}


class Analytic:
    """A function of two numbers with its derivatives, as an objective."""

    names = ("x", "y")
    scale = 1.0
    differentiable = True

    def __init__(self, value, gradient, curvature):
        self.space = si.ParameterSpace(**BOX)
        self.value, self.gradient, self.curvature = value, gradient, curvature

    def __call__(self, theta):
        return self.value(*theta.T)

    def linearised(self, theta):
        return self(theta), np.stack(self.gradient(*theta.T), -1), np.array([self.curvature(*row) for row in theta])


ROSENBROCK = Analytic(
    lambda x, y: 100 * (y - x**2) ** 2 + (1 - x) ** 2,
    lambda x, y: (-400 * x * (y - x**2) - 2 * (1 - x), 200 * (y - x**2)),
    lambda x, y: np.array([[800 * x**2 + 2, -400 * x], [-400 * x, 200.0]]),
)
BOWL = Analytic(
    lambda x, y: (x - 1.0) ** 2 + (y - 2.0) ** 2, lambda x, y: (2 * (x - 1), 2 * (y - 2)), lambda x, y: 2 * np.eye(2)
)
TWO_WELLS = Analytic(
    lambda x, y: (x**2 - 1) ** 2 + 0.1 * x + y**2,
    lambda x, y: (4 * x * (x**2 - 1) + 0.1, 2 * y),
    lambda x, y: np.diag([8 * x**2 + 0.1, 2.0]),
)


@pytest.mark.parametrize("search", METHODS)
class TestBoth:
    def test_valley(self, search):
        best = search(ROSENBROCK, starts=5, seed=1).best
        np.testing.assert_allclose(best.theta, [1.0, 1.0], atol=1e-5)

    def test_minimum_on_a_face_and_in_a_corner(self, search):
        # Minimise the distance to (1, 2) under x + y ≤ 1: the foot of the perpendicular is (0, 1).
        on_face = search(BOWL, constraints=["x + y <= 1"], starts=4, seed=1)
        np.testing.assert_allclose(on_face.best.theta, [0.0, 1.0], atol=1e-6)
        corner = search(BOWL, bounds={"x": (-1.0, 0.5), "y": (-1.0, 1.0)}, starts=4, seed=1)
        np.testing.assert_allclose(corner.best.theta, [0.5, 1.0], atol=1e-6)
        assert corner.best.on_boundary == ("x", "y")

    def test_distinct_minima_are_told_apart(self, search):
        result = search(TWO_WELLS, starts=12, seed=2)
        assert len(result.minima) == 2
        assert result.minima[0].theta[0] < -0.9 < 0.9 < result.minima[1].theta[0]
        assert sum(m.starts for m in result.minima) == 12

    def test_points_never_leave_the_region(self, search):
        seen = []

        class Watched(Analytic):
            def __call__(self, theta):
                seen.append(theta)
                return super().__call__(theta)

        search(
            Watched(BOWL.value, BOWL.gradient, BOWL.curvature),
            constraints=["x + y <= 1", "-1 <= x - y"],
            starts=3,
            seed=1,
        )
        theta = np.concatenate(seen)
        assert (theta.sum(1) <= 1 + 1e-9).all() and (theta[:, 0] - theta[:, 1] >= -1 - 1e-9).all()

    def test_result_file(self, search, tmp_path):
        text = search(BOWL, starts=2, seed=1).to_text(tmp_path / "minima.txt").read_text()
        assert "distinct minima" in text and "starts" in text and json.dumps(text)


@pytest.mark.parametrize("text", ["x * y <= 1", "x < y", "x + z <= 1", "1 <= 2"])
def test_bad_constraints_are_refused(text):
    with pytest.raises(InputError, match="constraint"):
        si.optimize.pattern_search(BOWL, constraints=[text])


def benchmark(record, **truth):
    """The source's table 3.2: k_i, β, γ, α in a box, |γ| ≤ β."""
    space = si.ParameterSpace(
        stiffness=si.Uniform(4.27, 11.85, unit="kN/mm"),
        beta=si.Uniform(55.0, 65.0, unit="1/m"),
        gamma=si.Uniform(-65.0, 65.0, unit="1/m"),
        alpha=si.Uniform(0.0, 1.0),
    )
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=space.names, substeps=1)
    velocity = si.BoucWen(**DEGRADING | truth, substeps=1).simulate(np.zeros((1, 0)), record).channel("velocity")[0]
    return si.Posterior(space, model, si.Observation(record, velocity)).misfit


@pytest.mark.filterwarnings("ignore:In .* of the prior .gamma. exceeds beta")  # the constraints see to it
@pytest.mark.parametrize(("which", "starts"), [("short_record", 4), pytest.param("record", 20, marks=pytest.mark.slow)])
@pytest.mark.parametrize("search", METHODS)
def test_every_start_finds_the_truth(search, which, starts, request):
    """Noise-free, no discrepancy: every start reaches J ≤ 1e-12 Σy² and the parameters to 1e-5; the truth is on the face γ = β."""
    misfit = benchmark(request.getfixturevalue(which), delta_nu=0.0, delta_eta=0.0)
    result = search(misfit, constraints=("gamma <= beta", "-beta <= gamma"), starts=starts, seed=1)
    error = np.abs(result.ends / np.array([7.6e6, 63.0, 63.0, 0.05]) - 1).max(axis=1)
    reached = (result.values <= 1e-12 * misfit.scale) & (error <= 1e-5)
    largest = result.values.max() / misfit.scale
    print(f"{result.method}: {reached.sum()} of {starts}, J/Σy² up to {largest:.0e}, {result.evaluations} runs")
    assert reached.all()


@pytest.mark.filterwarnings("ignore:In .* of the prior .gamma. exceeds beta")
@pytest.mark.slow
def test_with_discrepancy_both_agree_on_the_best_minimum(short_record):
    misfit = benchmark(short_record)
    constraints = ("gamma <= beta", "-beta <= gamma")
    first, second = (search(misfit, constraints=constraints, starts=4, seed=1).best for search in METHODS)
    assert first.value == pytest.approx(second.value, rel=1e-6)
    np.testing.assert_allclose(first.theta, second.theta, rtol=1e-3, atol=1e-3)
