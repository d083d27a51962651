"""Excitations: ground motions, forces, imposed displacements; their reading, simulation, processing, intensity measures."""
