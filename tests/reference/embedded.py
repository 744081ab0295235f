"""An exported estimator of this machine, loaded into this process without a linker, and called as C would."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import numpy as np
from llvmlite import binding as llvm

from bms_ukf.firmware.targets import TARGETS


class Embedded:
    """What a C program does with the folder that `export firmware --target host` wrote."""

    def __init__(self, folder: Path) -> None:
        self.macros = dict(re.findall(r"^#define BMS_UKF_(\w+) +(\d+)u?\b", (folder / "bms_ukf.h").read_text(), re.M))
        double = "typedef double" in (folder / "bms_ukf.h").read_text()
        self.dtype, self.real = (np.float64, ctypes.c_double) if double else (np.float32, ctypes.c_float)
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), TARGETS["host"].machine())
        self._engine.add_object_file(llvm.ObjectFileRef.from_path(str(folder / "bms_ukf.o")))
        self._engine.finalize_object()
        pointer, word = ctypes.c_void_p, ctypes.c_uint32
        self._init = self._function("init", None, pointer)
        self._step = self._function("step", word, pointer, pointer, word, self.real, pointer, pointer, word)
        self._get = self._function("get", self.real, pointer, word, word)
        self.cells = int(self.macros["CELLS"])
        self.state = np.empty(int(self.macros["STATE_SIZE"]), self.dtype)
        self.work = np.empty(int(self.macros["WORK_SIZE"]), self.dtype)
        self._init(self.state.ctypes.data)

    def step(self, time_ms: int, current_A: float, voltage_V, temperature_degC, contactor_open: bool = False) -> int:
        voltage = np.full(self.cells, voltage_V, self.dtype)
        temperature = np.full(self.cells, temperature_degC, self.dtype)
        self.work[:] = np.nan  # nothing in it outlives a step
        return self._step(
            self.state.ctypes.data,
            self.work.ctypes.data,
            time_ms % 2**32,
            current_A,
            voltage.ctypes.data,
            temperature.ctypes.data,
            contactor_open,
        )

    def get(self, what: str, cell: int = 0) -> float:
        return self._get(self.state.ctypes.data, int(self.macros[what]), cell)

    def _function(self, name: str, *types):
        return ctypes.CFUNCTYPE(*types)(self._engine.get_function_address(f"bms_ukf_{name}"))
