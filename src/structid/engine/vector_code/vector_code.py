"""Straight-line code on vectors of lanes, as text for LLVM.

A number is the same for all lanes (a `double`), or each lane has its own (a vector of them). An operation on numbers that are the
same for all lanes is done once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from structid.engine.vector_code.registers import Number, Register, constant

FLAGS = "contract nsz arcp"
"""What LLVM may do to floating-point operations: fuse products with sums, ignore the sign of zero, multiply by a reciprocal.

Nothing here lets it assume that numbers are finite: a run that diverges must be found.
"""


class VectorCode:
    """Text of one function as it grows."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.lines: list[str] = []
        self.entry: list[str] = []
        self._count = 0
        self._splats: list[dict[str, str]] = [{}]

    # --- names and constants ------------------------------------------------------------------------------------

    def name(self, what: str = "r") -> str:
        """Make up a name."""
        self._count += 1
        return f"%{what}{self._count}"

    def type_of(self, kind: str, lanes: bool) -> str:
        """Type of a number."""
        return f"<{self.width} x {kind}>" if lanes else kind

    def operand(self, number: Number, kind: str, lanes: bool) -> str:
        """Name of a number where an operation of this type takes it."""
        if not isinstance(number, Register):
            written = constant(number, kind)
            return f"splat ({kind} {written})" if lanes else written
        return self._splat(number) if lanes and not number.lanes else number.name

    def _splat(self, number: Register) -> str:
        """Copy a number to every lane, once in each loop."""
        for known in reversed(self._splats):
            if number.name in known:
                return known[number.name]
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
        """Do an operation on numbers of one kind."""
        lanes = any(isinstance(n, Register) and n.lanes for n in numbers)
        taken = ", ".join(self.operand(n, kind, lanes) for n in numbers)
        found = self.name()
        self.lines.append(f"  {found} = {words} {self.type_of(kind, lanes)} {taken}")
        return Register(found, result or kind, lanes)

    def call(self, function: str, numbers: Sequence[Number], kind: str = "double") -> Register:
        """Call an intrinsic function of LLVM, which has a version for every type."""
        lanes = any(isinstance(n, Register) and n.lanes for n in numbers)
        of = self.type_of(kind, lanes)
        taken = ", ".join(f"{of} {self.operand(n, kind, lanes)}" for n in numbers)
        suffix = (f"v{self.width}" if lanes else "") + {"double": "f64", "i64": "i64"}[kind]
        flags = f"{FLAGS} " if kind == "double" else ""
        found = self.name()
        self.lines.append(f"  {found} = call {flags}{of} @llvm.{function}.{suffix}({taken})")
        return Register(found, kind, lanes)

    def select(self, condition: Number, yes: Number, no: Number, kind: str = "double") -> Number:
        """Choose one of two numbers."""
        if not isinstance(condition, Register):
            return yes if condition else no
        lanes = any(isinstance(n, Register) and n.lanes for n in (condition, yes, no))
        of, which = self.type_of(kind, lanes), self.type_of("i1", lanes)
        found = self.name()
        self.lines.append(
            f"  {found} = select {which} {self.operand(condition, 'i1', lanes)}, "
            f"{of} {self.operand(yes, kind, lanes)}, {of} {self.operand(no, kind, lanes)}"
        )
        return Register(found, kind, lanes)

    def cast(self, words: str, number: Register, kind: str) -> Register:
        """Turn a number into one of another kind."""
        found = self.name()
        before, after = self.type_of(number.kind, number.lanes), self.type_of(kind, number.lanes)
        self.lines.append(f"  {found} = {words} {before} {number.name} to {after}")
        return Register(found, kind, number.lanes)

    # --- memory -------------------------------------------------------------------------------------------------

    def whole(self, words: str, a: str | int, b: str | int) -> str:
        """Do arithmetic of whole numbers that all lanes share, such as indices."""
        found = self.name("n")
        self.lines.append(f"  {found} = {words} i64 {a}, {b}")
        return found

    def address(self, base: str, index: str | int, lanes: bool = False) -> str:
        """Address of an element of an array."""
        place = self.name("at")
        self.lines.append(
            f"  {place} = getelementptr inbounds {self.type_of('double', lanes)}, ptr {base}, i64 {index}"
        )
        return place

    def load(self, place: str, lanes: bool, kind: str = "double") -> Register:
        """Read a number."""
        found = self.name()
        self.lines.append(
            f"  {found} = load {self.type_of(kind, lanes)}, ptr {place}, align {8 if kind == 'double' else 1}"
        )
        return Register(found, kind, lanes)

    def load_once(self, base: str, index: int, kind: str = "double") -> Register:
        """Read a number that all lanes share, before anything else is done."""
        place, found = self.name("at"), self.name()
        self.entry += [
            f"  {place} = getelementptr inbounds double, ptr {base}, i64 {index}",
            f"  {found} = load {kind}, ptr {place}, align 8",
        ]
        return Register(found, kind, False)

    def store(self, number: Number, place: str, lanes: bool, kind: str = "double") -> None:
        """Write a number."""
        written, of = self.operand(number, kind, lanes), self.type_of(kind, lanes)
        self.lines.append(f"  store {of} {written}, ptr {place}, align {8 if kind == 'double' else 1}")

    def slot(self, lanes: bool, count: int = 1, kind: str = "double") -> str:
        """Set aside a place for numbers that change from pass to pass of a loop."""
        place = self.name("slot")
        self.entry.append(f"  {place} = alloca [{count} x {self.type_of(kind, lanes)}], align 64")
        return place

    # --- loops --------------------------------------------------------------------------------------------------

    @contextmanager
    def loop(self, length: int | str) -> Iterator[str]:
        """Do what follows for 0, 1, … up to, but not including, `length`."""
        counter = self.name("slot")
        self.entry.append(f"  {counter} = alloca i64, align 8")
        self.lines.append(f"  store i64 0, ptr {counter}")
        with self._numbered(f"load i64, ptr {counter}", str(length)) as at:
            yield at
            following = self.whole("add", at, 1)
            self.lines.append(f"  store i64 {following}, ptr {counter}")

    @contextmanager
    def shared_loop(self, counter: str, end: str) -> Iterator[str]:
        """Do what follows for numbers that several threads take from one counter, each number by one of them."""
        with self._numbered(f"atomicrmw add ptr {counter}, i64 1 seq_cst", end) as at:
            yield at

    @contextmanager
    def loop_while(self) -> Iterator[Callable[[Number], None]]:
        """Do what follows as long as something holds in any lane."""
        with self._passes() as body:
            yield lambda holds: body(self._in_any_lane(holds))

    def _in_any_lane(self, truth: Number) -> str:
        if not (isinstance(truth, Register) and truth.lanes):
            return self.operand(truth, "i1", lanes=False)
        found = self.name("any")
        of = self.type_of("i1", True)
        self.lines.append(f"  {found} = call i1 @llvm.vector.reduce.or.v{self.width}i1({of} {truth.name})")
        return found

    @contextmanager
    def _numbered(self, taken: str, end: str) -> Iterator[str]:
        """Passes as long as their number, which `taken` gets, is less than `end`."""
        with self._passes() as body:
            at, more = self.name("i"), self.name("more")
            self.lines += [f"  {at} = {taken}", f"  {more} = icmp slt i64 {at}, {end}"]
            body(more)
            yield at

    @contextmanager
    def _passes(self) -> Iterator[Callable[[str], None]]:
        """Passes of a loop; what is yielded ends the head, with the name of a truth, and begins the body."""
        head, body, done = (self.name(w)[1:] for w in ("head", "body", "done"))
        self.lines += [f"  br label %{head}", f"{head}:"]
        self._splats.append({})

        def begin(more: str) -> None:
            self.lines.extend((f"  br i1 {more}, label %{body}, label %{done}", f"{body}:"))

        yield begin
        self._splats.pop()
        self.lines += [f"  br label %{head}", f"{done}:"]
