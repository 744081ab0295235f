"""An FMU as a file: whether it can be co-simulated on this machine, what variables it has, and its library."""

from __future__ import annotations

import difflib
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import fmpy
from fmpy.validation import validate_fmu

from bms_ukf.errors import ConfigError


def describe(path: Path) -> Any:
    """fmpy's model description of an FMU, if it is one for FMI 2.0 co-simulation; else raises ConfigError."""
    if not path.is_file():
        raise ConfigError(path, expected="an FMU; there is no such file")
    try:
        # Unpacked first: fmpy leaves an archive open when it stumbles over the XML in it.
        with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(path) as archive:
            archive.extract("modelDescription.xml", folder)
            description = fmpy.read_model_description(folder, validate=False)
    except (zipfile.BadZipFile, zlib.error):
        raise ConfigError(path, expected="an FMU, which is a zip archive") from None
    except KeyError:
        raise ConfigError(path, expected="an FMU, with a modelDescription.xml in it") from None
    except Exception as error:  # whatever a broken XML makes fmpy stumble over
        raise ConfigError(path, expected=f"an FMU whose modelDescription.xml can be read ({error})") from None
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        kind = "co-simulation" if description.coSimulation is not None else "model exchange only"
        raise ConfigError(path, value=f"FMI {description.fmiVersion}, {kind}", expected="FMI 2.0 co-simulation")
    return description


def variable_named(path: Path, description: Any, name: str, key: str) -> Any:
    """The variable of that name; else a ConfigError that blames `key` and names the nearest."""
    by_name = {variable.name: variable for variable in description.modelVariables}
    if name not in by_name:
        near = difflib.get_close_matches(name, by_name, n=3, cutoff=0.4) or sorted(by_name)[:5]
        raise ConfigError(path, key=key, value=name, expected=f"a variable of the FMU, such as {', '.join(near)}")
    return by_name[name]


def library(path: Path, identifier: str) -> str:
    """The archive member that is the FMU's library for this machine. ConfigError if there is none."""
    member = f"binaries/{fmpy.platform}/{identifier}{fmpy.sharedLibraryExtension}"
    if member not in _members(path):
        found = ", ".join(platforms(path)) or "none, only sources"
        raise ConfigError(path, key="binaries", value=found, expected=f"one for this machine, {fmpy.platform}")
    return member


def platforms(path: Path) -> list[str]:
    """The platforms an FMU has libraries for, sorted."""
    return sorted({name.split("/")[1] for name in _members(path) if name.startswith("binaries/")} - {""})


def findings(path: Path) -> list[str]:
    """What fmpy's validation says against the FMU; none for a sound one."""
    return [str(finding) for finding in validate_fmu(str(path))]


def unpack(path: Path, identifier: str, folder: str) -> None:
    """Unpacks all but the sources, if the FMU has a library for this machine. ConfigError if that fails."""
    library(path, identifier)
    with zipfile.ZipFile(path) as archive:
        try:
            archive.extractall(folder, [name for name in archive.namelist() if not name.startswith("sources/")])
        except (zipfile.BadZipFile, zlib.error) as error:
            raise ConfigError(path, expected=f"an FMU that can be unpacked ({error})") from None


def _members(path: Path) -> list[str]:
    with zipfile.ZipFile(path) as archive:
        return archive.namelist()
