"""What `limits` is told, and the rows of what it gives."""

from __future__ import annotations

# Conditions for `limits`.
A_VOLTAGE_MIN = 0  # V
A_VOLTAGE_MAX = 1
A_CURRENT_MIN = 2  # A, negative: charge
A_CURRENT_MAX = 3
A_DISCHARGE_RATE = 4  # A, at which a cell is to be emptied
A_CHARGE_RATE = 5  # A, negative, and filled
A_SECONDS = 6  # length of a pulse
A_MOVED = 7  # charge whose energy is asked for, A s, negative: to be charged
A_DRAIN = 8  # and the current it flows at, A
CONDITIONS = 9

# Rows of what `limits` gives.
L_EMPTY = 0  # SoC at which the cell is empty at that rate, 0..1
L_FULL = 1
L_DISCHARGE = 2  # A, of a pulse; then the same of a charge, <= 0
L_SIGMA = 1  # offsets from these: one sigma, A
L_VOLTAGE = 2  # terminal voltage at its end, V
L_OHM = 3  # and how fast that falls with the current, ohm
L_CHARGE = 6
L_MEAN_V = 10  # V
LIMIT_ROWS = 11
