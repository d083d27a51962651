"""Surrogates: cheap models fitted to runs of an expensive one."""
