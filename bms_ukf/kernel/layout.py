"""Where everything lies in the kernel's flat buffers: `params` (constant), `state` (the cells' records), `io`.

`params` is a header, whose slots are the `P_*` indices, followed by the tables.

`state` holds the cells in blocks of `Form.lanes`, slot by slot: slot k of lane c of a block stands at `lanes k + c`. So
a loop over the lanes meets neighbouring numbers and becomes vector instructions, and one cell alone (lanes = 1) is a
plain record. A record is: what the policy holds (`H_*`), x, sqrt_P packed by rows, the carries of x (float32 only), and
the cached part of the dynamics table (`C_*`).

`io` holds rows of one number per cell: the measurements that a caller writes (`IN_*`) and the results (`OUT_*`).
"""

from __future__ import annotations

from typing import NamedTuple

from bms_ukf.kernel.jit import inline

LANES = 16  # cells in a block of a pack. A float64 vector register holds 2 to 8: more lanes hide latency
PARTS = 24  # components of a belief of any shape
PART_LANES = 24  # handled in one loop: LLVM makes vector instructions of a loop over 16 or more lanes only

# The largest filter: SoC, three RC voltages, hysteresis, slow voltage error, r0 error, bias. These size the vectors on
# the stack.
N_MAX = 8
DENSE_MAX = N_MAX * N_MAX
N_RC_MAX = 3

SOC = 0  # SoC comes first: only the two sigma points along the first column of sqrt_P move it
V_RC1 = 1  # the voltages follow: v_rc1.., hysteresis, the slow voltage error; then the r0 error; last the bias, if any


class Form(NamedTuple):
    """A model variant and where its parts lie; constants of a compiled kernel. Make it by `form`."""

    n_rc: int
    hysteresis: int  # 0 or 1
    bias: int  # 0 or 1
    core: int  # 1: the core is warmer than the surface
    lanes: int
    compensated: int  # 1: x carries what rounding takes from it
    part_lanes: int  # components of a belief of any shape that one loop handles (`parts`); 0: it has no such belief
    n: int  # filter states
    n_pol: int  # of which polarisation voltages: RC pairs and hysteresis
    n_v: int  # and all voltages: one more, the slow voltage error
    r0: int  # index of the relative error of r0
    channels: int  # of the dynamics table
    x: int  # slots of a record
    root: int
    carry: int
    cache: int
    size: int
    parts: int  # numbers that the components of one cell take, beside its record

    @property
    def variant(self) -> tuple[int, int, int, int, int, int, int]:
        """The arguments of `form`."""
        return self[:7]


def form(n_rc: int, hysteresis: int, bias: int, core: int, lanes: int, compensated: int, part_lanes: int = 0) -> Form:
    n_pol = n_rc + hysteresis
    n_v = n_pol + 1
    r0 = 1 + n_v
    n = 1 + r0 + bias
    x = HELD
    root = x + n
    carry = root + n * (n + 1) // 2
    cache = carry + n * compensated
    channels = D_RC1 + 2 * n_rc + hysteresis
    size = cache + C_VALUES + 2 * channels
    # One component at a time keeps no table row, only where it was read: a small machine has less memory than time.
    component = (cache + C_VALUES if part_lanes == 1 else size) - HELD
    parts = PARTS * (1 + component) if part_lanes else 0
    return Form(
        n_rc,
        hysteresis,
        bias,
        core,
        lanes,
        compensated,
        part_lanes,
        n,
        n_pol,
        n_v,
        r0,
        channels,
        x,
        root,
        carry,
        cache,
        size,
        parts,
    )


form_at_compile_time = inline(form)  # a compiled function's closure may hold integers only, so it makes its form anew


@inline
def tri(row: int, column: int) -> int:
    """Index of an element of a lower-triangular matrix packed by rows."""
    return row * (row + 1) // 2 + column


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
P_VAR_VOLTAGE = 13  # noise of the voltage, V^2, of one reading a VOLTAGE_ERROR_S
P_FAST_REL = 14  # fast voltage error after a change of the current, as a share of the ohmic drop of that change
P_RC_REL = 15  # relative error of r1..
P_VAR_V = 16  # N_RC_MAX + 1 slots: stationary variance of the model error each voltage state carries, V^2
P_SLOW_REL = 20  # one sigma of the slow voltage error in proportion to the polarisation
P_SOC_WALK_OFFSET = 21  # growth of SoC variance from an unknown current offset, 1/s
P_SOC_WALK_GAIN = 22  # the same per charge moved, from an unknown current gain and capacity, 1/(A s)
P_BIAS_SIGMA = 23  # stationary sigma of the bias state, A
P_BIAS_TAU = 24  # and its correlation time, s
P_HYSTERESIS_RATE = 25  # of the hysteresis voltage's way to its target per charge moved, 1/(A s)
P_CORE_K_PER_W = 26  # core above surface temperature per loss
P_CORE_TAU = 27
P_GATE2 = 28  # a voltage is refused when innovation^2 > gate2 * its variance
P_REJECT_S = 29  # once voltages have been refused for so long the belief is doubted, s
P_CURRENT_TIMEOUT = 30  # how long a current is held, s
P_VOLTAGE_TIMEOUT = 31
P_TEMPERATURE_TIMEOUT = 32
P_CURRENT_RANGE = 33  # one sigma of the current while none is known, A
P_SOC_SIGMA_MIN = 34  # floor and ceiling of soc_sigma
P_SOC_SIGMA_MAX = 35
P_OK_HALF_WIDTH = 36  # half of the 95 % interval of SoC up to which a cell is ok
P_INITIAL_SOC = 37
P_INITIAL_SIGMA = 38
P_INITIAL_CURRENT = 39  # one sigma of the current before the first sample, A
P_WIDE_SIGMA = 40  # components take over a belief with a soc_sigma above it (`parts`); `Filter` uses a quadrature
P_CACHE_TEMPERATURE = 41  # a cached table row serves until the temperature has moved by more, K
P_STILL = 42  # a current that moves by no more is the same, A
P_PARASITIC = 43  # one sigma of what a cell that seems to rest may yet give, A
P_ADAPT = 44  # 1: the variance of the fast voltage error follows the innovations (`adapt`)
P_EXCITED = 45  # a current that differs by more from the reading at rest is a load, A
P_OCV = 46  # the two table descriptors, see the T_* offsets
P_DYN = 52
P_ALIKE = 58  # correlation of the cells' errors where they tell their current's offset
P_SLOW_VAR = 59  # stationary variance of the slow voltage error, V^2
P_SLOW_TAU = 60  # and its correlation time, s
P_SLOW_RATE = 61  # the same per charge moved, 1/(A s): at another SoC the OCV errs otherwise
P_R0_VAR = 62  # stationary variance of the relative error of the resistances
P_R0_TAU = 63  # and its correlation time, s
P_R0_RATE = 64  # the same per charge moved, 1/(A s)
P_HISTORY = 65  # one sigma of the mean current before a first sample under load, A
P_INVALID_HALF_WIDTH = 66  # half of the interval up to which a cell has a SoC at all
P_FAST_VAR = 67  # variance of the model's error that lasts FAST_S, V^2
PARAMS_HEADER = 68

# A table descriptor: rows over temperature, knots over SoC, both uniform.
T_OFFSET = 0  # where its numbers start in `params`
T_ROWS = 1  # at least 2
T_ROW_SIZE = 2  # numbers per row
T_INTERVALS = 3  # of SoC, from 0 to 1
T_TEMP0 = 4  # degC of row 0
T_INV_DTEMP = 5  # 1/K

OCV_COEFFICIENTS = 4  # of each SoC interval: cubic in the fraction of the interval, constant term first

# Channels of the dynamics table at each SoC knot.
D_R0 = 0  # ohm, on discharge
D_R0_CHARGE = 1
D_KNEE = 2  # A
D_ERROR = 3  # how many times the sigmas of [noise] the model errs here
D_RC1 = 4  # r1, tau1, then r2, tau2.. (ohm, s), then the largest hysteresis voltage (V)
CHANNELS_MAX = D_RC1 + 2 * N_RC_MAX + 1

# A record: what the policy holds. An age or a value of NaN: never measured.
H_CURRENT = 0  # the last one accepted, A
H_TEMPERATURE = 1  # the last one accepted, degC
H_CURRENT_AGE = 2  # s since it was measured
H_TEMPERATURE_AGE = 3
H_VOLTAGE_AGE = 4  # s since a voltage was last fused; NaN: initialising
H_HEARD_AGE = 5  # s since a plausible voltage came, fused or refused
H_REJECTED_S = 6  # s since the first of an unbroken row of refused voltages; NaN: the last one was fused
H_GAP_S = 7  # s of charge not counted, in the present gap of the current
H_CORE_RISE = 8  # core above surface temperature, K
H_SOC_WALK = 9  # growth of SoC's variance that a float32 root cannot show yet
H_FRESH = 10  # 1: no voltage has been fused yet into this belief
H_VOLTAGE_SCALE = 11  # variance of noise and fast voltage error, as a multiple of the cell file's (`adapt`)
H_STILL_A = 12  # the current that has not moved since
H_STILL_S = 13  # so many s
H_REST_A = 14  # what the current sensor showed at the last rest, A; NaN: there was none
H_LOADED = 15  # 1: a load was seen since
H_PER_CAPACITY = 16  # the cell file's capacity over the cell's own; NaN: 1
H_RESISTANCE = 17  # the cell's resistances over the cell file's; NaN: 1
H_SHARED = 18  # what all cells of a string know of their current's offset: its mean, A (`shared`)
H_SHARED_VAR = 19  # and its variance, A^2
H_THROUGH = 20  # the current of the cell: its string's and what balancing takes, A; in y it kept loops from vectors
H_RECENT = 21  # low-pass of the ohmic drop by the cell file's r0, over RECENT_S, without the last sample, V
H_UNSEEN_S = 22  # s of unknown current since a voltage was last fused
H_PARTS = 23  # 1: the belief is that of the components (`parts`); x and sqrt_P are its mean and covariance
H_PART_WIDTH = 24  # SoC between the components' centres when they were last placed, of each history
H_PART_GROUPS = 26  # histories that are kept apart: 2 or 1
H_PART_S = 27  # s since the components took over
H_PART_WALK = 28  # as H_SOC_WALK, of the components
H_LAST_V = 29  # the last plausible voltage, V
H_REPEATS = 30  # share of the voltages that repeat the one before, over REPEATS_S; NaN: 0
H_POLARISED = 31  # N_RC_MAX slots: voltage of each RC pair by the current alone, V, whatever was measured
H_USED = 34  # H_RECENT and the lead (`ohmic`) of the last sample that moved time on, V; others of its instant use them
H_LEAD = 35
H_CORE_USED = 36  # H_CORE_RISE at which the last sample that moved time on read its tables, K; for the same reason
H_LEAN = 37  # mean of the innovations over `adapt.SCALE_S`, in their own sigmas: 0 of a belief that is right
HELD = 38

# Offsets in a record's cache: two numbers per channel follow, the value at the knot and its rise to the next.
C_KNOT = 0  # SoC knot; NaN: nothing cached
C_TEMPERATURE = 1
C_VALUES = 2

# The step's own values, a slot per lane as in a record.
Y_VOLTAGE = 0  # measured and plausible, V, else NaN
Y_KNOWN = 1  # s of the step whose current is known
Y_GAP = 2  # s of it whose current is not
Y_CODE = 3  # fault bits, as a number: lanes of one type
Y_ALIVE = 4  # 1: has a belief
Y_SOC = 5  # where the tables are read: the mean predicted; at the end the SoC published
Y_T = 6  # temperature the tables are read at
Y_DROP = 7  # ohmic drop, V
Y_SCALED = 8  # and what the error of r0 scales of it, V
Y_DROP_SIGMA = 9
Y_OCV_AT = 10  # place of the OCV interval of each of three sigma points
Y_OCV_D = 13  # fraction of the interval; then the OCV
Y_OCV_F = 16  # fraction of the way between two temperature rows
Y_PREDICTED = 17
Y_INNOVATION = 18
Y_VARIANCE = 19
Y_ALPHA = 20  # the part of the variance that is not sqrt_P's: noise and curvature, V^2
Y_NOISE = 21  # and of that, noise
Y_FUSE = 22  # what to do with the voltage: one of those below
Y_STALE = 23  # 1: the cached table row does not serve
Y_NIS = 24
Y_BIAS = 25  # A
Y_R0 = 26  # in the direction of the current, ohm: by the cell file, published by the belief
Y_OHMIC = 27  # ohmic drop by the cell file's r0, V; NaN: at an unknown current
Y_SINCE_HEARD = 28  # s since the voltage before this one
Y_TRUST = 29  # share of its Kalman gain that the bias takes from this measurement, 0..1
Y_RESTED = 30  # 1: a rest shows what the one before it showed
Y_PER_VARIANCE = 31  # 1 / Y_VARIANCE
Y_SCALE = 32  # how much larger the current over the knee is than what the ohmic drop's logarithm is taken of
Y_COSH = 33  # on the way there
Y_SOC_SIGMA = 34  # published, as Y_SOC is (`interval`)
Y_SOC_LOW = 35
Y_SOC_HIGH = 36
Y_WALK = 37  # growth of SoC's variance in this step
Y_RESOLVED = 38  # and what of that the root of this step can show
Y_LEAD = 39  # voltage that an r0 of twice the size would take, V, as far as it has stood for RECENT_S
Y_PARTS_LOW = 40  # 2.5 % quantile, mean and 97.5 % quantile of SoC by the components; NaN: there are none
Y_PARTS_MEAN = 41
Y_PARTS_HIGH = 42
Y_SHOWN = 43  # A, what a rest shows of the current sensor's offset in this sample, NaN: nothing; and its variance
Y_SHOWN_VAR = 44
Y_CROWDED = 45  # part of Y_VARIANCE that is there because readings crowd: no reading by itself is off by it, V^2
Y_B = 46  # N_MAX slots: sqrt_P^-1 Pxz, V
Y_DYN = Y_B + N_MAX  # CHANNELS_MAX slots
Y_FALL = Y_DYN + CHANNELS_MAX  # of each voltage, slow error included, then of the core: 1 - exp(-time / tau)
Y_FADE = Y_FALL + N_RC_MAX + 4  # the same over the gap
VALUES = Y_FADE + N_RC_MAX + 3

# What `voltage.compare` decides.
DOUBT = -1  # refused for so long that it is the belief that is wrong
IGNORE = 0
BY_SIGMA_POINTS = 1
BY_QUADRATURE = 2
BY_PARTS = 3

# Rows of `io`.
IN_VOLTAGE = 0  # V; NaN: not measured
IN_TEMPERATURE = 1  # degC
IN_OFFSET = 2  # A, what the current sensor shows while none can flow; NaN: that is not known
IN_CURRENT = 3  # A, of the cell's own string; NaN: the current of the tick
IN_BLEED = 4  # A, what balancing takes from the cell beside it, positive = discharge; NaN: 0
OUT_SOC = 5  # 0..1
OUT_SOC_SIGMA = 6
OUT_VOLTAGE_PRED = 7  # V, before fusing; NaN here and below: nothing to compare
OUT_INNOVATION = 8  # V
OUT_INNOVATION_VAR = 9  # V^2
OUT_NIS = 10
OUT_AGE = 11  # s since a voltage was fused
OUT_BIAS = 12  # A; NaN without a bias state
OUT_R0 = 13  # ohm, in the direction of the current, as tracked
OUT_CODE = 14  # faults and status of the cell, as the tick returns those of all
OUT_SOC_LOW = 15  # 2.5 % and 97.5 % quantile of SoC, 0..1
OUT_SOC_HIGH = 16
IO_ROWS = 17
