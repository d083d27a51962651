"""Compilation of LLVM code to a function for this machine, with a cache on disk.

LLVM comes with llvmlite, Numba's Python binding, so no separate compiler is needed. If llvmlite is missing, JAX runs
the loops, and `why_not` returns the reason.
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
"""Version of the arithmetic of compiled loops; it increases if any result changes, even in the last digit."""

LEAST_LLVM = 20
"""Oldest LLVM version that can read the output of `vector_code`."""

_POINTERS, _WHOLE_NUMBERS = 6, 2
"""Number of pointer arguments and of integer arguments of a kernel; see `kernel.SIGNATURE`."""

_lock = threading.Lock()


def _forget() -> None:
    """Reset the locks in a forked process, which would otherwise wait forever for a thread of its parent."""
    global _lock
    _lock = threading.Lock()


os.register_at_fork(after_in_child=_forget)


@functools.cache
def why_not() -> str:
    """Return the reason why compilation is impossible here, or an empty string."""
    if os.environ.get("STRUCTID_ENGINE") == "jax":
        return "STRUCTID_ENGINE=jax"
    try:
        import llvmlite.binding as llvm

        if llvm.llvm_version_info[0] < LEAST_LLVM:
            return f"llvmlite has LLVM {llvm.llvm_version_info[0]}, but LLVM {LEAST_LLVM} or later is needed"
        _machine()
    except (ImportError, OSError, RuntimeError) as cause:
        return f"llvmlite cannot be used ({cause})"
    return ""


def levels(text: str) -> tuple[int, int]:
    """Return the optimisation levels of LLVM's passes and of its code generation."""
    return 2, 3


class _Machine:
    """LLVM for this processor."""

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
        # JITLink keeps code and its constants close together. In a process with little free space between its libraries, the older
        # linker may place them too far apart.
        self.linker = llvm.create_lljit_compiler(use_jit_link=True)
        self.loaded: dict[str, Callable[..., None]] = {}

    def object_code(self, text: str) -> bytes:
        """Compile LLVM code to object code."""
        passes_level, code_level = levels(text)
        target = self.llvm.Target.from_default_triple().create_target_machine(
            cpu=self.processor, features=self.features, opt=code_level, reloc="pic", codemodel="default"
        )
        module = self.llvm.parse_assembly(text)
        module.verify()
        module.triple, module.data_layout = target.triple, str(target.target_data)
        options = self.llvm.create_pipeline_tuning_options(speed_level=passes_level)
        # The code already has its final vectors and loops.
        options.loop_unrolling = options.loop_vectorization = options.slp_vectorization = False
        passes = self.llvm.create_pass_builder(target, options)
        passes.getModulePassManager().run(module, passes)
        return bytes(target.emit_object(module))

    def linked(self, code: bytes, function: str, name: str) -> Callable[..., None]:
        """Load object code."""
        library = self.llvm.JITLibraryBuilder().add_object_img(code).add_current_process().export_symbol(function)
        linked = library.link(self.linker, name)
        signature = [ctypes.c_void_p] * _POINTERS + [ctypes.c_int64] * _WHOLE_NUMBERS
        result = ctypes.CFUNCTYPE(None, *signature)(linked[function])
        # The code exists as long as its library.
        result.library = linked  # type: ignore[attr-defined]
        return result


@functools.cache
def _machine() -> _Machine:
    return _Machine()


def engine() -> str:
    """Return the name of the engine for loops over time; stores record it, since results differ in the last digits."""
    return "jax" if why_not() else f"lanes {ARITHMETIC}"


LARGEST_DOUBLE_STATE = 11
"""Largest number of state variables for which each variable has two registers. Measured change of the computing time
with two registers: NARX recursion (11 variables) −1/3, four-storey frame (12) +1/5, eight-storey frame (24) +1/3."""


def lanes(state: int = 1) -> int:
    """Return the number of runs in a block.

    Each state variable has two vector registers, so that a core can start an operation before the previous one ends. In
    a larger state each variable has one register, since twice as many registers would spill to memory.
    """
    in_a_register = 8 if _machine().wide else 4
    return in_a_register * (2 if state <= LARGEST_DOUBLE_STATE else 1)


def processor() -> str:
    """Return the name of the processor for which code is compiled."""
    return _machine().processor


def load(text: str, function: str) -> Callable[..., None]:
    """Compile a function, or reuse its compiled code from memory or disk."""
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
    """Return the object code for LLVM code, from disk if it was compiled before."""
    return _from_disk(name) or _kept(name, machine.object_code(text))


def _from_disk(name: str) -> bytes | None:
    """Read object code; return None if there is none or the file is damaged."""
    try:
        stored = _file(name).read_bytes()
    except OSError:
        return None
    check, code = stored[:32], stored[32:]
    return code if hashlib.sha256(code).digest() == check else None


def _kept(name: str, code: bytes) -> bytes:
    """Store object code on disk for later processes; a reader never sees a partly written file."""
    file = _file(name)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=name, delete=False) as written:
            written.write(hashlib.sha256(code).digest() + code)
        Path(written.name).replace(file)
    return code
