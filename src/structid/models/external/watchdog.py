"""The owner's side of a guarded call. A keeper process carries out the call, so that no crash or hang harms the owner.

Executors cannot kill a hung task, and the crash of a solver ends its process. Every owner of solver runs (a thread of
this program or a worker of a cluster) therefore has a keeper (`models/external/keeper.py`). The keeper is a supervisor
process that starts fresh, shares no memory with its owner, and has one BLAS or XLA thread.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import weakref
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from structid.core.reasons import with_words
from structid.models.external.keeper import ANSWERED, NOT_LOADED, START_LIMIT, TIMED_OUT

LAST_WORDS = 2000
"""Number of characters kept from the output of a failed call."""

_ONE_THREAD = {
    **dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS"),
        "1",
    ),
    "JAX_NUM_CPU_DEVICES": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
}


_START = "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); from structid.models.external.keeper import main; main()"
"""Code that passes the owner's import path to the keeper. PYTHONPATH would also reach programs that a solver starts."""


class CallTimeoutError(Exception):
    """Error raised if a call exceeds its time limit; its process is then killed."""


class NotLoadedError(Exception):
    """Error raised if a function cannot be loaded in the child process, so that no run is possible."""


class CallDiedError(Exception):
    """Error raised if the process of a call ends before the call returns, by a signal or by itself."""


@dataclass
class _Kept:
    """A keeper process and its connections to the owner."""

    process: subprocess.Popen[bytes]
    channel: Connection
    lifeline: int | None
    voice: int
    known: set[str] = field(default_factory=set)
    owner: int = field(default_factory=os.getpid)
    lock: Any = field(default_factory=threading.Lock)

    def cut(self) -> None:
        """Close the lifeline, so that keeper and runner kill themselves and all processes they have started."""
        with self.lock:
            lifeline, self.lifeline = self.lifeline, None
        if lifeline is not None:
            os.close(lifeline)
        if os.getpid() != self.owner:  # a fork of the owner has copies of the ends, but must not kill the keeper
            return
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def bury(self) -> None:
        self.cut()
        if os.getpid() == self.owner:
            self.process.wait()
        self.channel.close()
        os.close(self.voice)


class Watchdog:
    """Owner of one background process, the keeper, which starts at the first call."""

    def __init__(self) -> None:
        self._kept: _Kept | None = None
        self._finalizer: Any = None
        self._killed = False

    def call(
        self, key: str, function: bytes, arguments: tuple[Any, ...], time_limit: float | None, preloaded: str = ""
    ) -> Any:
        """Run a function in the child process."""
        kept = self._kept or self._start(preloaded)
        if self._killed:  # killed while the keeper was starting
            self.close()
            raise CallDiedError("the run was stopped before it began")
        request = (key, None if key in kept.known else function, pickle.dumps(arguments, protocol=5), time_limit)
        try:
            kept.channel.send_bytes(pickle.dumps(request, protocol=5))
            kept.known.add(key)
            # The keeper monitors the time. This limit applies if the keeper itself hangs.
            if not kept.channel.poll(None if time_limit is None else time_limit + 2 * START_LIMIT):
                raise EOFError
            answer = kept.channel.recv_bytes()
        except (EOFError, OSError) as cause:
            words = self.last_words()
            self.close()
            raise CallDiedError(with_words("its keeper was killed", words)) from cause
        except KeyboardInterrupt:
            self.close()  # the answer to this call must not be mistaken for the answer to the next call
            raise
        if answer[:1] == ANSWERED:
            good, result = pickle.loads(answer[1:])
            if good:
                return result
            raise result
        kind = {TIMED_OUT: CallTimeoutError, NOT_LOADED: NotLoadedError}.get(answer[:1], CallDiedError)
        raise kind(with_words(answer[1:].decode(), self.last_words()))

    def last_words(self) -> str:
        """Return the end of the last call's output."""
        return "" if self._kept is None else _tail(self._kept.voice)

    def kill(self) -> None:
        """Kill all processes permanently, from another thread; a thread waiting in `call` gets an error."""
        self._killed = True
        if self._kept is not None:
            self._kept.cut()

    def close(self) -> None:
        """Kill all processes; the next call starts a new keeper."""
        if self._kept is not None:
            self._kept = None
            self._finalizer()

    def _start(self, preloaded: str) -> _Kept:
        parent_end, child_end = socket.socketpair()
        read_end, write_end = os.pipe()
        voice = _nameless_file()
        search_path = [folder or str(Path.cwd()) for folder in sys.path]
        process = subprocess.Popen(
            [sys.executable, "-c", _START, json.dumps(search_path), str(child_end.fileno()), str(read_end), preloaded],
            stdin=subprocess.DEVNULL,
            stdout=voice,
            stderr=voice,
            env={**os.environ, **_ONE_THREAD},
            pass_fds=(child_end.fileno(), read_end),
            start_new_session=True,  # the terminal's Ctrl-C does not reach the process
        )
        child_end.close()
        os.close(read_end)
        self._kept = _Kept(process, Connection(parent_end.detach()), write_end, voice)
        self._finalizer = weakref.finalize(self, self._kept.bury)
        return self._kept


def _nameless_file() -> int:
    """Open a temporary file without a name; the operating system removes it when it is closed."""
    handle, name = tempfile.mkstemp(prefix="structid-")
    Path(name).unlink()
    return handle


def _tail(handle: int) -> str:
    """Read the end of a file without changing the runner's write position."""
    size = os.fstat(handle).st_size
    start = max(0, size - LAST_WORDS)
    return os.pread(handle, size - start, start).decode(errors="replace").strip()
