"""The open-circuit voltage in a BPX file, the exchange format of physics-based (DFN, SPM) parameter sets.

A BPX file holds electrodes, not a circuit, and no resistances of one. Its OCV, with the electrodes' open-circuit
potentials U and stoichiometry limits, is U_p(p_max - soc (p_max - p_min)) - U_n(n_min + soc (n_max - n_min)).
"""

from __future__ import annotations

import ast
import json
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf import plausible
from bms_ukf.errors import ConfigError

Array = NDArray[np.float64]

SOC = np.linspace(0, 1, 201)
# The ends of the stoichiometry of an empty and of a full cell.
ELECTRODES = {"Negative electrode": ("Minimum", "Maximum"), "Positive electrode": ("Maximum", "Minimum")}
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(np, name) for name in ("exp", "log", "sqrt", "tanh", "sinh", "cosh", "sin", "cos", "arctan", "abs")
}


def open_circuit(path: Path) -> tuple[Array, Array]:
    """SoC (0..1, rising) and open-circuit voltage, V, at the file's reference temperature.

    Raises ConfigError for a file that is no BPX, or whose electrodes have more than one open-circuit potential.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(path, expected=f"a readable BPX file ({error})") from None
    holds = _section(found, "Parameterisation")
    potentials = []
    for electrode, (empty, full) in ELECTRODES.items():
        values = _section(holds, electrode)
        limits = [_stoichiometry(path, electrode, values, f"{end} stoichiometry") for end in (empty, full)]
        potential = _value(path, electrode, values, "OCP [V]")
        potentials.append(_function(path, f"{electrode}.OCP [V]", potential, limits[0] + SOC * (limits[1] - limits[0])))
    voltage_V = potentials[1] - potentials[0]
    if not voltage_V[-1] > voltage_V[0] > 0:
        seen = f"{voltage_V[0]:.3g} to {voltage_V[-1]:.3g} V"
        raise ConfigError(path, key="OCP [V]", value=seen, expected="potentials that make a voltage rising with SoC")
    middle_V = float(np.median(voltage_V))
    doubt = plausible.VOLTAGE_V.doubt(middle_V)
    if doubt:
        raise ConfigError(path, key="OCP [V]", value=f"{middle_V:.4g} V between the electrodes", expected=doubt)
    return SOC, voltage_V


def _section(found: Any, key: str) -> dict[str, Any]:
    """Return the object of that name; empty if the file has no such object."""
    section = found.get(key) if isinstance(found, dict) else None
    return section if isinstance(section, dict) else {}


def _value(path: Path, electrode: str, values: dict[str, Any], key: str) -> Any:
    if key not in values:
        many = " (each material of a blend has its own: no single OCV)" if "Particle" in values else ""
        raise ConfigError(path, key=f"Parameterisation.{electrode}", expected=f"a BPX file with {key!r} there{many}")
    return values[key]


def _stoichiometry(path: Path, electrode: str, values: dict[str, Any], key: str) -> float:
    value = _value(path, electrode, values, key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise ConfigError(path, key=f"{electrode}.{key}", value=value, expected="a number from 0 to 1")
    return float(value)


def _function(path: Path, key: str, value: Any, x: Array) -> Array:
    """An open-circuit potential at x: a table {x, y}, or an expression of x."""
    if isinstance(value, int | float):
        expected = "a table or an expression of x; a constant stands for a potential defined elsewhere"
        raise ConfigError(path, key=key, value=value, expected=expected)
    try:
        with np.errstate(all="ignore"):
            found = _table(value, x) if isinstance(value, dict) else _expression(value, x)
    except (
        SyntaxError,
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        ArithmeticError,
        RecursionError,
        MemoryError,
    ) as error:
        expected = f"an expression of x, or a table of x and y ({str(error)[:80]})"
        raise ConfigError(path, key=key, value=value, expected=expected) from None
    if found.shape != x.shape or not np.isfinite(found).all():
        expected = f"a finite potential at every x from {x.min():g} to {x.max():g}"
        raise ConfigError(path, key=key, value=value, expected=expected)
    return found


def _table(value: dict[str, Any], x: Array) -> Array:
    knots, potential_V = (np.asarray(value[name], dtype=np.float64) for name in "xy")
    if knots.ndim != 1 or knots.shape != potential_V.shape or np.unique(knots).size < max(2, knots.size):
        raise ValueError("x and y as lists of numbers, as many of each, x all different")
    order = np.argsort(knots)
    return np.asarray(np.interp(x, knots[order], potential_V[order]))


def _expression(value: Any, x: Array) -> Array:
    if not isinstance(value, str):
        raise TypeError("a text")
    return np.asarray(_evaluate(ast.parse(value.strip(), mode="eval").body, x), dtype=np.float64) + 0 * x


def _evaluate(node: ast.expr, x: Array) -> Any:
    """Arithmetic and a few functions, and nothing else: a parameter file is data, not code."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id="x"):
            return x
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_evaluate(operand, x))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_evaluate(left, x), _evaluate(right, x))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _FUNCTIONS:
            return _FUNCTIONS[name](_evaluate(argument, x))
    raise ValueError(f"{ast.unparse(node)[:40]!r} is not allowed")
