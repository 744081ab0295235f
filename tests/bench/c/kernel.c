/* See kernel.h. The first part serves both variants; its functions are branch-free, as they run in the pack's lanes. */

#include "kernel.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>
#include <tgmath.h>

#define R(number) ((real)(number)) /* a bare literal would make a float kernel compute in double */
#ifdef __clang__
#define UNROLL _Pragma("clang loop unroll(full)")
#define EACH_LANE _Pragma("clang loop vectorize(assume_safety)") for (int c = 0; c < LANES; c++)
#else
#define UNROLL _Pragma("GCC unroll 16")
#define EACH_LANE _Pragma("GCC ivdep") for (int c = 0; c < LANES; c++)
#endif
#define INLINE static inline __attribute__((always_inline))

INLINE real least(real value, real high)
{
    return value > high ? high : value;
}

INLINE real clamp(real value, real low, real high)
{
    return least(value < low ? low : value, high);
}

INLINE bool within(const real *p, int low, real value)
{
    return (p[low] <= value) & (value <= p[low + 1]);
}

/* -- tables ------------------------------------------------------------------------------------------------------- */

/* A table row and the fraction of the way to the next, warmer one. */
struct row {
    int at;
    real f;
};

INLINE struct row row_of(const real *p, int table, real T)
{
    const real u = clamp((T - p[table + T_TEMP0]) * p[table + T_INV_DTEMP], 0, p[table + T_ROWS] - 1);
    const real row = floor(least(u, p[table + T_ROWS] - 2));
    return (struct row){(int)(p[table + T_OFFSET] + row * p[table + T_ROW_SIZE]), u - row};
}

INLINE real ocv(const real *p, struct row row, real soc)
{
    const real u = soc * p[P_OCV + T_INTERVALS];
    const real k = floor(clamp(u, -1, p[P_OCV + T_INTERVALS])), d = u - k;
    const int a = row.at + ((int)k + 1) * OCV_COEFFICIENTS, b = a + (int)p[P_OCV + T_ROW_SIZE];
    const real cold = p[a] + d * (p[a + 1] + d * (p[a + 2] + d * p[a + 3]));
    const real warm = p[b] + d * (p[b + 1] + d * (p[b + 2] + d * p[b + 3]));
    return cold + row.f * (warm - cold);
}

/* The place of `soc` among the knots of the dynamics table. */
INLINE real knots(const real *p, real soc)
{
    return clamp(soc * p[P_DYN + T_INTERVALS], 0, p[P_DYN + T_INTERVALS]);
}

INLINE real knot_below(const real *p, real place)
{
    return floor(least(place, p[P_DYN + T_INTERVALS] - 1));
}

/* The channels at a knot, and their rise to the next. */
INLINE void dynamics(const real *p, real knot, real T, real value[CHANNELS], real rise[CHANNELS])
{
    const struct row row = row_of(p, P_DYN, T);
    const real *here = p + row.at + (int)knot * CHANNELS, *next = here + CHANNELS;
    const int warmer = (int)p[P_DYN + T_ROW_SIZE];
    UNROLL for (int k = 0; k < CHANNELS; k++) {
        value[k] = here[k] + row.f * (here[warmer + k] - here[k]);
        rise[k] = next[k] + row.f * (next[warmer + k] - next[k]) - value[k];
    }
}

/* -- filter ------------------------------------------------------------------------------------------------------- */

INLINE void add(struct belief *b, int j, real increment)
{
    if (COMPENSATED) {
        const real all = increment + b->carry[j], x = b->x[j] + all;
        b->carry[j] = all - (x - b->x[j]);
        b->x[j] = x;
    } else {
        b->x[j] += increment;
    }
}

/* x' = (1 - lost) x + gain, with noise of sigma q. */
struct motion {
    real lost[N], gain[N], q[N];
};

/* SoC that a current takes off in `known` s. */
INLINE real charge(const real *p, real i, real known)
{
    return (i < 0 ? p[P_CE_CHARGE] : 1) * i * known / p[P_CHARGE_COULOMB];
}

/* `fall`: 1 - exp(-known / tau) of each voltage; `fade`: the same over the gap of the current.
 * `held`: 1 if what is known of the current is the beginning of the step, 0 if its end. */
INLINE void move(const real *p, const real dyn[CHANNELS], real i, real moved, real dt, real gap, real before,
                 real held, const real fall[N_V], const real fade[N_V], struct motion *m)
{
    const real doubted = p[P_CURRENT_RANGE] / p[P_CHARGE_COULOMB], range = gap > 0 ? p[P_CURRENT_RANGE] : 0;
    const real variance = dt * (p[P_SOC_WALK_OFFSET] + p[P_SOC_WALK_GAIN] * i * i)
                          + doubted * doubted * gap * (2 * before + gap);
    m->lost[0] = 0;
    m->gain[0] = -moved;
    m->q[0] = sqrt(variance) + R(TINY_ROOT);
    const real times = dyn[D_ERROR] * dyn[D_ERROR];
    UNROLL for (int j = 0; j < N_RC; j++) {
        const real r = dyn[D_RC1 + 2 * j], both = fall[j] * fade[j], lost = fall[j] + fade[j] - both;
        const real error = p[P_RC_REL] * r * i;
        const real shift = p[P_CURRENT_OFFSET] * (j == N_RC - 1 ? r + dyn[D_R0] : r);
        const real unknown = r * range;
        const real stationary = times * (p[P_VAR_V + j] + error * error) + shift * shift + unknown * unknown;
        m->lost[1 + j] = lost;
        m->gain[1 + j] = r * i * (fall[j] - held * both);
        m->q[1 + j] = sqrt(lost * (2 - lost) * stationary) + R(TINY_ROOT);
    }
    if (HYSTERESIS) {
        const real largest = dyn[CHANNELS - 1], both = fall[N_V - 1] * fade[N_V - 1];
        const real lost = fall[N_V - 1] + fade[N_V - 1] - both;
        const real anywhere = gap > 0 ? largest * largest / 3 : 0; /* between the branches */
        m->lost[N - 1] = lost;
        m->gain[N - 1] = (fall[N_V - 1] - held * both) * (i < 0 ? -largest : largest);
        m->q[N - 1] = sqrt(lost * (2 - lost) * (times * p[P_VAR_V + N_RC] + anywhere)) + R(TINY_ROOT);
    }
}

/* Householder on the lower triangle of [(1 - lost) root, q]: both start with zeros where the other has none. */
INLINE void predict(const real *p, struct belief *b, const struct motion *m)
{
    real (*root)[N] = b->root, noise[N][N];
    UNROLL for (int j = 0; j < N; j++) {
        add(b, j, m->gain[j] - m->lost[j] * b->x[j]);
        UNROLL for (int k = 0; k <= j; k++)
            root[j][k] -= m->lost[j] * root[j][k];
        UNROLL for (int k = 0; k < N; k++)
            noise[j][k] = k == j ? m->q[j] : 0;
    }
    UNROLL for (int j = 0; j < N; j++) {
        real squares = root[j][j] * root[j][j];
        UNROLL for (int k = 0; k <= j; k++)
            squares += noise[j][k] * noise[j][k];
        const real norm = sqrt(squares), both = 1 / (norm * (root[j][j] + norm));
        const real inverse = both * (root[j][j] + norm), away = both * norm;
        UNROLL for (int i = j + 1; i < N; i++) {
            real dot = root[j][j] * root[i][j];
            UNROLL for (int k = 0; k <= j; k++)
                dot += noise[j][k] * noise[i][k];
            const real along = dot * inverse, d = (root[i][j] + along) * away;
            root[i][j] = along;
            UNROLL for (int k = 0; k <= j; k++)
                noise[i][k] -= d * noise[j][k];
        }
        root[j][j] = norm;
    }
    root[0][0] = least(root[0][0], p[P_SOC_SIGMA_MAX]);
}

struct innovation {
    real predicted, variance, per_variance, alpha, b[N];
};

/* `g`: OCV at x[0] and at x[0] +- gamma root[0][0]; `r`: variance of the measurement. */
INLINE void innovate(const real *p, const struct belief *b, const real g[3], real drop, real r, struct innovation *n)
{
    const real e = p[P_W] * (g[1] + g[2] - 2 * g[0]);
    n->predicted = g[0] + e - drop;
    n->variance = n->alpha = r + e * e * p[P_E2];
    UNROLL for (int k = 0; k < N; k++) {
        real sum = k == 0 ? p[P_W] * p[P_GAMMA] * (g[1] - g[2]) : 0;
        UNROLL for (int j = k > 1 ? k : 1; j < N; j++)
            sum -= b->root[j][k];
        n->predicted -= k > 0 ? b->x[k] : 0;
        n->b[k] = sum;
        n->variance += sum * sum;
    }
    n->per_variance = 1 / n->variance;
}

/* Variance of a reading, after `age` s; `error`: how much more the model errs here, `scale`: and of late. */
INLINE real noise_of(const real *p, real age, real error, real scale, real drop_sigma)
{
    const real since = clamp(age, R(TINY_ROOT), R(VOLTAGE_ERROR_S));
    return R(VOLTAGE_ERROR_S) / since * scale * (error * error * p[P_VAR_VOLTAGE] + drop_sigma * drop_sigma);
}

/* -- adaptation --------------------------------------------------------------------------------------------------- */

/* What a tracked r0 has beyond the shape of the circuit. */
INLINE real beyond_shape(real scale)
{
    return scale - clamp(scale - 1, -R(R0_SHAPE), R(R0_SHAPE));
}

/* Of the noise of a reading, what is there because it came soon after the one before. */
INLINE real crowding(real age, real r) { return r * (1 - clamp(age, 0, R(VOLTAGE_ERROR_S)) / R(VOLTAGE_ERROR_S)); }

/* From an innovation that has not moved the belief yet; `r`: the noise in its variance, `ohmic`: the drop by the cell
 * file's r0, NaN if the current is not of its moment, `r0`: as tracked. */
INLINE void follow_r0(const real *p, struct adapted *a, real innovation, real per_variance, real r, bool fused,
                      real since, real error, real ohmic, real r0)
{
    const real moved = innovation - a->residual;
    const bool goes_on = (moved - moved == 0) & (since <= R(R0_STEP_S)), counts = ohmic == ohmic;
    const real drift = goes_on ? a->drift + moved : 0, before = goes_on ? a->ohmic : R(NAN);
    const real total = (goes_on ? a->block_drift : 0) + (counts ? drift : 0);
    const real total_ohmic = (goes_on ? a->block_ohmic : 0) + (counts ? ohmic : 0);
    const real count = (goes_on ? a->block_count : 0) + (counts ? 1 : 0), lasted = goes_on ? a->block_s + since : 0;
    const bool whole = (lasted >= R(R0_BLOCK_S)) | (goes_on & (since >= R(R0_ALONE_S)));
    const real each = 1 / count, mean = total * each, mean_ohmic = total_ohmic * each, change = mean_ohmic - before;

    const bool due = fused & whole & (a->fresh == 0);
    const real sigma = R(R0_SIGMA), var = a->r0_var + (sigma * sigma - a->r0_var) * lasted * R(1 / R0_TAU_S);
    const real white = 2 * a->voltage_scale * error * error * p[P_VAR_VOLTAGE], otherwise = R(R0_ELSE) * change;
    const real gain = var * change / (var * change * change + white + otherwise * otherwise), step = gain * mean;
    const bool told = due & (fabs(change) > r0 * p[P_EXCITED]) & (p[P_ADAPT] > 0) & (step - step == 0);
    a->r0_var = due ? (told ? var - gain * change * var : var) : a->r0_var;
    a->r0_scale = told ? clamp(a->r0_scale - step, R(R0_LEAST), R(R0_MOST)) : a->r0_scale;

    a->residual = fused ? innovation * r * per_variance : a->residual;
    a->drift = fused ? (whole & (mean == mean) ? drift - mean : drift) : a->drift;
    a->ohmic = fused ? (whole ? mean_ohmic : before) : a->ohmic;
    a->block_drift = fused ? (whole ? 0 : total) : a->block_drift;
    a->block_ohmic = fused ? (whole ? 0 : total_ohmic) : a->block_ohmic;
    a->block_count = fused ? (whole ? 0 : count) : a->block_count;
    a->block_s = fused ? (whole ? 0 : lasted) : a->block_s;
}

INLINE void learn(const real *p, struct adapted *a, real innovation, real variance, real per_variance, real r,
                  real crowded, bool fused, real since_heard, real error, real ohmic, real r0)
{
    const real heard_s = since_heard == since_heard ? since_heard : 0, since = clamp(heard_s, 0, R(STEP_MAX_S));
    const real nis = innovation * innovation / (variance - crowded), scale = a->voltage_scale;
    const bool compared = (nis - nis == 0) & (a->fresh == 0) & (p[P_ADAPT] > 0);
    const real followed = scale + scale * (clamp(nis, 0, p[P_GATE2]) - 1) * since * R(1 / SCALE_S);
    a->voltage_scale = compared ? clamp(followed, 1, R(SCALE_MAX)) : scale;
    follow_r0(p, a, innovation, per_variance, r, fused, heard_s, error, ohmic, r0);
    a->fresh = fused ? 0 : a->fresh;
}

static void start_adapted(struct adapted *a)
{
    *a = (struct adapted){1, 1, R(R0_SIGMA) * R(R0_SIGMA), R(NAN), 0, 0, 0, 0, 0, 0, 1};
}

/* Carlson's update, from the last column to the first. */
INLINE void update(struct belief *b, const struct innovation *n, real innovation)
{
    real gain[N] = {0}, alpha = n->alpha, per_variance = 0;
    UNROLL for (int j = N - 1; j >= 0; j--) {
        const real next = alpha + n->b[j] * n->b[j];
        const real inverse = 1 / sqrt(next * alpha), keep = alpha * inverse, take = n->b[j] * inverse;
        UNROLL for (int i = j; i < N; i++) {
            const real old = b->root[i][j];
            b->root[i][j] = keep * old - take * gain[i];
            gain[i] += n->b[j] * old;
        }
        alpha = next;
        per_variance = keep * inverse;
    }
    const real weight = innovation * per_variance;
    UNROLL for (int j = 0; j < N; j++)
        add(b, j, gain[j] * weight);
}

INLINE bool sound(const struct belief *b, real voltage_age)
{
    real total = voltage_age;
    UNROLL for (int j = 0; j < N; j++) {
        total += fabs(b->x[j]);
        UNROLL for (int k = 0; k <= j; k++)
            total += fabs(b->root[j][k]);
    }
    return total - total == 0;
}

INLINE real horner(const double *c, int count, real x)
{
    real value = R(c[count - 1]);
    for (int k = count - 2; k >= 0; k--)
        value = value * x + R(c[k]);
    return value;
}

static const double LOW[2][6] = INTERVAL_LOW, HIGH[2][6] = INTERVAL_HIGH, MEAN[2][6] = INTERVAL_MEAN;
static const double QUANTILE[2][4] = INTERVAL_QUANTILE;

INLINE real ratio(const double of[2][6], real x) { return horner(of[0], 5, x) / horner(of[1], 6, x); }

/* Probability that a standard Gaussian lies below z; its density there in *density. */
INLINE real below(real z, real *density)
{
    const real size = fabs(z), tail = (*density = exp(-z * z / 2) * R(1 / SQRT_TWO_PI)) / (size + ratio(MEAN, size));
    return z < 0 ? tail : 1 - tail;
}

INLINE real quantile(real probability)
{
    const real r = probability - R(0.5);
    return r * horner(QUANTILE[0], 4, r * r) / horner(QUANTILE[1], 4, r * r);
}

struct shown { real soc, sigma, low, high; };

INLINE bool is_near(real mean, real sigma) { return (mean < R(FAR) * sigma) | (1 - mean < R(FAR) * sigma); }

/* What is published of a Gaussian, truncated to 0..1. */
static struct shown truncated(real mean, real sigma)
{
    const real half = R(HALF_WIDTHS) * sigma;
    struct shown of = {mean, sigma, mean - half, mean + half};
    if (!is_near(mean, sigma))
        return of;
    const bool most = mean > R(0.5);
    const real away = least(mean, 1 - mean), a = -away / sigma, b = (1 - away) / sigma;
    real soc = sigma * ratio(MEAN, a), low = sigma * ratio(LOW, a), high = sigma * ratio(HIGH, a);
    if (b < R(FAR)) {
        real at_a, at_b;
        const real below_a = below(a, &at_a), below_b = below(b, &at_b), inside = below_b - below_a;
        soc = away + sigma * (at_a - at_b) / inside;
        low = away + sigma * quantile(below_a + R(TAIL) * inside);
        high = away + sigma * quantile(below_b - R(TAIL) * inside);
    }
    low = clamp(low, 0, 1);
    high = clamp(high, 0, 1);
    soc = clamp(soc, low, high);
    of.sigma = (high - low) / R(2 * HALF_WIDTHS);
    of.soc = most ? 1 - soc : soc;
    of.low = most ? 1 - high : low;
    of.high = most ? 1 - low : high;
    return of;
}

/* Keeps a record's SoC and sigma within their bounds; returns its fault. */
INLINE whole bound(const real *p, real *soc, real *sigma, real T, whole faults, bool alive)
{
    const bool inside = within(p, P_TABLE_TEMPERATURE_MIN, T) & (*soc >= -R(SOC_SLACK)) & (*soc <= 1 + R(SOC_SLACK));
    *soc = clamp(*soc, -R(SOC_BEYOND), 1 + R(SOC_BEYOND));
    *sigma = *sigma < p[P_SOC_SIGMA_MIN] ? p[P_SOC_SIGMA_MIN] : *sigma;
    return (alive & !inside & (faults != FAULT_NUMERIC)) ? FAULT_OUT_OF_TABLE : 0;
}

/* Faults and status. */
INLINE whole judge(const real *p, real low, real high, whole faults, bool alive)
{
    const real half = (high - low) / 2;
    faults |= (alive & (half > p[P_OK_HALF_WIDTH])) ? FAULT_UNCERTAIN : 0;
    whole status = faults == 0 ? STATUS_OK : STATUS_DEGRADED;
    status = half > p[P_INVALID_HALF_WIDTH] ? STATUS_INVALID : status;
    return faults | (alive ? status : STATUS_INITIALISING) << STATUS_SHIFT;
}

INLINE whole missing(const real *p, real current_age, real gap, real voltage_age, real temperature_age)
{
    const bool current = (current_age <= p[P_CURRENT_TIMEOUT]) & (gap <= 0);
    return (current ? 0 : FAULT_CURRENT_MISSING) | (voltage_age <= p[P_VOLTAGE_TIMEOUT] ? 0 : FAULT_VOLTAGE_MISSING)
           | (temperature_age <= p[P_TEMPERATURE_TIMEOUT] ? 0 : FAULT_TEMPERATURE_MISSING);
}

/* The first belief: the load may have begun just now or long ago. */
static void start(const real *p, struct belief *b, const real dyn[CHANNELS], real T, real i)
{
    const real half = knots(p, R(0.5)), knot = knot_below(p, half), times = dyn[D_ERROR] * dyn[D_ERROR];
    real value[CHANNELS], rise[CHANNELS];
    dynamics(p, knot, T, value, rise);
    const real before = sqrt(p[P_INITIAL_CURRENT] * p[P_INITIAL_CURRENT] + i * i / 4);
    memset(b, 0, sizeof *b);
    b->x[0] = p[P_INITIAL_SOC];
    b->root[0][0] = p[P_INITIAL_SIGMA];
    for (int j = 0; j < N_RC; j++) {
        const real r = value[D_RC1 + 2 * j] + (half - knot) * rise[D_RC1 + 2 * j], drop = r * before;
        b->x[1 + j] = r * i / 2;
        b->root[1 + j][1 + j] = sqrt(times * p[P_VAR_V + j] + drop * drop);
    }
    if (HYSTERESIS)
        b->root[N - 1][N - 1] = sqrt(times * p[P_VAR_V + N_RC] + dyn[CHANNELS - 1] * dyn[CHANNELS - 1] / 3);
}

/* -- one cell ----------------------------------------------------------------------------------------------------- */

/* Age what is held and take what is plausible; `*voltage` becomes NaN if it is not. Returns faults. */
static int take(const real *p, struct cell *c, real dt, real current, real *voltage, real temperature, real *since_heard)
{
    int faults = 0;
    c->current_age += dt;
    c->temperature_age += dt;
    c->voltage_age += dt;
    c->heard_age += dt;
    c->rejected_s += dt;
    *since_heard = c->heard_age;
    if (within(p, P_CURRENT_MIN, current)) {
        c->current = current;
        c->current_age = 0;
    } else if (!isnan(current)) {
        faults |= FAULT_CURRENT_IMPLAUSIBLE;
    }
    if (within(p, P_TEMPERATURE_MIN, temperature)) {
        c->temperature = temperature;
        c->temperature_age = 0;
    } else if (!isnan(temperature)) {
        faults |= FAULT_TEMPERATURE_IMPLAUSIBLE;
    }
    if (within(p, P_VOLTAGE_MIN, *voltage)) {
        if (c->heard_age > p[P_VOLTAGE_TIMEOUT])
            c->rejected_s = R(NAN); /* refusals with a silence between them are not an unbroken row */
        c->heard_age = 0;
    } else if (!isnan(*voltage)) {
        faults |= FAULT_VOLTAGE_IMPLAUSIBLE;
        *voltage = R(NAN);
    }
    return faults;
}

static void advance(const real *p, struct cell *c, const real dyn[CHANNELS], real moved, real dt, real gap)
{
    const real known = dt - gap;
    real fall[N_V], fade[N_V] = {0};
    struct motion m;
    for (int j = 0; j < N_RC; j++) {
        fall[j] = -expm1(-known / dyn[D_RC1 + 2 * j + 1]);
        if (gap > 0)
            fade[j] = -expm1(-gap / dyn[D_RC1 + 2 * j + 1]);
    }
    if (HYSTERESIS)
        fall[N_V - 1] = -expm1(-p[P_HYSTERESIS_RATE] * fabs(c->current) * known);
    if (HYSTERESIS && gap > 0)
        fade[N_V - 1] = -expm1(-p[P_HYSTERESIS_RATE] * p[P_CURRENT_RANGE] * gap);
    const real held = c->current_age > 0 ? 1 : 0;
    move(p, dyn, c->current, moved, dt, gap, c->gap_s, held, fall, fade, &m);
    c->gap_s = held * (c->gap_s + gap);
    predict(p, &c->belief, &m);
}

/* Compare the voltage and fuse it, if the gate lets it. Returns faults. */
static int fuse(const real *p, struct cell *c, real voltage, real T, real error, real r0, real ohmic, real drop,
                real drop_sigma, real since_heard)
{
    struct belief *b = &c->belief;
    struct innovation n;
    const struct row row = row_of(p, P_OCV, T);
    const real spread = p[P_GAMMA] * b->root[0][0];
    const real g[3] = {ocv(p, row, b->x[0]), ocv(p, row, b->x[0] + spread), ocv(p, row, b->x[0] - spread)};
    const real r = noise_of(p, c->voltage_age, error, c->adapted.voltage_scale, drop_sigma);
    innovate(p, b, g, drop, r, &n);
    c->voltage_pred = n.predicted;
    c->innovation = voltage - n.predicted;
    c->innovation_var = n.variance;
    c->nis = c->innovation * c->innovation * n.per_variance;
    if (!isfinite(c->innovation + n.variance))
        return FAULT_NUMERIC;
    const bool accepted = c->innovation * c->innovation <= p[P_GATE2] * n.variance;
    learn(p, &c->adapted, c->innovation, n.variance, n.per_variance, r, crowding(c->voltage_age, r), accepted,
          since_heard, error, ohmic, r0);
    if (!accepted) {
        if (isnan(c->rejected_s))
            c->rejected_s = 0;
        return FAULT_INNOVATION_REJECTED;
    }
    update(b, &n, c->innovation);
    c->rejected_s = R(NAN);
    c->voltage_age = 0;
    return 0;
}

int cell_step(const real *p, struct cell *cell, double dt_s, double current_A, double voltage_V,
              double temperature_degC)
{
    struct cell c = *cell; /* taken back if it does not stay finite */
    const real dt = (real)dt_s;
    real voltage = (real)voltage_V;
    bool alive = sound(&c.belief, c.voltage_age);
    real since_heard;
    int faults = take(p, &c, dt, (real)current_A, &voltage, (real)temperature_degC, &since_heard);
    const real gap = clamp((c.current_age <= 0 ? dt : c.current_age) - p[P_CURRENT_TIMEOUT], 0, dt);
    const real moved = charge(p, c.current, dt - gap);

    const real place = knots(p, alive ? c.belief.x[0] - moved : p[P_INITIAL_SOC]), knot = knot_below(p, place);
    const real T = isnan(c.temperature) ? R(UNKNOWN_TEMPERATURE) : c.temperature;
    real dyn[CHANNELS], rise[CHANNELS];
    dynamics(p, knot, T, dyn, rise);
    for (int k = 0; k < CHANNELS; k++)
        dyn[k] += (place - knot) * rise[k];

    const bool unknown = c.current_age > p[P_CURRENT_TIMEOUT];
    const real i = unknown ? p[P_CURRENT_RANGE] : c.current;
    const real r0 = dyn[i < 0 ? D_R0_CHARGE : D_R0], ohmic = r0 * dyn[D_KNEE] * asinh(i / dyn[D_KNEE]);
    const real scale = isnan(c.adapted.r0_scale) ? 1 : beyond_shape(c.adapted.r0_scale), drop = scale * ohmic;
    const real drop_sigma = unknown ? drop : p[P_R0_REL] * dyn[D_ERROR] * drop;
    const bool own = !unknown && c.current_age <= R(R0_CURRENT_S);

    c.voltage_pred = c.innovation = c.innovation_var = c.nis = R(NAN);
    if (alive && dt > 0)
        advance(p, &c, dyn, moved, dt, gap);
    if (!alive && isfinite(voltage + c.current + c.temperature)) {
        start(p, &c.belief, dyn, T, c.current);
        start_adapted(&c.adapted);
        c.gap_s = 0;
        c.voltage_age = R(VOLTAGE_ERROR_S);
        alive = true;
    }
    if (alive && !isnan(voltage))
        faults |= fuse(p, &c, voltage, T, dyn[D_ERROR], scale * r0, own ? ohmic : R(NAN), unknown ? 0 : drop, drop_sigma,
                       since_heard);
    faults |= missing(p, c.current_age, gap, c.voltage_age, c.temperature_age);

    if ((faults & FAULT_NUMERIC) || (alive && !sound(&c.belief, c.voltage_age))) {
        faults = FAULT_NUMERIC;
        c = *cell;
        c.voltage_pred = c.innovation = c.innovation_var = c.nis = R(NAN);
    }
    faults |= (int)bound(p, &c.belief.x[0], &c.belief.root[0][0], c.temperature, faults, alive);
    const struct shown of = truncated(c.belief.x[0], c.belief.root[0][0]);
    const whole code = judge(p, of.low, of.high, faults, alive);
    c.soc = of.soc;
    c.sigma = of.sigma;
    c.low = of.low;
    c.high = of.high;
    *cell = c;
    return (int)code;
}

int cell_replay(const real *p, struct cell *cell, long n, const real *samples, real *results)
{
    int code = 0;
    for (long k = 0; k < n; k++, samples += SAMPLE, results += RESULT) {
        code = cell_step(p, cell, (double)samples[0], (double)samples[1], (double)samples[2], (double)samples[3]);
        results[0] = cell->soc;
        results[1] = cell->sigma;
        results[2] = cell->nis;
    }
    return code;
}

void cell_reset(struct cell *cell)
{
    real *numbers = (real *)cell;
    for (size_t k = 0; k < sizeof *cell / sizeof(real); k++)
        numbers[k] = R(NAN);
}

size_t cell_size(void)
{
    return sizeof(struct cell);
}

/* -- a pack ------------------------------------------------------------------------------------------------------- */

/* 1 - exp(-x) for 0 <= x <= FALL_SMALL. */
INLINE real fall_small(real x)
{
    real r = 1;
    UNROLL for (int k = FALL_TERMS; k > 1; k--)
        r = 1 - x * (1 / R(k)) * r;
    return x * r;
}

/* The same for any x >= 0: 1 - e^2 = (1 - e) (2 - (1 - e)). */
INLINE real fall_large(real x)
{
    real r = fall_small(least(x, R(FALL_LARGEST)) * R(FALL_HALF));
    UNROLL for (int k = 0; k < FALL_DOUBLINGS; k++)
        r *= 2 - r;
    return r;
}

/* asinh of |v| <= ASINH_REACH. */
INLINE real asinh_small(real v)
{
    static const double terms[] = ASINH;
    const int count = sizeof terms / sizeof *terms;
    real ratio = R(terms[count - 1]);
    UNROLL for (int k = count - 2; k >= 0; k--)
        ratio = ratio * (v * v) + R(terms[k]);
    return v * ratio;
}

/* As libm's, which has no lanes: the block's largest |u| decides how often each is halved, as of a hyperbolic sine. */
static void asinh_lanes(real u[LANES])
{
    real cosh[LANES], scale[LANES], times = 1;
    whole large = 0;
    EACH_LANE {
        scale[c] = 1;
        large |= fabs(u[c]) > R(ASINH_REACH) ? 1 : 0;
    }
    if (large)
        EACH_LANE cosh[c] = sqrt(1 + u[c] * u[c]);
    for (int k = 0; k < ASINH_HALVINGS && large; k++) {
        large = 0;
        times *= 2;
        EACH_LANE {
            cosh[c] = sqrt(cosh[c] / 2 + R(0.5));
            scale[c] *= 2 * cosh[c];
            large |= fabs(u[c]) > R(ASINH_REACH) * scale[c] ? 1 : 0;
        }
    }
    EACH_LANE u[c] = times * asinh_small(u[c] / scale[c]);
}

INLINE struct belief load(const struct lanes *w, int c)
{
    struct belief b;
    UNROLL for (int j = 0; j < N; j++) {
        b.x[j] = w->x[j][c];
        b.carry[j] = COMPENSATED ? w->carry[j][c] : 0;
        UNROLL for (int k = 0; k <= j; k++)
            b.root[j][k] = w->root[j * (j + 1) / 2 + k][c];
    }
    return b;
}

INLINE void store(struct lanes *w, int c, const struct belief *b)
{
    UNROLL for (int j = 0; j < N; j++) {
        w->x[j][c] = b->x[j];
        if (COMPENSATED)
            w->carry[j][c] = b->carry[j];
        UNROLL for (int k = 0; k <= j; k++)
            w->root[j * (j + 1) / 2 + k][c] = b->root[j][k];
    }
}

INLINE struct adapted load_adapted(const struct lanes *w, int c)
{
    return (struct adapted){w->voltage_scale[c], w->r0_scale[c],    w->r0_var[c],      w->residual[c],
                            w->drift[c],         w->ohmic[c],       w->block_drift[c], w->block_ohmic[c],
                            w->block_count[c],   w->block_s[c],     w->fresh[c]};
}

INLINE void store_adapted(struct lanes *w, int c, const struct adapted *a)
{
    w->voltage_scale[c] = a->voltage_scale;
    w->r0_scale[c] = a->r0_scale;
    w->r0_var[c] = a->r0_var;
    w->residual[c] = a->residual;
    w->drift[c] = a->drift;
    w->ohmic[c] = a->ohmic;
    w->block_drift[c] = a->block_drift;
    w->block_ohmic[c] = a->block_ohmic;
    w->block_count[c] = a->block_count;
    w->block_s[c] = a->block_s;
    w->fresh[c] = a->fresh;
}

/* What a tick knows of the current, and works out on the way for each lane. */
struct work {
    real dt, current, current_age, gap, known, moved;
    bool fresh;
    whole fault;
    _Alignas(64) whole alive[LANES], code[LANES], fused[LANES];
    real voltage[LANES], T[LANES], soc[LANES];
    real dyn[CHANNELS][LANES], fall[N_V][LANES], fade[N_V][LANES];
    real r0[LANES], ohmic[LANES], drop[LANES], drop_sigma[LANES], since_heard[LANES], g[3][LANES];
    real predicted[LANES], innovation[LANES], variance[LANES], per_variance[LANES], r[LANES], crowded[LANES];
    real sigma[LANES], low[LANES], high[LANES]; /* published, with `soc` */
};

static void take_lanes(const real *restrict p, struct lanes *restrict w, struct work *restrict y,
                       const real *restrict temperature)
{
    const real dt = y->dt;
    EACH_LANE {
        const real z = y->voltage[c], T = temperature[c];
        const bool heard = within(p, P_VOLTAGE_MIN, z), felt = within(p, P_TEMPERATURE_MIN, T);
        const real heard_age = w->heard_age[c] + dt;
        w->temperature[c] = felt ? T : w->temperature[c];
        w->temperature_age[c] = felt ? 0 : w->temperature_age[c] + dt;
        w->rejected_s[c] = (heard & (heard_age > p[P_VOLTAGE_TIMEOUT])) ? R(NAN) : w->rejected_s[c] + dt;
        w->heard_age[c] = heard ? 0 : heard_age;
        y->since_heard[c] = heard_age;
        w->voltage_age[c] += dt;
        y->voltage[c] = heard ? z : R(NAN);
        y->code[c] = y->fault | ((!felt & (T == T)) ? FAULT_TEMPERATURE_IMPLAUSIBLE : 0)
                     | ((!heard & (z == z)) ? FAULT_VOLTAGE_IMPLAUSIBLE : 0);
    }
}

/* Read the dynamics at the mean SoC to come, through each lane's cached row. */
static void schedule(const real *restrict p, struct block *restrict s, const struct lanes *restrict w,
                     struct work *restrict y)
{
    const real moved = y->moved, initial = p[P_INITIAL_SOC], T_limit = p[P_CACHE_TEMPERATURE];
    whole stale = 0;
    EACH_LANE {
        const real place = knots(p, y->alive[c] ? w->x[0][c] - moved : initial);
        const real T = w->temperature[c] == w->temperature[c] ? w->temperature[c] : R(UNKNOWN_TEMPERATURE);
        const real d = place - s->knot[c];
        y->soc[c] = place;
        y->T[c] = T;
        stale |= ((d >= 0) & (d <= 1) & (fabs(T - s->row_temperature[c]) <= T_limit)) ? 0 : 1;
    }
    if (stale)
        for (int c = 0; c < LANES; c++) {
            const real knot = knot_below(p, y->soc[c]);
            if (knot == s->knot[c] && fabs(y->T[c] - s->row_temperature[c]) <= T_limit)
                continue;
            real value[CHANNELS], rise[CHANNELS];
            dynamics(p, knot, y->T[c], value, rise);
            s->knot[c] = knot;
            s->row_temperature[c] = y->T[c];
            for (int k = 0; k < CHANNELS; k++)
                s->value[k][c] = value[k], s->rise[k][c] = rise[k];
        }
    for (int k = 0; k < CHANNELS; k++)
        EACH_LANE y->dyn[k][c] = s->value[k][c] + (y->soc[c] - s->knot[c]) * s->rise[k][c];
}

static void ohmic(const real *restrict p, const struct lanes *restrict w, struct work *restrict y)
{
    const bool unknown = y->current_age > p[P_CURRENT_TIMEOUT];
    const real i = unknown ? p[P_CURRENT_RANGE] : y->current;
    const real share = unknown ? 0 : 1, doubt = unknown ? 1 : p[P_R0_REL], uneven = unknown ? 0 : 1;
    const real own = !unknown & (y->current_age <= R(R0_CURRENT_S)) ? 0 : R(NAN);
    const real *r0 = y->dyn[i < 0 ? D_R0_CHARGE : D_R0], *knee = y->dyn[D_KNEE];
    real u[LANES];
    EACH_LANE u[c] = i / knee[c];
    asinh_lanes(u);
    EACH_LANE {
        const real tracked = w->r0_scale[c], scale = tracked == tracked ? beyond_shape(tracked) : 1;
        const real ohmic = r0[c] * knee[c] * u[c], drop = scale * ohmic;
        y->r0[c] = scale * r0[c];
        y->ohmic[c] = ohmic + own;
        y->drop[c] = share * drop;
        y->drop_sigma[c] = doubt * (uneven * y->dyn[D_ERROR][c] + 1 - uneven) * drop;
    }
}

static void decay(real (*restrict x)[LANES], int count)
{
    whole large = 0;
    for (int j = 0; j < count; j++)
        EACH_LANE
            large |= x[j][c] > R(FALL_SMALL) ? 1 : 0;
    for (int j = 0; j < count; j++)
        if (large)
            EACH_LANE x[j][c] = fall_large(x[j][c]);
        else
            EACH_LANE x[j][c] = fall_small(x[j][c]);
}

static void relax(const real *restrict p, struct work *restrict y)
{
    for (int j = 0; j < N_RC; j++)
        EACH_LANE y->fall[j][c] = y->known / y->dyn[D_RC1 + 2 * j + 1][c];
    if (HYSTERESIS)
        EACH_LANE y->fall[N_V - 1][c] = p[P_HYSTERESIS_RATE] * fabs(y->current) * y->known;
    decay(y->fall, N_V);
    memset(y->fade, 0, sizeof y->fade);
    if (y->gap > 0) {
        for (int j = 0; j < N_RC; j++)
            EACH_LANE y->fade[j][c] = y->gap / y->dyn[D_RC1 + 2 * j + 1][c];
        if (HYSTERESIS)
            EACH_LANE y->fade[N_V - 1][c] = p[P_HYSTERESIS_RATE] * p[P_CURRENT_RANGE] * y->gap;
        decay(y->fade, N_V);
    }
}

static void advance_lanes(const real *restrict p, struct lanes *restrict w, const struct work *restrict y)
{
    const real i = y->current, moved = y->moved, dt = y->dt, gap = y->gap, held = y->fresh ? 0 : 1;
    EACH_LANE {
        struct belief b = load(w, c);
        struct motion m;
        real dyn[CHANNELS], fall[N_V], fade[N_V];
        UNROLL for (int k = 0; k < CHANNELS; k++)
            dyn[k] = y->dyn[k][c];
        UNROLL for (int j = 0; j < N_V; j++) {
            fall[j] = y->fall[j][c];
            fade[j] = y->fade[j][c];
        }
        move(p, dyn, i, moved, dt, gap, w->gap_s[c], held, fall, fade, &m);
        w->gap_s[c] = held * (w->gap_s[c] + gap);
        predict(p, &b, &m);
        store(w, c, &b);
    }
}

static void start_lanes(const real *p, struct lanes *w, struct work *y, int count)
{
    for (int c = 0; c < count; c++) {
        if (y->alive[c] || !isfinite(y->voltage[c] + y->current + w->temperature[c]))
            continue;
        real dyn[CHANNELS];
        for (int k = 0; k < CHANNELS; k++)
            dyn[k] = y->dyn[k][c];
        struct belief b;
        struct adapted a;
        start(p, &b, dyn, y->T[c], y->current);
        start_adapted(&a);
        store(w, c, &b);
        store_adapted(w, c, &a);
        w->gap_s[c] = 0;
        w->voltage_age[c] = R(VOLTAGE_ERROR_S);
        y->alive[c] = 1;
    }
}

static void look_up(const real *restrict p, const struct lanes *restrict w, struct work *restrict y)
{
    const real away[3] = {0, p[P_GAMMA], -p[P_GAMMA]};
    for (int point = 0; point < 3; point++) {
        const real gamma = away[point];
        EACH_LANE {
            const real soc = w->x[0][c] + gamma * w->root[0][c];
            y->g[point][c] = ocv(p, row_of(p, P_OCV, y->T[c]), soc - soc == 0 ? soc : R(0.5)); /* NaN is no index */
        }
    }
}

static void fuse_lanes(const real *restrict p, struct lanes *restrict w, struct work *restrict y)
{
    EACH_LANE {
        const struct belief before = load(w, c);
        struct belief b = load(w, c);
        struct innovation n;
        const real age = w->voltage_age[c];
        const real r = noise_of(p, age, y->dyn[D_ERROR][c], w->voltage_scale[c], y->drop_sigma[c]);
        const real g[3] = {y->g[0][c], y->g[1][c], y->g[2][c]}, rejected_s = w->rejected_s[c];
        innovate(p, &b, g, y->drop[c], r, &n);
        const real innovation = y->voltage[c] - n.predicted;
        const real total = innovation + n.variance;
        const bool heard = (y->voltage[c] == y->voltage[c]) & (y->alive[c] != 0);
        const bool compared = heard & (total - total == 0);
        const bool accepted = innovation * innovation <= p[P_GATE2] * n.variance;
        const bool fused = compared & accepted, refused = compared & !accepted;
        update(&b, &n, innovation);
        UNROLL for (int j = 0; j < N; j++) {
            b.x[j] = fused ? b.x[j] : before.x[j];
            b.carry[j] = fused ? b.carry[j] : before.carry[j];
            UNROLL for (int k = 0; k <= j; k++)
                b.root[j][k] = fused ? b.root[j][k] : before.root[j][k];
        }
        store(w, c, &b);
        w->rejected_s[c] = fused ? R(NAN) : (refused & (rejected_s != rejected_s)) ? 0 : rejected_s;
        w->voltage_age[c] = fused ? 0 : w->voltage_age[c];
        y->code[c] |= (refused ? FAULT_INNOVATION_REJECTED : 0) | ((heard & !compared) ? FAULT_NUMERIC : 0);
        y->predicted[c] = compared ? n.predicted : R(NAN);
        y->innovation[c] = compared ? innovation : R(NAN);
        y->variance[c] = compared ? n.variance : R(NAN);
        y->per_variance[c] = n.per_variance;
        y->r[c] = r;
        y->crowded[c] = crowding(age, r);
        y->fused[c] = fused ? 1 : 0;
    }
}

static void learn_lanes(const real *restrict p, struct lanes *restrict w, const struct work *restrict y)
{
    EACH_LANE {
        struct adapted a = load_adapted(w, c);
        learn(p, &a, y->innovation[c], y->variance[c], y->per_variance[c], y->r[c], y->crowded[c],
              y->fused[c] != 0, y->since_heard[c], y->dyn[D_ERROR][c], y->ohmic[c], y->r0[c]);
        store_adapted(w, c, &a);
    }
}

static void judge_lanes(const real *restrict p, struct lanes *restrict w, struct lanes *restrict s,
                        struct work *restrict y)
{
    whole refused = 0;
    EACH_LANE {
        const struct belief b = load(w, c);
        const whole code = y->code[c] | missing(p, y->current_age, y->gap, w->voltage_age[c], w->temperature_age[c]);
        const bool good = ((y->alive[c] == 0) | sound(&b, w->voltage_age[c])) & ((code & FAULT_NUMERIC) == 0);
        y->code[c] = good ? code : FAULT_NUMERIC;
        refused |= good ? 0 : 1;
    }
    if (refused)
        for (int c = 0; c < LANES; c++)
            if (y->code[c] == FAULT_NUMERIC) {
                for (size_t k = (size_t)c; k < sizeof *w / sizeof(real); k += LANES)
                    ((real *)w)[k] = ((const real *)s)[k];
                y->predicted[c] = y->innovation[c] = y->variance[c] = R(NAN);
            }
    whole near = 0;
    EACH_LANE {
        y->code[c] |= bound(p, &w->x[0][c], &w->root[0][c], w->temperature[c], y->code[c], y->alive[c] != 0);
        const real mean = w->x[0][c], sigma = w->root[0][c], half = R(HALF_WIDTHS) * sigma;
        y->soc[c] = mean;
        y->sigma[c] = sigma;
        y->low[c] = mean - half;
        y->high[c] = mean + half;
        near |= is_near(mean, sigma) ? 1 : 0;
    }
    if (near)
        for (int c = 0; c < LANES; c++) {
            const struct shown of = truncated(w->x[0][c], w->root[0][c]);
            y->soc[c] = of.soc;
            y->sigma[c] = of.sigma;
            y->low[c] = of.low;
            y->high[c] = of.high;
        }
    EACH_LANE y->code[c] = judge(p, y->low[c], y->high[c], y->code[c], y->alive[c] != 0);
    *s = *w;
}

static void publish(const struct lanes *restrict s, const struct work *restrict y, real *restrict out, long cells,
                    int count)
{
    for (int c = 0; c < count; c++) {
        out[OUT_SOC * cells + c] = y->soc[c];
        out[OUT_SOC_SIGMA * cells + c] = y->sigma[c];
        out[OUT_SOC_LOW * cells + c] = y->low[c];
        out[OUT_SOC_HIGH * cells + c] = y->high[c];
        out[OUT_VOLTAGE_PRED * cells + c] = y->predicted[c];
        out[OUT_INNOVATION * cells + c] = y->innovation[c];
        out[OUT_INNOVATION_VAR * cells + c] = y->variance[c];
        out[OUT_NIS * cells + c] = y->innovation[c] * y->innovation[c] * y->per_variance[c];
        out[OUT_AGE * cells + c] = s->voltage_age[c];
        out[OUT_R0 * cells + c] = y->alive[c] ? y->r0[c] : R(NAN);
        out[OUT_CODE * cells + c] = (real)y->code[c];
    }
}

/* Of the first `count` cells of a block. Returns their faults and, from bit STATUS_SHIFT up, a bit for each status. */
static int tick_block(const real *p, struct block *s, struct work *y, real *io, long cells, int count)
{
    struct lanes w = s->lanes;
    real temperature[LANES];
    whole everyone = 1;
    for (int c = 0; c < LANES; c++) {
        y->voltage[c] = c < count ? io[IN_VOLTAGE * cells + c] : R(NAN);
        temperature[c] = c < count ? io[IN_TEMPERATURE * cells + c] : R(NAN);
    }
    EACH_LANE {
        const struct belief b = load(&w, c);
        y->alive[c] = sound(&b, w.voltage_age[c]) ? 1 : 0;
    }
    take_lanes(p, &w, y, temperature);
    schedule(p, s, &w, y);
    ohmic(p, &w, y);
    if (y->dt > 0) {
        relax(p, y);
        advance_lanes(p, &w, y);
    }
    for (int c = 0; c < count; c++)
        everyone &= y->alive[c];
    if (!everyone)
        start_lanes(p, &w, y, count);
    look_up(p, &w, y);
    fuse_lanes(p, &w, y);
    learn_lanes(p, &w, y);
    judge_lanes(p, &w, &s->lanes, y);
    publish(&s->lanes, y, io, cells, count);
    int faults = 0, seen = 0;
    for (int c = 0; c < count; c++) {
        faults |= (int)y->code[c];
        seen |= 1 << (y->code[c] >> STATUS_SHIFT);
    }
    return (faults & ((1 << STATUS_SHIFT) - 1)) | seen << STATUS_SHIFT;
}

int pack_tick(const real *p, struct pack *pack, real *io, long cells, double dt_s, double current_A)
{
    struct work y;
    const real dt = y.dt = (real)dt_s, current = (real)current_A;
    y.fresh = within(p, P_CURRENT_MIN, current);
    y.fault = !y.fresh && !isnan(current) ? FAULT_CURRENT_IMPLAUSIBLE : 0;
    y.current = pack->current = y.fresh ? current : pack->current;
    y.current_age = pack->current_age = y.fresh ? 0 : pack->current_age + dt;
    y.gap = clamp((y.fresh ? dt : y.current_age) - p[P_CURRENT_TIMEOUT], 0, dt);
    y.known = dt - y.gap;
    y.moved = charge(p, y.current, y.known);
    int codes = 0;
    for (long first = 0; first < cells; first += LANES) {
        const int count = (int)(cells - first < LANES ? cells - first : LANES);
        codes |= tick_block(p, &pack->blocks[first / LANES], &y, io + first, cells, count);
    }
    const int seen = codes >> STATUS_SHIFT;
    const int status = seen & 1 << STATUS_INITIALISING ? STATUS_INITIALISING
                       : seen & 1 << STATUS_INVALID    ? STATUS_INVALID
                       : seen & 1 << STATUS_DEGRADED   ? STATUS_DEGRADED
                                                       : STATUS_OK;
    return (codes & ((1 << STATUS_SHIFT) - 1)) | status << STATUS_SHIFT;
}

int pack_replay(const real *p, struct pack *pack, real *io, long cells, long n, const real *drive,
                const real *measured)
{
    int code = 0;
    for (long k = 0; k < n; k++, drive += 2, measured += 2 * cells) {
        memcpy(io + IN_VOLTAGE * cells, measured, (size_t)cells * sizeof(real));
        memcpy(io + IN_TEMPERATURE * cells, measured + cells, (size_t)cells * sizeof(real));
        code = pack_tick(p, pack, io, cells, (double)drive[0], (double)drive[1]);
    }
    return code;
}

size_t pack_size(long cells)
{
    return sizeof(struct pack) + (size_t)((cells + LANES - 1) / LANES) * sizeof(struct block);
}

void pack_reset(struct pack *pack, long cells)
{
    real *numbers = (real *)pack;
    for (size_t k = 0; k < pack_size(cells) / sizeof(real); k++)
        numbers[k] = R(NAN);
}
