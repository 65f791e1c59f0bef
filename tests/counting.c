/* Counts the samples of tests/counter.py over many communication steps: ``counting T_s p q steps start clock``.

   The step is p/q of T_s; the clock is that of an importer: "sum" t += h, "product" t = start + k*h, or "difference",
   where the step is what two added-up times differ by. Prints the number of steps after which the count of samples, or
   the step whose input was seen last, is not that of whole numbers; then by how many T_s the clock is off k*h. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.c"

#ifdef FMI2_H
static void *make(double T_s, double start) {
    static const fmi2CallbackFunctions callbacks = {NULL, NULL, NULL, NULL, NULL};
    const fmi2ValueReference reference = PARAMETER_T_S;
    fmi2Component c = fmi2Instantiate("counter", fmi2CoSimulation, MODEL_GUID, NULL, &callbacks, fmi2False, fmi2False);
    fmi2SetupExperiment(c, fmi2False, 0.0, start, fmi2False, 0.0);
    fmi2SetReal(c, &reference, 1, &T_s);
    fmi2EnterInitializationMode(c);
    fmi2ExitInitializationMode(c);
    return c;
}

static int set_input(void *c, double value) {
    const fmi2ValueReference reference = INPUT_0;
    return fmi2SetReal(c, &reference, 1, &value);
}

/* One step; gets the outputs at its end. */
static int step_by(void *c, double t, double h, double values[2]) {
    const fmi2ValueReference references[] = {OUTPUT_0, OUTPUT_0 + 1};
    const int status = fmi2DoStep(c, t, h, fmi2True);
    return status == fmi2OK ? fmi2GetReal(c, references, 2, values) : status;
}
#else
static bool events, early;

static void *make(double T_s, double start) {
    const fmi3ValueReference reference = PARAMETER_T_S;
    fmi3Instance c = fmi3InstantiateCoSimulation("counter", MODEL_GUID, NULL, false, false, events, early, NULL, 0,
                                                 NULL, NULL, NULL);
    fmi3SetFloat64(c, &reference, 1, &T_s, 1);
    fmi3EnterInitializationMode(c, false, 0.0, start, false, 0.0);
    fmi3ExitInitializationMode(c);
    if (events) fmi3EnterStepMode(c);
    return c;
}

static int set_input(void *c, double value) {
    const fmi3ValueReference reference = INPUT_0;
    return fmi3SetFloat64(c, &reference, 1, &value, 1);
}

/* One step; gets the outputs at its end, before an event there takes the next sample. Goes on where it returns early. */
static int step_by(void *c, double t, double h, double values[2]) {
    const fmi3ValueReference references[] = {OUTPUT_0, OUTPUT_0 + 1};
    const double end = t + h;
    bool handle, terminate, returned;
    double reached;
    int status;
    for (;;) {
        status = fmi3DoStep(c, t, h, true, &handle, &terminate, &returned, &reached);
        if (status == fmi3OK) status = fmi3GetFloat64(c, references, 2, values, 2);
        if (status == fmi3OK && handle) {
            bool needed, other[3], next_defined;
            double next;
            if (fmi3EnterEventMode(c) != fmi3OK) return fmi3Error;
            fmi3UpdateDiscreteStates(c, &needed, other, other + 1, other + 2, &next_defined, &next);
            if (fmi3EnterStepMode(c) != fmi3OK) return fmi3Error;
        }
        if (status != fmi3OK || !returned) return status;
        t = reached;
        h = end - t;
    }
}
#endif

int main(int count, char **arguments) {
    if (count < 7) return 2;
    const double T_s = strtod(arguments[1], NULL), start = strtod(arguments[5], NULL);
    const long long p = atoll(arguments[2]), q = atoll(arguments[3]), steps = atoll(arguments[4]);
    const char *clock = arguments[6];
    const double h = q == 1 ? (double)p * T_s : (double)p * T_s / (double)q;
    long long wrong = 0, samples = 0, last = -1;
    double t = start;
#ifndef FMI2_H
    events = count > 7;
    early = count > 8;
#endif
    void *c = make(T_s, start);
    for (long long k = 0; k < steps; k++) {
        const double next = t + h;
        double values[2];
        while (samples * q < (k + 1) * p) samples++, last = k; /* sample j is due at tick j*q, step k begins at k*p */
        if (strcmp(clock, "product") == 0) t = start + (double)k * h;
        if (set_input(c, (double)k) != 0 ||
            step_by(c, t, strcmp(clock, "difference") == 0 ? next - t : h, values) != 0) {
            printf("stopped at step %lld\n", k);
            return 1;
        }
        wrong += values[0] != (double)last || values[1] != (double)samples;
        t = next;
    }
    printf("%lld %.3f\n", wrong, (t - (start + (double)steps * h)) / T_s);
    return 0;
}
