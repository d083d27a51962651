"""Oscillators that many tests are about."""

DEGRADING = dict(
    mass=12_000.0,
    damping_ratio=0.03,
    stiffness=7.6e6,
    alpha=0.05,
    beta=63.0,
    gamma_ratio=1.0,
    delta_nu=2.43,
    delta_eta=6.5,
)
"""The benchmark study's true oscillator."""
