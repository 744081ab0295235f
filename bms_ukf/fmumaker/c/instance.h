/* A running FMU, whatever the version of FMI: fmi2.c and fmi3.c put their names and types on these functions. No state
   outside the instance. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "model.h"

#include <stddef.h>

/* What functions return: the same numbers in FMI 2.0 and 3.0. No enum, as it would not convert to theirs. */
#define STATUS_OK 0
#define STATUS_DISCARD 2
#define STATUS_ERROR 3

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

typedef struct Instance Instance;

/* Hands a text to the master's logger, which is in `log` under the type that the version of FMI gives it. */
typedef void Tell(const Instance *c, int status, const char *category, const char *text);

struct Instance {
    State state;
    Tell *tell;
    void (*log)(void); /* NULL: the master does not listen */
    void *environment;
    char name[];
};

/* NULL if there is no memory, or if `token` is not that of this build; the reason is told. */
Instance *instance_new(const char *name, const char *token, Tell *tell, void (*log)(void), void *environment);

int instance_complain(const Instance *c, int status, const char *format, ...);

/* Leaves the calling function unless its instance is there and in one of the phases. */
#define REQUIRE_PHASE(component, phases)                                                                                   \
    Instance *c = component;                                                                                               \
    if (!c) {                                                                                                              \
        return STATUS_ERROR;                                                                                               \
    }                                                                                                                      \
    if (!(c->state.phase & (unsigned)(phases))) {                                                                          \
        return instance_complain(c, STATUS_ERROR, "%s is not allowed now", __func__);                                      \
    }

int instance_experiment(Instance *c, double start, int stop_defined, double stop);
int instance_enter_initialization(Instance *c);
int instance_exit_initialization(Instance *c);
int instance_reset(Instance *c);

/* Brings the values of the outputs up to date with state and inputs. */
int instance_update(Instance *c);

/* Whether value k, which must exist, may be set to `value` now. */
int instance_check(const Instance *c, size_t k, double value);
void instance_set(Instance *c, size_t k, double value);

/* From `time`, where the instance must be. A step that fails is refused whole. */
int instance_step(Instance *c, double time, double duration);

/* `*state` is allocated if it is NULL. */
int instance_get_state(Instance *c, void **state);
int instance_set_state(Instance *c, const void *state);

/* Serialised: the token, then the bytes of State. Only for the same build of the FMU, as the token covers its sources. */
#define SERIALISED_SIZE (sizeof MODEL_TOKEN + sizeof(State))
int instance_serialise(Instance *c, const void *state, unsigned char *bytes, size_t size);
int instance_deserialise(Instance *c, const unsigned char *bytes, size_t size, void **state);

#endif
