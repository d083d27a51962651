"""Probability of a passage as a function of the parameters, by logistic regression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments
from structid.probability.space import ParameterSpace
from structid.reliability.passages import Passages

DEGREES = (1, 2, 3)
"""Polynomial degrees to compare."""
PENALTIES = (1e-1, 1e1, 1e3)
"""Prior variances of the coefficients to compare."""
FOLDS = 5
"""Number of folds of the cross-validation."""
LEAST = 10
"""Minimum number of runs that pass the limit, and of runs that do not."""


@dataclass(frozen=True, eq=False)
class PassageProbability(ShownAsText):
    """P(passage | θ) = 1 / (1 + exp(−Σ_α c_α x^α)), x being the standardised coordinates of θ.

    Cross-validation selects the degree and the shrinkage of the polynomial with the smallest log loss. With one record, a passage
    is a deterministic function of the parameters: the width of the transition then reflects the polynomial's approximation error.

    Parameters
    ----------
    space : ParameterSpace
        Parameter space; the polynomial uses its coordinates, if it has any.
    classifier : object
        Fitted scikit-learn pipeline.
    degree : int
        Degree of the polynomial.
    log_loss, base_log_loss : float
        Mean of −log P of the observed outcomes in cross-validation; its value if P is always the fraction of passages.
    accuracy, base_accuracy : float
        Fraction of runs classified correctly in cross-validation, and the fraction of runs with the more frequent outcome.
    """

    space: ParameterSpace = field(repr=False)
    classifier: Any = field(repr=False)
    degree: int
    log_loss: float
    base_log_loss: float
    accuracy: float
    base_accuracy: float

    def probability(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Probability of a passage.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI.

        Returns
        -------
        ndarray, shape (run,)
            Probabilities between 0 and 1.
        """
        return self.at_coordinates(coordinates_of(self.space, theta))

    def at_coordinates(self, points: Float[np.ndarray, "run coordinate"]) -> Float[np.ndarray, " run"]:
        """Probability of a passage at coordinates of the space, even if no parameter point has these coordinates.

        Parameters
        ----------
        points : ndarray, shape (run, coordinate)
            Coordinates of the points.

        Returns
        -------
        ndarray, shape (run,)
            Probabilities between 0 and 1.
        """
        return np.asarray(self.classifier.predict_proba(points)[:, 1])

    def __str__(self) -> str:
        return (
            f"PassageProbability of degree {self.degree}: {self.accuracy:.1%} correct in cross-validation (baseline "
            f"{self.base_accuracy:.1%}), log loss {self.log_loss:.3f} (baseline {self.base_log_loss:.3f})"
        )


def coordinate_names(space: ParameterSpace) -> tuple[str, ...]:
    """Names of the coordinates of a space, or of its parameters if it has no coordinates."""
    return space.coordinates or space.names


def coordinates_of(
    space: ParameterSpace, theta: Float[np.ndarray, "run parameter"]
) -> Float[np.ndarray, "run coordinate"]:
    """Coordinates of points, or the points themselves if the space has no coordinates."""
    theta = np.asarray(theta, dtype=float)
    return np.asarray(space.in_coordinates(theta)) if space.coordinates else theta


@check_arguments
def passage_probability(passages: Passages, degrees: Sequence[int] = DEGREES) -> PassageProbability:
    """Fit the probability of a passage to the runs of a design.

    Parameters
    ----------
    passages : Passages
        Passages over a design.
    degrees : sequence of int
        Polynomial degrees to compare.

    Returns
    -------
    PassageProbability
        The fit with the smallest cross-validated log loss.

    Raises
    ------
    InputError
        If fewer than ten runs passed the limit, or fewer than ten stayed within it.

    Examples
    --------
    >>> import structid as si
    >>> probability = si.passage_probability(si.passages(runs, "displacement", 0.05))  # doctest: +SKIP
    """
    passed = passages.passed
    fewer = int(min(passed.sum(), (~passed).sum()))
    if fewer < LEAST:
        raise InputError(
            "passage_probability",
            f"{passed.sum()} of {len(passed)} runs passed the limit",
            f"at least {LEAST} runs that passed it and {LEAST} runs that did not",
            "Choose another limit, or add runs.",
        )
    space = passages.design.space
    points = coordinates_of(space, passages.design.values)
    best: tuple[float, int, Any, np.ndarray] | None = None
    for degree in degrees:
        for penalty in PENALTIES:
            classifier = _pipeline(degree, penalty)
            probability = _cross_validated(classifier, points, passed)
            loss = _log_loss(probability, passed)
            if best is None or loss < best[0]:
                best = loss, degree, classifier, probability
    assert best is not None
    loss, degree, classifier, probability = best
    share = float(passed.mean())
    return PassageProbability(
        space,
        classifier.fit(points, passed),
        degree,
        loss,
        _log_loss(np.full(len(passed), share), passed),
        float(((probability > 0.5) == passed).mean()),
        max(share, 1.0 - share),
    )


def _pipeline(degree: int, penalty: float) -> Any:
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    polynomial = PolynomialFeatures(degree, include_bias=False)
    return make_pipeline(
        StandardScaler(), polynomial, StandardScaler(), LogisticRegression(C=penalty, max_iter=1000, tol=1e-6)
    )


def _cross_validated(classifier: Any, points: np.ndarray, passed: np.ndarray) -> np.ndarray:
    """Probability of a passage for every run, predicted from the other folds."""
    from sklearn.model_selection import StratifiedKFold, cross_val_predict

    # The points of a design are ordered: shuffle them, so that neighbouring runs do not share a fold.
    folds = StratifiedKFold(FOLDS, shuffle=True, random_state=0)
    return np.asarray(cross_val_predict(classifier, points, passed, cv=folds, method="predict_proba")[:, 1])


def _log_loss(probability: np.ndarray, passed: np.ndarray) -> float:
    of_outcome = np.clip(np.where(passed, probability, 1.0 - probability), 1e-15, None)
    return float(-np.log(of_outcome).mean())
