"""External solvers as models: a Python function, a program, a server; run one at a time in guarded child processes."""
