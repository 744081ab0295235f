"""PyBaMM's models as functions of state and inputs: what the C code is generated from, and what it is compared with."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import casadi
import pybamm

from bms_ukf.errors import ConfigError

PARTICLE_STRETCH = 3.0
INPUTS = ["Current function [A]", "Ambient temperature [K]", "soc_initial"]
SOC_MARGIN = 1e-6  # lets a Thevenin start full or empty
# Charge counters that nothing in the models depends on.
COUNTERS = ["Discharge capacity [A.h]", "Throughput capacity [A.h]"]


@dataclass(frozen=True)
class Cell:
    """A model with its parameters, discretised.

    `outputs` names voltage, temperature (degC) and charge in PyBaMM, then what has to stay above 0 within the model's
    range, told by `out_of_range`. `soc` turns the third into the project's SoC: linear, from 0 to 1.
    """

    model: str
    parameter_set: str
    thermal: str
    simulation: Any
    outputs: list[str]
    soc: tuple[float, float]
    capacity_Ah: float  # between the voltage limits, at rest
    nominal_Ah: float
    voltage_limits_V: tuple[float, float]
    out_of_range: str
    guards: Callable[[Any, Any], Any]  # of the state and the outputs: what has to stay above 0
    hysteresis_V: float = 0.0  # half of the gap between the charge and the discharge branch, see `hysteresis.py`


def points(electrode: int, separator: int, particle: int) -> dict[str, int]:
    """A mesh, as pybamm.Simulation takes it by the name of `var_pts`."""
    return {"x_n": electrode, "x_s": separator, "x_p": electrode, "r_n": particle, "r_p": particle}


FINE = points(10, 4, 20)


def load(model: str, parameter_set: str, thermal: str = "lumped", **options: Any) -> Cell:
    """A model of `MODELS` with a parameter set of PyBaMM's, by name; `options` go to pybamm.Simulation.

    Current, ambient temperature and initial SoC are inputs (`INPUTS`); the cell starts at the ambient temperature, at
    rest. Raises ConfigError for a name that PyBaMM does not have, and for a set that lacks what the model needs.
    """
    if model not in MODELS:
        raise ConfigError("plantmaker", key="--model", value=model, expected=f"one of {', '.join(MODELS)}")
    if parameter_set not in pybamm.parameter_sets:
        near = difflib.get_close_matches(parameter_set, list(pybamm.parameter_sets), n=3, cutoff=0.3)
        known = near or sorted(pybamm.parameter_sets)
        expected = f"a parameter set of PyBaMM, such as {', '.join(known)}"
        raise ConfigError("plantmaker", key="--parameters", value=parameter_set, expected=expected)
    try:
        cell = MODELS[model](model, pybamm.ParameterValues(parameter_set), parameter_set, thermal, options)
        cell.simulation.build()
    except KeyError as error:
        raise _lacking(model, parameter_set, thermal, str(error.args[0])) from None
    except (pybamm.ModelError, pybamm.OptionError, ValueError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        expected = f"a parameter set for a {model} model ({reason})"
        raise ConfigError("plantmaker", key="--parameters", value=parameter_set, expected=expected) from None
    if cell.simulation.built_model.len_alg:
        expected = f"one with which the {model} has differential equations only"
        raise ConfigError("plantmaker", key="--parameters", value=parameter_set, expected=expected)
    return cell


def _lacking(model: str, parameter_set: str, thermal: str, message: str) -> ConfigError:
    """PyBaMM's message begins with the name that is not there."""
    name = message.split("'")[1] if message.count("'") > 1 else message
    expected = f"one with {name!r}, which the {thermal} {model} needs"
    with suppress(ConfigError):
        if thermal == "lumped" and MODELS[model] is _particle:
            load(model, parameter_set, "isothermal")
            expected += "; it has what --thermal isothermal needs"
    return ConfigError("plantmaker", key="--parameters", value=parameter_set, expected=expected)


def _particle(model: str, values: Any, parameter_set: str, thermal: str, options: dict[str, Any]) -> Cell:
    """SPM and SPMe: SoC is linear in the mean stoichiometry of the negative electrode, between the voltage limits."""
    x_0, x_100, y_100, y_0 = pybamm.lithium_ion.ElectrodeSOHSolver(values).get_min_max_stoichiometries()
    soc = pybamm.InputParameter("soc_initial")
    full_n = values["Maximum concentration in negative electrode [mol.m-3]"]
    full_p = values["Maximum concentration in positive electrode [mol.m-3]"]
    values.update(
        {
            "Current function [A]": "[input]",
            "Ambient temperature [K]": "[input]",
            "Initial temperature [K]": pybamm.InputParameter("Ambient temperature [K]"),
            "Initial concentration in negative electrode [mol.m-3]": full_n * (x_0 + soc * (x_100 - x_0)),
            "Initial concentration in positive electrode [mol.m-3]": full_p * (y_0 + soc * (y_100 - y_0)),
        }
    )
    built = getattr(pybamm.lithium_ion, model)({"thermal": thermal})
    submeshes = built.default_submesh_types
    for particle in ("negative particle", "positive particle"):
        submeshes[particle] = pybamm.MeshGenerator(
            pybamm.Exponential1DSubMesh, {"side": "right", "stretch": PARTICLE_STRETCH}
        )
    settings = {"parameter_values": values, "var_pts": FINE, "submesh_types": submeshes} | options
    charge_Ah = values.evaluate(built.param.n.Q_init)
    return Cell(
        model=model,
        parameter_set=parameter_set,
        thermal=thermal,
        simulation=pybamm.Simulation(built, **settings),
        outputs=[
            "Voltage [V]",
            "X-averaged cell temperature [C]",
            "Negative electrode stoichiometry",
            "X-averaged negative particle surface stoichiometry",
            "X-averaged positive particle surface stoichiometry",
        ],
        soc=(float(x_0), float(x_100)),
        capacity_Ah=float(charge_Ah * (x_100 - x_0)),
        nominal_Ah=float(values["Nominal cell capacity [A.h]"]),
        voltage_limits_V=(float(values["Lower voltage cut-off [V]"]), float(values["Upper voltage cut-off [V]"])),
        out_of_range="a particle is empty or full, or the electrolyte is depleted",
        guards=_particle_guards,
    )


def _particle_guards(x: Any, outputs: Any) -> Any:
    """Concentrations and absolute temperature are positive, surfaces neither empty nor full."""
    surfaces = outputs[3:5]
    return casadi.vertcat(surfaces, 1 - surfaces, casadi.mmin(x))


def _thevenin(model: str, values: Any, parameter_set: str, thermal: str, options: dict[str, Any]) -> Cell:
    """The equivalent circuit, with one RC pair; its own SoC is the project's. It has its thermal model always."""
    if thermal != "lumped":
        raise ConfigError("plantmaker", key="--thermal", value=thermal, expected="lumped, as a Thevenin always is")
    built = pybamm.equivalent_circuit.Thevenin()
    options = {name: value for name, value in options.items() if name != "var_pts"}  # of particles and electrodes
    values.update(
        {
            "Current function [A]": "[input]",
            "Ambient temperature [K]": "[input]",
            "Initial temperature [K]": pybamm.InputParameter("Ambient temperature [K]"),
            "Initial SoC": pybamm.InputParameter("soc_initial"),
        }
    )
    return Cell(
        model=model,
        parameter_set=parameter_set,
        thermal=thermal,
        simulation=pybamm.Simulation(built, parameter_values=values, **options),
        outputs=["Voltage [V]", "Cell temperature [degC]", "SoC"],
        soc=(0.0, 1.0),
        capacity_Ah=float(values["Cell capacity [A.h]"]),
        nominal_Ah=float(values["Cell capacity [A.h]"]),
        voltage_limits_V=(float(values["Lower voltage cut-off [V]"]), float(values["Upper voltage cut-off [V]"])),
        out_of_range="it is fuller than full or emptier than empty",
        guards=lambda _, outputs: casadi.vertcat(outputs[2] + SOC_MARGIN, 1 + SOC_MARGIN - outputs[2]),
    )


MODELS: dict[str, Callable[..., Cell]] = {"SPM": _particle, "SPMe": _particle, "Thevenin": _thevenin}
