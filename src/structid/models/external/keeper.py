"""The keeper process that a `Watchdog` starts. It imports slow modules once and forks the runner process for the calls.

    owner ── socket ── keeper ── socket ── runner ── whatever the solver starts
      └───────────────lifeline──┴────────────┘

If a runner hangs, the keeper kills it and all processes it has started. If a runner crashes, the keeper collects its exit code.
It then forks the next runner in milliseconds; a new Python process would take a second. When the owner ends for any reason, the
lifeline (a pipe) closes, and keeper and runner kill their process groups.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import signal
import socket
import sys
import threading
import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

ANSWERED, TIMED_OUT, DIED, NOT_LOADED = b"A", b"T", b"D", b"L"
"""Possible first bytes of the keeper's reply, which indicate how a call ended."""

START_LIMIT = 120.0
"""Time limit for loading a function with its imports [s]; it does not count towards the time limit of a call."""


@dataclass(frozen=True)
class _Runner:
    pid: int
    channel: Connection
    loaded: set[str] = field(default_factory=set)

    def kill(self) -> None:
        """Kill the runner and all processes it started."""
        self._kill_group()
        os.waitpid(self.pid, 0)

    def ended(self) -> str:
        """Describe how a runner that closed its channel ended, and kill the processes it left behind."""
        status = 0
        for _ in range(100):  # the runner is ending; its exit code is available shortly
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._kill_group()
                return ended_by(os.waitstatus_to_exitcode(status))
            time.sleep(0.02)
        self.kill()
        return "it closed its connection"

    def _kill_group(self) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        self.channel.close()


class Keeper:
    """The loop of the keeper process, which passes calls from the owner to the runner."""

    def __init__(self, channel: Connection, lifeline: int) -> None:
        self._channel, self._lifeline = channel, lifeline
        self._functions: dict[str, bytes] = {}
        self._runner: _Runner | None = None

    def serve(self) -> None:
        """Process calls until the owner closes the channel."""
        with contextlib.suppress(EOFError):
            while True:
                key, function, arguments, time_limit = pickle.loads(self._channel.recv_bytes())
                if function is not None:
                    self._functions[key] = function
                self._channel.send_bytes(self._done(key, arguments, time_limit))
        if self._runner is not None:
            self._runner.kill()

    def _done(self, key: str, arguments: bytes, time_limit: float | None) -> bytes:
        if self._runner is None:
            self._runner = self._forked()
        runner = self._runner
        try:
            if key not in runner.loaded:
                answer = _asked(runner.channel, (key, self._functions[key], None), START_LIMIT)
                if answer is None or answer[:1] != ANSWERED:
                    return answer or self._timed_out(START_LIMIT)
                runner.loaded.add(key)
            answer = _asked(runner.channel, (key, None, arguments), time_limit)
            return answer or self._timed_out(time_limit or 0.0)
        except (EOFError, OSError):
            self._runner = None
            return DIED + runner.ended().encode()

    def _timed_out(self, limit: float) -> bytes:
        assert self._runner is not None
        self._runner.kill()
        self._runner = None
        return TIMED_OUT + f"no answer within {limit:g} s".encode()

    def _forked(self) -> _Runner:
        parent_end, child_end = socket.socketpair()
        pid = os.fork()
        if pid == 0:
            parent_end.close()
            self._channel.close()
            os.setpgid(0, 0)  # a separate group, so that it can be killed as a whole without the keeper
            threading.Thread(target=die_with_the_owner, args=(self._lifeline,), daemon=True).start()
            code = 1
            try:
                _run(Connection(child_end.detach()))
                code = 0
            except SystemExit as left:
                code = left.code if isinstance(left.code, int) else int(left.code is not None)
                if isinstance(left.code, str):
                    _flush()
                    os.write(2, left.code.encode())
            finally:
                _flush()
                os._exit(code)
        child_end.close()
        return _Runner(pid, Connection(parent_end.detach()))


def _asked(channel: Connection, request: tuple[Any, ...], time_limit: float | None) -> bytes | None:
    channel.send_bytes(pickle.dumps(request, protocol=5))
    return channel.recv_bytes() if channel.poll(time_limit) else None


def _run(channel: Connection) -> None:
    """Main loop of the runner: load functions and call them."""
    functions: dict[str, Any] = {}
    voice = os.dup(1)
    while True:
        try:
            key, function, arguments = pickle.loads(channel.recv_bytes())
        except EOFError:
            return
        _listen_again(voice)
        answer = None
        try:
            if function is not None:
                functions[key] = pickle.loads(function)
            else:
                answer = functions[key](*pickle.loads(arguments))
            sent = ANSWERED + pickle.dumps((True, answer), protocol=5)
        except Exception as problem:
            sent = (ANSWERED if function is None else NOT_LOADED) + _told(problem, function is None)
        _flush()
        channel.send_bytes(sent)


def _listen_again(voice: int) -> None:
    """Empty the output file and redirect output to it, since the previous call may have closed or redirected output."""
    os.ftruncate(voice, 0)
    os.lseek(voice, 0, os.SEEK_SET)
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(voice, number)
        stream = getattr(sys, name)
        if stream is None or getattr(stream, "closed", False):
            setattr(sys, name, open(number, "w", closefd=False))  # noqa: SIM115


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()


def _told(problem: Exception, as_object: bool) -> bytes:
    words = f"{type(problem).__name__}: {problem}"
    if not as_object:
        return f"it could not be loaded: {words}".encode()
    try:
        pickle.loads(sent := pickle.dumps((False, problem), protocol=5))
        return sent
    except Exception:
        return pickle.dumps((False, RuntimeError(words)), protocol=5)


def die_with_the_owner(lifeline: int) -> None:
    """Wait until the owner has ended, then kill the whole process group."""
    with contextlib.suppress(OSError):
        os.read(lifeline, 1)
    os.killpg(0, signal.SIGKILL)


def ended_by(code: int) -> str:
    """Describe how a process ended, from its exit code."""
    if code >= 0:
        return f"exit code {code}"
    with contextlib.suppress(ValueError):
        return f"killed by signal {-code} ({signal.Signals(-code).name})"
    return f"killed by signal {-code}"


def main() -> None:
    """Run as a keeper. The arguments are the file descriptors of socket and lifeline, and a module to import first."""
    channel, lifeline = (int(word) for word in sys.argv[1:3])
    threading.Thread(target=die_with_the_owner, args=(lifeline,), daemon=True).start()
    if sys.argv[3]:
        # The module takes a second to import. It is imported once here, and every runner inherits it.
        importlib.import_module(sys.argv[3])
    Keeper(Connection(channel), lifeline).serve()
