"""A UM-Bridge server of waves, in a process of its own, started once for all tests of a process that ask for it."""

import atexit
import contextlib
import functools
import socket
import subprocess
import sys
import time

SERVER = """
import sys, math, umbridge
class Wave(umbridge.Model):
    def __init__(self): super().__init__("wave")
    def get_input_sizes(self, config): return [1, 1]
    def get_output_sizes(self, config):
        return [len(config["record"]["values"]) if "record" in config else config.get("samples", 400)]
    def __call__(self, parameters, config):
        (a,), (b,) = parameters
        if a > 5: raise RuntimeError("too large")
        record = config.get("record", {"dt": 0.01, "values": [0.0] * config.get("samples", 400)})
        return [[a * math.sin(b * record["dt"] * i) + x for i, x in enumerate(record["values"])]]
    def supports_evaluate(self): return True
umbridge.serve_models([Wave()], int(sys.argv[1]))
"""


def free_port():
    """A port that nobody listens to."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def answer(ask, alive=lambda: True):
    """The answer of a server that is starting, on a busy machine, too: without one it raises an error."""
    deadline = time.monotonic() + 90
    while True:
        try:
            return ask()
        except Exception:
            if time.monotonic() > deadline or not alive():
                raise
            time.sleep(0.1)


def served(arguments, port):
    """Start a server, wait for its answer: the process, and the names of its models."""
    import umbridge

    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address = f"http://127.0.0.1:{port}"
    return process, answer(lambda: umbridge.supported_models(address), lambda: process.poll() is None)


@functools.cache
def serving_waves():
    """Address of a server written with the official package, which offers the model ``wave``."""
    port = free_port()
    process, names = served([sys.executable, "-c", SERVER, str(port)], port)
    atexit.register(process.kill)
    assert names == ["wave"]
    return f"http://127.0.0.1:{port}"


@contextlib.contextmanager
def listening(arguments, port):
    """Run a server in a process of its own, from where it listens to the end of the context."""
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        answer(lambda: socket.create_connection(("127.0.0.1", port), 0.5).close(), lambda: process.poll() is None)
        yield process
    finally:
        process.kill()
        process.wait()
