/* The estimator as a model: one communication step is one sample. */
#include "model.h"

#include <stddef.h>

static const double LONGEST_S = 2147483.647; /* above it bms_ukf_step takes the clock for one that runs backwards */

const char *model_initialise(Model *m)
{
    bms_ukf_init(m->estimator);
    m->elapsed_s = 0.0;
    m->code = BMS_UKF_INITIALISING;
    return NULL;
}

const char *model_step(Model *m, double duration)
{
    bms_ukf_real work[BMS_UKF_WORK_SIZE];
    if (duration > LONGEST_S) {
        return "a step of more than 2^31 ms";
    }
    m->elapsed_s += duration;
    const uint32_t time_ms = (uint32_t)(uint64_t)(1000.0 * m->elapsed_s + 0.5);
    m->code = bms_ukf_step(m->estimator, work, time_ms, m->value[CURRENT_A], m->value + VOLTAGE_V,
                           m->value + TEMPERATURE_DEGC, 0);
    return NULL;
}

const char *model_outputs(Model *m)
{
    for (uint32_t cell = 0; cell < BMS_UKF_CELLS; ++cell) {
        m->value[SOC + cell] = bms_ukf_get(m->estimator, BMS_UKF_SOC, cell);
        m->value[SOC_SIGMA + cell] = bms_ukf_get(m->estimator, BMS_UKF_SOC_SIGMA, cell);
        m->value[SOC_LOW + cell] = bms_ukf_get(m->estimator, BMS_UKF_SOC_LOW, cell);
        m->value[SOC_HIGH + cell] = bms_ukf_get(m->estimator, BMS_UKF_SOC_HIGH, cell);
        m->value[INNOVATION_V + cell] = bms_ukf_get(m->estimator, BMS_UKF_INNOVATION, cell);
        m->value[VOLTAGE_PRED_V + cell] = bms_ukf_get(m->estimator, BMS_UKF_VOLTAGE_PRED, cell);
    }
    m->value[STATUS] = BMS_UKF_STATUS(m->code);
    m->value[FAULTS] = BMS_UKF_FAULTS(m->code);
    return NULL;
}
