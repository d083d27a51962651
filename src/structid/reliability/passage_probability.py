"""Probability of a passage over the parameters, by logistic regression."""

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
"""Polynomial degrees that are compared."""
PENALTIES = (1e-1, 1e1, 1e3)
"""Prior variances of the coefficients that are compared."""
FOLDS = 5
"""Folds of the cross-validation."""
LEAST = 10
"""Minimum number of runs of each kind."""


@dataclass(frozen=True, eq=False)
class PassageProbability(ShownAsText):
    """P(passage | θ) = 1 / (1 + exp(−Σ_α c_α x^α)), x being the standardised coordinates of θ.

    Degree and shrinkage of the polynomial are those with the smallest log loss in cross-validation. It is the parameters' alone:
    with one record the response has no other randomness, so that the width of the transition is what the polynomial cannot tell.

    Parameters
    ----------
    space : ParameterSpace
        Its coordinates are the polynomial's, where it has some.
    classifier : object
        The fitted pipeline.
    degree : int
        Of the polynomial.
    log_loss, base_log_loss : float
        Mean of −log P of what happened, in cross-validation, and that of the share of passages alone.
    accuracy, base_accuracy : float
        Share of the runs on whose side of one half the probability is, in cross-validation, and that of the commoner outcome.
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
            Between 0 and 1.
        """
        return self.at_coordinates(coordinates_of(self.space, theta))

    def at_coordinates(self, points: Float[np.ndarray, "run coordinate"]) -> Float[np.ndarray, " run"]:
        """Probability of a passage at coordinates of the space, which may be those of no point.

        Parameters
        ----------
        points : ndarray, shape (run, coordinate)
            Coordinates.

        Returns
        -------
        ndarray, shape (run,)
            Between 0 and 1.
        """
        return np.asarray(self.classifier.predict_proba(points)[:, 1])

    def __str__(self) -> str:
        return (
            f"PassageProbability of degree {self.degree}: {self.accuracy:.1%} right in cross-validation ({self.base_accuracy:.1%} "
            f"without looking), log loss {self.log_loss:.3f} ({self.base_log_loss:.3f})"
        )


def coordinate_names(space: ParameterSpace) -> tuple[str, ...]:
    """Names of the coordinates of a space, or of its parameters where it has none."""
    return space.coordinates or space.names


def coordinates_of(
    space: ParameterSpace, theta: Float[np.ndarray, "run parameter"]
) -> Float[np.ndarray, "run coordinate"]:
    """Coordinates of points, or the points themselves where a space has no coordinates."""
    theta = np.asarray(theta, dtype=float)
    return np.asarray(space.in_coordinates(theta)) if space.coordinates else theta


@check_arguments
def passage_probability(passages: Passages, degrees: Sequence[int] = DEGREES) -> PassageProbability:
    """Fit the probability of a passage to runs.

    Parameters
    ----------
    passages : Passages
        Over a design.
    degrees : sequence of int
        Degrees of the polynomials to try.

    Returns
    -------
    PassageProbability
        The best of them.

    Raises
    ------
    InputError
        If fewer than ten runs passed, or fewer than ten did not.

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
            f"{passed.sum()} of {len(passed)} runs passed",
            f"{LEAST} or more that did and {LEAST} or more that did not",
            "Choose another limit, or more runs.",
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
    """Probability of every run, predicted from the other folds."""
    from sklearn.model_selection import StratifiedKFold, cross_val_predict

    # Designs are filled in an order of their own: neighbouring runs must not share a part.
    parts = StratifiedKFold(FOLDS, shuffle=True, random_state=0)
    return np.asarray(cross_val_predict(classifier, points, passed, cv=parts, method="predict_proba")[:, 1])


def _log_loss(probability: np.ndarray, passed: np.ndarray) -> float:
    of_it = np.clip(np.where(passed, probability, 1.0 - probability), 1e-15, None)
    return float(-np.log(of_it).mean())
