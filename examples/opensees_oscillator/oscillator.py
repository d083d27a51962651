"""The Bouc-Wen oscillator in OpenSeesPy, as one would write it for OpenSees alone: structid calls `respond` once for each run."""

import openseespy.opensees as ops

MASS = 12_000.0  # kg
DAMPING_RATIO = 0.03


def respond(parameters, record):
    """Relative velocity of the mass [m/s] under the record, shape (time,)."""
    stiffness, alpha = parameters["stiffness"], parameters["alpha"]
    beta, gamma = parameters["beta"], parameters["gamma_ratio"] * parameters["beta"]

    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(1, 0.0)
    ops.node(2, 0.0)
    ops.fix(1, 1)
    ops.mass(2, MASS)
    # uniaxialMaterial BoucWen: tag, alpha, ko, n, gamma, beta, Ao, deltaA, deltaNu, deltaEta
    ops.uniaxialMaterial("BoucWen", 1, alpha, stiffness, 1.0, gamma, beta, 1.0, 0.0, 0.0, 0.0)
    ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
    ops.rayleigh(2.0 * DAMPING_RATIO * (stiffness / MASS) ** 0.5, 0.0, 0.0, 0.0)
    ops.timeSeries("Path", 1, "-dt", record.dt, "-values", *record.values.tolist(), "-useLast")
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)

    ops.system("BandGeneral")
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.algorithm("Newton")
    ops.test("NormUnbalance", 1e-8, 50)
    ops.analysis("Transient")

    velocity = [0.0]
    for step in range(1, len(record)):
        if ops.analyze(1, record.dt) != 0:
            raise ArithmeticError(f"OpenSees did not converge at {step * record.dt:g} s")
        velocity.append(ops.nodeVel(2, 1))
    return velocity
