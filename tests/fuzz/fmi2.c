/* Calls the functions of an FMI 2.0 FMU at random, see fuzz.h. */
#include "fuzz.h"

static void take(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
    (void)environment;
    if (!name || status < fmi2Warning || status > fmi2Error || !category || strlen(message) < 10 ||
        strchr(message, '%'))
        abort();
}

static fmi2Status serialize(fmi2Component c, fmi2FMUstate saved) {
    size_t size = 0;
    fmi2FMUstate copy = NULL;
    fmi2Status status = fmi2SerializedFMUstateSize(c, saved, &size);
    fmi2Byte *bytes = malloc(size + 1);
    if (status == fmi2OK) status = fmi2SerializeFMUstate(c, saved, bytes, size);
    if (status == fmi2OK && pick(4)) spoil(bytes);
    if (status == fmi2OK) status = fmi2DeSerializeFMUstate(c, bytes, size, &copy);
    if (status == fmi2OK) status = fmi2SetFMUstate(c, copy);
    free(copy);
    free(bytes);
    return status;
}

static fmi2Status call(fmi2Component c, fmi2FMUstate *saved, double *time) {
    static double reals[ROOM];
    static fmi2Integer whole[ROOM];
    static fmi2Boolean flags[ROOM];
    static const fmi2String names[] = {"logAll", "logStatusError", "unknown"};
    fmi2ValueReference r[4];
    fmi2EventInfo info;
    fmi2Boolean flag, other;
    fmi2Status status;
    double step = pick(4) ? 1e-4 : number(), from = pick(4) ? *time : number();
    const size_t n = pick(4);
    const unsigned limit = N_REFERENCES + (pick(10) ? 0 : 3);
    for (size_t i = 0; i < 4; i++) r[i] = pick(limit);
    for (size_t i = 0; i < ROOM; i++) {
        reals[i] = number();
        whole[i] = (fmi2Integer)pick(20) - 5;
        flags[i] = pick(2) == 0;
    }
    switch (pick(32)) {
        case 0:
            return fmi2SetupExperiment(c, flags[0], number(), pick(4) ? 0.0 : number(), pick(5) == 0, number());
        case 1:
            return fmi2EnterInitializationMode(c);
        case 2:
            return fmi2ExitInitializationMode(c);
        case 3:
        case 4:
        case 5:
            status = fmi2DoStep(c, from, step, fmi2True);
            if (status == fmi2OK) *time = from + step;
            return status;
        case 6:
            return fmi2GetReal(c, r, n, pick(30) ? reals : NULL);
        case 7:
        case 8:
            return fmi2SetReal(c, pick(30) ? r : NULL, n, reals);
        case 9:
            return fmi2SetInteger(c, r, n, whole);
        case 10:
            return fmi2SetBoolean(c, r, n, flags);
        case 11:
            return fmi2GetInteger(c, r, n, whole);
        case 12:
            return fmi2GetFMUstate(c, pick(20) ? saved : NULL);
        case 13:
            return fmi2SetFMUstate(c, *saved);
        case 14:
            return fmi2FreeFMUstate(c, saved);
        case 15:
            return fmi2EnterEventMode(c);
        case 16:
            return fmi2NewDiscreteStates(c, pick(20) ? &info : NULL);
        case 17:
            return fmi2Terminate(c);
        case 18:
            *time = 0.0;
            return fmi2Reset(c);
        case 19:
            return fmi2GetDirectionalDerivative(c, r, n, r + 1, n / 2, reals, reals + 10);
        case 20:
            return fmi2EnterContinuousTimeMode(c);
        case 21:
            return fmi2SetContinuousStates(c, reals, pick(2) ? N_CONTINUOUS : n);
        case 22:
            return fmi2GetDerivatives(c, reals, pick(2) ? N_CONTINUOUS : n);
        case 23:
            return fmi2CompletedIntegratorStep(c, fmi2True, &flag, pick(9) ? &other : NULL);
        case 24:
            return fmi2SetTime(c, number());
        case 25:
            return fmi2SetDebugLogging(c, flags[1], pick(4), pick(5) ? names : NULL);
        case 26:
            return fmi2GetNominalsOfContinuousStates(c, reals, N_CONTINUOUS);
        case 27:
            return *saved ? serialize(c, *saved) : fmi2OK;
        case 28:
            return fmi2GetRealStatus(c, (fmi2StatusKind)pick(4), pick(9) ? reals : NULL);
        case 29:
            return fmi2SetRealInputDerivatives(c, r, n, whole, reals);
        case 30:
            return fmi2GetEventIndicators(c, reals, n);
        default:
            return fmi2GetContinuousStates(c, reals, N_CONTINUOUS);
    }
}

int main(int count, char **arguments) {
    long numbers[fmi2Fatal] = {0};
    const long runs = runs_of(count, arguments);
    for (long run = 0; run < runs; run++) {
        const fmi2CallbackFunctions callbacks = {pick(10) ? take : NULL, NULL, NULL, NULL, NULL};
        const fmi2Type type = pick(3) ? fmi2CoSimulation : fmi2ModelExchange;
        fmi2FMUstate saved = NULL;
        double time = 0.0;
        fmi2Component c;
        c = fmi2Instantiate("fuzz", type, pick(50) ? MODEL_GUID : "another", NULL, &callbacks, fmi2False, pick(2) == 0);
        for (int k = 0; k < CALLS; k++) {
            const fmi2Status status = call(c, &saved, &time);
            if (status < fmi2OK || status > fmi2Error) abort();
            numbers[status]++;
            if (status == fmi2Error && pick(2)) { /* most sequences end early: begin again, further on */
                time = 0.0;
                fmi2Reset(c);
                if (pick(3)) fmi2EnterInitializationMode(c);
                if (pick(3)) fmi2ExitInitializationMode(c);
                if (type == fmi2ModelExchange) fmi2EnterContinuousTimeMode(c);
            }
        }
        free(saved);
        fmi2FreeInstance(c);
    }
    printf("%ld %ld %ld\n", numbers[fmi2OK], numbers[fmi2Discard], numbers[fmi2Error]);
    return 0;
}
