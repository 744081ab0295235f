"""An FMU as a file: unpacked, described, and with a library for this machine, which is compiled if there is none."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import fmpy
from fmpy.validation import validate_fmu

from bms_ukf.errors import ConfigError

_BUILD = "import sys; from fmpy.build import build_platform_binary; build_platform_binary(sys.argv[1])"
_BUILD_LIMIT_S = 600


def unpack(path: Path, folder: Path) -> None:
    """Unpacks an FMU. ConfigError if it is none."""
    if not path.is_file():
        raise ConfigError(path, expected="an FMU; there is no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                member.filename = member.filename.replace("\\", "/")  # as some tools on Windows write them
                file = Path(archive.extract(member, folder))
                if member.external_attr >> 16 & 0o111 and not file.is_dir():
                    file.chmod(0o755)  # programs among the resources
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise ConfigError(path, expected=f"an FMU, which is a zip archive that can be unpacked ({error})") from None


def describe(path: Path, folder: Path) -> Any:
    """fmpy's model description of an unpacked FMU, if it is one for FMI 2.0 or 3.0 co-simulation; else ConfigError."""
    if not (folder / "modelDescription.xml").is_file():
        raise ConfigError(path, expected="an FMU, with a modelDescription.xml in it")
    try:
        description = fmpy.read_model_description(folder, validate=False)
    except Exception as error:  # whatever a broken XML makes fmpy stumble over
        expected = f"an FMU whose modelDescription.xml can be read ({' '.join(str(error).split())[:200]})"
        raise ConfigError(path, expected=expected) from None
    version = str(description.fmiVersion)
    if not version.startswith(("2.", "3.")):
        raise ConfigError(path, value=f"FMI {version}", expected="FMI 2.0 or 3.0 co-simulation")
    if description.coSimulation is None:
        kinds = [name for name in ("modelExchange", "scheduledExecution") if getattr(description, name) is not None]
        kind = {"modelExchange": "model exchange only", "scheduledExecution": "scheduled execution only"}
        found = " and ".join(kind[name] for name in kinds) or "no interface"
        raise ConfigError(path, value=f"FMI {version}, {found}", expected="FMI 2.0 or 3.0 co-simulation")
    return description


def findings(folder: Path) -> list[str]:
    """What fmpy's validation says against an unpacked FMU; none for a sound one. One line each."""
    return [" ".join(str(finding).split()) for finding in validate_fmu(str(folder))]


def library(path: Path, folder: Path, description: Any) -> Path:
    """The unpacked FMU's library for this machine, which is compiled if it brings its sources only.

    Raises ConfigError, naming the platforms it does have, or what compiling it lacks.
    """
    names = [fmpy.platform, fmpy.platform_tuple]  # as FMI 2.0 and as FMI 3.0 call this machine
    if not description.fmiVersion.startswith("2."):
        names.reverse()
    file = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    candidates: list[Path] = [folder / "binaries" / name / file for name in names]
    for candidate in candidates:
        if candidate.is_file() and not _is_foreign(candidate):
            return candidate
    if not description.buildConfigurations or not (folder / "sources").is_dir():
        found = ", ".join(platforms(folder)) or "none, and no sources"
        misnamed = [
            f"{other.parent.name}/{other.name}"
            for name in names
            for other in (folder / "binaries" / name).glob("*.so")
            if other.name != file
        ]
        if misnamed:
            raise ConfigError(path, key="binaries", value=", ".join(misnamed), expected=f"{names[0]}/{file}")
        foreign = [f"{candidate.parent.name}/{file}" for candidate in candidates if candidate.is_file()]
        if foreign:
            expected = f"one for this machine's processor, {fmpy.platform_tuple}"
            raise ConfigError(path, key="binaries", value=", ".join(foreign), expected=expected)
        raise ConfigError(path, key="binaries", value=found, expected=f"one for this machine, {names[0]}")
    _compile(path, folder, candidates[0])
    return candidates[0]


def _is_foreign(library: Path) -> bool:
    """Whether a library is one for another processor: linux64 of FMI 2.0 does not say which.

    The header of an ELF file has its word size, byte order and machine (elf(5)); the interpreter's is of this one.
    """
    theirs, ours = (_start(file) for file in (library, Path(sys.executable)))
    both = theirs.startswith(b"\x7fELF") and ours.startswith(b"\x7fELF")
    return both and (theirs[4:6], theirs[18:20]) != (ours[4:6], ours[18:20])


def _start(file: Path) -> bytes:
    with file.open("rb") as opened:
        return opened.read(20)


def platforms(folder: Path) -> list[str]:
    """The platforms an unpacked FMU has libraries for, sorted."""
    return sorted(entry.name for entry in folder.glob("binaries/*") if entry.is_dir())


def cache() -> Path:
    """The folder that keeps compiled libraries."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bms-ukf" / "fmu"


def _compile(path: Path, folder: Path, target: Path) -> None:
    """Compiles an FMU's sources to `target`, or takes what was compiled of the same file before."""
    kept = cache() / f"{hashlib.sha256(path.read_bytes()).hexdigest()}{fmpy.sharedLibraryExtension}"
    if not kept.is_file():
        missing = [tool for tool in ("cmake", "cc") if shutil.which(tool) is None]
        if missing:
            expected = f"a library for this machine, or {' and '.join(missing)} to compile its sources"
            raise ConfigError(path, key="binaries", value=", ".join(platforms(folder)) or "none", expected=expected)
        said = _build(folder)
        if not target.is_file():
            raise ConfigError(path, key="sources", expected=f"sources that compile here ({said})")
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=kept.parent, delete=False) as copy:
            copy.write(target.read_bytes())
        Path(copy.name).replace(kept)  # whole or not at all, whoever else compiles it now
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(kept, target)


def _build(folder: Path) -> str:
    """Has fmpy compile the sources; the line of its output that says most about why it failed."""
    command = [sys.executable, "-c", _BUILD, str(folder)]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_BUILD_LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"not done within {_BUILD_LIMIT_S} s"
    lines = [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    return next((line for line in lines if "error:" in line.lower()), lines[-1] if lines else "no reason given")
