"""Simulation-based calibration with gaps, two loggers, an unknown polarity and a sensor that fails at half time."""

import numpy as np
import pytest
import scipy.interpolate

import structid as si

EXPLORER = si.SMC(particles=60, ensembles=1, steps=30, effective_share=0.5, correlation=0.3)
REPLICAS = 100
RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 7.0).scale_to_pga(2.0)
SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
)
CHANNELS = ("velocity", "displacement")
MODEL = si.BoucWen(
    mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPACE.names, substeps=1, channels=CHANNELS
)
CLEAN = MODEL.simulate(np.array([[7.2e6, 0.4]]), RECORD).values[0]


def sensors():
    """200 Hz from the begin of the record on, with a fifth of the values missing; 128 Hz from 0.37 s on, dead at half time."""
    observations = []
    for column, (rate, start, polarity) in enumerate(((200.0, 0.0, "normal"), (128.0, 0.37, "unknown"))):
        times = np.arange(start, RECORD.time[-1], 1.0 / rate)
        values = scipy.interpolate.make_interp_spline(RECORD.time, CLEAN[:, column], k=5)(times)
        if column:
            values[times > 0.5 * RECORD.duration] = np.nan
        else:
            values[np.random.default_rng(1).random(len(values)) < 0.2] = np.nan
        observations.append(
            si.Observation(RECORD, values, (CHANNELS[column],), dt=1.0 / rate, start=start, polarity=polarity)
        )
    return observations


def ranks(error_model, space=SPACE, model=MODEL, sampler=EXPLORER):
    """Ranks of the parameters under both sensors; a variance is relative to a fifth of the channel's rms."""
    observations = [
        si.Observation(
            RECORD,
            o.values,
            o.channels,
            dt=o.dt,
            start=o.start,
            polarity=o.polarity,
            sd=0.2 * float(CLEAN[:, index].std()),
        )
        for index, o in enumerate(sensors())
    ]
    return si.sbc(si.Posterior(space, model, observations, error_model), REPLICAS, seed=1, sampler=sampler)


@pytest.mark.slow
@pytest.mark.parametrize(
    "error_model",
    [
        si.IID(variance=si.LogNormal(mean=1.0, sd=0.3)),
        si.AR1(variance=si.LogNormal(mean=1.0, sd=0.3), white=0.05, correlation_time=0.04),
        si.Matern32(variance=1.0, white=0.05, correlation_time=si.LogNormal(mean=0.04, sd=0.01, unit="s")),
        si.DampedCosine(variance=1.0, white=0.1, frequency=si.LogNormal(mean=4.0, sd=0.5, unit="Hz"), damping=0.2),
    ],
    ids=["iid", "ar1", "matern32", "damped cosine"],
)
def test_ranks_are_uniform(error_model):
    result = ranks(error_model)
    assert result.uniform, str(result)


@pytest.mark.slow
def test_ranks_of_a_drifting_parameter_are_uniform():
    """The parameter drifts on through the gaps, for both sensors in the same way."""
    space = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"))
    model = si.BoucWen(
        mass=12_000.0,
        damping_ratio=0.03,
        beta=60.0,
        gamma=20.0,
        alpha=0.06,
        free=("stiffness",),
        substeps=1,
        channels=CHANNELS,
    )
    sampler = si.SMC(particles=80, ensembles=1, steps=40, effective_share=0.5, correlation=0.3)
    result = ranks(si.Drifting(every=2.0, errors=si.IID(variance=0.25)), space, model, sampler)
    assert result.uniform, str(result)


@pytest.mark.slow
def test_a_gap_taken_for_silence_is_found_out():
    """The second sensor's dead half read as zeros: the ranks are not uniform."""
    _, second = sensors()
    blind = si.Observation(RECORD, np.nan_to_num(second.values), second.channels, dt=second.dt, start=second.start)
    of = si.Posterior(SPACE, MODEL, blind, si.IID(variance=float(0.2 * CLEAN[:, 1].std()) ** 2))
    zeros = np.isnan(second.values[:, 0])
    rng, inside = np.random.default_rng(3), []
    for stiffness, gamma_ratio in SPACE.sample(40, seed=2).values:
        clean = of.predict(np.array([[stiffness, gamma_ratio]]))[0]
        noisy = clean + 0.2 * CLEAN[:, 1].std() * rng.normal(size=clean.shape)
        noisy[zeros] = 0.0
        grid = np.column_stack([np.linspace(5e6, 10e6, 400), np.full(400, gamma_ratio)])
        density = si.Posterior(
            SPACE,
            MODEL,
            si.Observation(RECORD, noisy, second.channels, dt=second.dt, start=second.start),
            si.IID(variance=float(0.2 * CLEAN[:, 1].std()) ** 2),
        ).log_density(grid)
        share = np.cumsum(np.exp(density - density.max()))
        position = np.interp(stiffness, grid[:, 0], share / share[-1])
        inside.append(0.05 <= position <= 0.95)
    assert np.mean(inside) < 0.75
