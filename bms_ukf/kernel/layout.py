"""Where everything lies in the two flat buffers of the kernel: `params` (constant) and `state` (one record per cell).

`params` is a header, whose slots are the `P_*` indices, followed by the tables. `state` holds `cells` records of
`state_size(n)` numbers. In a record `n` is the number of filter states: SoC first, then the RC voltages.
"""

from __future__ import annotations

from bms_ukf.kernel.memory import inline

N_RC = 2
# The largest filter any variant may have. These size the vectors on the stack: x, packed sqrt_P, a dense n x n.
N_MAX = 5
PACKED_MAX = N_MAX * (N_MAX + 1) // 2
DENSE_MAX = N_MAX * N_MAX

# State index. SoC comes first: then the only sigma points that move SoC are +-gamma * sqrt_P[0, 0], and soc_sigma is
# sqrt_P[0, 0] itself.
SOC = 0
V_RC1 = 1

# Header of `params`.
P_CHARGE_COULOMB = 0  # capacity, A s
P_CE_CHARGE = 1  # coulombic efficiency while charging
P_VOLTAGE_MIN = 2  # plausible range of a voltage, V
P_VOLTAGE_MAX = 3
P_CURRENT_MIN = 4  # plausible range of a current, A (negative: charge)
P_CURRENT_MAX = 5
P_TEMPERATURE_MIN = 6  # plausible range of a temperature, degC
P_TEMPERATURE_MAX = 7
P_TABLE_TEMPERATURE_MIN = 8  # range the cell file vouches for, degC
P_TABLE_TEMPERATURE_MAX = 9
P_GAMMA = 10  # sigma points lie at +- gamma * (columns of sqrt_P)
P_W = 11  # weight of each sigma point but the central one
P_E2 = 12  # beta + alpha^2 (n + kappa - 1)
P_VAR_VOLTAGE = 13  # fast voltage error, sensor and model, V^2, of one reading a VOLTAGE_ERROR_S
P_R0_REL = 14  # relative error of r0
P_RC_REL = 15  # relative error of r1, r2
P_VAR_RC = 16  # N_RC slots: stationary variance of the model error carried by each RC voltage, V^2
P_VAR_RC2 = 17
P_CURRENT_OFFSET = 18  # one sigma of the current sensor's offset, A
P_SOC_WALK_OFFSET = 19  # growth of SoC variance from an unknown current offset, 1/s
P_SOC_WALK_GAIN = 20  # the same from an unknown current gain, 1/(s A^2)
P_GATE2 = 21  # a voltage is refused when innovation^2 > gate2 * its variance
P_REJECT_S = 22  # once voltages have been refused for so long the SoC believed is forgotten, s
P_CURRENT_TIMEOUT = 23  # how long a current is held, s
P_VOLTAGE_TIMEOUT = 24
P_TEMPERATURE_TIMEOUT = 25
P_CURRENT_RANGE = 26  # one sigma of the current while none is known, A
P_SOC_SIGMA_MAX = 27  # ceiling of soc_sigma
P_SOC_SIGMA_INVALID = 28  # a wider soc_sigma is not worth publishing
P_INITIAL_SOC = 29
P_INITIAL_SIGMA = 30
P_INITIAL_CURRENT = 31  # one sigma of the current before the first sample, A
P_WIDE_SIGMA = 32  # a soc_sigma above it is updated by quadrature
P_OCV = 33  # the two table descriptors, see the T_* offsets
P_DYN = 40
PARAMS_HEADER = 47

# A table descriptor: rows over temperature, knots over SoC, both uniform.
T_OFFSET = 0  # where its numbers start in `params`
T_ROWS = 1  # at least 2
T_ROW_SIZE = 2  # numbers per row
T_KNOTS = 3  # SoC intervals (OCV) or SoC knots minus 1 (dynamics): the same number
T_TEMP0 = 4  # degC of row 0
T_INV_DTEMP = 5  # 1/K
T_INV_DSOC = 6  # SoC 0 is knot 0

OCV_COEFFICIENTS = 4  # of each SoC interval: cubic in the fraction of the interval, constant term first
DYN_CHANNELS = 6  # of each SoC knot: r0, then r, tau of each RC pair, then the knee of r0


@inline
def tri(row: int, column: int) -> int:
    """Index of an element of a lower-triangular matrix packed by rows."""
    return row * (row + 1) // 2 + column


# One cell's record in `state`: the filter's own part first (x, then sqrt_P packed), then what steps leave for each
# other and for their caller.
def root_offset(n: int) -> int:
    return n


def held_offset(n: int) -> int:
    return n + n * (n + 1) // 2


def record_size(n: int) -> int:
    return held_offset(n) + H_B + n


root_at = inline(root_offset)
held_at = inline(held_offset)

# Offsets from held_at(n). An age or a value of NaN: never measured.
H_CURRENT = 0  # the last one accepted, A
H_TEMPERATURE = 1  # the last one accepted, degC
H_CURRENT_AGE = 2  # s since it was measured
H_TEMPERATURE_AGE = 3
H_VOLTAGE_AGE = 4  # s since a voltage was last fused; NaN: initialising
H_REJECTED_S = 5  # s since the first of an unbroken row of refused voltages; NaN: the last one was fused
H_GAP_S = 6  # s of charge not counted, in the present gap of the current
H_VOLTAGE_PRED = 7  # V, before fusing
H_INNOVATION = 8  # V; NaN: no voltage came
H_INNOVATION_VAR = 9  # V^2
H_ALPHA = 10  # the part of innovation_var that is not sqrt_P's: noise and curvature, V^2
H_INPUT_VOLTAGE = 11  # a pack's measurements are written here before its tick, V and degC; NaN: not measured
H_INPUT_TEMPERATURE = 12
H_HEARD_AGE = 13  # s since a plausible voltage came, fused or refused
H_B = 14  # n numbers: sqrt_P^-1 Pxz, V
