"""External solvers as models: a Python function, a program, a server. Each run takes place in a guarded child process."""
