"""A hysteretic law with further terms of the force, each a function of the state of the spring."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import near_zero

NARROW = 4.0
"""Inverse width of a term near zero displacement, relative to the largest displacement."""
SMALLEST_PEAK = 1e-3
"""Smallest peak, relative to the largest displacement, by which a displacement is divided."""


class SpringState(NamedTuple):
    """State of a spring, relative to the largest displacement U and the largest force F of its test."""

    u: Any  # displacement over U
    s: Any  # direction of the motion: 1 or −1, 0 before the first motion
    z: Any  # force of the law over F
    p: Any  # largest displacement so far in the direction of u, over U
    e: Any  # absorbed energy over 4 F U

    @classmethod
    def of(
        cls, deformation: Any, s: Any, force: Any, peaks: tuple[Any, Any], energy: Any, scales: tuple[float, float]
    ) -> SpringState:
        """Return a state from dimensional values; `peaks` are the largest negative and positive deformation so far."""
        largest, strength = scales
        peak = namespace(deformation).where(deformation >= 0.0, peaks[1], peaks[0])
        return cls(deformation / largest, s, force / strength, peak / largest, energy / (4.0 * strength * largest))

    @property
    def reached(self) -> Any:
        """|u|/p: the part of the largest displacement so far that is reached now."""
        xp = namespace(self.u)
        return xp.abs(self.u) / xp.maximum(self.p, SMALLEST_PEAK)


class ForceTerm(NamedTuple):
    """A term of the force, relative to its coefficient."""

    meaning: str
    value: Callable[[SpringState], Any]


_FACTORS: dict[str, ForceTerm] = {
    "u": ForceTerm("an elastic force", lambda x: x.u),
    "|u|": ForceTerm("an elastic stiffness that differs in the two directions", lambda x: abs(x.u)),
    "u^2": ForceTerm("an elastic force that is curved to one side", lambda x: x.u**2),
    "u^3": ForceTerm("an elastic stiffness that grows with the displacement", lambda x: x.u**3),
    "s": ForceTerm("friction", lambda x: x.s),
    "s|u|": ForceTerm("friction that grows with the displacement", lambda x: x.s * abs(x.u)),
    "s exp(-(4u)^2)": ForceTerm(
        "friction near zero displacement", lambda x: x.s * namespace(x.u).exp(-((NARROW * x.u) ** 2))
    ),
    "s|u|/p": ForceTerm("friction near the peaks", lambda x: x.s * x.reached),
    "s(1-|u|/p)": ForceTerm("friction that vanishes at the peaks", lambda x: x.s * (1.0 - x.reached)),
    "z": ForceTerm("a strength", lambda x: x.z),
    "z^3": ForceTerm("sharper yielding", lambda x: x.z**3),
    "z|u|/p": ForceTerm("strength near the peaks", lambda x: x.z * x.reached),
    "u z^2": ForceTerm("stiffness under large forces", lambda x: x.u * x.z**2),
}
_GROWTH: dict[str, ForceTerm] = {
    "": ForceTerm("", lambda x: 1.0),
    "p": ForceTerm(", which grows with the peak displacement", lambda x: x.p),
    "e": ForceTerm(", which grows with the absorbed energy", lambda x: x.e),
}


def _product(factor: ForceTerm, growth: ForceTerm) -> ForceTerm:
    return ForceTerm(factor.meaning + growth.meaning, lambda x: factor.value(x) * growth.value(x))


TERMS: dict[str, ForceTerm] = {
    # Every test has a constant offset already.
    "p": ForceTerm("an offset, which grows with the peak displacement", lambda x: x.p),
    "e": ForceTerm("an offset, which grows with the absorbed energy", lambda x: x.e),
    **{
        f"{growth} {name}".strip(): _product(factor, of_growth)
        for name, factor in _FACTORS.items()
        for growth, of_growth in _GROWTH.items()
    },
}
"""Terms by their formulas in u, s, z, p and e of `SpringState`."""


def states_along(
    displacement: Float[np.ndarray, " time"], force: Float[np.ndarray, " time"], scales: tuple[float, float]
) -> SpringState:
    """Return the states along a path that begins at rest, from the force of a law; the scales are U and F."""
    moves = np.diff(displacement, prepend=0.0)
    direction = np.sign(moves)
    # A sample without a move keeps the direction of the last one
    last = np.maximum.accumulate(np.where(direction != 0.0, np.arange(len(direction)), 0))
    energy = np.cumsum(0.5 * (force + np.concatenate([[0.0], force[:-1]])) * moves)
    negative, positive = (np.maximum.accumulate(np.maximum(side * displacement, 0.0)) for side in (-1.0, 1.0))
    return SpringState.of(displacement, direction[last], force, (negative, positive), energy, scales)


def law_with_terms(law: HystereticLaw, names: Sequence[str], scales: tuple[float, float]) -> HystereticLaw:
    """Return a law whose force has further terms; their coefficients c_i are parameters.

    f = f_law + Σ c_i φ_i(u/U, sgn u̇, f_law/F, p/U, E/4FU), with the law's parameters and memory unchanged.

    Parameters
    ----------
    law : HystereticLaw
        The law.
    names : sequence of str
        Names of the terms in `TERMS`.
    scales : tuple of float
        U [m] and F [N].

    Returns
    -------
    HystereticLaw
        The law with the terms; without them if all coefficients are zero.

    Examples
    --------
    >>> import numpy as np
    >>> from structid.mechanics.hysteretic_laws.added_terms import law_with_terms
    >>> from structid.mechanics.hysteretic_laws.linear import Linear
    >>> law = law_with_terms(Linear(stiffness=2.0), ["s"], (1.0, 1.0)).with_values({"term_1": 0.5})
    >>> law.forces_along(np.array([0.0, 1.0, 0.0]))
    array([ 0. ,  2.5, -0.5])
    """
    base, terms = type(law), [TERMS[name] for name in names]
    coefficients = [f"term_{number}" for number in range(1, len(names) + 1)]

    def at_rest(self: HystereticLaw, zero: Any) -> Memory:
        inner = base.at_rest(self, zero)
        return {"d": zero, "f": zero, "inner": inner, "s": zero, "positive": zero, "negative": zero, "energy": zero}

    def moved(self: HystereticLaw, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        xp = namespace(deformation)
        inner = base.moved(self, prepared, memory["inner"], deformation)
        move = deformation - memory["d"]
        s = xp.where(move > 0.0, 1.0, xp.where(move < 0.0, -1.0, memory["s"]))
        positive = xp.maximum(memory["positive"], deformation)
        negative = xp.maximum(memory["negative"], -deformation)
        energy = memory["energy"] + 0.5 * (memory["inner"]["f"] + inner["f"]) * move
        state = SpringState.of(deformation, s, inner["f"], (negative, positive), energy, scales)
        added = sum(getattr(self, c) * term.value(state) for c, term in zip(coefficients, terms, strict=True))
        return {
            "d": deformation,
            "f": inner["f"] + added,
            "inner": inner,
            "s": s,
            "positive": positive,
            "negative": negative,
            "energy": energy,
        }

    described = [
        parameter(
            f"coefficient of the term {name}: {term.meaning}",
            near_zero(0.3),
            "N",
            low=-np.inf,
            default=0.0,
            neutral=0.0,
            mechanism=term.meaning,
        )
        for name, term in zip(names, terms, strict=True)
    ]
    word = f"{base.word} + {', '.join(names)}"
    made: Any = dataclasses.make_dataclass(
        f"{base.__name__}WithTerms",
        [
            *((name, Any, field) for name, field in zip(coefficients, described, strict=True)),
            ("scales", tuple, dataclasses.field(default=scales)),
        ],
        bases=(base,),
        namespace={
            "word": word,
            "title": f"{base.title} with {_counted(len(names))}",
            "dissipative": False,
            "at_rest": at_rest,
            "moved": moved,
        },
        frozen=True,
        eq=False,
    )
    values: HystereticLaw = made(**{f.name: getattr(law, f.name) for f in dataclasses.fields(law)})
    return values


def _counted(count: int) -> str:
    return "a further term" if count == 1 else f"{count} further terms"
