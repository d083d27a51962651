"""A solver to put yours in place of: an oscillator with a bilinear spring, stepped by central differences in plain Python.

structid calls `respond` once for each run, in a child process: it may be slow, crash, hang or return too little, and the
others go on. Parameters arrive in SI under the names the study file gives them; the histories go back in SI, a value for each
sample of the record. Raise an exception where it fails; numbers that are not finite mean that it diverged there.
"""

import numpy as np

MASS = 12_000.0  # kg
DAMPING_RATIO = 0.03


def respond(parameters, record):
    """Relative velocity of the mass [m/s] under the record, shape (time,)."""
    stiffness = parameters["stiffness"]  # N/m
    yield_displacement = parameters["yield_displacement"]  # m
    hardening = parameters["hardening"]  # stiffness after yielding over that before
    damping = 2.0 * DAMPING_RATIO * np.sqrt(stiffness * MASS)
    dt, ground = record.dt, record.values

    displacement = np.zeros(len(record))
    plastic = 0.0
    for i in range(1, len(record) - 1):
        # A bilinear spring: an elastic one beside an elastic-plastic one, whose slider moves beyond the yield displacement.
        elastic = displacement[i] - plastic
        if abs(elastic) > yield_displacement:
            plastic += elastic - np.sign(elastic) * yield_displacement
        spring = stiffness * (hardening * displacement[i] + (1.0 - hardening) * (displacement[i] - plastic))
        # m ü + c u̇ + f = −m a_g, with u̇ and ü by central differences
        inertia, friction = MASS / dt**2, damping / (2.0 * dt)
        push = (
            -MASS * ground[i]
            - spring
            + inertia * (2.0 * displacement[i] - displacement[i - 1])
            + friction * displacement[i - 1]
        )
        displacement[i + 1] = push / (inertia + friction)
    return np.gradient(displacement, dt)
