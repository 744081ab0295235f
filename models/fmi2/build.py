"""Builds an FMI 2.0 co-simulation FMU for this machine from a model's folder. Needs a C compiler and fmpy.

    python models/fmi2/build.py models/lgm50_spme models/plants/lgm50_spme.fmu

The folder's fmu.toml is the one table of variables: modelDescription.xml and variables.h are made from it here. The FMU
carries its sources, the FMI headers and the folder's README.md. The same inputs and compiler give the same bytes.
"""

from __future__ import annotations

import argparse
import hashlib
import html
import os
import subprocess
import sys
import tempfile
import tomllib
import uuid
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import fmpy

FMI_HEADERS = ["fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"]
# No contraction into fused multiply-add: every x86-64 and aarch64 compiler then computes the same trace.
FLAGS = ["-std=c11", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
LINK_FLAGS = ["-shared", "-fPIC", "-fvisibility=hidden", "-s", "-Wl,--build-id=none"]
KINDS = {"input": "INPUT", "output": "OUTPUT", "parameter": "PARAMETER"}


def source_files(folder: Path, table: dict[str, Any]) -> list[Path]:
    """The C files to compile, then every header they include."""
    ours = [folder / name for name in table["model"]["sources"] + table["model"]["headers"]]
    return ours + [Path(fmpy.__file__).parent / "c-code" / name for name in FMI_HEADERS]


def model_guid(table: dict[str, Any], sources: list[Path]) -> str:
    """Changes with the table and with any source, so that a saved FMU state is only taken by the code that wrote it."""
    digest = hashlib.sha256(repr(table).encode())
    for path in sources:
        digest.update(path.read_bytes())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def variables_header(table: dict[str, Any], guid: str) -> str:
    """variables.h: the enum of value references and the table of limits."""
    variables = table["variable"]
    names = "".join(f"    {v['name'].upper()},\n" for v in variables)
    rows = "".join(
        f'    {{"{v["name"]}", {KINDS[v["causality"]]}, {v.get("start", 0.0)!r}, '
        f"{v.get('min', '-HUGE_VAL')}, {v.get('max', 'HUGE_VAL')}}},\n"
        for v in variables
    )
    return (
        "/* Generated from fmu.toml: do not edit. */\n#ifndef VARIABLES_H\n#define VARIABLES_H\n\n#include <math.h>\n\n"
        f'#define MODEL_GUID "{guid}"\n\n'
        f"enum {{\n{names}    N_VARIABLES\n}};\n\n"
        "typedef struct {\n    const char *name;\n    enum { INPUT, OUTPUT, PARAMETER } kind;\n"
        "    double start, min, max;\n} Variable;\n\n"
        f"static const Variable VARIABLES[N_VARIABLES] = {{\n{rows}}};\n\n#endif\n"
    )


def model_description(table: dict[str, Any], guid: str) -> bytes:
    """modelDescription.xml."""
    model, variables = table["model"], table["variable"]
    position = {v["name"]: str(k) for k, v in enumerate(variables, start=1)}
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model["name"],
        guid=guid,
        description=f"{model['description']} ({model['reference']})",
        version=model["version"],
        license="MIT",
        variableNamingConvention="flat",
    )
    slave = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model["name"],
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    files = ET.SubElement(slave, "SourceFiles")
    for name in model["sources"]:
        ET.SubElement(files, "File", name=Path(name).name)
    units = ET.SubElement(root, "UnitDefinitions")
    for name, exponents in table["units"].items():
        base = {key: str(value) for key, value in exponents.items()}
        ET.SubElement(ET.SubElement(units, "Unit", name=name), "BaseUnit", base)
    categories = ET.SubElement(root, "LogCategories")
    for name in ("logStatusDiscard", "logStatusError"):
        ET.SubElement(categories, "Category", name=name)
    ET.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime=str(model["stop_s"]), stepSize=str(model["step_s"])
    )
    described = ET.SubElement(root, "ModelVariables")
    for k, v in enumerate(variables):
        attributes = {"name": v["name"], "valueReference": str(k), "description": v["description"]}
        attributes["causality"] = v["causality"]
        attributes["variability"] = "fixed" if v["causality"] == "parameter" else "continuous"
        if v["causality"] != "input":
            attributes["initial"] = "exact" if "start" in v else "calculated"
        real = {"unit": v["unit"]} | {key: str(v[key]) for key in ("min", "max", "start") if key in v}
        ET.SubElement(ET.SubElement(described, "ScalarVariable", attributes), "Real", real)
    structure = ET.SubElement(root, "ModelStructure")
    for title in ("Outputs", "InitialUnknowns"):
        unknowns = ET.SubElement(structure, title)
        for v in variables:
            if v["causality"] == "output":
                known = " ".join(
                    position[name] for name in v["at_start" if title == "InitialUnknowns" else "feedthrough"]
                )
                ET.SubElement(unknowns, "Unknown", index=position[v["name"]], dependencies=known)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def compile_library(sources: list[Path], library: Path) -> None:
    """Compiles C files that lie in one folder with their headers. Raises FileNotFoundError without a C compiler."""
    compiler = os.environ.get("CC", "cc")
    names = [path.name for path in sources]
    folder = sources[0].parent
    library.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run([compiler, *FLAGS, *LINK_FLAGS, "-o", library.resolve(), *names, "-lm"], cwd=folder, check=True)


def build(folder: Path, fmu: Path) -> None:
    """Writes `fmu` from the model in `folder`."""
    table = tomllib.loads((folder / "fmu.toml").read_text())
    model = table["model"]
    sources = source_files(folder, table)
    guid = model_guid(table, sources)
    readme = (folder / "README.md").read_text()
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        (root / "sources").mkdir()
        for path in sources:
            (root / "sources" / path.name).write_bytes(path.read_bytes())
        (root / "sources" / "variables.h").write_text(variables_header(table, guid))
        (root / "documentation").mkdir()
        (root / "documentation" / "README.md").write_text(readme)
        (root / "documentation" / "index.html").write_text(
            f'<!DOCTYPE html><meta charset="utf-8"><title>{model["name"]}</title><pre>{html.escape(readme)}</pre>\n'
        )
        (root / "modelDescription.xml").write_bytes(model_description(table, guid))
        to_compile = [root / "sources" / Path(name).name for name in model["sources"]]
        compile_library(to_compile, root / "binaries" / fmpy.platform / f"{model['name']}{fmpy.sharedLibraryExtension}")
        write_zip(root, fmu)


def write_zip(root: Path, target: Path) -> None:
    """Zips a folder with sorted names and a fixed date."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(p for p in root.rglob("*") if p.is_file()):
            entry = zipfile.ZipInfo(path.relative_to(root).as_posix(), date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, path.read_bytes())


def main() -> int:
    """Command line: the model's folder and the FMU to write."""
    parser = argparse.ArgumentParser(description="Builds a model's folder into an FMI 2.0 co-simulation FMU.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("fmu", type=Path)
    arguments = parser.parse_args()
    try:
        build(arguments.folder, arguments.fmu)
    except FileNotFoundError as error:
        sys.stderr.write(
            f"{error.filename}: not found; a C compiler (cc, or the one in $CC) and the sources are needed\n"
        )
        return 2
    except subprocess.CalledProcessError as error:
        sys.stderr.write(f"{arguments.folder}: the C compiler failed: {error.cmd[0]} returned {error.returncode}\n")
        return 1
    sys.stdout.write(f"{arguments.fmu}: {arguments.fmu.stat().st_size} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
