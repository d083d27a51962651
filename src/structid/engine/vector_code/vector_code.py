"""Writer of LLVM code that operates on SIMD vectors.

A number is either equal in all lanes (a `double`) or different in each lane (a vector). An operation on numbers that are equal in
all lanes is computed once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from structid.engine.vector_code.registers import Number, Register, constant

FLAGS = "contract nsz arcp"
"""Allowed transformations of floating-point operations: fused products and sums, unsigned zero, multiplication by a reciprocal.

LLVM must not assume that numbers are finite, since a run that diverges must be detected.
"""


class VectorCode:
    """Builder of the LLVM code of one function."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.lines: list[str] = []
        self.entry: list[str] = []
        self._count = 0
        self._splats: list[dict[str, str]] = [{}]

    # --- names and constants ------------------------------------------------------------------------------------

    def name(self, what: str = "r") -> str:
        """Return a new unique name."""
        self._count += 1
        return f"%{what}{self._count}"

    def type_of(self, kind: str, lanes: bool) -> str:
        """Return the LLVM type of a number."""
        return f"<{self.width} x {kind}>" if lanes else kind

    def operand(self, number: Number, kind: str, lanes: bool) -> str:
        """Return a number as it appears as an operand in LLVM code: a literal or a register name."""
        if not isinstance(number, Register):
            written = constant(number, kind)
            return f"splat ({kind} {written})" if lanes else written
        return self._splat(number) if lanes and not number.lanes else number.name

    def _splat(self, number: Register) -> str:
        """Copy a number to every lane, once per loop."""
        for splats in reversed(self._splats):
            if number.name in splats:
                return splats[number.name]
        vector = self.type_of(number.kind, True)
        first, every = self.name("first"), self.name("every")
        self.lines.append(f"  {first} = insertelement {vector} poison, {number.kind} {number.name}, i64 0")
        self.lines.append(
            f"  {every} = shufflevector {vector} {first}, {vector} poison, <{self.width} x i32> zeroinitializer"
        )
        self._splats[-1][number.name] = every
        return every

    # --- operations ---------------------------------------------------------------------------------------------

    def operation(
        self, words: str, numbers: Sequence[Number], kind: str = "double", result: str | None = None
    ) -> Register:
        """Write an instruction whose operands have the same type."""
        lanes = any(isinstance(n, Register) and n.lanes for n in numbers)
        operands = ", ".join(self.operand(n, kind, lanes) for n in numbers)
        value = self.name()
        self.lines.append(f"  {value} = {words} {self.type_of(kind, lanes)} {operands}")
        return Register(value, result or kind, lanes)

    def call(self, function: str, numbers: Sequence[Number], kind: str = "double") -> Register:
        """Call an LLVM intrinsic in the version for the operands' type."""
        lanes = any(isinstance(n, Register) and n.lanes for n in numbers)
        of = self.type_of(kind, lanes)
        operands = ", ".join(f"{of} {self.operand(n, kind, lanes)}" for n in numbers)
        suffix = (f"v{self.width}" if lanes else "") + {"double": "f64", "i64": "i64"}[kind]
        flags = f"{FLAGS} " if kind == "double" else ""
        result = self.name()
        self.lines.append(f"  {result} = call {flags}{of} @llvm.{function}.{suffix}({operands})")
        return Register(result, kind, lanes)

    def select(self, condition: Number, yes: Number, no: Number, kind: str = "double") -> Number:
        """Select one of two numbers by a condition."""
        if not isinstance(condition, Register):
            return yes if condition else no
        lanes = any(isinstance(n, Register) and n.lanes for n in (condition, yes, no))
        of, which = self.type_of(kind, lanes), self.type_of("i1", lanes)
        result = self.name()
        self.lines.append(
            f"  {result} = select {which} {self.operand(condition, 'i1', lanes)}, "
            f"{of} {self.operand(yes, kind, lanes)}, {of} {self.operand(no, kind, lanes)}"
        )
        return Register(result, kind, lanes)

    def cast(self, words: str, number: Register, kind: str) -> Register:
        """Convert a number to another type."""
        result = self.name()
        before, after = self.type_of(number.kind, number.lanes), self.type_of(kind, number.lanes)
        self.lines.append(f"  {result} = {words} {before} {number.name} to {after}")
        return Register(result, kind, number.lanes)

    # --- memory -------------------------------------------------------------------------------------------------

    def whole(self, words: str, a: str | int, b: str | int) -> str:
        """Write integer arithmetic that is equal for all lanes, such as indices."""
        result = self.name("n")
        self.lines.append(f"  {result} = {words} i64 {a}, {b}")
        return result

    def address(self, base: str, index: str | int, lanes: bool = False) -> str:
        """Return the address of an element of an array."""
        address = self.name("at")
        self.lines.append(
            f"  {address} = getelementptr inbounds {self.type_of('double', lanes)}, ptr {base}, i64 {index}"
        )
        return address

    def load(self, place: str, lanes: bool, kind: str = "double") -> Register:
        """Load a number."""
        result = self.name()
        self.lines.append(
            f"  {result} = load {self.type_of(kind, lanes)}, ptr {place}, align {8 if kind == 'double' else 1}"
        )
        return Register(result, kind, lanes)

    def load_once(self, base: str, index: int, kind: str = "double") -> Register:
        """Load a shared number at the start of the function."""
        address, result = self.name("at"), self.name()
        self.entry += [
            f"  {address} = getelementptr inbounds double, ptr {base}, i64 {index}",
            f"  {result} = load {kind}, ptr {address}, align 8",
        ]
        return Register(result, kind, False)

    def store(self, number: Number, place: str, lanes: bool, kind: str = "double") -> None:
        """Store a number."""
        written, of = self.operand(number, kind, lanes), self.type_of(kind, lanes)
        self.lines.append(f"  store {of} {written}, ptr {place}, align {8 if kind == 'double' else 1}")

    def slot(self, lanes: bool, count: int = 1, kind: str = "double") -> str:
        """Reserve memory for numbers that change in each iteration of a loop."""
        address = self.name("slot")
        self.entry.append(f"  {address} = alloca [{count} x {self.type_of(kind, lanes)}], align 64")
        return address

    # --- loops --------------------------------------------------------------------------------------------------

    @contextmanager
    def loop(self, length: int | str) -> Iterator[str]:
        """Repeat the code in the context for the indices 0, 1, …, `length` − 1."""
        counter = self.name("slot")
        self.entry.append(f"  {counter} = alloca i64, align 8")
        self.lines.append(f"  store i64 0, ptr {counter}")
        with self._numbered(f"load i64, ptr {counter}", str(length)) as at:
            yield at
            following = self.whole("add", at, 1)
            self.lines.append(f"  store i64 {following}, ptr {counter}")

    @contextmanager
    def shared_loop(self, counter: str, end: str) -> Iterator[str]:
        """Repeat the code in the context for the indices that this thread takes from a shared counter."""
        with self._numbered(f"atomicrmw add ptr {counter}, i64 1 seq_cst", end) as at:
            yield at

    @contextmanager
    def loop_while(self) -> Iterator[Callable[[Number], None]]:
        """Repeat the code in the context while a condition holds in any lane."""
        with self._passes() as body:
            yield lambda holds: body(self._in_any_lane(holds))

    def _in_any_lane(self, truth: Number) -> str:
        if not (isinstance(truth, Register) and truth.lanes):
            return self.operand(truth, "i1", lanes=False)
        result = self.name("any")
        of = self.type_of("i1", True)
        self.lines.append(f"  {result} = call i1 @llvm.vector.reduce.or.v{self.width}i1({of} {truth.name})")
        return result

    @contextmanager
    def _numbered(self, taken: str, end: str) -> Iterator[str]:
        """Write a loop that continues while its index is below `end`; the instruction `taken` reads the index."""
        with self._passes() as body:
            at, more = self.name("i"), self.name("more")
            self.lines += [f"  {at} = {taken}", f"  {more} = icmp slt i64 {at}, {end}"]
            body(more)
            yield at

    @contextmanager
    def _passes(self) -> Iterator[Callable[[str], None]]:
        """Write a loop. The yielded function takes the name of the loop condition and writes the branch to the body."""
        head, body, done = (self.name(w)[1:] for w in ("head", "body", "done"))
        self.lines += [f"  br label %{head}", f"{head}:"]
        self._splats.append({})

        def begin(more: str) -> None:
            self.lines.extend((f"  br i1 {more}, label %{body}, label %{done}", f"{body}:"))

        yield begin
        self._splats.pop()
        self.lines += [f"  br label %{head}", f"{done}:"]
