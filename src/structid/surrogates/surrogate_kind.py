"""Description of a kind of surrogate, so that no other code depends on its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from structid.surrogates.base import Surrogate, SurrogateSettings


@dataclass(frozen=True, eq=False)
class SurrogateKind:
    """One kind of surrogate: its names, its settings and the class that reads it from a file.

    Parameters
    ----------
    settings : type
        Class of the settings; `Fit.kind` is the name of this class.
    fitted : type
        Class of the fitted surrogate. It reads a surrogate from a file, and defines whether it is restricted to its records.
    word : str
        Name in a study file; empty for a kind that a study cannot use.
    keys : mapping of str to type
        Study-file keys of this kind, in addition to keys common to all surrogates, and their types for pydantic.
    build : callable, optional
        Function that makes the settings from the keys in a file; by default the class `settings`.
    unused : mapping of (str, str) to tuple of str
        For a key with a given value: other keys that then have no effect.

    Examples
    --------
    >>> from structid.surrogates.pod.pod_kriging import PODKriging
    >>> from structid.surrogates.pod.response_space import ResponseSpaceSurrogate
    >>> from structid.surrogates.surrogate_kind import SurrogateKind
    >>> kind = SurrogateKind(PODKriging, ResponseSpaceSurrogate, "kriging_of_components", {"left_out_energy": float})
    >>> kind.made({"left_out_energy": 1e-6}).left_out_energy
    1e-06
    """

    settings: type[Any]
    fitted: type[Surrogate]
    word: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)
    build: Callable[..., SurrogateSettings] | None = None
    unused: Mapping[tuple[str, str], tuple[str, ...]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the kind in files and reports."""
        return self.settings.__name__

    @property
    def own_records(self) -> bool:
        """Whether the surrogate is restricted to the records of its training runs."""
        return self.fitted.own_records

    def made(self, given: Mapping[str, Any]) -> SurrogateSettings:
        """Make settings from the keys of a study file.

        Parameters
        ----------
        given : mapping of str to object
            Keys and values in the file.

        Returns
        -------
        SurrogateSettings
            The settings.
        """
        settings: SurrogateSettings = (self.build or self.settings)(**given)
        return settings
