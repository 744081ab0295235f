"""How the kernel becomes machine code: functions that are inlined, and entries that Python calls.

numba optimises every function on its own before it is inlined, when loop bounds are still arguments: loops over a few
states get run-time checks that no later pass removes, and nothing is vectorised. Here a function to be inlined is only
tidied, and all else is left to the entry, where its bounds are constants: loops over states vanish, their vectors
become registers, and loops over lanes become vector instructions (`tests/test_kernel_code.py` looks). It also spares
most of the compile time; of what is left most is numba's own Python, which is therefore asked nothing twice.

With `NUMBA_DISABLE_JIT=1` the same source runs as plain Python.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import sys
from collections.abc import Callable, Container, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import config
from numba.core import compiler, event, typed_passes, types, untyped_passes
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.registry import cpu_target
from numba.core.typed_passes import NativeLowering
from numba.core.types.functions import BaseFunction

F = TypeVar("F", bound=Callable[..., Any])

_register_pass: Any = register_pass
_compiler: Any = compiler
_target: Any = cpu_target
_CONFIG: Any = config  # its names are set from the environment: invisible to type checkers
DISABLED = bool(getattr(config, "DISABLE_JIT", 0))

# "contract" allows fused multiply-add only: anything looser would let LLVM drop the checks for NaN and infinity.
# The "numpy" error model makes x/0 infinite; Python's would branch to an exception and stop vectorisation.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}


@_register_pass(mutates_CFG=True, analysis_only=False)
class _Tidy(NativeLowering):
    """Lowers a function to be inlined: no optimiser, no machine code, no wrapper; loops in the form LLVM expects."""

    _name = "bms_ukf_tidy"

    def run_pass(self, state: Any) -> bool:
        state.flags.no_compile = state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = True
        level, _CONFIG.OPT = _CONFIG.OPT, type(_CONFIG.OPT)(0)
        try:
            lower: Any = super().run_pass
            changed = bool(lower(state))
            _link(state.library)
            passes, builder = state.targetctx.codegen()._module_pass_manager()
        finally:
            _CONFIG.OPT = level
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.add_instruction_combine_pass()
        passes.add_jump_threading_pass()
        passes.add_simplify_cfg_pass()
        passes.add_loop_rotate_pass()
        passes.add_instruction_combine_pass()
        passes.add_simplify_cfg_pass()
        passes.run(state.library._final_module, builder)
        # The name that callers' code finds it under; any built-in function that no other function has will do.
        name: Any = object().__reduce__
        state.cr = state.cr._replace(cfunc=name)
        state.targetctx.insert_user_function(name, state.cr.fndesc, [state.library])
        return changed


def _link(library: Any) -> None:
    """`library.finalize()` without machine code: its modules are only for inlining."""
    for used in dict.fromkeys(library._linking_libraries):
        library._final_module.link_in(used._get_module_for_linking(), preserve=True)
    library._optimize_final_module()
    library._final_module.verify()
    library._finalize_dynamic_globals()
    library._finalized = True


# For what kernel functions have not: closures, `with`, exceptions, overloads. LLVM finds constant branches. After each
# of these numba would look at all of a function again.
_NEEDLESS: set[Any] = {
    untyped_passes.WithLifting,
    untyped_passes.InlineClosureLikes,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables,
    untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass,
    typed_passes.InlineOverloads,
    typed_passes.NopythonRewrites,
    typed_passes.NoPythonSupportedFeatureValidation,
    typed_passes.AnnotateTypes,
    typed_passes.DumpParforDiagnostics,
}


def _pipelines(state: Any, lowering: Any, needless: Container[Any] = ()) -> list[Any]:
    """numba's own, with another lowering and without some passes."""
    builder: Any = DefaultPassBuilder
    passes = builder.define_nopython_pipeline(state)
    steps = [(step, why) for step, why in passes.passes if step not in needless]
    passes.passes = [(lowering if step is NativeLowering else step, why) for step, why in steps]
    passes.finalize()
    return [passes]


class _Inlined(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        return _pipelines(self.state, _Tidy, _NEEDLESS)


class _WholeVectors(Lower):
    """LLVM uses half of a 512-bit register, as early processors of that kind slow down for whole ones.

    Those with avx512_vbmi2, from Ice Lake and Zen 4 on, hardly do.
    """

    def setup_function(self, fndesc: Any) -> None:
        lower: Any = super()
        lower.setup_function(fndesc)
        if "+avx512vbmi2" in self.library.codegen.magic_tuple()[-1]:
            set.add(self.function.attributes, '"prefer-vector-width"="512"')  # llvmlite knows only some names


@_register_pass(mutates_CFG=True, analysis_only=False)
class _ForLanes(NativeLowering):
    """Lowers an entry, whose loops over lanes become vector instructions."""

    _name = "bms_ukf_for_lanes"

    @property
    def lowering_class(self) -> Any:
        return _WholeVectors


class _Entry(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        return _pipelines(self.state, _ForLanes)


@contextlib.contextmanager
def _operators_remembered() -> Iterator[None]:
    """What an operator makes of two numbers is asked thousands of times, and found among dozens of array operations."""
    found: dict[Any, Any] = {}
    function_type: Any = BaseFunction
    look_up = function_type.get_call_type

    def remembered(self: Any, context: Any, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        plain = all(isinstance(argument, types.Number | types.Boolean | types.Literal) for argument in arguments)
        if named or not plain or not isinstance(self, types.Function):
            return look_up(self, context, arguments, named)
        key = self, context, arguments
        if key not in found:
            found[key] = look_up(self, context, arguments, named)
        return found[key]

    function_type.get_call_type = remembered
    try:
        yield
    finally:
        function_type.get_call_type = look_up


def inline(function: F) -> F:
    """A kernel function that exists only inside its callers."""
    compiled: F = numba.njit(forceinline=True, pipeline_class=_Inlined, **OPTIONS)(function)
    return compiled


def entry(function: Callable[..., Any], signature: str) -> Callable[..., Any]:
    """Compile a kernel function that is called from outside; cached on disk. Its closure may hold integers only.

    What it returns is numba's wrapper of the compiled code itself, without the dispatcher's look-up of argument types:
    half the cost of a call. It converts any number to the type of the signature.
    """
    compiled: Any = numba.njit(cache=True, pipeline_class=_Entry, **OPTIONS)(function)
    if DISABLED:
        return function
    # numba stamps a cached function with the size and time of its own file only, and wheels carry a fixed time: without
    # this a new version of an inlined function would never be compiled.
    compiled._cache._cache_file._source_stamp = source_stamp()
    with event.install_listener("numba:compile", _Announcement()), _operators_remembered():
        call: Callable[..., Any] = compiled.compile(signature)
    DISPATCHERS.append(compiled)
    return call


def portable(function: Callable[..., Any], returns: Any, arguments: tuple[Any, ...]) -> tuple[str, str]:
    """A kernel function for any machine, from numba's types of what it takes and returns: its LLVM module, its name.

    All it calls is in the module; nothing is optimised for this machine or for its vectors, and no object of numba's
    run time is needed. Its C arguments come after two pointers: where the result goes, and numba's exception.
    """
    flags = _compiler.Flags()
    flags.nrt = flags.enable_pyobject = False
    flags.error_model = OPTIONS["error_model"]
    _target.target_context.refresh()
    typing, context = _target.typing_context, _target.target_context
    with _operators_remembered():
        result = _compiler.compile_extra(typing, context, function, arguments, returns, flags, {}, None, _Inlined)
    return str(result.library._final_module), result.fndesc.llvm_func_name


DISPATCHERS: list[Any] = []  # a dispatcher owns the machine code that its wrapper jumps to


class _Announcement(event.Listener):
    """Compiling takes seconds; loading from the cache, which comes without this event, milliseconds."""

    def on_start(self, event: Any) -> None:
        _announce()

    def on_end(self, event: Any) -> None:
        pass


@functools.cache
def _announce() -> None:
    sys.stderr.write("bms-ukf: compiling the filter for this machine, once\n")


@functools.cache
def source_stamp() -> str:
    """Of all that is compiled."""
    sources = [*sorted(Path(__file__).parent.glob("*.py")), Path(__file__).parent.parent / "records.py"]
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
