/* FMI 3.0 co-simulation for any model behind model.h. Variables are Float64, some outputs Int32, arrays of
   one dimension among them. */
#include "fmi3Functions.h"
#include "instance.h"

#include <stdlib.h>

static void tell(const Instance *c, int status, const char *category, const char *text)
{
    ((fmi3LogMessageCallback)c->log)(c->environment, (fmi3Status)status, category, text);
}

/* Identity and life */

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n_intermediate,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)resources, (void)visible, (void)logging, (void)early_return; /* only errors are logged, and those always */
    (void)intermediate, (void)n_intermediate, (void)update;            /* there are no intermediate updates */
    Instance *c = instance_new(name, token, tell, (void (*)(void))log, environment);
    if (c && event_mode) {
        instance_complain(c, STATUS_ERROR, "there is no event mode");
        free(c);
        return NULL;
    }
    return c;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)on, (void)n, (void)categories;
    REQUIRE_PHASE(instance, ANY_PHASE)
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined, (void)tolerance; /* the model knows its own */
    REQUIRE_PHASE(instance, INSTANTIATED)
    const int status = instance_experiment(c, start, stop_defined, stop);
    return status == STATUS_OK ? instance_enter_initialization(c) : status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    REQUIRE_PHASE(instance, INITIALIZING)
    return instance_exit_initialization(c);
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    REQUIRE_PHASE(instance, RUNNING)
    c->state.phase = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    REQUIRE_PHASE(instance, ANY_PHASE)
    return instance_reset(c);
}

/* Values. A value reference is the place in value[] of the variable's first element; the one after the last is time. */

/* How many values there are to a value reference; 0 if there is no such variable of that type. */
static size_t elements(fmi3ValueReference vr, int type)
{
    if (vr == N_VALUES) {
        return type == REAL;
    }
    return vr < N_VALUES && (int)VALUES[vr].type == type ? VALUES[vr].elements : 0;
}

static int check_references(const Instance *c, const fmi3ValueReference vr[], size_t n, size_t n_values, int type)
{
    size_t sum = 0;
    for (size_t k = 0; k < n; ++k) {
        if (elements(vr[k], type) == 0) {
            return instance_complain(c, STATUS_ERROR, "no %s variable has value reference %u",
                                     type == REAL ? "Float64" : "Int32", (unsigned)vr[k]);
        }
        sum += elements(vr[k], type);
    }
    if (sum != n_values) {
        return instance_complain(c, STATUS_ERROR, "%u values for variables of %u", (unsigned)n_values, (unsigned)sum);
    }
    return STATUS_OK;
}

#define GET(name, value_type, type)                                                                                        \
    fmi3Status name(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, value_type values[], size_t n_values)  \
    {                                                                                                                      \
        REQUIRE_PHASE(instance, INITIALIZING | RUNNING | TERMINATED)                                                       \
        int status = check_references(c, vr, n, n_values, type);                                                           \
        if (status == STATUS_OK) {                                                                                         \
            status = instance_update(c);                                                                                   \
        }                                                                                                                  \
        for (size_t k = 0, at = 0; k < n && status == STATUS_OK; ++k) {                                                    \
            for (size_t j = 0; j < elements(vr[k], type); ++j) {                                                           \
                values[at++] = (value_type)(vr[k] == N_VALUES ? c->state.time : c->state.model.value[vr[k] + j]);          \
            }                                                                                                              \
        }                                                                                                                  \
        return status;                                                                                                     \
    }

GET(fmi3GetFloat64, fmi3Float64, REAL)
GET(fmi3GetInt32, fmi3Int32, INTEGER)

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[],
                          size_t n_values)
{
    REQUIRE_PHASE(instance, INSTANTIATED | INITIALIZING | RUNNING)
    int status = check_references(c, vr, n, n_values, REAL);
    for (size_t k = 0, at = 0; k < n && status == STATUS_OK; ++k) {
        if (vr[k] == N_VALUES) {
            return instance_complain(c, STATUS_ERROR, "time cannot be set");
        }
        for (size_t j = 0; j < elements(vr[k], REAL) && status == STATUS_OK; ++j) {
            status = instance_check(c, vr[k] + j, values[at++]);
        }
    }
    for (size_t k = 0, at = 0; k < n && status == STATUS_OK; ++k) {
        for (size_t j = 0; j < elements(vr[k], REAL); ++j) {
            instance_set(c, vr[k] + j, values[at++]);
        }
    }
    return status;
}

/* Time */

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 duration, fmi3Boolean no_set_state_before,
                      fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                      fmi3Float64 *last_successful_time)
{
    (void)no_set_state_before;
    REQUIRE_PHASE(instance, RUNNING)
    const int status = instance_step(c, time, duration);
    *event_needed = *terminate = *early_return = fmi3False; /* a refused step may be tried again with another input */
    *last_successful_time = c->state.time;
    return status;
}

/* State */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    REQUIRE_PHASE(instance, ANY_PHASE)
    return instance_get_state(c, state);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    REQUIRE_PHASE(instance, ANY_PHASE)
    return instance_set_state(c, state);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    REQUIRE_PHASE(instance, ANY_PHASE)
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)state;
    REQUIRE_PHASE(instance, ANY_PHASE)
    *size = SERIALISED_SIZE;
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    REQUIRE_PHASE(instance, ANY_PHASE)
    return instance_serialise(c, state, bytes, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    REQUIRE_PHASE(instance, ANY_PHASE)
    return instance_deserialise(c, bytes, size, state);
}

/* What this FMU does not have. The standard wants every function to be there. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}

#define NOT_OFFERED(name, ...)                                                                                             \
    fmi3Status name(fmi3Instance instance, __VA_ARGS__)                                                                    \
    {                                                                                                                      \
        REQUIRE_PHASE(instance, ANY_PHASE)                                                                                 \
        return instance_complain(c, STATUS_ERROR, "%s is not offered", __func__);                                          \
    }
#define MODE_NOT_OFFERED(name)                                                                                             \
    fmi3Status name(fmi3Instance instance)                                                                                 \
    {                                                                                                                      \
        REQUIRE_PHASE(instance, ANY_PHASE)                                                                                 \
        return instance_complain(c, STATUS_ERROR, "%s is not offered", __func__);                                          \
    }
#define TYPE_NOT_OFFERED(type)                                                                                             \
    NOT_OFFERED(fmi3Get##type, const fmi3ValueReference vr[], size_t n, fmi3##type values[], size_t n_values)              \
    NOT_OFFERED(fmi3Set##type, const fmi3ValueReference vr[], size_t n, const fmi3##type values[], size_t n_values)

TYPE_NOT_OFFERED(Float32)
TYPE_NOT_OFFERED(Int8)
TYPE_NOT_OFFERED(UInt8)
TYPE_NOT_OFFERED(Int16)
TYPE_NOT_OFFERED(UInt16)
NOT_OFFERED(fmi3SetInt32, const fmi3ValueReference vr[], size_t n, const fmi3Int32 values[], size_t n_values)
TYPE_NOT_OFFERED(UInt32)
TYPE_NOT_OFFERED(Int64)
TYPE_NOT_OFFERED(UInt64)
TYPE_NOT_OFFERED(Boolean)
TYPE_NOT_OFFERED(String)
NOT_OFFERED(fmi3GetBinary, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary values[], size_t n_values)
NOT_OFFERED(fmi3SetBinary, const fmi3ValueReference vr[], size_t n, const size_t sizes[], const fmi3Binary values[],
            size_t n_values)
NOT_OFFERED(fmi3GetClock, const fmi3ValueReference vr[], size_t n, fmi3Clock values[])
NOT_OFFERED(fmi3SetClock, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[])
NOT_OFFERED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
NOT_OFFERED(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t of_dependent[],
            fmi3ValueReference independents[], size_t of_independents[], fmi3DependencyKind kinds[], size_t n)
NOT_OFFERED(fmi3GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t n_unknowns,
            const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
            fmi3Float64 sensitivity[], size_t n_sensitivity)
NOT_OFFERED(fmi3GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t n_unknowns,
            const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
            fmi3Float64 sensitivity[], size_t n_sensitivity)
NOT_OFFERED(fmi3GetOutputDerivatives, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[],
            fmi3Float64 values[], size_t n_values)
NOT_OFFERED(fmi3GetIntervalDecimal, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
            fmi3IntervalQualifier qualifiers[])
NOT_OFFERED(fmi3GetIntervalFraction, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
            fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
NOT_OFFERED(fmi3GetShiftDecimal, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[])
NOT_OFFERED(fmi3GetShiftFraction, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
            fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3SetIntervalDecimal, const fmi3ValueReference vr[], size_t n, const fmi3Float64 intervals[])
NOT_OFFERED(fmi3SetIntervalFraction, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
            const fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3SetShiftDecimal, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[])
NOT_OFFERED(fmi3SetShiftFraction, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
            const fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3UpdateDiscreteStates, fmi3Boolean *need_update, fmi3Boolean *terminate, fmi3Boolean *nominals_changed,
            fmi3Boolean *values_changed, fmi3Boolean *next_event_defined, fmi3Float64 *next_event)
NOT_OFFERED(fmi3CompletedIntegratorStep, fmi3Boolean no_set_state_before, fmi3Boolean *event_mode,
            fmi3Boolean *terminate)
NOT_OFFERED(fmi3SetTime, fmi3Float64 time)
NOT_OFFERED(fmi3SetContinuousStates, const fmi3Float64 states[], size_t n)
NOT_OFFERED(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
NOT_OFFERED(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t n)
NOT_OFFERED(fmi3GetContinuousStates, fmi3Float64 states[], size_t n)
NOT_OFFERED(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t n)
NOT_OFFERED(fmi3GetNumberOfEventIndicators, size_t *n)
NOT_OFFERED(fmi3GetNumberOfContinuousStates, size_t *n)
NOT_OFFERED(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)
MODE_NOT_OFFERED(fmi3EnterEventMode)
MODE_NOT_OFFERED(fmi3EnterConfigurationMode)
MODE_NOT_OFFERED(fmi3ExitConfigurationMode)
MODE_NOT_OFFERED(fmi3EvaluateDiscreteStates)
MODE_NOT_OFFERED(fmi3EnterContinuousTimeMode)
MODE_NOT_OFFERED(fmi3EnterStepMode)
