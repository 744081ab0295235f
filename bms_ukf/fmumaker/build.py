"""Builds the FMU of a model's folder, for this machine and others. Needs a C compiler for each.

    python -m bms_ukf.fmumaker models/lgm50_spme models/plants/lgm50_spme.fmu

The folder's fmu.toml is the one table of variables (`table.py`). The FMU carries its sources, unless part of them are
object files, the FMI headers and the folder's README.md. The same inputs and compiler give the same bytes.
"""

from __future__ import annotations

import hashlib
import html
import os
import shutil
import subprocess
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import fmpy

from bms_ukf import toml
from bms_ukf.errors import BmsError, ConfigError
from bms_ukf.fmumaker.description import all_sources, build_description, describe
from bms_ukf.fmumaker.table import Table, header

SHARED = Path(__file__).parent / "c"
FMI_HEADERS = {
    2: ["fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"],
    3: ["fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"],
}
# No contraction into fused multiply-add: every x86-64 and aarch64 compiler then computes the same trace.
FLAGS = ["-std=c11", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
LINK_FLAGS = ["-shared", "-fPIC", "-fvisibility=hidden", "-s", "-Wl,--build-id=none"]

HERE = str(fmpy.platform_tuple)


class Machine(NamedTuple):
    """How FMI 2.0 calls a machine's folder of libraries, and Debian its compiler."""

    fmi2: str
    compiler: str


# By the names of FMI 3.0, which since FMI 2.0.4 are also those of 2.0 for all but x86.
MACHINES = {
    "x86_64-linux": Machine("linux64", "x86_64-linux-gnu-gcc"),
    "aarch64-linux": Machine("aarch64-linux", "aarch64-linux-gnu-gcc"),
}


class BuildError(BmsError):
    """The C compiler does not take the sources."""


def compiler(machine: str) -> str:
    """The command that compiles for a machine: of this one CC, or cc."""
    return os.environ.get("CC", "cc") if machine == HERE else MACHINES[machine].compiler


def require_compiler(machine: str) -> None:
    """Raises ConfigError if there is none."""
    if shutil.which(compiler(machine)) is None:
        raise ConfigError(
            compiler(machine), expected="a C compiler; install one (apt install gcc libc6-dev) or name it in CC"
        )


def build(folder: Path, fmu: Path, fmi: int = 2, machines: Sequence[str] = (HERE,)) -> None:
    """Writes `fmu`, for FMI 2.0 (`fmi` = 2) or 3.0 (3), from the model in `folder`, to run on `machines`.

    Raises ConfigError if there is no compiler, and for a fmu.toml that is not sound or names a file that is not there;
    BuildError if the compiler fails.
    """
    for machine in machines:
        require_compiler(machine)
    table = toml.load(folder / "fmu.toml", Table)
    model = table.model
    sources = [_find(folder, name) for name in all_sources(table, fmi)]
    headers = [_find(folder, name) for name in (*model.headers, "model.h", "instance.h")]
    headers += [Path(fmpy.__file__).parent / "c-code" / name for name in FMI_HEADERS[fmi]]
    objects = {machine: [_find(folder, f"{machine}/{name}") for name in model.objects] for machine in machines}
    token = _token(table, [*sources, *headers, *(path for paths in objects.values() for path in paths)])
    readme = _find(folder, "README.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        (root / "sources").mkdir()
        for path in (*sources, *headers):
            (root / "sources" / path.name).write_bytes(path.read_bytes())
        (root / "sources" / "variables.h").write_text(header(table, token))
        if fmi == 3:
            (root / "sources" / "buildDescription.xml").write_bytes(build_description(table))
        (root / "documentation").mkdir()
        (root / "documentation" / "README.md").write_text(readme)
        (root / "documentation" / "index.html").write_text(
            f'<!DOCTYPE html><meta charset="utf-8"><title>{model.name}</title><pre>{html.escape(readme)}</pre>\n'
        )
        (root / "modelDescription.xml").write_bytes(describe(table, token, fmi))
        for machine in machines:
            library = root / "binaries" / _platform(machine, fmi) / f"{model.name}{fmpy.sharedLibraryExtension}"
            _compile(machine, [root / "sources" / path.name for path in sources], objects[machine], library)
        if model.objects:
            shutil.rmtree(root / "sources")  # nobody could build the library from them
        try:
            _zip(root, fmu)
        except OSError as error:
            raise ConfigError(fmu, expected=f"a file that can be written ({error.strerror})") from None


def _platform(machine: str, fmi: int) -> str:
    """The name of a machine's folder of libraries."""
    if fmi == 3:
        return machine
    return MACHINES[machine].fmi2 if machine in MACHINES else str(fmpy.platform)


def _find(folder: Path, name: str) -> Path:
    for path in (folder / name, SHARED / name):
        if path.is_file():
            return path
    raise ConfigError(folder / "fmu.toml", key="model", value=name, expected=f"a file there, or in {SHARED}")


def _token(table: Table, files: list[Path]) -> str:
    """Changes with the table and with any source, so that a saved FMU state is only taken by the code that wrote it."""
    digest = hashlib.sha256(table.model_dump_json().encode())
    for path in files:
        digest.update(path.read_bytes())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _compile(machine: str, sources: list[Path], objects: list[Path], library: Path) -> None:
    """Compiles C files that lie in one folder with their headers, and objects with theirs."""
    library.parent.mkdir(parents=True)
    includes = sorted({f"-I{path.resolve().parent}" for path in objects})
    files = [*(path.name for path in sources), *(str(path.resolve()) for path in objects)]
    command = [compiler(machine), *FLAGS, *LINK_FLAGS, *includes, "-o", str(library), *files, "-lm"]
    done = subprocess.run(command, cwd=sources[0].parent, capture_output=True, text=True, check=False)
    if done.returncode:
        says = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip()[-200:])
        raise BuildError(f"{compiler(machine)} does not compile {library.stem}: {says}")


def _zip(root: Path, target: Path) -> None:
    """Zips a folder with sorted names and a fixed date."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(p for p in root.rglob("*") if p.is_file()):
            entry = zipfile.ZipInfo(path.relative_to(root).as_posix(), date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, path.read_bytes())
