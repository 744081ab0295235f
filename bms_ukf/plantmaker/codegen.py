"""cell.c and cell.h: a PyBaMM model of one cell, exported through CasADi."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import casadi

from bms_ukf.plantmaker import hysteresis
from bms_ukf.plantmaker.models import COUNTERS, INPUTS, Cell

# Where CasADi copies a result if it is asked for, GCC follows the one that is not. Clang lacks the second option.
FALSE_ALARMS = """#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Warray-bounds"
#pragma GCC diagnostic ignored "-Wstringop-overflow"
#endif
"""
ANSWERS = 3  # voltage, temperature and SoC, before the guards


class Functions(NamedTuple):
    """CasADi functions of the state x and the inputs u (current in A, ambient temperature in K, SoC at the start)."""

    initial: Any  # u -> x
    rhs: Any  # x, u -> dx/dt
    outputs: Any  # x, u -> voltage (V), temperature (degC), SoC, guards
    radius: Any  # x, u -> bound on the spectral radius of d(rhs)/dx, 1/s


def functions(cell: Cell) -> Functions:
    model = cell.simulation.built_model
    unused = [model.y_slices[v][0] for v in model.y_slices if v.name in COUNTERS]
    first = max((piece.stop for piece in unused), default=0)
    parts = model.export_casadi_objects(cell.outputs, INPUTS)
    n_x = parts["x"].shape[0] - first

    everything = [parts["t"], parts["x"], parts["z"], parts["inputs"]]
    of_rhs: Any = casadi.Function("rhs", everything, [parts["rhs"]])
    of_outputs: Any = casadi.Function("outputs", everything, [casadi.vertcat(*parts["variables"].values())])
    of_initial: Any = casadi.Function("initial", [parts["inputs"]], [parts["x0"]])
    # Scalar expressions make the fastest code; only a model with tables (interpolants) cannot be written in them.
    symbol: Any = casadi.SX if _expands(of_rhs) and _expands(of_outputs) else casadi.MX
    n_h = len(hysteresis.DEPTHS) if cell.hysteresis_V else 0
    x, u = symbol.sym("x", n_h + n_x), symbol.sym("u", len(INPUTS))
    h, of_model = x[:n_h], x[n_h:]
    at: list[Any] = [0, casadi.vertcat(symbol.zeros(first), of_model), symbol.zeros(0), u]
    rhs, outputs = of_rhs(*at)[first:], of_outputs(*at)
    voltage_V, initial = outputs[0], of_initial(u)[first:]
    if n_h:
        rhs = casadi.vertcat(hysteresis.rates(h, u[0], cell.capacity_Ah), rhs)
        voltage_V += hysteresis.voltage_V(h, cell.hysteresis_V)
        initial = casadi.vertcat(symbol.zeros(n_h), initial)
    empty, full = cell.soc
    answers = casadi.vertcat(voltage_V, outputs[1], (outputs[2] - empty) / (full - empty))
    # The largest row sum of |Jacobian| bounds its spectral radius (Gershgorin), and is close to it for diffusion. A
    # temperature is the last state, slower by far, and drives no other strongly: its row would only cost time.
    fast = rhs[:-1] if cell.thermal == "lumped" else rhs
    radius = casadi.mmax(casadi.sum2(casadi.fabs(casadi.jacobian(fast, x))))
    return Functions(
        _function("cell_initial", [u], initial),
        _function("cell_rhs", [x, u], rhs),
        _function("cell_outputs", [x, u], casadi.vertcat(answers, cell.guards(of_model, outputs))),
        _function("cell_radius", [x, u], radius),
    )


def _expands(function: Any) -> bool:
    try:
        function.expand()
    except RuntimeError:
        return False
    return True


def _function(name: str, arguments: list[Any], result: Any) -> Any:
    return casadi.Function(name, arguments, [casadi.densify(result)], {"cse": True})


def write(cell: Cell, folder: Path) -> None:
    """Writes cell.c and cell.h into `folder`."""
    made = functions(cell)
    code = casadi.CodeGenerator("cell.c", {"casadi_int": "int"})
    for function in made:
        code.add(function)
    versions = f"PyBaMM {metadata.version('pybamm')}, CasADi {metadata.version('casadi')}"
    says = f"/* {cell.model}, parameter set {cell.parameter_set}, generated with {versions}: do not edit. */\n"
    pragmas = '#pragma GCC diagnostic ignored "-Wunused-parameter"\n'
    if not all(function.is_a("SXFunction") for function in made):
        pragmas += FALSE_ALARMS
    # glibc 2.35 gave hypot a new symbol version, so that older systems would refuse it; nothing here overflows.
    own_hypot = "#include <math.h>\n#define hypot(x, y) sqrt((x) * (x) + (y) * (y))\n"
    (folder / "cell.c").write_text(says + pragmas + own_hypot + code.dump())
    # Scratch memory: at least one element, as C has no empty arrays.
    sizes = {kind: max(1, *(getattr(f, f"sz_{kind}")() for f in made)) for kind in ("arg", "res", "iw", "w")}
    declare = "(const double **arg, double **res, int *iw, double *w, int mem);"
    (folder / "cell.h").write_text(
        says + "#ifndef CELL_H\n#define CELL_H\n\n"
        f"#define CELL_N_X {made.rhs.size1_out(0)}\n\n"
        "/* Inputs u: current (A, positive = discharge), ambient temperature (K), SoC at the start.\n"
        "   Outputs: voltage (V), temperature (degC), SoC, then what has to stay above 0. */\n"
        f"#define CELL_N_U {len(INPUTS)}\n#define CELL_N_ANSWERS {ANSWERS}\n"
        f"#define CELL_N_OUTPUTS {made.outputs.size1_out(0)}\n"
        f'#define CELL_RANGE "{cell.out_of_range}"\n\n'
        + "".join(f"#define CELL_SZ_{kind.upper()} {size}\n" for kind, size in sizes.items())
        + f"\nint cell_initial{declare} /* u -> x */\n"
        f"int cell_rhs{declare}     /* x, u -> dx/dt */\n"
        f"int cell_outputs{declare} /* x, u -> outputs */\n"
        f"int cell_radius{declare}  /* x, u -> bound on the spectral radius of d(rhs)/dx, 1/s */\n\n#endif\n"
    )
