"""The limits that a certificate must meet."""

from __future__ import annotations

from dataclasses import dataclass

from structid.core.validation import check_arguments


@check_arguments
@dataclass(frozen=True)
class Limits:
    """Limits that a certificate must meet.

    Parameters
    ----------
    mean : float
        Largest error of any mean, in posterior standard deviations.
    sd : float
        Largest relative error of any standard deviation.
    correlation : float
        Largest error of any correlation of two parameters. For independent parameters, an error of 0.2 changes the standard
        deviation of the sum of two by a tenth.
    confidence : float
        Confidence with which all three hold, over all attempts of a calibration together.
    above : float
        Largest excess of a stored model run's log density over every draw [nat].
    reach : float
        Stored model runs whose log density is within this distance of the best run are checked [nat].
    excess : float
        Largest log π/q of such a run above the median over the draws [nat].
    understated : float
        q may understate runs further from the best run by this fraction of their distance. If it understates them more, it could
        miss a mode that no draw visits.
    usable : float
        Largest bound of χ with which re-weighted moments may be used.
    usable_size : float
        Smallest effective number of draws with which re-weighted moments may be used.

    Examples
    --------
    >>> import structid as si
    >>> limits = si.Limits(mean=0.05, sd=0.05)
    >>> limits.mean
    0.05
    """

    mean: float = 0.1
    sd: float = 0.1
    correlation: float = 0.2
    confidence: float = 0.95
    above: float = 2.0
    reach: float = 10.0
    excess: float = 3.0
    understated: float = 0.5
    usable: float = 1.0
    usable_size: float = 50.0

    def confidence_of(self, look: int) -> float:
        """Confidence of one of several attempts, since one of many attempts can succeed by chance.

        Parameters
        ----------
        look : int
            Number of the attempt, 1 for the first.

        Returns
        -------
        float
            1 − α/2^look, so that the α of all attempts sum up to less than one minus the confidence.
        """
        return 1.0 - (1.0 - self.confidence) / 2.0**look
