/* Runs the library of an FMI 2.0 FMU of the estimator: `fmu LIBRARY GUID STEP_S < inputs > outputs`, doubles of this
   machine's kind: current, voltage and temperature a step, and soc, soc_sigma, innovation,
   voltage_pred, soc_low, soc_high, status, faults. */
#include "fmi2FunctionTypes.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

enum { INPUTS = 3, REALS = 6, INTEGERS = 2 };

static void tell(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String text, ...)
{
    (void)environment, (void)name, (void)status, (void)category;
    fprintf(stderr, "%s\n", text);
}

static void *library;

#define FUNCTION(name) ((name##TYPE *)dlsym(library, #name))
#define REQUIRE(condition)                                                                                                 \
    if (!(condition)) {                                                                                                    \
        fprintf(stderr, "not so: %s\n", #condition);                                                                       \
        return 1;                                                                                                          \
    }

int main(int argc, char **argv)
{
    const fmi2CallbackFunctions callbacks = {tell, calloc, free, NULL, NULL};
    const fmi2ValueReference in[INPUTS] = {0, 1, 2}, real[REALS] = {3, 4, 5, 6, 7, 8}, integer[INTEGERS] = {9, 10};
    double inputs[INPUTS], outputs[REALS + INTEGERS];
    fmi2Integer integers[INTEGERS];

    REQUIRE(argc == 4)
    REQUIRE(library = dlopen(argv[1], RTLD_NOW))
    const double step_s = atof(argv[3]);
    fmi2Component c = FUNCTION(fmi2Instantiate)("soc", fmi2CoSimulation, argv[2], "", &callbacks, fmi2False, fmi2False);
    REQUIRE(c)
    REQUIRE(FUNCTION(fmi2SetupExperiment)(c, fmi2False, 0, 0, fmi2False, 0) == fmi2OK)
    REQUIRE(FUNCTION(fmi2EnterInitializationMode)(c) == fmi2OK)
    REQUIRE(FUNCTION(fmi2ExitInitializationMode)(c) == fmi2OK)
    for (int k = 0; fread(inputs, sizeof inputs, 1, stdin) == 1; ++k) {
        REQUIRE(FUNCTION(fmi2SetReal)(c, in, INPUTS, inputs) == fmi2OK)
        REQUIRE(FUNCTION(fmi2DoStep)(c, k * step_s, step_s, fmi2True) == fmi2OK)
        REQUIRE(FUNCTION(fmi2GetReal)(c, real, REALS, outputs) == fmi2OK)
        REQUIRE(FUNCTION(fmi2GetInteger)(c, integer, INTEGERS, integers) == fmi2OK)
        for (int j = 0; j < INTEGERS; ++j) {
            outputs[REALS + j] = integers[j];
        }
        REQUIRE(fwrite(outputs, sizeof outputs, 1, stdout) == 1)
    }
    FUNCTION(fmi2FreeInstance)(c);
    return 0;
}
