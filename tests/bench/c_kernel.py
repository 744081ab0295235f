"""The filter step in hand-written C (`c/kernel.c`), built here with `cc`: what the benchmarks compare with."""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_ukf import CellParams, Estimator, Fault, Status, Tuning
from bms_ukf.kernel import adapt, bias, ecm, inputs, interval, layout, ohmic, process, voltage
from bms_ukf.kernel import step as policy
from bms_ukf.kernel.params import aligned, params

SOURCE = Path(__file__).parent / "c" / "kernel.c"
OPTIMISED: tuple[str, ...] = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")
if platform.machine() == "x86_64":
    OPTIMISED += ("-mprefer-vector-width=512",)  # as ours, where there are such registers
SHARED = ("-fPIC", "-fno-semantic-interposition", "-shared")
STRICT = ("-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
Array = NDArray[np.floating]


def layout_header() -> str:
    """layout.h: the slots and constants of the Python kernel, so that they are written once."""
    prefixes = ("P_", "H_", "T_", "D_", "IN_", "OUT_")
    constants: dict[str, object] = {name: value for name, value in vars(layout).items() if name.startswith(prefixes)}
    for module, names in (
        (layout, ("LANES", "IO_ROWS", "OCV_COEFFICIENTS", "HELD")),
        (ecm, ("FALL_SMALL", "FALL_TERMS", "FALL_DOUBLINGS", "FALL_HALF", "FALL_LARGEST")),
        (ecm, ("ASINH_REACH", "ASINH_HALVINGS")),
        (inputs, ("UNKNOWN_TEMPERATURE", "REPEATS_S")),
        (process, ("TINY_ROOT", "RESOLVED")),
        (ohmic, ("RECENT_S", "LEADS_S", "SMALL_LOAD", "STALE", "LASTS_S")),
        (bias, ("REST_S", "PLAUSIBLE")),
        (adapt, ("SCALE_S", "SCALE_MAX", "STEP_MAX_S", "VOLTAGE_ERROR_S", "FAST_S")),
        (voltage, ("AT_ONCE_S", "REPEATS_MOST")),
        (policy, ("STATUS_SHIFT", "SOC_SLACK", "SOC_BEYOND")),
        (interval, ("HALF_WIDTHS", "TAIL", "FAR", "SQRT_TWO_PI")),
    ):
        constants |= {name: getattr(module, name) for name in names}
    constants |= {f"FAULT_{fault.name}": int(fault) for fault in Fault}
    constants |= {f"STATUS_{status.name}": int(status) for status in Status}
    constants["ASINH"] = _initialiser(ecm.ASINH)
    for name in ("LOW", "HIGH", "MEAN", "QUANTILE"):
        constants[f"INTERVAL_{name}"] = "{" + ", ".join(map(_initialiser, getattr(interval, name))) + "}"
    return "".join(f"#define {name} {value}\n" for name, value in constants.items())


def _initialiser(numbers: tuple[float, ...]) -> str:
    return "{" + ", ".join(map(repr, numbers)) + "}"


@functools.cache
def library(bits: int, hysteresis: bool) -> Path:
    """Compile one variant into a temporary folder that lives as long as the process. `CC` chooses the compiler."""
    folder = Path(_folder().name)
    (folder / "layout.h").write_text(layout_header())
    built = folder / f"kernel_{bits}_{int(hysteresis)}.so"
    variant = (f"-DBITS={bits}", f"-DHYSTERESIS={int(hysteresis)}", f"-I{folder}")
    command = [os.environ.get("CC", "cc"), *STRICT, *OPTIMISED, *SHARED, *variant, str(SOURCE), "-o", str(built), "-lm"]
    subprocess.run(command, check=True)
    return built


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="bms-ukf-c-")


class CKernel:
    """The C kernel of a cell type: one cell (`step`, `replay`) and a pack of `cells` (`tick`, `replay_pack`).

    The buffers are `params`, `cell`, `pack`, and `io`, which has `layout.IO_ROWS` rows of `cells` numbers. `raw` has
    the C functions with their argument types set, `addresses` what they take first: for calls without these wrappers.
    A new kernel has no belief, and never gets one by itself: `adopt` one of an `Estimator`.
    """

    def __init__(self, cell: CellParams, tuning: Tuning | None = None, bits: int = 64, cells: int = 1) -> None:
        tuning = tuning or Tuning()
        if cell.dynamics.n_rc != 2 or cell.thermal is not None or not tuning.current_bias:
            raise ValueError("the C kernel has two RC pairs, a bias state and no core temperature")
        self.cells = cells
        self.raw = ctypes.CDLL(str(library(bits, cell.hysteresis is not None)))
        pointer, number, count = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
        self.raw.cell_adopt.argtypes = [pointer, pointer]
        self.raw.cell_step.argtypes = [pointer, pointer, number, number, number, number]
        self.raw.cell_replay.argtypes = [pointer, pointer, count, pointer, pointer]
        self.raw.pack_adopt.argtypes = [pointer, pointer, count, count]
        self.raw.pack_tick.argtypes = [pointer, pointer, pointer, count, number, number]
        self.raw.pack_replay.argtypes = [pointer, pointer, pointer, count, count, pointer, pointer]
        self.raw.pack_size.argtypes = [count]
        self.raw.cell_size.restype = self.raw.pack_size.restype = ctypes.c_size_t
        self.params = params(cell, tuning, bits)
        self.dtype = self.params.dtype
        self.cell = aligned(self.raw.cell_size() // self.dtype.itemsize, bits)
        self.pack = aligned(self.raw.pack_size(cells) // self.dtype.itemsize, bits)
        self.io = aligned(layout.IO_ROWS * cells, bits).reshape(layout.IO_ROWS, cells)
        self.addresses = {name: getattr(self, name).ctypes.data for name in ("params", "cell", "pack", "io")}
        self._one = self.addresses["params"], self.addresses["cell"]
        self._all = self.addresses["params"], self.addresses["pack"], self.addresses["io"], cells

    def adopt(self, estimator: Estimator) -> None:
        """Go on from the records of an `Estimator` of the same cells: in `cell` if it has one, else in `pack`."""
        if (estimator._state[:, layout.H_PARTS] > 0).any() or (estimator._state[:, layout.H_FRESH] > 0).any():
            raise ValueError("the C kernel has one Gaussian a cell")
        if estimator.cells == 1:
            self.raw.cell_adopt(self.addresses["cell"], estimator._state.ctypes.data)
        else:
            size = estimator._form.size
            self.raw.pack_adopt(self.addresses["pack"], estimator._state.ctypes.data, self.cells, size)

    @property
    def soc(self) -> float:
        """Published by the last step of the cell."""
        return float(self.cell[-4])  # the last numbers of `struct cell` are soc, sigma, low, high

    def step(self, dt: float, current: float, voltage: float, temperature: float) -> int:
        """Advance the cell by dt s to a sample (A, V, degC); returns the code that `kernel.entry.tick` returns."""
        return int(self.raw.cell_step(*self._one, dt, current, voltage, temperature))

    def replay(self, samples: Array) -> Array:
        """Step through `samples`, (n, 4): dt, current, voltage, temperature. Returns (n, 3): soc, soc_sigma, nis."""
        samples = np.ascontiguousarray(samples, self.dtype)
        results = np.empty((len(samples), 3), self.dtype)
        self.raw.cell_replay(*self._one, len(samples), samples.ctypes.data, results.ctypes.data)
        return results

    def tick(self, dt: float, current: float) -> int:
        """Advance the pack by dt s to a current, A, and what is in the `IN_*` rows of `io`; writes the `OUT_*` rows."""
        return int(self.raw.pack_tick(*self._all, dt, current))

    def replay_pack(self, drive: Array, measured: Array) -> int:
        """Tick through `drive`, (n, 2): dt, current, and `measured`, (n, 2, cells): voltages and temperatures."""
        drive, measured = np.ascontiguousarray(drive, self.dtype), np.ascontiguousarray(measured, self.dtype)
        return int(self.raw.pack_replay(*self._all, len(drive), drive.ctypes.data, measured.ctypes.data))
