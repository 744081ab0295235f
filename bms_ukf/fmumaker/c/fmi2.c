/* FMI 2.0 co-simulation for any model behind model.h. Variables are Real, some outputs Integer; an
   array is a variable for each element. */
#include "fmi2Functions.h"
#include "instance.h"

#include <stdlib.h>

static void tell(const Instance *c, int status, const char *category, const char *text)
{
    /* Some masters do not expand the format: it is the text itself, and must never hold a %. */
    ((fmi2CallbackLogger)c->log)(c->environment, c->name, (fmi2Status)status, category, text);
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
    if (!functions) {
        return NULL;
    }
    Instance *c = instance_new(name, guid, tell, (void (*)(void))functions->logger, functions->componentEnvironment);
    if (c && type != fmi2CoSimulation) {
        instance_complain(c, STATUS_ERROR, "expected co-simulation");
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
    return instance_experiment(c, start, stop_defined, stop);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    REQUIRE_PHASE(component, INSTANTIATED)
    return instance_enter_initialization(c);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    REQUIRE_PHASE(component, INITIALIZING)
    return instance_exit_initialization(c);
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
    return instance_reset(c);
}

/* Values. A value reference is the place in value[]. */

static int check_reference(const Instance *c, fmi2ValueReference vr, int type)
{
    if (vr < N_VALUES && (int)VALUES[vr].type == type) {
        return STATUS_OK;
    }
    return instance_complain(c, STATUS_ERROR, "no %s variable has value reference %u", type == REAL ? "Real" : "Integer",
                             vr);
}

#define GET(name, value_type, type)                                                                                        \
    fmi2Status name(fmi2Component component, const fmi2ValueReference vr[], size_t n, value_type value[])                  \
    {                                                                                                                      \
        REQUIRE_PHASE(component, INITIALIZING | RUNNING | TERMINATED)                                                      \
        int status = instance_update(c);                                                                                   \
        for (size_t k = 0; k < n && status == STATUS_OK; ++k) {                                                            \
            status = check_reference(c, vr[k], type);                                                                      \
            if (status == STATUS_OK) {                                                                                     \
                value[k] = (value_type)c->state.model.value[vr[k]];                                                        \
            }                                                                                                              \
        }                                                                                                                  \
        return status;                                                                                                     \
    }

GET(fmi2GetReal, fmi2Real, REAL)
GET(fmi2GetInteger, fmi2Integer, INTEGER)

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    REQUIRE_PHASE(component, INSTANTIATED | INITIALIZING | RUNNING)
    for (size_t k = 0; k < n; ++k) {
        int status = check_reference(c, vr[k], REAL);
        if (status == STATUS_OK) {
            status = instance_check(c, vr[k], value[k]);
        }
        if (status != STATUS_OK) {
            return status;
        }
    }
    for (size_t k = 0; k < n; ++k) {
        instance_set(c, vr[k], value[k]);
    }
    return fmi2OK;
}

/* Time */

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real duration, fmi2Boolean no_set_state_before)
{
    (void)no_set_state_before;
    REQUIRE_PHASE(component, RUNNING)
    return instance_step(c, time, duration);
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
    return instance_get_state(c, state);
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    return instance_set_state(c, state);
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

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    (void)state;
    *size = SERIALISED_SIZE;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    return instance_serialise(c, state, (unsigned char *)bytes, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    return instance_deserialise(c, (const unsigned char *)bytes, size, state);
}

/* What this FMU does not have. The standard wants every function to be there. */

#define NOT_OFFERED(name, value_type, get)                                                                                 \
    fmi2Status name(fmi2Component component, const fmi2ValueReference vr[], size_t n, get value_type value[])              \
    {                                                                                                                      \
        (void)vr, (void)value;                                                                                             \
        REQUIRE_PHASE(component, ANY_PHASE)                                                                                \
        return n == 0 ? fmi2OK : instance_complain(c, STATUS_ERROR, "%s is not offered", __func__);             \
    }

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
    return instance_complain(c, STATUS_ERROR, "%s is not offered", __func__);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    REQUIRE_PHASE(component, ANY_PHASE)
    return instance_complain(c, STATUS_ERROR, "%s is not offered", __func__);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    REQUIRE_PHASE(component, ANY_PHASE)
    return instance_complain(c, STATUS_ERROR, "%s is not offered", __func__);
}

fmi2Status fmi2CancelStep(fmi2Component component)
{
    REQUIRE_PHASE(component, ANY_PHASE)
    return instance_complain(c, STATUS_ERROR, "%s: no step is ever pending", __func__);
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
