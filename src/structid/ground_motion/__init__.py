"""Excitations: ground-motion records, forces and imposed displacements; reading, processing, describing, making."""
