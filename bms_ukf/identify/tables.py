"""The unknowns of the fit and what is believed of them before any data: where they stand, and how smooth they are.

One vector holds, in this order: the logarithms of the tables (some over SoC and temperature, some over temperature
only), the log of the hysteresis rate, corrections of the OCV, and the log of how much faster than counted the SoC
falls, by temperature. Beliefs are linear: rows of a matrix B and targets b, with B x - b in units of one millivolt of
misfit, so that they decide only where the recordings say little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf.cell import NO_KNEE_A, ZERO_CELSIUS_K
from bms_ukf.identify.simulate import HYSTERESIS, KNEE, R0, R0_CHARGE, R1

Array = NDArray[np.float64]
Real = NDArray[np.floating[Any]]

SOC = np.array([0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0])
OCV_SOC = np.linspace(0, 1, 14)
ACTIVATION_K = 3000.0  # r ~ exp(ACTIVATION_K / T): about 25 kJ/mol, what cells show between 0 and 40 degC

TAU_START_S = (10.0, 100.0, 1000.0)
# Apart: the faster first, at any temperature. Rows are a second apart: a faster pair would be r0 under another name.
TAU_LIMITS_S = ((1.5, 25.0), (25.0, 200.0), (200.0, 2e4))
SLOWEST_S = 2e4  # the last pair, whichever it is, may be as slow
RATE_START = 50.0  # hysteresis: a branch is reached after some 2 % of SoC
LEAST_HYSTERESIS_V = 1e-4

# How strongly, in mV for a change of 1 in a logarithm: kink from SoC knot to knot, kink over 1000/T, step between
# neighbouring temperatures off the Arrhenius line, the same for what should hardly depend on temperature, level, rate.
KINK_SOC, KINK_T, ARRHENIUS, HELD, LEVEL, RATE = 30.0, 9.0, 3.0, 30.0, 1.0, 20.0
TRANSFER = 30.0  # mV for a change of 1 in the log of r0 times knee, between neighbouring temperatures
DIFFUSION = 1.0  # power of the OCV slope in the third resistance: a lag of the SoC at the surface makes 1
STEP_SOC = 30.0  # from knot to knot: where nothing is known, a table goes on as it was
HYSTERESIS_LEVEL = 30.0  # its width is measured by the slow test
# OCV correction: mV per mV of kink, of size and of difference between neighbouring temperatures.
OCV_KINK, OCV_SIZE, OCV_BETWEEN = 30.0, 2.7, 1.0
OCV_SIZE_BOTH = 10.0  # with both branches the slow test has no polarisation left in it
# SoC scale: mV per unit of log scale, of kink over 1000/T, of difference between neighbouring temperatures.
SCALE_SIZE, SCALE_KINK, SCALE_BETWEEN = 2000.0, 100.0, 300.0


@dataclass(slots=True, frozen=True)
class Core:
    """A temperature of the tables that follows the heat of the load: K/W for each 1/Ah and s, start and limits."""

    name: str
    start: tuple[float, float]
    lower: tuple[float, float]
    upper: tuple[float, float]


# Two things make a loaded cell differ from its surface temperature: its core is warmer, and its electrodes deplete,
# which raises the resistances as if it were colder. The sign of K/W says which of them prevails.
CORES = (
    Core("warmer core", (3.0, 600.0), (0.0, 100.0), (60.0, 5000.0)),
    Core("depletion under load", (-9.0, 80.0), (-30.0, 20.0), (0.0, 300.0)),
)
CORE_WEIGHT = (1.0, 100.0)  # mV for 1 K Ah/W, and for leaving the start of the time constant by a factor of e


@dataclass(slots=True, frozen=True)
class Structure:
    """What the model has; chosen by the error on rows left out of the fit."""

    pairs: int
    hysteresis: bool = False
    core: Core | None = None
    knee: bool = True  # of r0 with the current
    charge: bool = True  # an r0 of its own on charge

    def __str__(self) -> str:
        parts = [f"{self.pairs} RC"]
        parts += ["hysteresis"] if self.hysteresis else []
        parts += [] if self.knee else ["r0 without knee"]
        parts += [] if self.charge else ["one r0 for both directions"]
        return ", ".join([*parts, self.core.name] if self.core else parts)


class Unknowns:
    """The vector of unknowns for a structure, as linear maps: to the tables, and to what is believed of it.

    tables = (to_tables @ x[:n_tables] + offset) in logarithms, shape (channels, temperatures, soc). After the tables
    come the log of the hysteresis rate (as charge / capacity; there even without hysteresis), the OCV corrections,
    shape (temperatures, OCV_SOC), V, and the log of the SoC scale, shape (temperatures,).
    """

    def __init__(
        self,
        structure: Structure,
        temperature_degC: Array,
        capacity_Ah: float,
        ocv_slope_V: Array,
        half_width_V: Array | None,
        *,
        both_branches: bool,
    ) -> None:
        self.structure = structure
        self.both_branches = both_branches
        self.temperature_degC = temperature_degC
        self.inverse_K = -1000 / (temperature_degC + ZERO_CELSIUS_K)
        self.shape = (R1 + 2 * structure.pairs, temperature_degC.size, SOC.size)
        self._maps: list[Array] = []
        self._limits: list[tuple[slice, float, float]] = []
        self._starts: list[Array] = []
        self._beliefs: list[tuple[int, Array, Array]] = []  # first column, rows of the matrix, targets
        self.offset = np.zeros(self.shape)

        # With r ~ 0.1 V / capacity at 25 degC; the knee moves against the resistance.
        arrhenius = ACTIVATION_K / 1000 * (-self.inverse_K - 1000 / (25 + ZERO_CELSIUS_K))
        r_start = np.log(0.1 / capacity_Ah) + arrhenius
        least, most = 1e-4 / capacity_Ah, 5.0 / capacity_Ah  # ohm
        self._table((R0, R0_CHARGE), r_start, (least, most), over_soc=True)
        if structure.charge:
            self._table((R0_CHARGE,), np.zeros_like(arrhenius), (0.3, 3.0), over_soc=False, held=True)
        if structure.knee:
            knee = np.log(2.0 * capacity_Ah) - arrhenius
            self._table((KNEE,), knee, (0.02 * capacity_Ah, 1000 * capacity_Ah), over_soc=False)
            self._believe_in_charge_transfer()
        else:
            self.offset[KNEE] = np.log(NO_KNEE_A)
        if half_width_V is not None:
            self.offset[HYSTERESIS] = np.log(np.maximum(half_width_V, LEAST_HYSTERESIS_V))
            self._table(
                (HYSTERESIS,), np.zeros_like(arrhenius), (0.3, 3.0), over_soc=False, held=True, level=HYSTERESIS_LEVEL
            )
        for j in range(structure.pairs):
            shape = DIFFUSION * np.log(ocv_slope_V) if j == 2 else 0.0
            self._table((R1 + 2 * j,), r_start - 0.7, (least, most), over_soc=True, shape=shape)
            tau = np.full_like(arrhenius, np.log(TAU_START_S[j]))
            fastest_s, slowest_s = TAU_LIMITS_S[j]
            limits = (fastest_s, slowest_s if j + 1 < structure.pairs else SLOWEST_S)
            self._table((R1 + 2 * j + 1,), tau, limits, over_soc=False, held=True)
        self.to_tables = np.hstack(self._maps)
        self.n_tables = self.to_tables.shape[1]
        self.rate = self.n_tables
        self.ocv = slice(self.rate + 1, self.rate + 1 + temperature_degC.size * OCV_SOC.size)
        self.scale = slice(self.ocv.stop, self.ocv.stop + temperature_degC.size)
        self.size = self.scale.stop
        self._believe_the_rest()
        self.start = np.concatenate([*self._starts, np.zeros(self.size - self.n_tables)])
        self.start[self.rate] = np.log(RATE_START)
        self.prior, self.prior_target = self._beliefs_together()

    def tables(self, x: Array) -> Array:
        """Logarithms of all tables, shape (channels, temperatures, soc)."""
        return np.asarray(self.offset + (self.to_tables @ x[: self.n_tables]).reshape(self.shape))

    def limits(self) -> list[tuple[slice, float, float]]:
        """Columns of the vector and the range they stay in."""
        return [*self._limits, (slice(self.rate, self.rate + 1), np.log(2.0), np.log(2000.0))]

    def correction_V(self, x: Array) -> Array:
        """Correction of the OCV at `OCV_SOC`, shape (temperatures, OCV_SOC)."""
        return x[self.ocv].reshape(-1, OCV_SOC.size)

    def _table(
        self,
        channels: tuple[int, ...],
        start: Array,
        limits: tuple[float, float],
        *,
        over_soc: bool,
        held: bool = False,
        level: float | None = None,
        shape: Array | float = 0.0,
    ) -> None:
        """Unknowns of a table, over temperature and perhaps SoC, and what is believed of them.

        `held`: the table is near its neighbour in temperature; else it is near an Arrhenius line of the start's slope.
        """
        _, rows, knots = self.shape
        along_soc = np.eye(knots) if over_soc else np.ones((knots, 1))
        one = np.kron(np.eye(rows), along_soc)
        to_tables = np.zeros((np.prod(self.shape), one.shape[1]))
        for channel in channels:
            to_tables[channel * rows * knots : (channel + 1) * rows * knots] += one
        first = sum(part.size for part in self._starts)
        self._maps.append(to_tables)
        low, high = np.log(limits)
        self._limits.append((slice(first, first + one.shape[1]), low, high))
        self._starts.append((start[:, None] + np.broadcast_to(shape, along_soc.shape[1])).ravel())
        each = np.eye(along_soc.shape[1])
        self._believe(first, KINK_T * np.kron(second_difference(self.inverse_K), each))
        difference = np.kron(np.diff(np.eye(rows), axis=0), each)
        strength = HELD if held else ARRHENIUS
        self._believe(first, strength * difference, strength * difference @ self._starts[-1])
        level = LEVEL if level is None else level
        self._believe(first, level * np.eye(one.shape[1]), level * self._starts[-1])
        if over_soc:
            for strength, order in ((KINK_SOC, 2), (STEP_SOC, 1)):
                along = strength * np.kron(np.eye(rows), np.diff(np.eye(knots), order, axis=0))
                self._believe(first, along, along @ self._starts[-1])

    def _believe_in_charge_transfer(self) -> None:
        """Believe r0 knee ~ T, as a charge transfer has it; else rows share one voltage out to r0 and knee at will."""
        rows = self.temperature_degC.size
        between = np.diff(np.eye(rows), axis=0)
        mean_r0 = np.kron(between, np.full(SOC.size, 1 / SOC.size))
        unused = np.zeros((rows - 1, rows * self.structure.charge))
        target = between @ np.log(self.temperature_degC + ZERO_CELSIUS_K)
        self._believe(0, TRANSFER * np.hstack([mean_r0, unused, between]), TRANSFER * target)

    def _believe_the_rest(self) -> None:
        rows = self.temperature_degC.size
        between, kink_T = np.diff(np.eye(rows), axis=0), second_difference(self.inverse_K)
        self._believe(self.rate, np.full((1, 1), RATE), np.full(1, RATE * np.log(RATE_START)))
        each = np.eye(OCV_SOC.size)
        for matrix in (
            OCV_KINK * np.kron(np.eye(rows), np.diff(each, 2, axis=0)),
            (OCV_SIZE_BOTH if self.both_branches else OCV_SIZE) * np.eye(rows * OCV_SOC.size),
            OCV_BETWEEN * np.kron(between, each),
        ):
            self._believe(self.ocv.start, 1e3 * matrix)
        for matrix in (SCALE_SIZE * np.eye(rows), SCALE_KINK * kink_T, SCALE_BETWEEN * between):
            self._believe(self.scale.start, matrix)

    def _beliefs_together(self) -> tuple[Array, Array]:
        """Matrix and targets of all beliefs, in as few rows as there are unknowns: of the same least squares."""
        matrix = np.zeros((sum(len(rows) for _, rows, _ in self._beliefs), self.size))
        row = 0
        for first, rows, _ in self._beliefs:
            matrix[row : row + len(rows), first : first + rows.shape[1]] = rows
            row += len(rows)
        q, r = np.linalg.qr(matrix)
        return r, q.T @ np.concatenate([target for _, _, target in self._beliefs])

    def _believe(self, first: int, rows: Real, target: Array | None = None) -> None:
        target = np.zeros(len(rows)) if target is None else target
        self._beliefs.append((first, np.asarray(rows, dtype=np.float64), target))


def second_difference(x: Array) -> Array:
    """Rows that give the change of slope at every inner knot of an uneven grid, shape (n - 2, n)."""
    slopes = np.diff(np.eye(x.size), axis=0) / np.diff(x)[:, None]
    return np.diff(slopes, axis=0)
