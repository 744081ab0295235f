"""The compiled functions, float64: what Python calls. Nothing else in the kernel is compiled on its own.

Buffers are passed as integer addresses (see `memory`); the cells' records, `RECORD_SIZE` numbers each, lie one after
another. Compiling takes some seconds on a new machine and is cached on disk (NUMBA_CACHE_DIR).
"""

from __future__ import annotations

from bms_ukf.kernel import ecm
from bms_ukf.kernel import step as policy
from bms_ukf.kernel.layout import H_INPUT_TEMPERATURE, H_INPUT_VOLTAGE, N_RC, held_at, record_size
from bms_ukf.kernel.memory import entry, pointer_f64

N = 1 + N_RC
RECORD_SIZE = record_size(N)


@entry("int64(int64, int64, int64, float64, float64)")
def tick(params: int, state: int, cells: int, dt: float, current: float) -> int:
    """`step_cell` of every cell under one current (A), with the voltage and temperature in its record; dt >= 0 s.

    Returns the faults of all cells together (`records.Fault`) and, from bit STATUS_SHIFT up, a `records.Status`:
    INITIALISING if any cell's is, else the worst.
    """
    p = pointer_f64(params)
    s = pointer_f64(state)
    faults = 0
    worst = policy.OK
    initialising = False
    for cell in range(cells):
        o = cell * RECORD_SIZE
        h = o + held_at(N)
        code = policy.step_cell(p, s, o, N, dt, current, s[h + H_INPUT_VOLTAGE], s[h + H_INPUT_TEMPERATURE])
        faults |= code & policy.FAULT_MASK
        worst = max(worst, code >> policy.STATUS_SHIFT)
        initialising = initialising or code >> policy.STATUS_SHIFT == policy.INITIALISING
    return faults | ((policy.INITIALISING if initialising else worst) << policy.STATUS_SHIFT)


@entry("float64(int64, float64, float64)")
def ocv(params: int, soc: float, temperature: float) -> float:
    """Open-circuit voltage, V."""
    return ecm.ocv(pointer_f64(params), soc, temperature)  # type: ignore[no-any-return]


@entry("float64(int64, float64, float64, int64)")
def dynamics(params: int, soc: float, temperature: float, channel: int) -> float:
    """One of r0, r1, tau1, r2, tau2, knee (channel 0..5), ohm, s or A."""
    return ecm.dynamics(pointer_f64(params), soc, temperature, channel)  # type: ignore[no-any-return]
