"""The description of a kind of surrogate, by which no other code needs to know its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from structid.surrogates.base import Surrogate, SurrogateSettings


@dataclass(frozen=True, eq=False)
class SurrogateKind:
    """One kind of surrogate: its words, its settings, and what reads it back.

    Parameters
    ----------
    settings : type
        Class of its settings; `Fit.kind` is this class's name.
    fitted : type
        Class of the fitted surrogate, which reads it back from a file and says whether it knows only its own records.
    word : str
        What a study file calls it; empty for a kind that a study cannot name.
    keys : mapping of str to type
        Keys of a study file that it understands besides those of every surrogate, and their types as pydantic reads them.
    build : callable, optional
        Makes the settings from the keys that a file gives; the class itself when left out.
    unused : mapping of (str, str) to tuple of str
        Of a key and a value that it may have: other keys, which then change nothing.

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
        """Its name in files and reports."""
        return self.settings.__name__

    @property
    def own_records(self) -> bool:
        """Whether it is restricted to the records it was fitted to."""
        return self.fitted.own_records

    def made(self, given: Mapping[str, Any]) -> SurrogateSettings:
        """Make settings from the keys of a study file.

        Parameters
        ----------
        given : mapping of str to object
            What the file says.

        Returns
        -------
        SurrogateSettings
            The settings.
        """
        settings: SurrogateSettings = (self.build or self.settings)(**given)
        return settings
