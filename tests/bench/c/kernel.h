/* The filter step of bms_ukf/kernel as C, by hand: what the benchmark compares with. Two RC pairs, a bias, no core.
 *
 * Compile with -DBITS=64 or 32 (numbers) and -DHYSTERESIS=0 or 1 (a further state). `params` is the buffer that
 * bms_ukf.kernel.params.params makes; layout.h, its slots, is written from the Python at build time (c_kernel.py).
 *
 * Only the path of one Gaussian is here. A cell takes over the record of an Estimator whose belief is one Gaussian
 * (`cell_adopt`, `pack_adopt`), and is right while that belief stays narrow. Left out: the components of a wide belief
 * and with them a first belief, a belief doubted after P_REJECT_S, an offset read while no current can flow, the
 * offset that cells exchange, a cell's own capacity, resistances, current and bleed, and the blocks that a part of an
 * instant leaves as they are.
 */
#ifndef KERNEL_H
#define KERNEL_H

#include <stddef.h>
#include <stdint.h>

#include "layout.h"

#if BITS == 32
typedef float real;
typedef int32_t whole; /* of the same width, so that flags and numbers share vector registers */
#else
typedef double real;
typedef int64_t whole;
#endif

enum {
    N_RC = 2,
    N_POL = N_RC + HYSTERESIS, /* polarisation voltages */
    N_V = N_POL + 1,           /* all voltages: the slow error, too */
    SLOW = N_V,                /* the states: soc, v_rc1, v_rc2, hysteresis, slow voltage error, error of r0, bias */
    R0 = SLOW + 1,
    BIAS = R0 + 1,
    N = BIAS + 1,
    ROOTS = N * (N + 1) / 2,
    CHANNELS = D_RC1 + 2 * N_RC + HYSTERESIS,
    COMPENSATED = BITS == 32,
    SAMPLE = 4, /* numbers of a sample: dt, current, voltage, temperature */
    RESULT = 3  /* of a result: soc, soc_sigma, nis */
};

struct belief {
    real x[N];
    real root[N][N]; /* sqrt_P, lower triangle */
    real carry[N];   /* of x, if COMPENSATED: what rounding took off */
};

/* What a cell holds beside its belief, and the slot of layout.py that has it. An age or a value of NaN: never measured.
 * soc_walk, if COMPENSATED: growth of SoC's variance that the root cannot show yet. */
#define HELD_SLOTS(SLOT)                                                                                              \
    SLOT(temperature, H_TEMPERATURE) SLOT(temperature_age, H_TEMPERATURE_AGE) SLOT(voltage_age, H_VOLTAGE_AGE)        \
    SLOT(heard_age, H_HEARD_AGE) SLOT(rejected_s, H_REJECTED_S) SLOT(last_V, H_LAST_V) SLOT(repeats, H_REPEATS)       \
    SLOT(voltage_scale, H_VOLTAGE_SCALE) SLOT(recent, H_RECENT) SLOT(used, H_USED) SLOT(lead, H_LEAD)                 \
    SLOT(soc_walk, H_SOC_WALK)

struct held {
#define SLOT(name, slot) real name;
    HELD_SLOTS(SLOT)
#undef SLOT
    real polarised[N_RC]; /* voltage of each RC pair by the current alone */
};

/* The current, and how long it has not moved. */
struct sensor {
    real current, age, gap_s;
    real still_A, still_s, rest_A, loaded;
};

struct cell {
    struct sensor sensor;
    struct held held;
    struct belief belief;
    real voltage_pred, innovation, innovation_var, nis; /* of the last step; NaN: nothing compared */
    real soc, sigma, low, high;                         /* published */
};

/* The same for LANES cells, and their rows of the dynamics table. */
struct lanes {
#define SLOT(name, slot) real name[LANES];
    HELD_SLOTS(SLOT)
#undef SLOT
    real polarised[N_RC][LANES];
    real x[N][LANES], root[ROOTS][LANES], carry[N][LANES];
};

struct block {
    struct lanes lanes;
    real knot[LANES], row_temperature[LANES]; /* NaN: nothing cached */
    real value[CHANNELS][LANES], rise[CHANNELS][LANES];
};

/* Cells in series: one current for all. */
struct pack {
    struct sensor sensor;
    _Alignas(64) struct block blocks[];
};

/* Take over the record, or the blocks of records, of an Estimator. `size`: slots of a record. */
void cell_adopt(struct cell *cell, const real *record);
void pack_adopt(struct pack *pack, const real *state, long cells, long size);

/* All return faults and, from bit STATUS_SHIFT up, a status, as bms_ukf.kernel.entry.tick does. */
int cell_step(const real *params, struct cell *cell, double dt_s, double current_A, double voltage_V,
              double temperature_degC);
int cell_replay(const real *params, struct cell *cell, long n, const real *samples, real *results);

/* `io`: IO_ROWS rows of `cells` numbers (IN_*, OUT_*). */
int pack_tick(const real *params, struct pack *pack, real *io, long cells, double dt_s, double current_A);
/* `drive`: n times dt and current; `measured`: n times the voltages, then the temperatures, of all cells. */
int pack_replay(const real *params, struct pack *pack, real *io, long cells, long n, const real *drive,
                const real *measured);

size_t cell_size(void);
size_t pack_size(long cells);

#endif
