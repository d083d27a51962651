"""Compilation of LLVM text to a function of this machine, with a cache on disk.

LLVM comes with llvmlite, Numba's binding to Python; no compiler need be installed. Where llvmlite is missing, `why_not` gives the
reason and loops are left to JAX.
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
"""Version of the arithmetic of compiled loops, to the last digit."""

LEAST_LLVM = 20
"""Oldest LLVM that reads the output of `vector_code`."""

_POINTERS, _WHOLE_NUMBERS = 6, 2
"""Types of a kernel's arguments; see `kernel.SIGNATURE`."""

_lock = threading.Lock()


def _forget() -> None:
    """Reset the locks in a forked process, which would otherwise wait forever for a thread of its parent."""
    global _lock
    _lock = threading.Lock()


os.register_at_fork(after_in_child=_forget)


@functools.cache
def why_not() -> str:
    """Return the reason why nothing can be compiled here, or an empty string."""
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
    """Optimisation levels of LLVM's passes and of its code generation."""
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
        # JITLink keeps code and its constants side by side. The older linker may put them further apart than code can reach, in a
        # process with little room left between its other libraries.
        self.linker = llvm.create_lljit_compiler(use_jit_link=True)
        self.loaded: dict[str, Callable[..., None]] = {}

    def object_code(self, text: str) -> bytes:
        """Compile LLVM text to object code."""
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
        result = ctypes.CFUNCTYPE(None, *signature)(linked[function])
        # The code is there for as long as its library is.
        result.library = linked  # type: ignore[attr-defined]
        return result


@functools.cache
def _machine() -> _Machine:
    return _Machine()


def engine() -> str:
    """Name of the engine that runs loops over time here, for stores: engines differ in the last digits."""
    return "jax" if why_not() else f"lanes {ARITHMETIC}"


LARGEST_DOUBLE_STATE = 11
"""Largest state for which each number has two registers. Measured: the 11 numbers of a NARX recursion take two thirds of the
time with two registers each; the 12 of a four-storey frame take a fifth more, the 24 of an eight-storey frame a third more."""


def lanes(state: int = 1) -> int:
    """Number of runs in a block.

    Two vector registers for each number, so that a core need not wait for one operation before it starts the next. A larger state
    has one register for each number, since twice as many would spill to memory.
    """
    in_a_register = 8 if _machine().wide else 4
    return in_a_register * (2 if state <= LARGEST_DOUBLE_STATE else 1)


def processor() -> str:
    """Name of the processor for which code is compiled."""
    return _machine().processor


def load(text: str, function: str) -> Callable[..., None]:
    """Compile a function, or reuse it from memory or disk."""
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
    """Object code of a text, from disk if it was compiled before."""
    return _from_disk(name) or _kept(name, machine.object_code(text))


def _from_disk(name: str) -> bytes | None:
    """Read object code; None where there is none or the file is damaged."""
    try:
        stored = _file(name).read_bytes()
    except OSError:
        return None
    check, code = stored[:32], stored[32:]
    return code if hashlib.sha256(code).digest() == check else None


def _kept(name: str, code: bytes) -> bytes:
    """Store object code for the next process, completely or not at all."""
    file = _file(name)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=name, delete=False) as written:
            written.write(hashlib.sha256(code).digest() + code)
        Path(written.name).replace(file)
    return code
