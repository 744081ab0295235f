"""From the kernel's Python to an object file: numba's LLVM module for any machine, optimised and written for one.

What comes out computes the same, bit for bit, on every machine with IEEE arithmetic: operations are not fused, although
the kernel allows it, because each processor's compiler would fuse others; and the kernel calls nothing that rounds its
own way (square roots and whole parts are exact).
"""

from __future__ import annotations

import functools
import re
import struct
from typing import Any, NamedTuple

from llvmlite import binding as llvm
from numpy.typing import NDArray

from bms_ukf.firmware.targets import Target
from bms_ukf.kernel.embedded import c_functions
from bms_ukf.kernel.jit import portable
from bms_ukf.kernel.layout import Form

# No call that is not in the source, as a loop that copies becomes one of memcpy.
NO_LIBRARY = '"no-builtins"'

# numba's functions return a status, and take where the result goes and where an exception goes before their arguments.
# None of it is left once they are inlined.
C_FUNCTIONS = """
@bms_ukf_params = internal constant [{count} x {real}] [{numbers}], align 8
declare i32 @{init}(ptr, ptr, ptr, i32)
declare i32 @{step}(ptr, ptr, ptr, ptr, i32, {real}, ptr, ptr, i32, i32)
declare i32 @{get}(ptr, ptr, ptr, i32, i32, i32)
define void @bms_ukf_init(ptr %state) {attributes} section ".text.bms_ukf_init" {{
  %result = alloca ptr
  %exception = alloca ptr
  call i32 @{init}(ptr %result, ptr %exception, ptr %state, i32 {cells})
  ret void
}}
define i32 @bms_ukf_step(ptr noalias %state, ptr noalias %work, i32 %time_ms, {real} %current_A, ptr %voltage_V,
                         ptr %temperature_degC, i32 %contactor_open) {attributes} section ".text.bms_ukf_step" {{
  %result = alloca i32
  %exception = alloca ptr
  call i32 @{step}(ptr %result, ptr %exception, ptr @bms_ukf_params, ptr %state, i32 %time_ms, {real} %current_A,
                   ptr %voltage_V, ptr %temperature_degC, i32 %contactor_open, i32 {cells})
  %code = load i32, ptr %result
  ret i32 %code
}}
define {real} @bms_ukf_get(ptr %state, i32 %what, i32 %cell) {attributes} section ".text.bms_ukf_get" {{
  %result = alloca {real}
  %exception = alloca ptr
  call i32 @{get}(ptr %result, ptr %exception, ptr %state, i32 %what, i32 %cell, i32 {cells})
  %value = load {real}, ptr %result
  ret {real} %value
}}
"""


class Compiled(NamedTuple):
    """An object file, how it came about, and the numbers of workspace its `bms_ukf_step` asks of the caller."""

    object: bytes
    assembly: str
    llvm: str
    work: int


def compiled(form: Form, cells: int, params: NDArray[Any], target: Target) -> Compiled:
    """The estimator of `cells` cells, in the type of `params`, which become constants."""
    bits = 8 * params.itemsize
    machine = target.machine()
    module = _optimised(_linked(form, cells, params, bits, target, machine), machine)
    text, work = _with_workspace(str(module), bits)
    # Writing code changes a module: the assembly of one that has been written is not that of its object.
    return Compiled(machine.emit_object(_small(text)), machine.emit_assembly(_small(text)), text, work)


def _small(text: str) -> llvm.ModuleRef:
    """A module that was optimised for speed, which unrolled its loops over states, to be written for size."""
    module = llvm.parse_assembly(text)
    for function in module.functions:
        if not function.is_declaration:
            function.add_function_attribute("optsize")
            function.add_function_attribute("minsize")
    module.verify()
    return module


def _linked(
    form: Form, cells: int, params: NDArray[Any], bits: int, target: Target, machine: llvm.TargetMachine
) -> llvm.ModuleRef:
    """Everything in one module, with only the C functions to be seen from outside."""
    head = f'target triple = "{target.triple}"\ntarget datalayout = "{machine.target_data}"\n'
    parts = _parts(form, bits)
    names = {name: symbol for name, (_, symbol) in parts.items()}
    real = "double" if bits == 64 else "float"
    numbers = ", ".join(f"{real} {_hexadecimal(float(number))}" for number in params)
    places = {"cells": cells, "attributes": NO_LIBRARY, "real": real, "count": params.size, "numbers": numbers}
    linked = llvm.parse_assembly(head + C_FUNCTIONS.format(**places, **names))
    for text, _ in parts.values():
        linked.link_in(llvm.parse_assembly(head + text))
    for function in linked.functions:
        if not function.is_declaration:
            if not function.name.startswith("bms_ukf_"):
                function.linkage = "internal"
                function.add_function_attribute("alwaysinline")
            function.add_function_attribute("nounwind")
    for variable in linked.global_variables:
        variable.linkage = "internal"  # numba's environments, which nothing refers to any more, vanish
    linked.verify()
    return linked


@functools.cache
def _parts(form: Form, bits: int) -> dict[str, tuple[str, str]]:
    """The LLVM module of every C function, and its name in there; half a minute of numba's time."""
    made = {}
    for name, (function, returns, arguments) in c_functions(form, bits).items():
        text, symbol = portable(function, returns, arguments)
        made[name] = _neutral(text), symbol
    return made


def _neutral(text: str) -> str:
    """A module without what is this machine's own, or would make a compiler fuse operations or call a library."""
    text = re.sub(r"^target (datalayout|triple) .*\n", "", text, flags=re.MULTILINE)
    # A large vector is aligned to a cache line; the caller's workspace, which it becomes, to a number only.
    text = re.sub(r"(= alloca .*), align 64$", r"\1", text, flags=re.MULTILINE)
    text = re.sub(r"^(define .*) \{$", rf"\1 {NO_LIBRARY} {{", text, flags=re.MULTILINE)
    text = re.sub(r"^declare .* @sqrtf?\(.*\n", "", text, flags=re.MULTILINE)
    square_roots = "declare float @llvm.sqrt.f32(float)\ndeclare double @llvm.sqrt.f64(double)\n"
    text = text.replace("@sqrtf(", "@llvm.sqrt.f32(").replace("@sqrt(", "@llvm.sqrt.f64(")
    return text.replace(" contract ", " ") + square_roots


def _optimised(module: llvm.ModuleRef, machine: llvm.TargetMachine) -> llvm.ModuleRef:
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_vectorization = options.slp_vectorization = options.loop_interleaving = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return module


def _with_workspace(text: str, bits: int) -> tuple[str, int]:
    """The optimised module with the arrays it still has on the stack in the caller's workspace; how many numbers."""
    used = 0

    def place(found: re.Match[str]) -> str:
        nonlocal used
        used, start = used + int(found[2]), used
        return f"{found[1]} = getelementptr inbounds i8, ptr %work, i32 {start * bits // 8}"

    text = re.sub(r"^ +(?:tail )?call void @llvm\.lifetime\..*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"(%[\w.]+) = alloca \[(\d+) x (?:float|double)\], align \d+", place, text)
    return text, max(used, 1)


def _hexadecimal(number: float) -> str:
    """As LLVM reads a float or a double exactly."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}"
