"""modelDescription.xml, in the words of FMI 2.0 and of FMI 3.0."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from bms_ukf.fmumaker.table import Table, Variable


def describe(table: Table, token: str, fmi: int) -> bytes:
    """The description of a model for FMI 2.0 (`fmi` = 2) or 3.0 (3)."""
    root = _Fmi2(table, token).root() if fmi == 2 else _Fmi3(table, token).root()
    return _text(root)


class Scalar(NamedTuple):
    """An element of a variable, as FMI 2.0 sees it."""

    variable: Variable
    name: str
    k: int  # of the array


class _Description:
    def __init__(self, table: Table, token: str) -> None:
        self.table, self.token, self.model = table, token, table.model

    def common(self, version: str, token_key: str) -> ET.Element:
        return ET.Element(
            "fmiModelDescription",
            {
                "fmiVersion": version,
                "modelName": self.model.name,
                token_key: self.token,
                "description": f"{self.model.description} ({self.model.reference})",
                "version": self.model.version,
                "license": "MIT",
            },
        )

    def add_units(self, root: ET.Element) -> None:
        units = ET.SubElement(root, "UnitDefinitions")
        for name, exponents in self.table.units.items():
            base = {key: f"{value:g}" for key, value in exponents.items()}
            ET.SubElement(ET.SubElement(units, "Unit", name=name), "BaseUnit", base)

    def add_experiment(self, root: ET.Element) -> None:
        categories = ET.SubElement(root, "LogCategories")
        for name in ("logStatusDiscard", "logStatusError"):
            ET.SubElement(categories, "Category", name=name)
        stop, step = str(self.model.stop_s), str(self.model.step_s)
        ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime=stop, stepSize=step)

    def outputs(self) -> Iterator[Variable]:
        return (v for v in self.table.variable if v.causality == "output")


def _kind(v: Variable) -> dict[str, str]:
    variability = "fixed" if v.causality == "parameter" else "continuous" if v.type == "real" else "discrete"
    kind = {"causality": v.causality, "variability": variability}
    if v.causality != "input":
        kind["initial"] = "calculated" if v.start is None else "exact"
    return kind


def _limits(v: Variable) -> dict[str, str]:
    limits = {"min": v.min, "max": v.max}
    unit = {"unit": v.unit} if v.type == "real" else {}
    return unit | {key: str(value) for key, value in limits.items() if value is not None}


class _Fmi2(_Description):
    """An array is a variable for each element, named as in a structured name; value references are places."""

    def root(self) -> ET.Element:
        root = self.common("2.0", "guid")
        scalars = [Scalar(v, name, k) for v in self.table.variable for k, name in enumerate(v.scalar_names)]
        arrays = any(v.elements for v in self.table.variable)
        root.set("variableNamingConvention", "structured" if arrays else "flat")
        slave = ET.SubElement(
            root,
            "CoSimulation",
            modelIdentifier=self.model.name,
            canHandleVariableCommunicationStepSize="true",
            canNotUseMemoryManagementFunctions="true",
            canGetAndSetFMUstate="true",
            canSerializeFMUstate="true",
        )
        if not self.model.objects:
            files = ET.SubElement(slave, "SourceFiles")
            for name in all_sources(self.table, 2):
                ET.SubElement(files, "File", name=Path(name).name)
        self.add_units(root)
        self.add_experiment(root)
        described = ET.SubElement(root, "ModelVariables")
        for place, (v, name, k) in enumerate(scalars):
            attributes = {"name": name, "valueReference": str(place), "description": v.description} | _kind(v)
            start = {"start": str(v.starts[k])} if v.starts else {}
            scalar = ET.SubElement(described, "ScalarVariable", attributes)
            ET.SubElement(scalar, v.type.capitalize(), _limits(v) | start)
        structure = ET.SubElement(root, "ModelStructure")
        for title in ("Outputs", "InitialUnknowns"):
            unknowns = ET.SubElement(structure, title)
            for position, (v, _, k) in enumerate(scalars, start=1):
                if v.causality == "output":
                    known = self._positions(v.at_start if title == "InitialUnknowns" else v.feedthrough, k)
                    ET.SubElement(unknowns, "Unknown", index=str(position), dependencies=known)
        return root

    def _positions(self, names: list[str], k: int) -> str:
        """Of the variables that element `k` of an array depends on: of arrays, the element that is its own."""
        places = self.table.places()
        sizes = {v.name: v.size for v in self.table.variable}
        return " ".join(str(places[name] + 1 + (k if sizes[name] > 1 else 0)) for name in names)


class _Fmi3(_Description):
    """Value references are the places of first elements; time, which FMI 3.0 wants to be there, has the one after."""

    def root(self) -> ET.Element:
        root = self.common("3.0", "instantiationToken")
        root.set("variableNamingConvention", "flat")
        ET.SubElement(
            root,
            "CoSimulation",
            modelIdentifier=self.model.name,
            canHandleVariableCommunicationStepSize="true",
            canGetAndSetFMUState="true",
            canSerializeFMUState="true",
        )
        self.add_units(root)
        self.add_experiment(root)
        places = {name: str(place) for name, place in self.table.places().items()}
        described = ET.SubElement(root, "ModelVariables")
        for v in self.table.variable:
            attributes = {"name": v.name, "valueReference": places[v.name], "description": v.description} | _kind(v)
            start = {"start": " ".join(map(str, v.starts))} if v.starts else {}
            type_name = "Float64" if v.type == "real" else "Int32"
            element = ET.SubElement(described, type_name, attributes | _limits(v) | start)
            if v.elements is not None:
                ET.SubElement(element, "Dimension", start=str(v.elements))
        ET.SubElement(
            described,
            "Float64",
            name="time",
            valueReference=str(self.table.size),
            causality="independent",
            variability="continuous",
            description="simulation time, s",
        )
        structure = ET.SubElement(root, "ModelStructure")
        for title, key in (("Output", "feedthrough"), ("InitialUnknown", "at_start")):
            for v in self.outputs():
                known = " ".join(places[name] for name in getattr(v, key))
                ET.SubElement(structure, title, valueReference=places[v.name], dependencies=known)
        return root


def build_description(table: Table) -> bytes:
    """sources/buildDescription.xml, by which FMI 3.0 tells how to compile."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=table.model.name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in all_sources(table, 3):
        ET.SubElement(files, "SourceFile", name=Path(name).name)
    ET.SubElement(configuration, "Library", name="m")
    return _text(root)


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def all_sources(table: Table, fmi: int) -> list[str]:
    """The model's C files and those of the FMI layer."""
    return [*table.model.sources, "instance.c", f"fmi{fmi}.c"]
