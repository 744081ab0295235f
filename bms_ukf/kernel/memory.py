"""What the kernel needs and Python lacks: raw pointers, vectors on the stack, typed constants, short whole numbers.

Every kernel function works on `CPointer(float32)` or `CPointer(float64)` with flat indexing, which is all that a
microcontroller needs too. An ndarray argument would allocate at every call; an integer address does not.

`vector` is a stack allocation made in the function that calls it. Once the callers are inlined and their loops, whose
bounds are then constants, are unrolled, LLVM keeps its elements in registers.

Un-jitted, the same source runs on ctypes pointers and lists.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from bms_ukf.kernel.jit import DISABLED

CACHE_LINE = 64  # bytes
OF_A_BLOCK = 256  # numbers: what one cell needs is less

if DISABLED:

    def pointer(address: int, bits: int) -> Any:
        return ctypes.cast(address, ctypes.POINTER(ctypes.c_double if bits == 64 else ctypes.c_float))

    def vector(pointer: Any, length: int) -> Any:
        return [math.nan] * length

    def real(pointer: Any, value: float) -> float:
        return float(value)

    def floor(value: float) -> float:
        return float(math.floor(value)) if math.isfinite(value) else value

    def whole(value: float) -> int:
        return int(value)

    def words(pointer: Any) -> Any:
        return ctypes.cast(pointer, ctypes.POINTER(ctypes.c_int32))

    class _Beyond:
        def __init__(self, pointer: Any, count: int) -> None:
            self._pointer, self._count = pointer, count

        def __getitem__(self, place: int) -> Any:
            return self._pointer[self._count + place]

        def __setitem__(self, place: int, value: Any) -> None:
            self._pointer[self._count + place] = value

    def beyond(pointer: Any, count: int) -> Any:
        return _Beyond(pointer, count)

else:
    _TYPES = {32: (types.float32, ir.FloatType()), 64: (types.float64, ir.DoubleType())}

    @intrinsic(prefer_literal=True)
    def pointer(typing_context: Any, address: Any, bits: Any) -> Any:
        """An address as a pointer to numbers of 32 or 64 bits (a literal)."""
        dtype, llvm_type = _TYPES[bits.literal_value]

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], llvm_type.as_pointer())

        numbers: Any = types.CPointer
        return numbers(dtype)(types.intp, bits), generate

    @intrinsic(prefer_literal=True)
    def vector(typing_context: Any, pointer: Any, length: Any) -> Any:
        """`length` (a literal) uninitialised numbers of the type `pointer` points to, until the caller returns."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            dtype = context.get_value_type(pointer.dtype)
            with builder.goto_entry_block():  # in a loop it would otherwise grow the stack at every pass
                array = builder.alloca(ir.ArrayType(dtype, length.literal_value))
            if length.literal_value >= OF_A_BLOCK:
                array.align = CACHE_LINE  # a machine vector that lies on two lines takes twice as long
            return builder.bitcast(array, dtype.as_pointer())

        return pointer(pointer, length), generate

    @intrinsic
    def real(typing_context: Any, pointer: Any, value: Any) -> Any:
        """`value` as the type `pointer` points to: a bare literal would make a float32 kernel compute in double.

        A whole number must fit 32 bits; of 64, a microcontroller would call its compiler's library.
        """

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            number, of = arguments[1], value
            if isinstance(value, types.Integer):
                number, of = context.cast(builder, number, value, types.int32), types.int32
            return context.cast(builder, number, of, pointer.dtype)

        return pointer.dtype(pointer, value), generate

    @intrinsic
    def floor(typing_context: Any, value: Any) -> Any:
        """The largest whole number not above `value`, as a real: math.floor's integer would stop vectorisation."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            function = builder.module.declare_intrinsic("llvm.floor", [arguments[0].type])
            return builder.call(function, arguments)

        return value(value), generate

    @intrinsic
    def whole(typing_context: Any, value: Any) -> Any:
        """A real as a whole number of 32 bits, which microcontrollers and vector units have an instruction for."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            number = builder.fptosi(arguments[0], ir.IntType(32))
            return builder.sext(number, ir.IntType(64))

        return types.int64(value), generate

    @intrinsic
    def beyond(typing_context: Any, pointer: Any, count: Any) -> Any:
        """The same memory, from number `count` on."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.gep(arguments[0], [arguments[1]])

        return pointer(pointer, count), generate

    @intrinsic
    def words(typing_context: Any, pointer: Any) -> Any:
        """The same memory as whole numbers of 32 bits."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.bitcast(arguments[0], ir.IntType(32).as_pointer())

        numbers: Any = types.CPointer
        return numbers(types.int32)(pointer), generate
