/* The state of an estimator FMU: plain data, so that an FMU state is a copy of it. bms_ukf.h comes with the object file
   of the estimator. */
#ifndef STATE_H
#define STATE_H

#pragma GCC visibility push(hidden) /* only the standard's functions are to be seen from outside */
#include "bms_ukf.h"
#pragma GCC visibility pop

#include "variables.h"

typedef struct {
    double value[N_VALUES];
    double elapsed_s; /* since initialisation */
    bms_ukf_real estimator[BMS_UKF_STATE_SIZE];
    uint32_t code; /* of the latest sample */
} Model;

#endif
