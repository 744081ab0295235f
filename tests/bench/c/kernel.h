/* The filter step of bms_ukf/kernel as C, by hand: two RC pairs, no bias, no core; what the benchmark compares with.
 *
 * Compile with -DBITS=64 or 32 (numbers) and -DHYSTERESIS=0 or 1 (a fourth state). `params` is the buffer that
 * bms_ukf.kernel.params.params makes; layout.h, its slots, is written from the Python at build time (c_kernel.py).
 * Left out: the quadrature update of a wide first belief, the belief doubted after P_REJECT_S, a cell's own capacity,
 * resistances, current and bleed, and the blocks that a part of an instant leaves as they are.
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
    N_V = N_RC + HYSTERESIS,
    N = 1 + N_V, /* soc, v_rc1, v_rc2, hysteresis */
    ROOTS = N * (N + 1) / 2,
    CHANNELS = D_RC1 + 2 * N_RC + HYSTERESIS,
    COMPENSATED = BITS == 32,
    SAMPLE = 4, /* numbers of a sample: dt, current, voltage, temperature */
    RESULT = 3  /* of a result: soc, soc_sigma, nis */
};

struct belief {
    real x[N];
    real root[N][N];  /* sqrt_P, lower triangle */
    real carry[N];    /* of x, if COMPENSATED: what rounding took off */
};

/* What the innovations tell of the model. */
struct adapted {
    real voltage_scale, r0_scale, r0_var;
    real residual;     /* what the last voltage fused left of its innovation; NaN: there was none */
    real drift, ohmic; /* of the prediction's error, from the last whole block on; the mean ohmic drop of that block */
    real block_drift, block_ohmic, block_count, block_s; /* sums over the present one */
    real fresh;           /* 1: no voltage has been fused yet */
};

/* One cell. An age or a value of NaN: never measured. */
struct cell {
    real current, temperature;
    real current_age, temperature_age, voltage_age, heard_age, rejected_s, gap_s;
    struct adapted adapted;
    struct belief belief;
    real voltage_pred, innovation, innovation_var, nis; /* of the last step; NaN: nothing compared */
    real soc, sigma, low, high; /* published */
};

/* The same for LANES cells, and their rows of the dynamics table. */
struct lanes {
    real temperature[LANES], temperature_age[LANES];
    real voltage_age[LANES], heard_age[LANES], rejected_s[LANES], gap_s[LANES];
    real voltage_scale[LANES], r0_scale[LANES], r0_var[LANES], residual[LANES], fresh[LANES];
    real drift[LANES], ohmic[LANES], block_drift[LANES], block_ohmic[LANES], block_count[LANES], block_s[LANES];
    real x[N][LANES], root[ROOTS][LANES], carry[N][LANES];
};

struct block {
    struct lanes lanes;
    real knot[LANES], row_temperature[LANES]; /* NaN: nothing cached */
    real value[CHANNELS][LANES], rise[CHANNELS][LANES];
};

/* Cells in series: one current for all. */
struct pack {
    real current, current_age;
    _Alignas(64) struct block blocks[];
};

/* All return faults and, from bit STATUS_SHIFT up, a status, as bms_ukf.kernel.entry.tick does. */
int cell_step(const real *params, struct cell *cell, double dt_s, double current_A, double voltage_V,
              double temperature_degC);
int cell_replay(const real *params, struct cell *cell, long n, const real *samples, real *results);

/* `io`: IO_ROWS rows of `cells` numbers (IN_*, OUT_*). */
int pack_tick(const real *params, struct pack *pack, real *io, long cells, double dt_s, double current_A);
/* `drive`: n times dt and current; `measured`: n times the voltages, then the temperatures, of all cells. */
int pack_replay(const real *params, struct pack *pack, real *io, long cells, long n, const real *drive,
                const real *measured);

void cell_reset(struct cell *cell);
size_t cell_size(void);
void pack_reset(struct pack *pack, long cells);
size_t pack_size(long cells);

#endif
