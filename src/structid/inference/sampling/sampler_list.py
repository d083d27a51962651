"""All samplers. A new sampler needs a file with its settings and a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, get_type_hints

from structid.inference.sampling.aies import AIES, study_defaults
from structid.inference.sampling.base import Sampler
from structid.inference.sampling.delayed_acceptance import DelayedAcceptance
from structid.inference.sampling.nuts import NUTS
from structid.inference.sampling.smc.smc import SMC


@dataclass(frozen=True, eq=False)
class SamplerKind:
    """One sampler: its name and its defaults in a study file.

    Parameters
    ----------
    settings : type
        The class of its settings, a dataclass.
    word : str
        Value of ``kind`` in a study file.
    defaults : callable, optional
        Returns the settings missing in a study from the given settings. If left out, the defaults of the class apply.
    hidden : tuple of str
        Settings that a study file cannot give.

    Examples
    --------
    >>> from structid.inference.sampling.sampler_list import SamplerKind
    >>> from structid.inference.sampling.smc.smc import SMC
    >>> kind = SamplerKind(SMC, "particles", hidden=("least_moves", "most_moves"))
    >>> kind.made({"particles": 500}).particles
    500
    """

    settings: type[Any]
    word: str
    defaults: Callable[[Mapping[str, Any]], dict[str, Any]] | None = None
    hidden: tuple[str, ...] = field(default=())

    @property
    def keys(self) -> dict[str, Any]:
        """The sampler's study-file keys and their types."""
        hints = get_type_hints(self.settings)
        return {f.name: hints[f.name] for f in fields(self.settings) if f.name not in self.hidden}

    def made(self, given: Mapping[str, Any]) -> Sampler:
        """Make settings from the keys of a study file.

        Parameters
        ----------
        given : mapping of str to object
            Keys and values of the file.

        Returns
        -------
        Sampler
            The settings.
        """
        defaults = {} if self.defaults is None else self.defaults(given)
        sampler: Sampler = self.settings(**{**defaults, **given})
        return sampler


SAMPLERS: tuple[SamplerKind, ...] = (
    SamplerKind(AIES, "aies", study_defaults),
    SamplerKind(SMC, "smc", hidden=("least_moves", "most_moves")),
    SamplerKind(NUTS, "nuts", hidden=("deepest",)),
    SamplerKind(DelayedAcceptance, "delayed_acceptance", hidden=("approximation",)),
)
