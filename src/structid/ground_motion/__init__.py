"""Excitations: ground motions, forces and imposed displacements; reading, simulation, processing, intensity measures."""
