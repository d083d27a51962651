"""From text to a function of this machine: LLVM compiles it once, and what it made is kept on disk.

LLVM comes with llvmlite, the part of Numba that binds it to Python; no compiler need be installed. Where llvmlite is missing,
`why_not` says so, and loops are left to JAX.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

from structid.core.cores import cache_folder

ARITHMETIC = 1
"""Version of what compiled loops compute, to the last digit."""

LEAST_LLVM = 20
"""The first version of LLVM that reads what `vector_code` writes."""

_POINTERS, _WHOLE_NUMBERS = 6, 2
"""Arguments of a kernel; see `kernel.SIGNATURE`."""

_lock = threading.Lock()


def _forget() -> None:
    """A process that is forked while another thread compiles would wait for it forever."""
    global _lock
    _lock = threading.Lock()


os.register_at_fork(after_in_child=_forget)


@functools.cache
def why_not() -> str:
    """Say why nothing can be compiled here."""
    if os.environ.get("STRUCTID_ENGINE") == "jax":
        return "STRUCTID_ENGINE=jax"
    try:
        import llvmlite.binding as llvm

        if llvm.llvm_version_info[0] < LEAST_LLVM:
            return f"llvmlite with LLVM {llvm.llvm_version_info[0]}, and LLVM {LEAST_LLVM} or later is needed"
        _machine()
    except (ImportError, OSError, RuntimeError) as cause:
        return f"llvmlite cannot be used ({cause})"
    return ""


def levels(text: str) -> tuple[int, int]:
    """Say how far LLVM's passes, and its writing of code, are to optimise."""
    return 2, 3


class _Machine:
    """LLVM for the processor it runs on."""

    def __init__(self) -> None:
        import llvmlite
        import llvmlite.binding as llvm

        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self.llvm = llvm
        self.processor: str = llvm.get_host_cpu_name()
        features = llvm.get_host_cpu_features().flatten()
        self.wide = "+avx512f" in features
        self.features = features
        self.identity = f"llvmlite {llvmlite.__version__}, LLVM {llvm.llvm_version_info}, {self.processor}, {features}"
        # JITLink keeps code and its constants side by side. The older linker may put them further apart than code can reach, in a
        # process with little room left between its other libraries.
        self.linker = llvm.create_lljit_compiler(use_jit_link=True)
        self.loaded: dict[str, Callable[..., None]] = {}

    def object_code(self, text: str) -> bytes:
        """Compile."""
        passes_level, code_level = levels(text)
        target = self.llvm.Target.from_default_triple().create_target_machine(
            cpu=self.processor, features=self.features, opt=code_level, reloc="pic", codemodel="default"
        )
        module = self.llvm.parse_assembly(text)
        module.verify()
        module.triple, module.data_layout = target.triple, str(target.target_data)
        options = self.llvm.create_pipeline_tuning_options(speed_level=passes_level)
        # The code is in vectors and in the loops that it should be in.
        options.loop_unrolling = options.loop_vectorization = options.slp_vectorization = False
        passes = self.llvm.create_pass_builder(target, options)
        passes.getModulePassManager().run(module, passes)
        return bytes(target.emit_object(module))

    def linked(self, code: bytes, function: str, name: str) -> Callable[..., None]:
        """Load object code."""
        library = self.llvm.JITLibraryBuilder().add_object_img(code).add_current_process().export_symbol(function)
        linked = library.link(self.linker, name)
        signature = [ctypes.c_void_p] * _POINTERS + [ctypes.c_int64] * _WHOLE_NUMBERS
        found = ctypes.CFUNCTYPE(None, *signature)(linked[function])
        # The code is there for as long as its library is.
        found.library = linked  # type: ignore[attr-defined]
        return found


@functools.cache
def _machine() -> _Machine:
    return _Machine()


def engine() -> str:
    """Name what runs loops over time here, for stores: another engine gives the same numbers but for the last digits."""
    return "jax" if why_not() else f"lanes {ARITHMETIC}"


LARGEST_DOUBLE_STATE = 11
"""Numbers of a state up to which each has two registers. Measured: the 11 numbers of a NARX recursion take two thirds of the time
that they take in one register each, the 12 of a frame of four storeys a fifth more, the 24 of one of eight a third more."""


def lanes(state: int = 1) -> int:
    """Number of runs in a block: two registers for each number, or a core would wait for one operation to begin the next.

    A larger state has one register for each number: it keeps the core busy by itself, and twice as many would be in memory.
    """
    in_a_register = 8 if _machine().wide else 4
    return in_a_register * (2 if state <= LARGEST_DOUBLE_STATE else 1)


def processor() -> str:
    """Name of the processor that code is compiled for."""
    return _machine().processor


def load(text: str, function: str) -> Callable[..., None]:
    """Compile a function, or take it from memory or disk where it has been compiled before."""
    with _lock:
        machine = _machine()
        name = hashlib.sha256(f"{machine.identity}, {levels(text)}\n{text}".encode()).hexdigest()[:32]
        if name not in machine.loaded:
            machine.loaded[name] = machine.linked(_code(machine, text, name), function, name)
        return machine.loaded[name]


# --- on disk --------------------------------------------------------------------------------------------------------


def _file(name: str) -> Path:
    return cache_folder("lanes") / f"{name}.o"


def _code(machine: _Machine, text: str, name: str) -> bytes:
    """Object code, from disk where it has been compiled before."""
    return _from_disk(name) or _kept(name, machine.object_code(text))


def _from_disk(name: str) -> bytes | None:
    """What was compiled before; None where there is nothing, or something broken, which is then made again."""
    try:
        stored = _file(name).read_bytes()
    except OSError:
        return None
    check, code = stored[:32], stored[32:]
    return code if hashlib.sha256(code).digest() == check else None


def _kept(name: str, code: bytes) -> bytes:
    """Keep object code for the next process, whole or not at all. Where nothing can be written, nothing is kept."""
    file = _file(name)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=name, delete=False) as written:
            written.write(hashlib.sha256(code).digest() + code)
        Path(written.name).replace(file)
    return code
