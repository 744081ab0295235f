/* FMI 2.0 co-simulation for any model behind model.h whose variables are all Real. No state outside the instance. */
#include "fmi2Functions.h"
#include "model.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum {
    INSTANTIATED = 1,
    INITIALIZING = 2,
    RUNNING = 4,
    TERMINATED = 8,
} Phase;

#define ANY_PHASE (INSTANTIATED | INITIALIZING | RUNNING | TERMINATED)

/* All that an FMU state holds. Cleared before use, so that its padding is the same bytes every time. */
typedef struct {
    Phase phase;
    int stop_defined;
    double time, stop;
    int outputs_are_old;
    Model model;
} State;

typedef struct {
    State state;
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
    char name[];
} Instance;

static fmi2Status complain(const Instance *c, fmi2Status status, const char *format, ...)
{
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (c->log) {
        /* Some masters do not expand the format: it is the text itself, and must never hold a %. */
        c->log(c->environment, c->name, status, status == fmi2Discard ? "logStatusDiscard" : "logStatusError", text);
    }
    return status;
}

/* Leaves the calling function unless its instance is there and in one of the phases. */
#define REQUIRE_PHASE(component, phases)                                                                                   \
    Instance *c = component;                                                                                               \
    if (!c) {                                                                                                              \
        return fmi2Error;                                                                                                  \
    }                                                                                                                      \
    if (!(c->state.phase & (unsigned)(phases))) {                                                                          \
        return complain(c, fmi2Error, "%s is not allowed now", __func__);                                                  \
    }

static void set_start_values(State *s)
{
    memset(s, 0, sizeof *s);
    s->phase = INSTANTIATED;
    for (int k = 0; k < N_VARIABLES; ++k) {
        s->model.value[k] = VARIABLES[k].start;
    }
}

/* Brings the values of the outputs up to date with state and inputs. */
static fmi2Status update(Instance *c)
{
    if (!c->state.outputs_are_old) {
        return fmi2OK;
    }
    const char *failure = c->state.phase == INITIALIZING ? model_initialise(&c->state.model) : NULL;
    if (!failure) {
        failure = model_outputs(&c->state.model);
    }
    if (failure) {
        return complain(c, fmi2Error, "at t = %.9g s: %s", c->state.time, failure);
    }
    c->state.outputs_are_old = 0;
    return fmi2OK;
}

/* Identity and life */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging; /* only errors are logged, and those always */
    if (!name || !guid || !functions) {
        return NULL;
    }
    Instance *c = calloc(1, sizeof *c + strlen(name) + 1);
    if (!c) {
        return NULL;
    }
    c->log = functions->logger;
    c->environment = functions->componentEnvironment;
    memcpy(c->name, name, strlen(name));
    set_start_values(&c->state);
    if (type != fmi2CoSimulation || strcmp(guid, MODEL_GUID) != 0) {
        complain(c, fmi2Error, "expected co-simulation and guid %s", MODEL_GUID);
        free(c);
        return NULL;
    }
    return c;
}

void fmi2FreeInstance(fmi2Component component)
{
    free(component);
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)on, (void)n, (void)categories;
    REQUIRE_PHASE(component, ANY_PHASE)
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined, (void)tolerance; /* the model knows its own */
    REQUIRE_PHASE(component, INSTANTIATED)
    if (!isfinite(start) || (stop_defined && !(stop >= start))) {
        return complain(c, fmi2Error, "experiment from %g s to %g s", start, stop);
    }
    c->state.time = start;
    c->state.stop_defined = stop_defined;
    c->state.stop = stop;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    REQUIRE_PHASE(component, INSTANTIATED)
    c->state.phase = INITIALIZING;
    c->state.outputs_are_old = 1;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    REQUIRE_PHASE(component, INITIALIZING)
    c->state.outputs_are_old = 1;
    const fmi2Status status = update(c);
    if (status == fmi2OK) {
        c->state.phase = RUNNING;
    }
    return status;
}

fmi2Status fmi2Terminate(fmi2Component component)
{
    REQUIRE_PHASE(component, RUNNING)
    c->state.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    set_start_values(&c->state);
    return fmi2OK;
}

/* Values */

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    REQUIRE_PHASE(component, INITIALIZING | RUNNING | TERMINATED)
    const fmi2Status status = update(c);
    if (status != fmi2OK) {
        return status;
    }
    for (size_t k = 0; k < n; ++k) {
        if (vr[k] >= N_VARIABLES) {
            return complain(c, fmi2Error, "no Real variable has value reference %u", vr[k]);
        }
        value[k] = c->state.model.value[vr[k]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    REQUIRE_PHASE(component, INSTANTIATED | INITIALIZING | RUNNING)
    for (size_t k = 0; k < n; ++k) {
        if (vr[k] >= N_VARIABLES) {
            return complain(c, fmi2Error, "no Real variable has value reference %u", vr[k]);
        }
        const Variable *v = &VARIABLES[vr[k]];
        if (v->kind == OUTPUT || (v->kind == PARAMETER && c->state.phase == RUNNING)) {
            return complain(c, fmi2Error, "%s cannot be set now", v->name);
        }
        if (!(value[k] >= v->min && value[k] <= v->max)) {
            return complain(c, fmi2Discard, "%s = %g is not within [%g, %g]", v->name, value[k], v->min, v->max);
        }
    }
    for (size_t k = 0; k < n; ++k) {
        c->state.model.value[vr[k]] = value[k];
    }
    c->state.outputs_are_old = 1;
    return fmi2OK;
}

/* Time */

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real duration, fmi2Boolean no_set_state_before)
{
    (void)no_set_state_before;
    REQUIRE_PHASE(component, RUNNING)
    State *s = &c->state;
    const double slack = 1e-9 * fmax(1.0, fabs(s->time)); /* rounding of a master that multiplies or adds up */
    if (!(fabs(time - s->time) <= slack)) {
        return complain(c, fmi2Error, "step starts at %.9g s, expected %.9g s", time, s->time);
    }
    if (!(duration > 0.0) || !isfinite(duration)) {
        return complain(c, fmi2Error, "step size is %g s, expected more than 0", duration);
    }
    if (s->stop_defined && time + duration > s->stop + slack) {
        return complain(c, fmi2Error, "step ends at %.9g s, after the stop time %.9g s", time + duration, s->stop);
    }
    const Model before = s->model;
    const char *failure = model_step(&s->model, duration);
    if (!failure) {
        failure = model_outputs(&s->model);
    }
    if (failure) {
        s->model = before;
        return complain(c, fmi2Discard, "step from %.9g s to %.9g s: %s", time, time + duration, failure);
    }
    s->outputs_are_old = 0;
    s->time = time + duration;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value)
{
    REQUIRE_PHASE(component, RUNNING | TERMINATED)
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = c->state.time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value)
{
    REQUIRE_PHASE(component, RUNNING | TERMINATED)
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False; /* a refused step may be tried again with another input */
    return fmi2OK;
}

/* State */

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    if (!*state && !(*state = malloc(sizeof(State)))) {
        return complain(c, fmi2Error, "out of memory");
    }
    memcpy(*state, &c->state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    if (!state) {
        return complain(c, fmi2Error, "no FMU state given");
    }
    memcpy(&c->state, state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

/* Serialised: the GUID, then the bytes of State. Only for the same build of the FMU, as the GUID covers its sources. */

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    (void)state;
    *size = sizeof MODEL_GUID + sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    if (!state || size < sizeof MODEL_GUID + sizeof(State)) {
        return complain(c, fmi2Error, "no FMU state given, or no room for it");
    }
    memcpy(bytes, MODEL_GUID, sizeof MODEL_GUID);
    memcpy(bytes + sizeof MODEL_GUID, state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    if (size != sizeof MODEL_GUID + sizeof(State) || memcmp(bytes, MODEL_GUID, sizeof MODEL_GUID) != 0) {
        return complain(c, fmi2Error, "these bytes are not a state of this FMU");
    }
    if (!*state && !(*state = malloc(sizeof(State)))) {
        return complain(c, fmi2Error, "out of memory");
    }
    memcpy(*state, bytes + sizeof MODEL_GUID, sizeof(State));
    return fmi2OK;
}

/* What this FMU does not have. The standard wants every function to be there. */

#define NOT_OFFERED(name, value_type, get)                                                                                 \
    fmi2Status name(fmi2Component component, const fmi2ValueReference vr[], size_t n, get value_type value[])              \
    {                                                                                                                      \
        (void)vr, (void)value;                                                                                             \
        REQUIRE_PHASE(component, ANY_PHASE)                                                                                \
        return n == 0 ? fmi2OK : complain(c, fmi2Error, "%s: all variables are Real", __func__);                           \
    }

NOT_OFFERED(fmi2GetInteger, fmi2Integer, )
NOT_OFFERED(fmi2GetBoolean, fmi2Boolean, )
NOT_OFFERED(fmi2GetString, fmi2String, )
NOT_OFFERED(fmi2SetInteger, fmi2Integer, const)
NOT_OFFERED(fmi2SetBoolean, fmi2Boolean, const)
NOT_OFFERED(fmi2SetString, fmi2String, const)

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                        fmi2Real sensitivity[])
{
    (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)seed, (void)sensitivity;
    REQUIRE_PHASE(component, ANY_PHASE)
    return complain(c, fmi2Error, "%s is not offered", __func__);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    REQUIRE_PHASE(component, ANY_PHASE)
    return complain(c, fmi2Error, "%s is not offered", __func__);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    REQUIRE_PHASE(component, ANY_PHASE)
    return complain(c, fmi2Error, "%s is not offered", __func__);
}

fmi2Status fmi2CancelStep(fmi2Component component)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    return complain(c, fmi2Error, "%s: no step is ever pending", __func__);
}

/* Steps are never pending, and a step that fails is refused whole: there is nothing more to ask. */
#define NO_STATUS(name, value_type)                                                                                        \
    fmi2Status name(fmi2Component component, const fmi2StatusKind kind, value_type *value)                                 \
    {                                                                                                                      \
        (void)kind, (void)value;                                                                                           \
        REQUIRE_PHASE(component, ANY_PHASE)                                                                                \
        (void)c;                                                                                                           \
        return fmi2Discard;                                                                                                \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)
