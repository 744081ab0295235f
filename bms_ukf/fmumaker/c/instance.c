/* What an FMU does, in whatever version of FMI it is asked. */
#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int instance_complain(const Instance *c, int status, const char *format, ...)
{
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (c->log) {
        c->tell(c, status, status == STATUS_DISCARD ? "logStatusDiscard" : "logStatusError", text);
    }
    return status;
}

static void set_start_values(State *s)
{
    memset(s, 0, sizeof *s);
    s->phase = INSTANTIATED;
    for (int k = 0; k < N_VALUES; ++k) {
        s->model.value[k] = VALUES[k].start;
    }
}

Instance *instance_new(const char *name, const char *token, Tell *tell, void (*log)(void), void *environment)
{
    Instance *c = name && token ? calloc(1, sizeof *c + strlen(name) + 1) : NULL;
    if (!c) {
        return NULL;
    }
    c->tell = tell;
    c->log = log;
    c->environment = environment;
    memcpy(c->name, name, strlen(name));
    set_start_values(&c->state);
    if (strcmp(token, MODEL_TOKEN) != 0) {
        instance_complain(c, STATUS_ERROR, "expected the token (guid) %s", MODEL_TOKEN);
        free(c);
        return NULL;
    }
    return c;
}

int instance_update(Instance *c)
{
    if (!c->state.outputs_are_old) {
        return STATUS_OK;
    }
    const char *failure = c->state.phase == INITIALIZING ? model_initialise(&c->state.model) : NULL;
    if (!failure) {
        failure = model_outputs(&c->state.model);
    }
    if (failure) {
        return instance_complain(c, STATUS_ERROR, "at t = %.9g s: %s", c->state.time, failure);
    }
    c->state.outputs_are_old = 0;
    return STATUS_OK;
}

int instance_experiment(Instance *c, double start, int stop_defined, double stop)
{
    if (!isfinite(start) || (stop_defined && !(stop >= start))) {
        return instance_complain(c, STATUS_ERROR, "experiment from %g s to %g s", start, stop);
    }
    c->state.time = start;
    c->state.stop_defined = stop_defined;
    c->state.stop = stop;
    return STATUS_OK;
}

int instance_enter_initialization(Instance *c)
{
    c->state.phase = INITIALIZING;
    c->state.outputs_are_old = 1;
    return STATUS_OK;
}

int instance_exit_initialization(Instance *c)
{
    c->state.outputs_are_old = 1;
    const int status = instance_update(c);
    if (status == STATUS_OK) {
        c->state.phase = RUNNING;
    }
    return status;
}

int instance_reset(Instance *c)
{
    set_start_values(&c->state);
    return STATUS_OK;
}

int instance_check(const Instance *c, size_t k, double value)
{
    const Value *v = &VALUES[k];
    if (v->kind == OUTPUT || (v->kind == PARAMETER && c->state.phase == RUNNING)) {
        return instance_complain(c, STATUS_ERROR, "%s cannot be set now", v->name);
    }
    if (!(value >= v->min && value <= v->max) && !(v->may_be_nan && isnan(value))) {
        return instance_complain(c, STATUS_DISCARD, "%s = %g is not within [%g, %g]", v->name, value, v->min, v->max);
    }
    return STATUS_OK;
}

void instance_set(Instance *c, size_t k, double value)
{
    c->state.model.value[k] = value;
    c->state.outputs_are_old = 1;
}

int instance_step(Instance *c, double time, double duration)
{
    State *s = &c->state;
    const double slack = 1e-9 * fmax(1.0, fabs(s->time)); /* rounding of a master that multiplies or adds up */
    if (!(fabs(time - s->time) <= slack)) {
        return instance_complain(c, STATUS_ERROR, "step starts at %.9g s, expected %.9g s", time, s->time);
    }
    if (!(duration > 0.0) || !isfinite(duration)) {
        return instance_complain(c, STATUS_ERROR, "step size is %g s, expected more than 0", duration);
    }
    if (s->stop_defined && time + duration > s->stop + slack) {
        return instance_complain(c, STATUS_ERROR, "step ends at %.9g s, after the stop time %.9g s", time + duration,
                                 s->stop);
    }
    const Model before = s->model;
    const char *failure = model_step(&s->model, duration);
    if (!failure) {
        failure = model_outputs(&s->model);
    }
    if (failure) {
        s->model = before;
        return instance_complain(c, STATUS_DISCARD, "step from %.9g s to %.9g s: %s", time, time + duration, failure);
    }
    s->outputs_are_old = 0;
    s->time = time + duration;
    return STATUS_OK;
}

int instance_get_state(Instance *c, void **state)
{
    if (!*state && !(*state = malloc(sizeof(State)))) {
        return instance_complain(c, STATUS_ERROR, "out of memory");
    }
    memcpy(*state, &c->state, sizeof(State));
    return STATUS_OK;
}

int instance_set_state(Instance *c, const void *state)
{
    if (!state) {
        return instance_complain(c, STATUS_ERROR, "no FMU state given");
    }
    memcpy(&c->state, state, sizeof(State));
    return STATUS_OK;
}

int instance_serialise(Instance *c, const void *state, unsigned char *bytes, size_t size)
{
    if (!state || size < SERIALISED_SIZE) {
        return instance_complain(c, STATUS_ERROR, "no FMU state given, or no room for it");
    }
    memcpy(bytes, MODEL_TOKEN, sizeof MODEL_TOKEN);
    memcpy(bytes + sizeof MODEL_TOKEN, state, sizeof(State));
    return STATUS_OK;
}

int instance_deserialise(Instance *c, const unsigned char *bytes, size_t size, void **state)
{
    if (size != SERIALISED_SIZE || memcmp(bytes, MODEL_TOKEN, sizeof MODEL_TOKEN) != 0) {
        return instance_complain(c, STATUS_ERROR, "these bytes are not a state of this FMU");
    }
    if (!*state && !(*state = malloc(sizeof(State)))) {
        return instance_complain(c, STATUS_ERROR, "out of memory");
    }
    memcpy(*state, bytes + sizeof MODEL_TOKEN, sizeof(State));
    return STATUS_OK;
}
