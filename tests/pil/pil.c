/* The exported estimator on its processor, in QEMU: samples in from a file of the host, results out to another.
 *
 * In the order of `tests/test_pil.py`: a row in is time_ms, current_A, voltage_V, temperature_degC and contactor_open, a
 * row out is the code, SoC, its sigma, the innovation, the instructions of bms_ukf_step and the bytes of stack it took.
 */
#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

#include "bms_ukf.h"

struct sample {
    uint32_t time_ms;
    bms_ukf_real current_A, voltage_V, temperature_degC;
    uint32_t contactor_open;
};

struct answer {
    uint32_t code;
    bms_ukf_real soc, soc_sigma, innovation_V, soc_low, soc_high;
    uint32_t instructions, stack;
};

#if defined(__riscv)
/* With -icount shift=0 QEMU's cycle counter counts instructions. */
static void start_counter(void) {}

static uint32_t counter(void)
{
    uint32_t count;
    __asm__ volatile("rdcycle %0" : "=r"(count));
    return count;
}

static uint32_t instructions(uint32_t before, uint32_t after) { return after - before; }
#else
/* SysTick counts down at 25 MHz; with -icount shift=6 an instruction takes 64 ns. */
#define SYST_CSR (*(volatile uint32_t *)0xE000E010)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018)

static void start_counter(void)
{
    SYST_RVR = 0xFFFFFF;
    SYST_CVR = 0;
    SYST_CSR = 5;
}

static uint32_t counter(void) { return SYST_CVR; }

static uint32_t instructions(uint32_t before, uint32_t after) { return ((before - after) & 0xFFFFFF) * 40 / 64; }
#endif

#define PAINTED 1024 /* words below the frame of `step_on_fresh_paint` */
#define PAINT 0xC0FFEE5Au

static bms_ukf_real state[BMS_UKF_STATE_SIZE], work[BMS_UKF_WORK_SIZE];

__attribute__((noinline)) static void step_on_fresh_paint(const struct sample *in, struct answer *out)
{
    volatile uint32_t *top;
#if defined(__riscv)
    __asm__ volatile("mv %0, sp" : "=r"(top));
#else
    __asm__ volatile("mov %0, sp" : "=r"(top));
#endif
    for (int k = 1; k <= PAINTED; ++k)
        top[-k] = PAINT;
    const uint32_t before = counter();
    out->code = bms_ukf_step(state, work, in->time_ms, in->current_A, &in->voltage_V, &in->temperature_degC,
                             in->contactor_open);
    out->instructions = instructions(before, counter());
    int deepest = PAINTED;
    while (deepest > 0 && top[-deepest] == PAINT)
        --deepest;
    out->stack = 4 * deepest;
}

int main(void)
{
    const int from = open("samples.bin", O_RDONLY), to = open("answers.bin", O_WRONLY | O_CREAT | O_TRUNC, 0644);
    static struct sample in;
    static struct answer out;

    if (from < 0 || to < 0)
        return 1;
    start_counter();
    bms_ukf_init(state);
    while (read(from, &in, sizeof in) == sizeof in) {
        step_on_fresh_paint(&in, &out);
        out.soc = bms_ukf_get(state, BMS_UKF_SOC, 0);
        out.soc_sigma = bms_ukf_get(state, BMS_UKF_SOC_SIGMA, 0);
        out.soc_low = bms_ukf_get(state, BMS_UKF_SOC_LOW, 0);
        out.soc_high = bms_ukf_get(state, BMS_UKF_SOC_HIGH, 0);
        out.innovation_V = bms_ukf_get(state, BMS_UKF_INNOVATION, 0);
        if (write(to, &out, sizeof out) != sizeof out)
            return 1;
    }
    return 0;
}
