"""Structures of hysteretic springs: the oscillator, the shear frame, cyclic tests."""
