"""Modified Ibarra–Medina–Krawinkler law: deteriorating backbone, peak-oriented or pinched reloading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import power
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, clip, parameter
from structid.mechanics.hysteretic_laws.default_priors import ASYMMETRY, STRENGTH, around, up_to

SIDE = ("f_y", "k_p", "d_cap", "f_cap", "d_global", "f_global", "d_local", "f_local")
"""Variables of a side: its backbone, the largest deformation reached, and the last reversal."""
PATH = ("a_d", "a_f", "b_d", "b_f", "c_d", "c_f", "pinch_d", "pinch_f")
"""Points of the reloading path: start, pinching point or start, last reversal or the point before; and the pinching point."""


@dataclass(frozen=True, eq=False)
class IbarraPeakOriented(HystereticLaw):
    """Trilinear backbone with capping and residual strength; reloading aims at the largest deformation reached.

    Four modes of deterioration follow the absorbed energy E, relative to F_y u_y. At each crossing of zero force (at each
    reversal for the unloading stiffness)::

        β_i = (δ_i ΔE/(1 − δ_i E))^c,        ΔE since the last crossing,  δ_i = F_y u_y/E_ref,i

    β_S lowers yield force and hardening, β_C the line after capping, β_K the unloading stiffness, and β_A moves the target away.
    A rate β above 1 is the end of the spring, whose force then is zero.
    """

    word: ClassVar[str] = "ibarra_peak_oriented"
    title: ClassVar[str] = "modified Ibarra–Medina–Krawinkler law, peak-oriented"
    use: ClassVar[str] = "reinforced-concrete members and frames up to collapse"
    source: ClassVar[str] = "Ibarra, Medina & Krawinkler (2005); Lignos & Krawinkler (2011)"
    dissipative: ClassVar[bool] = False
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "capping_displacement": 0.5,
        "capping_ratio": 1.3,
        "post_capping_displacement": 3.0,
        "residual_ratio": 0.2,
        "strength_deterioration": 0.003,
    }
    opensees: ClassVar[str] = (
        "IMKPeakOriented tag, k, then u_p, u_pc, ultimate_displacement, F_y, capping_ratio, residual_ratio for each sign, "
        "u_y/δ_S, u_y/δ_C, u_y/δ_A, u_y/δ_K, c, c, c, c, 1, 1"
    )

    yield_force: Any = parameter("yield force F_y", STRENGTH, "N")
    capping_displacement: Any = parameter("plastic deformation from yielding to capping, u_p", around(0.5, 4.0), "m")
    capping_ratio: Any = parameter("force at capping, relative to F_y", around(1.2, 1.4, low=1.0), low=1.0, default=1.0)
    post_capping_displacement: Any = parameter("deformation from capping to zero force, u_pc", around(3.0, 5.0), "m")
    residual_ratio: Any = parameter(
        "residual force, relative to F_y", up_to(0.6, high=1.0), high=1.0, default=0.0, neutral=0.0
    )
    ultimate_displacement: Any = parameter(
        "deformation at which the spring breaks", None, "m", default=np.inf, neutral=np.inf
    )
    strength_deterioration: Any = parameter(
        "rate of the loss of strength, δ_S",
        up_to(0.1),
        default=0.0,
        neutral=0.0,
        mechanism="loss of strength with the energy",
    )
    capping_deterioration: Any = parameter(
        "rate of the loss after capping, δ_C",
        up_to(0.1),
        default=0.0,
        neutral=0.0,
        mechanism="loss of capping strength with the energy",
    )
    reloading_deterioration: Any = parameter(
        "rate of the accelerated reloading, δ_A",
        up_to(0.1),
        default=0.0,
        neutral=0.0,
        mechanism="loss of reloading stiffness with the energy",
    )
    unloading_deterioration: Any = parameter(
        "rate of the loss of unloading stiffness, δ_K",
        up_to(0.1),
        default=0.0,
        neutral=0.0,
        mechanism="loss of unloading stiffness with the energy",
    )
    deterioration_exponent: Any = parameter("exponent c of the rates", None, default=1.0)
    asymmetry: Any = parameter(
        "negative forces, relative to the positive ones, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )

    def at_rest(self, zero: Any) -> Memory:
        """Return the backbones of both sides and the variables of the path; see `HystereticLaw.at_rest`."""
        state = dict.fromkeys(("d", "f", "side", "loading", "energy", "energy_before", "broken", *PATH), zero)
        state["unloading"] = self.stiffness + zero
        for name, factor in (("positive", 1.0), ("negative", self.asymmetry)):
            f_y = self.yield_force * factor + zero
            d_y = f_y / self.stiffness
            side = {
                "f_y": f_y,
                "k_p": (self.capping_ratio - 1.0) * f_y / self.capping_displacement,
                "d_cap": d_y + self.capping_displacement,
                "f_cap": self.capping_ratio * f_y,
                "d_global": d_y,
                "f_global": f_y,
                "d_local": d_y,
                "f_local": f_y,
            }
            state |= {f"{name}_{key}": side[key] for key in SIDE}
        return state

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`. All of it is mirrored so that the move is in the positive direction."""
        xp = namespace(deformation)
        still = deformation == memory["d"]
        sign = xp.where(deformation >= memory["d"], 1.0, -1.0)
        ahead, behind = self._sides(memory, sign)
        # The slope after capping and the residual force do not deteriorate.
        first = self._first_yield_force(sign)
        ahead["k_pc"] = self.capping_ratio * first / self.post_capping_displacement
        ahead["residual"] = self.residual_ratio * first
        d, f, to = sign * memory["d"], sign * memory["f"], sign * deformation

        # A reversal on the path or the backbone of the other side
        turned = (memory["loading"] * memory["side"] * sign < 0.0) & ~still
        behind = self._peaks(behind, turned, -d, -f)
        unloading = memory["unloading"] * xp.where(turned, 1.0 - self._unloading_loss(memory, f), 1.0)
        # Without unloading stiffness the spring no longer returns to zero force.
        slope = xp.where(unloading > 0.0, unloading, 1.0)
        unloads = (memory["side"] != 0.0) & ((memory["loading"] == 0.0) | turned)
        elastic = f + unloading * (to - d)

        # A crossing of zero force: deterioration of this side, and a new path
        crosses = unloads & (f <= 0.0) & (elastic >= 0.0) & ~still
        ahead, lost = self._deteriorated(memory, ahead, crosses)
        path = {name: memory[name] for name in PATH}
        path = self._choose(crosses, self._path_from_zero(ahead, d - f / slope, slope), path)
        # A return to the last reversal of the same side
        returns = unloads & (f > 0.0) & (to > ahead["d_local"]) & ~still
        path = self._choose(returns, self._path_from_local(ahead, path), path)
        # The first yielding
        yields = (memory["side"] == 0.0) & (to > ahead["d_global"])
        path = self._choose(yields, self._path_at_yield(ahead), path)

        loads = crosses | returns | yields | (memory["loading"] * memory["side"] * sign > 0.0)
        force = xp.where(loads, self._on_path(to, path, ahead), xp.where(unloads, elastic, self.stiffness * to))
        broken = (memory["broken"] > 0.0) | lost | (loads & (to >= self.ultimate_displacement))
        broken = broken | (loads & (to > ahead["d_cap"]) & (force <= 0.0))
        force = xp.where(broken, 0.0, force)
        return {
            "d": deformation,
            "f": xp.where(still, memory["f"], sign * force),
            "side": xp.where(loads, sign, memory["side"]),
            "loading": xp.where(loads, 1.0, xp.where(unloads, 0.0, memory["loading"])),
            "unloading": unloading,
            "energy": memory["energy"] + 0.5 * (f + force) * (to - d) / self._energy_unit(),
            "energy_before": xp.where(crosses, memory["energy"], memory["energy_before"]),
            "broken": xp.where(broken, 1.0, 0.0),
            **path,
            **self._both(sign, ahead, behind),
        }

    @staticmethod
    def _sides(memory: Memory, sign: Any) -> tuple[Memory, Memory]:
        """Return the variables of the side ahead and of the side behind."""
        xp = namespace(sign)
        positive = sign > 0.0
        both = {key: (memory[f"positive_{key}"], memory[f"negative_{key}"]) for key in SIDE}
        ahead = {key: xp.where(positive, one, other) for key, (one, other) in both.items()}
        return ahead, {key: xp.where(positive, other, one) for key, (one, other) in both.items()}

    def _first_yield_force(self, sign: Any) -> Any:
        """Return the yield force of the first loading on the side ahead."""
        return self.yield_force * namespace(sign).where(sign > 0.0, 1.0, self.asymmetry)

    @staticmethod
    def _both(sign: Any, ahead: Memory, behind: Memory) -> Memory:
        """Return the variables of both sides by name."""
        xp = namespace(sign)
        positive = sign > 0.0
        after = {f"positive_{key}": xp.where(positive, ahead[key], behind[key]) for key in SIDE}
        return after | {f"negative_{key}": xp.where(positive, behind[key], ahead[key]) for key in SIDE}

    @staticmethod
    def _choose(condition: Any, this: Memory, other: Memory) -> Memory:
        xp = namespace(condition)
        return {name: xp.where(condition, this[name], other[name]) for name in other}

    def _energy_unit(self) -> Any:
        """Return F_y u_y [J]."""
        return self.yield_force**2 / self.stiffness

    def _rate(self, rate: Any, absorbed: Any, total: Any) -> tuple[Any, Any]:
        """Return β, between 0 and 1, and whether it is above 1 or the reference energy is spent."""
        xp = namespace(total)
        left = 1.0 - rate * total
        ratio = rate * xp.maximum(absorbed, 0.0) / xp.where(left > 0.0, left, 1.0)
        beta = power(ratio, self.deterioration_exponent)
        return clip(beta, 0.0, 1.0), (left <= 0.0) | (beta > 1.0)

    def _unloading_loss(self, memory: Memory, force: Any) -> Any:
        """Return β_K at a reversal; the energy that the unloading gives back does not count."""
        xp = namespace(force)
        unloading = memory["unloading"]
        elastic = 0.5 * force**2 / xp.where(unloading > 0.0, unloading, 1.0) / self._energy_unit()
        spent = memory["energy"] - elastic
        return self._rate(self.unloading_deterioration, spent - memory["energy_before"], spent)[0]

    @staticmethod
    def _peaks(side: Memory, turned: Any, d: Any, f: Any) -> Memory:
        """Return a side with its last reversal, and its largest deformation if this is larger."""
        xp = namespace(d)
        beyond = turned & (d > side["d_global"])
        return side | {
            "d_local": xp.where(turned, d, side["d_local"]),
            "f_local": xp.where(turned, f, side["f_local"]),
            "d_global": xp.where(beyond, d, side["d_global"]),
            "f_global": xp.where(beyond, f, side["f_global"]),
        }

    def _deteriorated(self, memory: Memory, side: Memory, crosses: Any) -> tuple[Memory, Any]:
        """Return a side after the deterioration of a crossing, and whether the spring breaks."""
        xp = namespace(crosses)
        total, absorbed = memory["energy"], memory["energy"] - memory["energy_before"]
        rates = (self.strength_deterioration, self.capping_deterioration, self.reloading_deterioration)
        (strength, broken_s), (capping, broken_c), (reloading, broken_a) = (
            self._rate(rate, absorbed, total) for rate in rates
        )
        k_pc = side["k_pc"]
        f_y, k_p = (1.0 - strength) * side["f_y"], (1.0 - strength) * side["k_p"]
        # Force at zero deformation of the lines after yielding and after capping
        yielded = f_y * (1.0 - k_p / self.stiffness)
        capped = (1.0 - capping) * (side["f_cap"] + k_pc * side["d_cap"])
        d_cap = (capped - yielded) / (k_p + k_pc)
        after = side | {
            "f_y": f_y,
            "k_p": k_p,
            "d_cap": d_cap,
            "f_cap": yielded + k_p * d_cap,
            "d_global": (1.0 + reloading) * side["d_global"],
        }
        after["f_global"] = xp.maximum(self._backbone(after["d_global"], after), side["residual"])
        broken = crosses & (broken_s | broken_c | broken_a | (after["f_global"] <= 0.0))
        return {name: xp.where(crosses, value, side[name]) for name, value in after.items()}, broken

    def _backbone(self, d: Any, side: Memory) -> Any:
        """Return the force of a backbone."""
        xp = namespace(d)
        hardened = side["f_cap"] + side["k_p"] * (d - side["d_cap"])
        softened = xp.maximum(side["f_cap"] - side["k_pc"] * (d - side["d_cap"]), side["residual"])
        yielded = xp.where(d <= side["d_cap"], hardened, softened)
        return xp.where(d < side["f_y"] / self.stiffness, self.stiffness * d, yielded)

    def _path_from_zero(self, side: Memory, start: Any, unloading: Any) -> Memory:
        """Return the path from zero force over the last reversal, if that is stiffer, to the largest deformation."""
        xp = namespace(start)
        pinch_d, pinch_f, pinched = self._pinching(side, start, unloading)
        path = {
            "a_d": start,
            "a_f": 0.0 * start,
            "b_d": xp.where(pinched, pinch_d, start),
            "b_f": xp.where(pinched, pinch_f, 0.0),
            "pinch_d": pinch_d,
            "pinch_f": pinch_f,
        }
        over_local = (
            (path["b_d"] < side["d_local"])
            & (path["b_f"] < side["f_local"])
            & (side["f_local"] < side["f_global"])
            & (
                (side["f_local"] - path["b_f"]) * (side["d_global"] - path["b_d"])
                > (side["f_global"] - path["b_f"]) * (side["d_local"] - path["b_d"])
            )
        )
        path["c_d"] = xp.where(over_local, side["d_local"], path["b_d"])
        path["c_f"] = xp.where(over_local, side["f_local"], path["b_f"])
        return path

    def _pinching(self, side: Memory, start: Any, unloading: Any) -> tuple[Any, Any, Any]:
        """Return the pinching point of a path, and whether the path passes it; here there is none."""
        return start, 0.0 * start, start != start

    @staticmethod
    def _path_from_local(side: Memory, path: Memory) -> Memory:
        """Return the path from the last reversal to the largest deformation, over the pinching point if that is below it."""
        xp = namespace(side["d_local"])
        d, f, pinch_d, pinch_f = side["d_local"], side["f_local"], path["pinch_d"], path["pinch_f"]
        pinched = (d < pinch_d) & (f < pinch_f) & (pinch_d < side["d_global"]) & (pinch_f < side["f_global"])
        pinched = pinched & ((pinch_f - f) * (side["d_global"] - d) < (side["f_global"] - f) * (pinch_d - d))
        b_d, b_f = xp.where(pinched, pinch_d, d), xp.where(pinched, pinch_f, f)
        return {
            "a_d": d,
            "a_f": f,
            "b_d": b_d,
            "b_f": b_f,
            "c_d": b_d,
            "c_f": b_f,
            "pinch_d": pinch_d,
            "pinch_f": pinch_f,
        }

    @staticmethod
    def _path_at_yield(side: Memory) -> Memory:
        """Return the path that consists of the yield point only."""
        path = {f"{point}_d": side["d_global"] for point in ("a", "b", "c", "pinch")}
        return path | {f"{point}_f": side["f_global"] for point in ("a", "b", "c", "pinch")}

    def _on_path(self, d: Any, path: Memory, side: Memory) -> Any:
        """Return the force at a deformation on the path or, beyond the largest deformation, on the backbone."""
        xp = namespace(d)

        def line(from_d: Any, from_f: Any, to_d: Any, to_f: Any) -> Any:
            length = to_d - from_d
            return from_f + (to_f - from_f) * (d - from_d) / xp.where(length > 0.0, length, 1.0)

        to_global = line(path["c_d"], path["c_f"], side["d_global"], side["f_global"])
        over_c = xp.where(d <= path["c_d"], line(path["b_d"], path["b_f"], path["c_d"], path["c_f"]), to_global)
        over_b = xp.where(d <= path["b_d"], line(path["a_d"], path["a_f"], path["b_d"], path["b_f"]), over_c)
        return xp.where(d > side["d_global"], self._backbone(d, side), over_b)
