"""Structures with hysteretic springs: the oscillator, the shear frame, cyclic tests."""
