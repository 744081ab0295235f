/* See kernel.h. The first part serves a cell and a pack; its functions have no branch: they run in a pack's lanes. */

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

INLINE real largest(real value, real low)
{
    return value > low ? value : low;
}

INLINE bool is_finite(real value)
{
    return value - value == 0;
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

/* -- the current -------------------------------------------------------------------------------------------------- */

/* The part of a step that all cells share. */
struct tick {
    real dt, current, age, gap, known;
    real per_ampere, moved; /* SoC per ampere of the known current, and SoC that this takes off */
    real walk;              /* growth of SoC's variance */
    real passed;            /* of the low-pass of the ohmic drop */
    real range;             /* of the unknown current of a gap; 0: there is no gap */
    real i;                 /* whose ohmic drop counts: with no current known, what one could be */
    real held;              /* 1 if what is known of the current is the beginning of the step, 0 if its end */
    real counts, leads;     /* 1 or 0: whether the ohmic drop is known, and whether it says something of r0 */
    real lasting, late;     /* sigma of the drop: per drop of an unknown current, per r0 of an old one */
    real again;             /* 1: another measurement of the same instant */
    bool fresh, moves;
    bool rested; /* a rest shows what the one before it showed */
    real shown;  /* and what that is */
    real hysteresis_fall, hysteresis_fade, slow_lost, r0_lost, bias_lost;
    int fault;
};

/* Part of a distance that goes in `tau_s` time constants. */
static real fall_of(real taus) { return -expm1(-taus); }

static real lost_of(real fall, real fade) { return fall + fade - fall * fade; }

/* Keep the account of how long the current has not moved, and of loads between rests. */
static void stand_still(const real *p, struct sensor *s, struct tick *t)
{
    const bool still = fabs(s->current - s->still_A) <= p[P_STILL] && s->age <= p[P_CURRENT_TIMEOUT];
    s->still_A = still ? s->still_A : s->current;
    s->still_s = still ? s->still_s + t->dt : 0;
    if (fabs(s->current - s->rest_A) > p[P_EXCITED])
        s->loaded = 1;
    const bool rests = still && s->still_s >= R(REST_S) && s->still_s - t->dt < R(REST_S)
                       && fabs(s->still_A) <= R(PLAUSIBLE) * p[P_BIAS_SIGMA];
    t->rested = rests && s->loaded > 0 && fabs(s->still_A - s->rest_A) <= 2 * p[P_STILL];
    t->shown = s->still_A;
    if (rests) {
        s->rest_A = s->still_A;
        s->loaded = 0;
    }
}

static struct tick begin(const real *p, struct sensor *s, real dt, real current)
{
    struct tick t = {.dt = dt, .fresh = within(p, P_CURRENT_MIN, current), .moves = dt > 0};
    t.fault = !t.fresh && !isnan(current) ? FAULT_CURRENT_IMPLAUSIBLE : 0;
    s->current = t.current = t.fresh ? current : s->current;
    s->age = t.age = t.fresh ? 0 : s->age + dt;
    if (t.fresh && !t.moves)
        s->gap_s = 0; /* a current that comes after the voltage of its moment ends a gap, too */
    t.gap = clamp((t.fresh ? dt : t.age) - p[P_CURRENT_TIMEOUT], 0, dt);
    t.known = dt - t.gap;
    t.per_ampere = (t.current < 0 ? p[P_CE_CHARGE] : 1) * t.known / p[P_CHARGE_COULOMB];
    t.moved = t.current * t.per_ampere;
    t.range = t.gap > 0 ? p[P_CURRENT_RANGE] : 0;
    t.held = t.fresh ? 0 : 1;
    t.again = t.moves ? 0 : 1;
    const bool unknown = t.age > p[P_CURRENT_TIMEOUT], stale = t.age > R(LEADS_S);
    t.i = unknown ? p[P_CURRENT_RANGE] : t.current;
    t.counts = unknown ? 0 : 1;
    t.leads = unknown || stale ? 0 : 1;
    t.lasting = unknown ? sqrt(R(LASTS_S) / R(VOLTAGE_ERROR_S)) : 0;
    t.late = stale ? R(STALE) * p[P_EXCITED] : 0;
    t.passed = unknown ? 0 : dt / (dt + R(RECENT_S));
    if (t.moves) {
        const real size = fabs(t.current), range = p[P_CURRENT_RANGE], doubted = range / p[P_CHARGE_COULOMB];
        const real after = s->gap_s + t.gap, unknown = doubted * doubted * t.gap * (after + s->gap_s);
        t.walk = dt * p[P_SOC_WALK_OFFSET] + unknown + p[P_SOC_WALK_GAIN] * size * t.known;
        s->gap_s = t.fresh ? 0 : after;
        t.hysteresis_fall = fall_of(p[P_HYSTERESIS_RATE] * size * t.known);
        t.hysteresis_fade = fall_of(p[P_HYSTERESIS_RATE] * range * t.gap);
        t.slow_lost = lost_of(fall_of(t.known * (p[P_SLOW_RATE] * size + 1 / p[P_SLOW_TAU])),
                              fall_of(t.gap * (p[P_SLOW_RATE] * range + 1 / p[P_SLOW_TAU])));
        t.r0_lost = lost_of(fall_of(t.known * (p[P_R0_RATE] * size + 1 / p[P_R0_TAU])),
                            fall_of(t.gap * (p[P_R0_RATE] * range + 1 / p[P_R0_TAU])));
        t.bias_lost = fall_of(dt / p[P_BIAS_TAU]);
    }
    stand_still(p, s, &t);
    return t;
}

/* -- the ohmic drop ----------------------------------------------------------------------------------------------- */

/* By the cell file's r0; `scaled`: the part that the error of r0 scales; `lead`: the slope over that error. */
struct drop {
    real drop, scaled, lead, variance;
};

/* The part of a drop beyond that of a small load. */
INLINE real beyond(real drop, real small) { return drop - clamp(drop, -small, small); }

/* `u`: current over the knee, `ohmic`: the drop of t->i. */
INLINE struct drop drop_of(const real *p, const struct tick *t, struct held *h, real r0, real u, real ohmic, bool alive)
{
    const real small = R(SMALL_LOAD) * p[P_STILL] * r0;
    const real recent = (is_finite(h->recent) & alive) ? h->recent : ohmic;
    real lead = beyond(recent, small);
    UNROLL for (int j = 0; j < N_RC; j++)
        lead += is_finite(h->polarised[j]) ? h->polarised[j] : 0;
    const bool again = (t->again > 0) & alive;
    h->used = (again & is_finite(h->used)) ? h->used : recent;
    h->lead = (again & is_finite(h->lead)) ? h->lead : lead;
    h->recent = recent + (ohmic - recent) * t->passed;
    const real fast = p[P_FAST_REL] * (ohmic - h->used), moved = t->late * r0, any = t->lasting * ohmic;
    return (struct drop){
        .drop = t->counts * ohmic,
        .scaled = t->counts * beyond(ohmic, small),
        .lead = t->leads * h->lead,
        .variance = any * any + t->counts * (fast * fast + moved * moved / (1 + u * u)),
    };
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

/* x' = (1 - lost) x + gain, with noise of sigma q. The bias moves SoC, too: by t->per_ampere. */
struct motion {
    real lost[N], gain[N], q[N];
};

INLINE real noise_root(real lost, real stationary) { return sqrt(lost * (2 - lost) * stationary) + R(TINY_ROOT); }

/* `fall`: 1 - exp(-known / tau) of each RC pair; `fade`: the same over the gap of the current. */
INLINE void move(const real *p, const struct tick *t, const real dyn[CHANNELS], real sigma, struct held *h,
                 const real fall[N_RC], const real fade[N_RC], struct motion *m)
{
    const real held = t->held;
    real variance = t->walk;
    if (COMPENSATED) {
        const real grown = variance + h->soc_walk;
        const bool enough = grown > R(RESOLVED) * sigma * sigma;
        variance = enough ? grown : 0;
        h->soc_walk = enough ? 0 : grown;
    }
    m->lost[0] = 0;
    m->gain[0] = -t->moved;
    m->q[0] = sqrt(variance) + R(TINY_ROOT);
    const real times = dyn[D_ERROR] * dyn[D_ERROR];
    real polarised = 0, resistance = dyn[D_R0];
    UNROLL for (int j = 0; j < N_RC; j++) {
        const real r = dyn[D_RC1 + 2 * j], both = fall[j] * fade[j], lost = fall[j] + fade[j] - both;
        const real error = p[P_RC_REL] * r * t->current, unknown = r * t->range;
        m->lost[1 + j] = lost;
        m->gain[1 + j] = r * t->current * (fall[j] - held * both);
        m->q[1 + j] = noise_root(lost, times * (p[P_VAR_V + j] + error * error) + unknown * unknown);
        h->polarised[j] += m->gain[1 + j] - lost * h->polarised[j];
        polarised += h->polarised[j];
        resistance += r;
    }
    if (HYSTERESIS) {
        const real largest = dyn[CHANNELS - 1], both = t->hysteresis_fall * t->hysteresis_fade;
        const real lost = t->hysteresis_fall + t->hysteresis_fade - both;
        const real anywhere = t->range > 0 ? largest * largest / 3 : 0; /* between the branches */
        m->lost[N_POL] = lost;
        m->gain[N_POL] = (t->hysteresis_fall - held * both) * (t->current < 0 ? -largest : largest);
        m->q[N_POL] = noise_root(lost, times * p[P_VAR_V + N_RC] + anywhere);
    }
    const real offset = p[P_BIAS_SIGMA] * resistance, follows = p[P_SLOW_REL] * polarised;
    m->lost[SLOW] = t->slow_lost;
    m->q[SLOW] = noise_root(t->slow_lost, times * p[P_SLOW_VAR] + offset * offset + follows * follows);
    m->lost[R0] = t->r0_lost;
    m->q[R0] = noise_root(t->r0_lost, p[P_R0_VAR]);
    m->lost[BIAS] = t->bias_lost;
    m->q[BIAS] = noise_root(t->bias_lost, p[P_BIAS_SIGMA] * p[P_BIAS_SIGMA]);
    m->gain[SLOW] = m->gain[R0] = m->gain[BIAS] = 0;
}

/* Householder on [A root, q]: row 0 of A root is dense, as the bias moves SoC, and fills the rows below. */
INLINE void predict(const real *p, const struct tick *t, struct belief *b, const struct motion *m)
{
    real root[N][N], noise[N][N];
    add(b, 0, m->gain[0] - m->lost[0] * b->x[0] + t->per_ampere * b->x[BIAS]);
    UNROLL for (int j = 1; j < N; j++)
        add(b, j, m->gain[j] - m->lost[j] * b->x[j]);
    UNROLL for (int j = 0; j < N; j++)
        UNROLL for (int k = 0; k < N; k++) {
            const real old = k <= j ? b->root[j][k] : 0;
            root[j][k] = old - m->lost[j] * old + (j == 0 ? t->per_ampere * b->root[BIAS][k] : 0);
            noise[j][k] = k == j ? m->q[j] : 0;
        }
    UNROLL for (int j = 0; j < N; j++) {
        real squares = 0;
        UNROLL for (int k = j; k < N; k++)
            squares += root[j][k] * root[j][k];
        UNROLL for (int k = 0; k <= j; k++)
            squares += noise[j][k] * noise[j][k];
        const real norm = sqrt(squares), sign = root[j][j] >= 0 ? 1 : -1, pivot = root[j][j] + sign * norm;
        const real both = 1 / (norm * pivot), inverse = both * pivot, away = both * norm;
        UNROLL for (int i = j + 1; i < N; i++) {
            real dot = 0;
            UNROLL for (int k = j; k < N; k++)
                dot += root[j][k] * root[i][k];
            UNROLL for (int k = 0; k <= j; k++)
                dot += noise[j][k] * noise[i][k];
            const real along = dot * inverse, d = (root[i][j] + sign * along) * away;
            root[i][j] = along;
            UNROLL for (int k = j + 1; k < N; k++)
                root[i][k] -= d * root[j][k];
            UNROLL for (int k = 0; k <= j; k++)
                noise[i][k] -= d * noise[j][k];
        }
        root[j][j] = norm;
    }
    UNROLL for (int j = 0; j < N; j++)
        UNROLL for (int k = 0; k <= j; k++)
            b->root[j][k] = root[j][k];
    b->root[0][0] = least(b->root[0][0], p[P_SOC_SIGMA_MAX]);
}

struct innovation {
    real predicted, variance, alpha, b[N];
    real trust; /* share of its gain that the bias takes */
};

/* Variance of a reading, and of that what is there because readings crowd. */
struct noise {
    real r, crowded;
};

INLINE struct noise noise_of(const real *p, const struct held *h, real error, real drop_variance)
{
    const real age = largest(h->voltage_age, R(AT_ONCE_S)), scale = h->voltage_scale;
    const real white = error * error * p[P_VAR_VOLTAGE] + drop_variance;
    const real fast = error * error * p[P_FAST_VAR];
    const real lasting = white * largest(R(VOLTAGE_ERROR_S) / age, 1) + fast * largest(R(FAST_S) / age, 1);
    const real r = lasting * (scale / (R(1 + 1 / REPEATS_MOST) - h->repeats));
    return (struct noise){r, r - scale * (white + fast)};
}

/* `g`: OCV at x[0] and at x[0] +- gamma root[0][0]. */
INLINE void innovate(const real *p, const struct belief *b, const struct held *h, const real g[3],
                     const struct drop *d, real error, real r, struct innovation *n)
{
    const real e = p[P_W] * (g[1] + g[2] - 2 * g[0]), by_soc = p[P_W] * p[P_GAMMA] * (g[1] - g[2]);
    real now = d->scaled, model = r;
    UNROLL for (int j = 0; j < N_RC; j++)
        now += h->polarised[j];
    n->predicted = g[0] + e - d->drop - now * b->x[R0];
    n->variance = n->alpha = r + e * e * p[P_E2];
    UNROLL for (int j = 1; j <= N_V; j++)
        n->predicted -= b->x[j];
    UNROLL for (int k = 0; k < N; k++) {
        real sum = k == 0 ? by_soc : 0;
        UNROLL for (int j = k > 1 ? k : 1; j <= N_V; j++)
            sum -= b->root[j][k];
        if (k <= R0)
            sum -= d->lead * b->root[R0][k];
        n->b[k] = sum;
        n->variance += sum * sum;
    }
    UNROLL for (int j = 0; j < N_POL; j++)
        model += error * error * p[P_VAR_V + j];
    n->trust = by_soc * by_soc / (by_soc * by_soc + model);
}

/* A rest, as a measurement of the bias. */
INLINE void innovate_rest(const real *p, const struct belief *b, struct innovation *n)
{
    n->predicted = b->x[BIAS];
    n->variance = n->alpha = p[P_PARASITIC] * p[P_PARASITIC];
    UNROLL for (int k = 0; k < N; k++) {
        n->b[k] = b->root[BIAS][k];
        n->variance += n->b[k] * n->b[k];
    }
    n->trust = 1;
}

/* Carlson's update, from the last column to the first; the bias takes n->trust of its gain. */
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
    const real refused = (1 - n->trust) * gain[BIAS], old = b->root[BIAS][BIAS];
    b->root[BIAS][BIAS] = sqrt(old * old + refused * refused * per_variance);
    gain[BIAS] *= n->trust;
    const real weight = innovation * per_variance;
    UNROLL for (int j = 0; j < N; j++)
        add(b, j, gain[j] * weight);
}

INLINE bool passes(const real *p, real innovation, real expected)
{
    return innovation * innovation <= p[P_GATE2] * expected;
}

/* Follow the size of the fast voltage error by an innovation that is to be fused. */
INLINE void learn(const real *p, struct held *h, real innovation, real expected, real since_heard, bool fused)
{
    const real since = clamp(since_heard == since_heard ? since_heard : 0, 0, R(STEP_MAX_S));
    const real nis = innovation * innovation / expected, scale = h->voltage_scale;
    const real followed = scale + scale * (clamp(nis, 0, p[P_GATE2]) - 1) * since * R(1 / SCALE_S);
    const bool follows = fused & is_finite(nis) & (p[P_ADAPT] > 0);
    h->voltage_scale = follows ? clamp(followed, 1, R(SCALE_MAX)) : scale;
}

/* -- around the filter -------------------------------------------------------------------------------------------- */

/* Age what is held and take what is plausible; `*voltage` becomes NaN if it is not. Returns faults. */
INLINE whole take(const real *p, const struct tick *t, struct held *h, real *voltage, real temperature,
                  real *since_heard)
{
    const real z = *voltage;
    const bool heard = within(p, P_VOLTAGE_MIN, z), felt = within(p, P_TEMPERATURE_MIN, temperature);
    const real heard_age = h->heard_age + t->dt, since = heard_age == heard_age ? heard_age : 0;
    const real repeats = h->repeats == h->repeats ? h->repeats : 0, same = z == h->last_V ? 1 : 0;
    const real filtered = repeats + (same - repeats) * (since / (since + R(REPEATS_S)));
    h->temperature = felt ? temperature : h->temperature;
    h->temperature_age = felt ? 0 : h->temperature_age + t->dt;
    /* Refusals with a silence between them are not an unbroken row. */
    h->rejected_s = (heard & (heard_age > p[P_VOLTAGE_TIMEOUT])) ? R(NAN) : h->rejected_s + t->dt;
    h->heard_age = heard ? 0 : heard_age;
    h->voltage_age += t->dt;
    h->repeats = heard ? filtered : repeats;
    h->last_V = heard ? z : h->last_V;
    *since_heard = heard_age;
    *voltage = heard ? z : R(NAN);
    return t->fault | ((!felt & (temperature == temperature)) ? FAULT_TEMPERATURE_IMPLAUSIBLE : 0)
           | ((!heard & (z == z)) ? FAULT_VOLTAGE_IMPLAUSIBLE : 0);
}

INLINE bool sound(const struct belief *b, real voltage_age)
{
    real total = voltage_age;
    UNROLL for (int j = 0; j < N; j++) {
        total += fabs(b->x[j]);
        UNROLL for (int k = 0; k <= j; k++)
            total += fabs(b->root[j][k]);
    }
    return is_finite(total);
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
    *sigma = clamp(*sigma, p[P_SOC_SIGMA_MIN], p[P_SOC_SIGMA_MAX]);
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

INLINE whole missing(const real *p, const struct tick *t, const struct held *h)
{
    const bool current = (t->age <= p[P_CURRENT_TIMEOUT]) & (t->gap <= 0);
    return (current ? 0 : FAULT_CURRENT_MISSING)
           | (h->voltage_age <= p[P_VOLTAGE_TIMEOUT] ? 0 : FAULT_VOLTAGE_MISSING)
           | (h->temperature_age <= p[P_TEMPERATURE_TIMEOUT] ? 0 : FAULT_TEMPERATURE_MISSING);
}

/* Of an Estimator's record, whose slots are `stride` apart: the current's part, a cell's and its belief. */
static struct sensor sensor_of(const real *record, size_t stride)
{
    return (struct sensor){
        .current = record[stride * H_CURRENT],
        .age = record[stride * H_CURRENT_AGE],
        .gap_s = record[stride * H_GAP_S],
        .still_A = record[stride * H_STILL_A],
        .still_s = record[stride * H_STILL_S],
        .rest_A = record[stride * H_REST_A],
        .loaded = record[stride * H_LOADED],
    };
}

static struct held held_of(const real *record, size_t stride)
{
    struct held h;
#define SLOT(name, slot) h.name = record[stride * (slot)];
    HELD_SLOTS(SLOT)
#undef SLOT
    for (size_t j = 0; j < N_RC; j++)
        h.polarised[j] = record[stride * (H_POLARISED + j)];
    return h;
}

static struct belief belief_of(const real *record, size_t stride)
{
    struct belief b = {0};
    const real *root = record + stride * (HELD + N), *carry = root + stride * ROOTS;
    for (size_t j = 0; j < N; j++) {
        b.x[j] = record[stride * (HELD + j)];
        b.carry[j] = COMPENSATED ? carry[stride * j] : 0;
        for (size_t k = 0; k <= j; k++)
            b.root[j][k] = root[stride * (j * (j + 1) / 2 + k)];
    }
    return b;
}

/* -- one cell ----------------------------------------------------------------------------------------------------- */

static void advance(const real *p, const struct tick *t, struct cell *c, const real dyn[CHANNELS])
{
    real fall[N_RC], fade[N_RC] = {0};
    struct motion m;
    for (int j = 0; j < N_RC; j++) {
        fall[j] = fall_of(t->known / dyn[D_RC1 + 2 * j + 1]);
        if (t->gap > 0)
            fade[j] = fall_of(t->gap / dyn[D_RC1 + 2 * j + 1]);
    }
    move(p, t, dyn, c->belief.root[0][0], &c->held, fall, fade, &m);
    predict(p, t, &c->belief, &m);
}

/* Compare the voltage and fuse it, if the gate lets it. Returns faults. */
static int fuse(const real *p, struct cell *c, real voltage, real T, real error, const struct drop *d, real since_heard)
{
    struct belief *b = &c->belief;
    struct held *h = &c->held;
    struct innovation n;
    const struct row row = row_of(p, P_OCV, T);
    const real spread = p[P_GAMMA] * b->root[0][0];
    const real g[3] = {ocv(p, row, b->x[0]), ocv(p, row, b->x[0] + spread), ocv(p, row, b->x[0] - spread)};
    const struct noise noise = noise_of(p, h, error, d->variance);
    innovate(p, b, h, g, d, error, noise.r, &n);
    const real innovation = voltage - n.predicted, expected = n.variance - noise.crowded;
    if (!isfinite(innovation + n.variance))
        return FAULT_NUMERIC;
    c->voltage_pred = n.predicted;
    c->innovation = innovation;
    c->innovation_var = expected;
    c->nis = innovation * innovation / expected;
    if (!passes(p, innovation, expected)) {
        if (isnan(h->rejected_s))
            h->rejected_s = 0;
        return FAULT_INNOVATION_REJECTED;
    }
    learn(p, h, innovation, expected, since_heard, true);
    update(b, &n, innovation);
    h->rejected_s = R(NAN);
    h->voltage_age = 0;
    return 0;
}

static void fuse_rest(const real *p, const struct tick *t, struct belief *b)
{
    struct innovation n;
    innovate_rest(p, b, &n);
    if (isfinite(t->shown - n.predicted + n.variance))
        update(b, &n, t->shown - n.predicted);
}

int cell_step(const real *p, struct cell *cell, double dt_s, double current_A, double voltage_V,
              double temperature_degC)
{
    struct cell c = *cell; /* taken back if it does not stay finite */
    real voltage = (real)voltage_V, since_heard;
    const bool alive = sound(&c.belief, c.held.voltage_age);
    const struct tick t = begin(p, &c.sensor, (real)dt_s, (real)current_A);
    int faults = (int)take(p, &t, &c.held, &voltage, (real)temperature_degC, &since_heard);

    const real soc = alive ? c.belief.x[0] - t.moved + t.per_ampere * c.belief.x[BIAS] : p[P_INITIAL_SOC];
    const real place = knots(p, is_finite(soc) ? soc : p[P_INITIAL_SOC]), knot = knot_below(p, place);
    const real T = isnan(c.held.temperature) ? R(UNKNOWN_TEMPERATURE) : c.held.temperature;
    real dyn[CHANNELS], rise[CHANNELS];
    dynamics(p, knot, T, dyn, rise);
    for (int k = 0; k < CHANNELS; k++)
        dyn[k] += (place - knot) * rise[k];
    const real r0 = dyn[t.i < 0 ? D_R0_CHARGE : D_R0], u = t.i / dyn[D_KNEE];
    const struct drop d = drop_of(p, &t, &c.held, r0, u, r0 * dyn[D_KNEE] * asinh(u), alive);

    c.voltage_pred = c.innovation = c.innovation_var = c.nis = R(NAN);
    if (alive && t.moves)
        advance(p, &t, &c, dyn);
    if (alive && t.rested)
        fuse_rest(p, &t, &c.belief);
    if (alive && !isnan(voltage))
        faults |= fuse(p, &c, voltage, T, dyn[D_ERROR], &d, since_heard);
    faults |= (int)missing(p, &t, &c.held);

    if ((faults & FAULT_NUMERIC) || (alive && !sound(&c.belief, c.held.voltage_age))) {
        faults = FAULT_NUMERIC;
        c = *cell;
        c.voltage_pred = c.innovation = c.innovation_var = c.nis = R(NAN);
    }
    faults |= (int)bound(p, &c.belief.x[0], &c.belief.root[0][0], c.held.temperature, faults, alive);
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

void cell_adopt(struct cell *cell, const real *record)
{
    cell->sensor = sensor_of(record, 1);
    cell->held = held_of(record, 1);
    cell->belief = belief_of(record, 1);
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

/* The belief where `choice` is true, else what stands in the lane. */
INLINE void store_if(bool choice, struct lanes *w, int c, const struct belief *b)
{
    const struct belief before = load(w, c);
    struct belief after;
    UNROLL for (int j = 0; j < N; j++) {
        after.x[j] = choice ? b->x[j] : before.x[j];
        after.carry[j] = choice ? b->carry[j] : before.carry[j];
        UNROLL for (int k = 0; k <= j; k++)
            after.root[j][k] = choice ? b->root[j][k] : before.root[j][k];
    }
    store(w, c, &after);
}

INLINE struct held load_held(const struct lanes *w, int c)
{
    struct held h;
#define SLOT(name, slot) h.name = w->name[c];
    HELD_SLOTS(SLOT)
#undef SLOT
    UNROLL for (int j = 0; j < N_RC; j++)
        h.polarised[j] = w->polarised[j][c];
    return h;
}

INLINE void store_held(struct lanes *w, int c, const struct held *h)
{
#define SLOT(name, slot) w->name[c] = h->name;
    HELD_SLOTS(SLOT)
#undef SLOT
    UNROLL for (int j = 0; j < N_RC; j++)
        w->polarised[j][c] = h->polarised[j];
}

/* Values of a step that are not kept. */
struct work {
    _Alignas(64) whole alive[LANES], code[LANES];
    real voltage[LANES], T[LANES], soc[LANES];
    real dyn[CHANNELS][LANES], fall[N_RC][LANES], fade[N_RC][LANES];
    real r0[LANES], u[LANES], asinh_u[LANES];
    real drop[LANES], scaled[LANES], lead[LANES], drop_variance[LANES], since_heard[LANES], g[3][LANES];
    real predicted[LANES], innovation[LANES], expected[LANES];
    real sigma[LANES], low[LANES], high[LANES]; /* published, with `soc` */
};

static void take_lanes(const real *restrict p, const struct tick *restrict t, struct lanes *restrict w,
                       struct work *restrict y, const real *restrict temperature)
{
    EACH_LANE {
        struct held h = load_held(w, c);
        real voltage = y->voltage[c], since_heard;
        y->code[c] = take(p, t, &h, &voltage, temperature[c], &since_heard);
        y->voltage[c] = voltage;
        y->since_heard[c] = since_heard;
        store_held(w, c, &h);
    }
}

/* Read the dynamics at the mean SoC to come, through each lane's cached row. */
static void schedule(const real *restrict p, const struct tick *restrict t, struct block *restrict s,
                     const struct lanes *restrict w, struct work *restrict y)
{
    const real moved = t->moved, per_ampere = t->per_ampere, initial = p[P_INITIAL_SOC];
    const real T_limit = p[P_CACHE_TEMPERATURE];
    whole stale = 0;
    EACH_LANE {
        const real soc = w->x[0][c] - moved + per_ampere * w->x[BIAS][c];
        const real place = knots(p, ((y->alive[c] != 0) & is_finite(soc)) ? soc : initial);
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

static void drop_lanes(const real *restrict p, const struct tick *restrict t, struct lanes *restrict w,
                       struct work *restrict y)
{
    const real i = t->i, *r0 = y->dyn[i < 0 ? D_R0_CHARGE : D_R0], *knee = y->dyn[D_KNEE];
    EACH_LANE {
        y->r0[c] = r0[c];
        y->u[c] = y->asinh_u[c] = i / knee[c];
    }
    asinh_lanes(y->asinh_u);
    EACH_LANE {
        struct held h = load_held(w, c);
        const real ohmic = y->r0[c] * y->dyn[D_KNEE][c] * y->asinh_u[c];
        const struct drop d = drop_of(p, t, &h, y->r0[c], y->u[c], ohmic, y->alive[c] != 0);
        y->drop[c] = d.drop;
        y->scaled[c] = d.scaled;
        y->lead[c] = d.lead;
        y->drop_variance[c] = d.variance;
        store_held(w, c, &h);
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

static void relax(const struct tick *restrict t, struct work *restrict y)
{
    for (int j = 0; j < N_RC; j++)
        EACH_LANE y->fall[j][c] = t->known / y->dyn[D_RC1 + 2 * j + 1][c];
    decay(y->fall, N_RC);
    memset(y->fade, 0, sizeof y->fade);
    if (t->gap > 0) {
        for (int j = 0; j < N_RC; j++)
            EACH_LANE y->fade[j][c] = t->gap / y->dyn[D_RC1 + 2 * j + 1][c];
        decay(y->fade, N_RC);
    }
}

static void advance_lanes(const real *restrict p, const struct tick *restrict t, struct lanes *restrict w,
                          const struct work *restrict y)
{
    EACH_LANE {
        struct belief b = load(w, c);
        struct held h = load_held(w, c);
        struct motion m;
        real dyn[CHANNELS], fall[N_RC], fade[N_RC];
        UNROLL for (int k = 0; k < CHANNELS; k++)
            dyn[k] = y->dyn[k][c];
        UNROLL for (int j = 0; j < N_RC; j++) {
            fall[j] = y->fall[j][c];
            fade[j] = y->fade[j][c];
        }
        move(p, t, dyn, b.root[0][0], &h, fall, fade, &m);
        predict(p, t, &b, &m);
        store(w, c, &b);
        store_held(w, c, &h);
    }
}

static void fuse_rest_lanes(const real *restrict p, const struct tick *restrict t, struct lanes *restrict w,
                            const struct work *restrict y)
{
    EACH_LANE {
        struct belief b = load(w, c);
        struct innovation n;
        innovate_rest(p, &b, &n);
        const real innovation = t->shown - n.predicted;
        update(&b, &n, innovation);
        store_if((y->alive[c] != 0) & is_finite(innovation + n.variance), w, c, &b);
    }
}

static void look_up(const real *restrict p, const struct lanes *restrict w, struct work *restrict y)
{
    const real away[3] = {0, p[P_GAMMA], -p[P_GAMMA]};
    for (int point = 0; point < 3; point++) {
        const real gamma = away[point];
        EACH_LANE {
            const real soc = w->x[0][c] + gamma * w->root[0][c];
            y->g[point][c] = ocv(p, row_of(p, P_OCV, y->T[c]), is_finite(soc) ? soc : R(0.5)); /* NaN is no index */
        }
    }
}

static void fuse_lanes(const real *restrict p, struct lanes *restrict w, struct work *restrict y)
{
    EACH_LANE {
        struct belief b = load(w, c);
        struct held h = load_held(w, c);
        struct innovation n;
        const struct drop d = {y->drop[c], y->scaled[c], y->lead[c], y->drop_variance[c]};
        const real g[3] = {y->g[0][c], y->g[1][c], y->g[2][c]}, error = y->dyn[D_ERROR][c];
        const struct noise noise = noise_of(p, &h, error, d.variance);
        innovate(p, &b, &h, g, &d, error, noise.r, &n);
        const real innovation = y->voltage[c] - n.predicted, expected = n.variance - noise.crowded;
        const bool heard = (y->voltage[c] == y->voltage[c]) & (y->alive[c] != 0);
        const bool compared = heard & is_finite(innovation + n.variance), accepted = passes(p, innovation, expected);
        const bool fused = compared & accepted, refused = compared & !accepted;
        learn(p, &h, innovation, expected, y->since_heard[c], fused);
        update(&b, &n, innovation);
        store_if(fused, w, c, &b);
        h.rejected_s = fused ? R(NAN) : (refused & (h.rejected_s != h.rejected_s)) ? 0 : h.rejected_s;
        h.voltage_age = fused ? 0 : h.voltage_age;
        store_held(w, c, &h);
        y->code[c] |= (refused ? FAULT_INNOVATION_REJECTED : 0) | ((heard & !compared) ? FAULT_NUMERIC : 0);
        y->predicted[c] = compared ? n.predicted : R(NAN);
        y->innovation[c] = compared ? innovation : R(NAN);
        y->expected[c] = compared ? expected : R(NAN);
    }
}

static void judge_lanes(const real *restrict p, const struct tick *restrict t, struct lanes *restrict w,
                        struct lanes *restrict s, struct work *restrict y)
{
    whole refused = 0;
    EACH_LANE {
        const struct belief b = load(w, c);
        const struct held h = load_held(w, c);
        const whole code = y->code[c] | missing(p, t, &h);
        const bool good = ((y->alive[c] == 0) | sound(&b, h.voltage_age)) & ((code & FAULT_NUMERIC) == 0);
        y->code[c] = good ? code : FAULT_NUMERIC;
        refused |= good ? 0 : 1;
    }
    if (refused)
        for (int c = 0; c < LANES; c++)
            if (y->code[c] == FAULT_NUMERIC) {
                for (size_t k = (size_t)c; k < sizeof *w / sizeof(real); k += LANES)
                    ((real *)w)[k] = ((const real *)s)[k];
                y->predicted[c] = y->innovation[c] = y->expected[c] = R(NAN);
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
        out[OUT_INNOVATION_VAR * cells + c] = y->expected[c];
        out[OUT_NIS * cells + c] = y->innovation[c] * y->innovation[c] / y->expected[c];
        out[OUT_AGE * cells + c] = s->voltage_age[c];
        out[OUT_BIAS * cells + c] = s->x[BIAS][c];
        out[OUT_R0 * cells + c] = y->alive[c] ? y->r0[c] * (1 + s->x[R0][c]) : R(NAN);
        out[OUT_CODE * cells + c] = (real)y->code[c];
    }
}

/* Of the first `count` cells of a block. Returns their faults and, from bit STATUS_SHIFT up, a bit for each status. */
static int tick_block(const real *p, const struct tick *t, struct block *s, struct work *y, real *io, long cells,
                      int count)
{
    struct lanes w = s->lanes;
    real temperature[LANES];
    for (int c = 0; c < LANES; c++) {
        y->voltage[c] = c < count ? io[IN_VOLTAGE * cells + c] : R(NAN);
        temperature[c] = c < count ? io[IN_TEMPERATURE * cells + c] : R(NAN);
    }
    EACH_LANE {
        const struct belief b = load(&w, c);
        y->alive[c] = sound(&b, w.voltage_age[c]) ? 1 : 0;
    }
    take_lanes(p, t, &w, y, temperature);
    schedule(p, t, s, &w, y);
    drop_lanes(p, t, &w, y);
    if (t->moves) {
        relax(t, y);
        advance_lanes(p, t, &w, y);
    }
    if (t->rested)
        fuse_rest_lanes(p, t, &w, y);
    look_up(p, &w, y);
    fuse_lanes(p, &w, y);
    judge_lanes(p, t, &w, &s->lanes, y);
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
    const struct tick t = begin(p, &pack->sensor, (real)dt_s, (real)current_A);
    int codes = 0;
    for (long first = 0; first < cells; first += LANES) {
        const int count = (int)(cells - first < LANES ? cells - first : LANES);
        codes |= tick_block(p, &t, &pack->blocks[first / LANES], &y, io + first, cells, count);
    }
    const int seen = codes >> STATUS_SHIFT;
    const int status = seen & 1 << STATUS_INITIALISING ? STATUS_INITIALISING
                       : seen == 1 << STATUS_INVALID   ? STATUS_INVALID
                       : seen == 1 << STATUS_OK        ? STATUS_OK
                                                       : STATUS_DEGRADED;
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

void pack_adopt(struct pack *pack, const real *state, long cells, long size)
{
    pack->sensor = sensor_of(state, LANES);
    for (long first = 0; first < cells; first += LANES)
        for (int c = 0; c < LANES; c++) {
            const real *record = state + first * size + c;
            const struct held h = held_of(record, LANES);
            const struct belief b = belief_of(record, LANES);
            store_held(&pack->blocks[first / LANES].lanes, c, &h);
            store(&pack->blocks[first / LANES].lanes, c, &b);
        }
}

size_t pack_size(long cells)
{
    return sizeof(struct pack) + (size_t)((cells + LANES - 1) / LANES) * sizeof(struct block);
}
