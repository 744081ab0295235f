"""The shape of the project that no single module can hold: who imports what, names that would shadow, sizes, paths."""

from __future__ import annotations

import ast
import graphlib
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "bms_ukf"
MODULES = sorted(PACKAGE.rglob("*.py"))

CODEC = {"decoder", "encoder", "dbc", "e2e", "fault_bits", "frames", "signals", "units"}

# A module or subpackage, and all of ours that it may import. Those not named here join the parts, and are checked only
# for cycles; nothing named here can import them.
MAY_IMPORT = {
    "records": set(),
    "errors": set(),
    "resources": {"errors"},
    "toml": {"errors"},
    "pchip": set(),
    "cell": {"errors", "pchip", "records", "resources", "toml"},
    "sensor_spec": {"cell", "errors", "toml"},
    "tuning": {"cell", "errors", "sensor_spec", "toml"},
    "kernel": {"cell", "errors", "kernel", "pchip", "records", "tuning"},
    "wiring": set(),
    "beliefs": {"kernel"},
    "percell": {"beliefs", "kernel", "records", "tuning", "wiring"},
    "shown": {"kernel", "records"},
    "estimator": {"beliefs", "cell", "errors", "kernel", "percell", "records", "shown", "tuning", "wiring"},
    "pack": {"beliefs", "cell", "estimator", "kernel", "pack", "records", "toml", "tuning"},
    "firmware": {"__version__", "cell", "errors", "firmware", "kernel", "records", "tuning"},
    "filter": {"cell", "kernel", "records", "tuning"},
    "plausible": set(),
    "recordings": {"errors", "plausible", "recordings"},
    "honesty": set(),
    "manifest": {"cell", "errors", "toml"},
    "measured": {"manifest", "recordings"},
    "offline": {"cell", "estimator", "honesty", "offline", "pack", "recordings", "records", "tuning"},
    "score": {
        "cell",
        "errors",
        "honesty",
        "identify",
        "manifest",
        "measured",
        "metrics",
        "offline",
        "recordings",
        "score",
    }
    | {"tuning"},
    "benchmark_entry": {"cell", "errors", "estimator", "records", "resources", "tuning"},
    "bpx": {"errors", "plausible"},
    "identify": {
        "bpx",
        "cell",
        "errors",
        "estimator",
        "honesty",
        "identify",
        "manifest",
        "measured",
        "pchip",
        "recordings",
        "toml",
        "tuning",
    },
    "ecm_csv": {"errors", "plausible"},
    "ecm_tables": {"cell", "ecm_csv", "errors", "identify", "plausible", "toml"},
    "fmi": {"fmi"},  # in a process of its own, which is to start quickly
    "plant": {"errors", "fmi", "plant", "records", "resources", "toml", "units"},
    "loads": {"errors", "loads", "resources"},
    "sensors": {"errors", "records"},
    "fmumaker": {"errors", "fmumaker", "toml"},
    "plantmaker": {"errors", "fmumaker", "plantmaker"},
    "estimator_fmu": {"__version__", "cell", "estimator_fmu", "firmware", "fmumaker", "tuning"},
    "faults": {"dbc", "e2e", "faults", "frames", "records", "toml"},
    "expectations": {"expectations", "faults", "honesty", "plant", "records", "toml", "trace"},
    "hil": CODEC
    | {"bus", "clock", "config", "daemon", "errors", "estimator", "expectations", "faults", "hil", "node", "plant"}
    | {"cell", "records", "resources", "scenario", "sensors", "slots", "state"},
    "pytest_plugin": {"ConfigError", "bus", "config", "hil", "plant", "scenario"},
    "scaling": {"cell"},
    "open_circuit": {"records"},
    "stuck": {"cell", "records"},
    "failed": {"cell", "estimator", "failed", "percell", "records", "sensor_spec", "strings"},
    "strings": {"cell", "commissioning", "records", "stuck", "wiring"},
    "alignment": {"records"},
    "intake": {"alignment", "decoder", "frames", "open_circuit", "records"},
    "e2e_settings": {"dbc", "e2e", "errors", "toml"},
    "candidates": {"dbc", "units"},
    "skeleton": {"candidates", "dbc", "sensor_spec", "units"},
    "signal_scale": {"cell", "errors", "signals"},
    "socketcan": set(),
    "seldom": set(),
    "logsetup": {"toml"},
    "publication": {"records"},
    "pace": set(),
    "framelog": {"errors"},
    "scan": {"records"},
    "monitor": CODEC | {"bus", "config", "errors", "honesty", "monitor", "records", "view"},
    "flight": {"estimator", "records"},
    "slots": set(),
    "state": {"estimator", "pack", "records", "seldom", "slots"},
    "notify": set(),
    "commissioning": {"cell", "records"},
    "core": {
        "commissioning",
        "estimator",
        "failed",
        "intake",
        "pace",
        "pack",
        "publication",
        "records",
        "scan",
        "strings",
        "stuck",
    },
    "pack_encoder": {"dbc", "frames", "pack", "records"},
    "pack_output": {"estimator", "frames", "pack", "pack_encoder", "records"},
    "health_encoder": {"frames", "pack", "pack_encoder", "records"},
    "daemon": {
        "bus",
        "clock",
        "core",
        "encoder",
        "estimator",
        "health_encoder",
        "intake",
        "pace",
        "pack",
        "pack_output",
    }
    | {"records"},
} | dict.fromkeys(CODEC, CODEC | {"errors", "records", "resources"})
# The only modules that may know of a library.
KNOWN_TO = {
    "numba": {"identify", "kernel", "offline"},
    "pyarrow": {"recordings", "replay"},
    "distributed": {"replay"},
    "llvmlite": {"firmware", "kernel"},
    "fmpy": {"fmumaker", "plant"},
    "pybamm": {"plantmaker"},
    "casadi": {"plantmaker"},
    "cantools": CODEC | {"candidates", "monitor", "skeleton"},
    "fastcrc": {"e2e"},
    "prometheus_client": {"exporter"},
    "can": {"bus", "cosim", "framelog", "hil", "links", "pytest_plugin", "replay", "socketcan"},
    "click": {"cli"},
}
# Time is data and the outside world is elsewhere, for the estimator and all below it.
PURE = {"records", "errors", "resources", "toml", "pchip", "cell", "tuning", "kernel", "estimator", "filter"}
PURE |= {"sensor_spec", "wiring", "beliefs", "percell", "pack"}
IMPURE = {"can", "cantools", "fmpy", "time", "datetime", "logging", "socket", "threading", "asyncio"}

SOURCES = [".ci", ".github", "bms_ukf", "can", "models", "tests"]
MACHINE_PATH = re.compile(rb"/[w]ork/|/[h]ome/[a-z]|/[r]oot/|[.][.]/[s]hared")
MAY_NAME_A_PATH = {".ci/run"}


def part(module: Path) -> str:
    """`bms_ukf/kernel/ecm.py` is of the part `kernel`, `bms_ukf/cell.py` is the part `cell`."""
    return module.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(module: Path) -> Iterator[str]:
    """Dotted names of all a module imports, wherever in it; `from a import b` gives `a.b`."""
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imported_parts(module: Path) -> set[str]:
    return {name.split(".")[1] for name in imports(module) if name.startswith("bms_ukf.")}


def imported_libraries(module: Path) -> set[str]:
    return {name.split(".")[0] for name in imports(module)}


def offenders(excess: Callable[[Path], set[str]]) -> dict[str, set[str]]:
    """The modules of ours that import what they should not, with what that is."""
    return {str(module.relative_to(ROOT)): names for module in MODULES if (names := excess(module))}


def committed_files() -> Iterator[Path]:
    yield from (path for path in ROOT.iterdir() if path.is_file())
    for folder in SOURCES:
        yield from (path for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts)


def contents(path: Path) -> Iterator[bytes]:
    yield path.read_bytes()
    if path.suffix == ".fmu":
        with zipfile.ZipFile(path) as archive:
            yield from (archive.read(name) for name in archive.namelist())


@pytest.mark.parametrize("name", ["can/__init__.py", "can/can.py", "models/__init__.py"])
def test_no_file_of_ours_turns_a_data_folder_into_a_package(name):
    assert not (ROOT / name).exists()


def test_import_can_is_python_can_even_from_the_checkout():
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import can; print(can.Bus.__module__, can.__file__)"
    printed = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    module, file = printed.split()
    assert module.startswith("can.")
    assert ROOT / "can" not in Path(file).parents


def test_a_module_imports_only_what_lies_below_it():
    assert not offenders(
        lambda module: imported_parts(module) - MAY_IMPORT[part(module)] if part(module) in MAY_IMPORT else set()
    )


def test_no_two_parts_import_each_other():
    graph: dict[str, set[str]] = {}
    for module in MODULES:
        graph.setdefault(part(module), set()).update(imported_parts(module) - {part(module)})
    assert list(graphlib.TopologicalSorter(graph).static_order())


def test_a_library_is_known_only_to_the_modules_that_wrap_it():
    assert not offenders(
        lambda module: {
            name for name in imported_libraries(module) if name in KNOWN_TO and part(module) not in KNOWN_TO[name]
        }
    )


def test_the_estimator_knows_no_clock_no_bus_and_no_log():
    assert not offenders(lambda module: imported_libraries(module) & IMPURE if part(module) in PURE else set())


def test_a_module_fits_in_the_head():
    lengths = {str(module.relative_to(ROOT)): len(module.read_text("utf-8").splitlines()) for module in MODULES}
    assert not {module: length for module, length in lengths.items() if length > 300}


def test_no_file_carries_the_path_of_a_machine():
    files = [path for path in committed_files() if str(path.relative_to(ROOT)) not in MAY_NAME_A_PATH]
    found = [(path, match[0]) for path in files for data in contents(path) if (match := MACHINE_PATH.search(data))]
    assert len(files) > len(MODULES)
    assert not found


def test_every_test_over_vcan_is_where_the_suite_looks_for_it():
    elsewhere = [path for path in (ROOT / "tests").glob("*.py") if "mark." + "socketcan" in path.read_text()]
    assert not elsewhere
    suite = list((ROOT / "tests" / "socketcan").glob("test_*.py"))
    assert suite
    assert all("pytestmark = pytest.mark." + "socketcan" in path.read_text() for path in suite)
