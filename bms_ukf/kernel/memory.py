"""What the kernel needs and Python lacks: raw pointers, vectors on the stack, typed constants, forced inlining.

Every kernel function works on `CPointer(float32)` or `CPointer(float64)` with flat indexing, which is all that a
microcontroller needs too. An ndarray argument would allocate at every call; an integer address does not.

`vector` is a stack allocation made in the function that calls it. Once the callers are inlined and their loops, whose
bounds are then constants, are unrolled, LLVM keeps its elements in registers: such loops cost what hand-unrolled
scalars cost.

With `NUMBA_DISABLE_JIT=1` the same source runs as plain Python, on ctypes pointers and lists.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])

_DISABLE_JIT = bool(getattr(config, "DISABLE_JIT", 0))  # set from the environment: invisible to type checkers

# "contract" allows fused multiply-add only: anything looser would let LLVM drop the checks for NaN and infinity.
# The "numpy" error model makes x/0 infinite; Python's would branch to an exception and stop vectorisation.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}


def inline(function: F) -> F:
    """A kernel function that exists only inside its callers."""
    compiled: F = numba.njit(forceinline=True, **_OPTIONS)(function)
    return compiled


def entry(signature: str) -> Callable[[F], F]:
    """A kernel function that is called from outside; compiled when its module is imported, and cached on disk."""

    def compile_now(function: F) -> F:
        compiled: Any = numba.njit(cache=True, **_OPTIONS)(function)
        if not _DISABLE_JIT:
            # numba stamps a cached function with the size and time of its own file only, and wheels carry a fixed time:
            # without this a new version of an inlined function would never be compiled.
            cache_file = compiled._cache._cache_file
            cache_file._source_stamp = _source_stamp()
            if not cache_file._load_index():
                _announce()
            compiled.compile(signature)
            compiled.disable_compile()
        return compiled  # type: ignore[no-any-return]

    return compile_now


@functools.cache
def _announce() -> None:
    sys.stderr.write("bms-ukf: compiling the filter for this machine, once\n")


@functools.cache
def _source_stamp() -> str:
    sources = [*sorted(Path(__file__).parent.glob("*.py")), Path(__file__).parent.parent / "records.py"]
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


if _DISABLE_JIT:

    def pointer_f64(address: int) -> Any:
        return ctypes.cast(address, ctypes.POINTER(ctypes.c_double))

    def pointer_f32(address: int) -> Any:
        return ctypes.cast(address, ctypes.POINTER(ctypes.c_float))

    def vector(pointer: Any, length: int) -> Any:
        return [math.nan] * length

    def real(pointer: Any, value: float) -> float:
        return float(value)

else:

    def _pointer_from_address(dtype: types.Float, llvm_type: ir.Type) -> Any:
        @intrinsic
        def pointer(typing_context: Any, address: Any) -> Any:
            def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                return builder.inttoptr(arguments[0], llvm_type.as_pointer())

            return types.CPointer(dtype)(types.intp), generate  # type: ignore[no-untyped-call]

        return pointer

    pointer_f64 = _pointer_from_address(types.float64, ir.DoubleType())
    pointer_f32 = _pointer_from_address(types.float32, ir.FloatType())

    @intrinsic(prefer_literal=True)
    def vector(typing_context: Any, pointer: Any, length: Any) -> Any:
        """`length` (a literal) uninitialised numbers of the type `pointer` points to, until the caller returns."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            dtype = context.get_value_type(pointer.dtype)
            with builder.goto_entry_block():  # in a loop it would otherwise grow the stack at every pass
                array = builder.alloca(ir.ArrayType(dtype, length.literal_value))
            return builder.bitcast(array, dtype.as_pointer())

        return pointer(pointer, length), generate

    @intrinsic
    def real(typing_context: Any, pointer: Any, value: Any) -> Any:
        """`value` as the type `pointer` points to: a bare literal would make a float32 kernel compute in double."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return context.cast(builder, arguments[1], value, pointer.dtype)

        return pointer.dtype(pointer, value), generate
