#!/usr/bin/env bash
# OpenSeesPy 3.7.1.2, uniaxialMaterial SelfCentering (flag-shaped spring: k1 = 100, k2 = 5, activation force 10, beta = 0.7).
#
# Guess: the material is piecewise linear, and a strain history only has to reach its turning points. After unloading to zero, a
# reload is elastic to the activation force again: at a strain of 0.05 the stress is 5, at 0.1 it is 10, whatever the steps.
#
# Seen: the first step of the reload that passes the lower corner (strain 0.03) ends on the lower line of the flag, and the rest of
# the reload is elastic from there. At a strain of 0.1 the stress is 8.1 with steps of 0.05, and 9.05 with steps of 0.02.
# The force stays too low, by k1 - k2 times a part of the step, until the spring is activated; the first loading is right.
# In a transient analysis the stiffness seen between the corners therefore depends on the time step, and a cycle on where its
# samples happen to lie. A spring under imposed displacements needs samples at its corners.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "openseespy==3.7.1.2" "openseespylinux==3.7.1.2"
cat > "$folder/reload.py" <<'PYTHON'
import openseespy.opensees as ops


def stresses(strains):
    ops.wipe()
    ops.uniaxialMaterial("SelfCentering", 1, 100.0, 5.0, 10.0, 0.7)
    ops.testUniaxialMaterial(1)
    found = {}
    for strain in strains:
        ops.setStrain(strain)
        found[round(strain, 6)] = round(ops.getStress(), 6)
    return found


first = stresses([0.05, 0.1])
print("first loading in steps of 0.05:", first)
assert first == {0.05: 5.0, 0.1: 10.0}, first
wide = stresses([0.4, 0.0, 0.05, 0.1])
print("reload in steps of 0.05:", wide[0.05], wide[0.1])
assert (wide[0.05], wide[0.1]) == (3.1, 8.1), wide
narrow = stresses([0.4, 0.0, 0.02, 0.04, 0.06, 0.08, 0.1])
print("reload in steps of 0.02:", narrow[0.1])
assert narrow[0.1] == 9.05, narrow
PYTHON
ldconfig -p | grep -q libblas.so.3 || { apt-get update -qq && apt-get install -y -qq libblas3 liblapack3; }
"$folder/venv/bin/python" "$folder/reload.py" | grep -v '^Process'
echo "As described: OpenSeesPy's SelfCentering material reloads below its own lines, by an amount that depends on the step."
