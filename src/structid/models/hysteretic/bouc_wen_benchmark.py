"""Conversion of the parameters of the Bouc-Wen benchmark for nonlinear system identification."""

from __future__ import annotations

from typing import Any


def benchmark_parameters(k: Any, alpha: Any, beta: Any, gamma: Any, delta: Any, nu: Any) -> dict[str, Any]:
    """Convert the parameters of the Bouc-Wen benchmark (Noël & Schoukens 2016) to the parameters of `BoucWen`.

    The benchmark's m ÿ + c ẏ + k y + z = f, z′ = α ẏ − β (γ |ẏ| |z|^(ν−1) z + δ ẏ |z|^ν) is the oscillator with
    k_i = k + α, α′ = k/k_i, z′ = z/α, β′ = β γ α^(ν−1), γ′ = β δ α^(ν−1); m and c are unchanged.
    """
    shape = beta * alpha ** (nu - 1.0)
    return {
        "stiffness": k + alpha,
        "alpha": k / (k + alpha),
        "beta": shape * gamma,
        "gamma": shape * delta,
        "exponent": nu,
    }
