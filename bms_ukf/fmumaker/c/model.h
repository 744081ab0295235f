/* What a model gives to the FMI layer (instance.c with fmi2.c or fmi3.c). Each model's folder holds a state.h that
   defines

       typedef struct { double value[N_VALUES]; ... } Model;

   with no pointers in it, because an FMU state is a copy of its bytes. variables.h is generated from the model's
   fmu.toml: an enum of the place in value[] of each variable (of an array, of its first element), and a table of
   start values and limits in the same order.

   Each function returns NULL, or one constant sentence saying why it failed; after a failure the FMI layer restores
   the Model to what it was before the call. */
#ifndef MODEL_H
#define MODEL_H

#include "state.h"

/* Initial state from the parameters and inputs in value[]. May be called again, with other values, before the first step. */
const char *model_initialise(Model *m);

/* Advances the state by `duration` seconds (> 0), with the inputs in value[] held. */
const char *model_step(Model *m, double duration);

/* Writes the outputs into value[], from the state and the inputs. */
const char *model_outputs(Model *m);

#endif
