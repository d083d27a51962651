"""A calibration in Python, from a record to a verdict; the study file `structid new` writes says the same in words."""

from __future__ import annotations

import structid as si


def main(steps: int = 3000) -> si.SamplingResult:
    """Calibrate a non-degrading oscillator to the velocity of a degrading one."""
    record = si.GroundMotion.synthetic(seed=8).lowpass(20.0).scale_to_pga(1.8)  # or .read("RSN6_….AT2")
    truth = si.BoucWen(
        mass=12_000.0,
        damping_ratio=0.03,
        stiffness=7.6e6,
        alpha=0.05,
        beta=63.0,
        gamma_ratio=1.0,
        delta_nu=2.43,
        delta_eta=6.5,
    )
    velocity = truth.simulate([[]], record).channel("velocity")[0]  # or your measurement, in m/s

    space = si.ParameterSpace(
        stiffness=si.Normal(7.42, 0.742, low=4.27, high=11.85, unit="kN/mm"),
        beta=si.Uniform(55.0, 65.0, unit="1/m"),
        gamma_ratio=si.Uniform(-1.0, 1.0),
        alpha=si.LogNormal(mean=0.063, sd=0.01, high=1.0),
    )
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=space.names, channels=("velocity",))
    posterior = si.Posterior(space, model, si.Observation(record, velocity))

    print(si.optimize.interior_point(posterior.misfit, starts=8))
    sampler = si.AIES(
        walkers=32,
        steps=steps,
        ensembles=4,
        differential_evolution=0.8,
        start_candidates=10,
        settling_steps=min(500, steps // 4),
    )
    result = si.sample(posterior, sampler, seed=1)
    print(result.summary())
    print(result.verdict())
    other = si.GroundMotion.synthetic(seed=9).lowpass(20.0).scale_to_pga(1.8)
    print("peak velocity on another record [m/s], 5 and 95 %:", result.predict(other, draws=100).band()[1].max())
    return result


if __name__ == "__main__":
    main()
