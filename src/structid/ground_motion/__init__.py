"""Excitations: ground-motion records, forces and imposed displacements. Read, simulate, process and measure them."""
