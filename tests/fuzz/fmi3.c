/* Calls the functions of an FMI 3.0 FMU at random, see fuzz.h. */
#include "fuzz.h"

static void take(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)environment;
    if (status < fmi3Warning || status > fmi3Error || !category || strlen(message) < 10) abort();
}

static fmi3Status serialize(fmi3Instance c, fmi3FMUState saved) {
    size_t size = 0;
    fmi3FMUState copy = NULL;
    fmi3Status status = fmi3SerializedFMUStateSize(c, saved, &size);
    fmi3Byte *bytes = malloc(size + 1);
    if (status == fmi3OK) status = fmi3SerializeFMUState(c, saved, bytes, size);
    if (status == fmi3OK && pick(4)) spoil(bytes);
    if (status == fmi3OK) status = fmi3DeserializeFMUState(c, bytes, size, &copy);
    if (status == fmi3OK) status = fmi3SetFMUState(c, copy);
    free(copy);
    free(bytes);
    return status;
}

static fmi3Status call(fmi3Instance c, fmi3FMUState *saved, double *time) {
    static double reals[ROOM], results[ROOM];
    static fmi3Int32 whole[ROOM];
    static fmi3Int64 items[ROOM];
    static fmi3UInt64 counts[ROOM];
    static fmi3Boolean flags[ROOM];
    static const fmi3String names[] = {"logAll", "logStatusError", "unknown"};
    fmi3ValueReference r[4];
    fmi3Boolean f[5];
    fmi3Status status;
    double reached;
    size_t n = pick(4), m = 0;
    const unsigned limit = N_REFERENCES + (pick(10) ? 0 : 3);
    for (size_t i = 0; i < 4; i++) {
        r[i] = pick(limit);
        if (i < n && r[i] < N_REFERENCES) m += (size_t)lengths[r[i]];
    }
    if (pick(10) == 0) m = pick(300);
    for (size_t i = 0; i < ROOM; i++) {
        reals[i] = number();
        whole[i] = (fmi3Int32)pick(20) - 5;
        items[i] = (fmi3Int64)pick(6);
        flags[i] = pick(2) == 0;
    }
    switch (pick(34)) {
        case 0:
            return fmi3EnterInitializationMode(c, flags[0], number(), pick(4) ? 0.0 : number(), pick(5) == 0, number());
        case 1:
            return fmi3ExitInitializationMode(c);
        case 2:
        case 3:
        case 4:
            status =
                fmi3DoStep(c, pick(4) ? *time : number(), pick(4) ? 1e-4 : number(), true, f, f + 1, f + 2, &reached);
            if (status == fmi3OK) *time = reached;
            return status;
        case 5:
            return fmi3GetFloat64(c, r, n, pick(30) ? results : NULL, m);
        case 6:
        case 7:
            return fmi3SetFloat64(c, pick(30) ? r : NULL, n, reals, m);
        case 8:
            return fmi3SetInt64(c, r, n, items, m);
        case 9:
            return fmi3SetBoolean(c, r, n, flags, m);
        case 10:
            return fmi3GetUInt64(c, r, n, counts, m);
        case 11:
            return fmi3GetFMUState(c, pick(20) ? saved : NULL);
        case 12:
            return fmi3SetFMUState(c, *saved);
        case 13:
            return fmi3FreeFMUState(c, saved);
        case 14:
            return fmi3EnterEventMode(c);
        case 15:
            return fmi3UpdateDiscreteStates(c, f, f + 1, f + 2, f + 3, f + 4, pick(20) ? &reached : NULL);
        case 16:
            return fmi3EnterStepMode(c);
        case 17:
            return fmi3Terminate(c);
        case 18:
            *time = 0.0;
            return fmi3Reset(c);
        case 19:
            return fmi3GetDirectionalDerivative(c, r, n, r + 1, n / 2, reals, n / 2, results, n);
        case 20:
            return fmi3GetAdjointDerivative(c, r, n, r + 1, n / 2, reals, n, results, n / 2);
        case 21:
            return fmi3EnterContinuousTimeMode(c);
        case 22:
            return fmi3SetContinuousStates(c, reals, pick(2) ? N_CONTINUOUS : n);
        case 23:
            return fmi3GetContinuousStateDerivatives(c, results, pick(2) ? N_CONTINUOUS : n);
        case 24:
            return fmi3CompletedIntegratorStep(c, true, f, pick(9) ? f + 1 : NULL);
        case 25:
            return fmi3SetTime(c, number());
        case 26:
            return fmi3GetInt32(c, r, n, whole, m);
        case 27:
            return fmi3SetInt32(c, r, n, whole, m);
        case 28:
            return fmi3SetDebugLogging(c, flags[1], pick(4), pick(5) ? names : NULL);
        case 29:
            return fmi3GetClock(c, r, n, flags);
        case 30:
            return fmi3GetNominalsOfContinuousStates(c, results, N_CONTINUOUS);
        case 31:
            return fmi3EnterConfigurationMode(c);
        case 32:
            return *saved ? serialize(c, *saved) : fmi3OK;
        default:
            return fmi3GetContinuousStates(c, results, N_CONTINUOUS);
    }
}

int main(int count, char **arguments) {
    long numbers[fmi3Fatal] = {0};
    const long runs = runs_of(count, arguments);
    for (long run = 0; run < runs; run++) {
        const bool exchange = pick(3) == 0, events = pick(2) == 0, logging = pick(2) == 0;
        const fmi3String token = pick(50) ? MODEL_GUID : "another";
        fmi3LogMessageCallback log = pick(10) ? take : NULL;
        fmi3FMUState saved = NULL;
        double time = 0.0;
        fmi3Instance c = exchange ? fmi3InstantiateModelExchange("fuzz", token, NULL, false, logging, NULL, log)
                                  : fmi3InstantiateCoSimulation("fuzz", token, NULL, false, logging, events,
                                                                pick(2) == 0, NULL, 0, NULL, log, NULL);
        for (int k = 0; k < CALLS; k++) {
            const fmi3Status status = call(c, &saved, &time);
            if (status < fmi3OK || status > fmi3Error) abort();
            numbers[status]++;
            if (status == fmi3Error && pick(2)) { /* most sequences end early: begin again, further on */
                time = 0.0;
                fmi3Reset(c);
                if (pick(3)) fmi3EnterInitializationMode(c, false, 0.0, 0.0, false, 0.0);
                if (pick(3)) fmi3ExitInitializationMode(c);
                if (exchange)
                    fmi3EnterContinuousTimeMode(c);
                else if (events)
                    fmi3EnterStepMode(c);
            }
        }
        free(saved);
        fmi3FreeInstance(c);
    }
    printf("%ld %ld %ld\n", numbers[fmi3OK], numbers[fmi3Discard], numbers[fmi3Error]);
    return 0;
}
