/* An FMI 3.0 co-simulation FMU for tests: only what an importer needs that neither saves states nor uses clocks.
 *
 *   der(y[1]) = (sense*gain*u - y[1])/0.1     exact for a held input; sense is 1, or -1 with mode = 2
 *   y[2]      = sense*gain*u                  feedthrough
 *   positive  = u > 0
 */
#include <math.h>
#include <stdlib.h>

#include "fmi3FunctionTypes.h"

enum { TIME, U, Y, GAIN, MODE, POSITIVE };

typedef struct {
    double u, y, gain;
    fmi3Int64 mode;
} Probe;

static double target(const Probe *p) { return (p->mode == 2 ? -1.0 : 1.0) * p->gain * p->u; }

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)events;
    (void)early;
    (void)required;
    (void)n;
    (void)environment;
    (void)log;
    (void)update;
    Probe *p = calloc(1, sizeof *p);
    p->gain = 1.0;
    p->mode = 1;
    return p;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean b, fmi3Float64 stop) {
    (void)c;
    (void)a;
    (void)tolerance;
    (void)start;
    (void)b;
    (void)stop;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    (void)c;
    return fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance c) {
    (void)c;
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                          size_t values) {
    (void)values;
    Probe *p = c;
    for (size_t k = 0; k < n; k++) *(vr[k] == GAIN ? &p->gain : &p->u) = value[k];
    return fmi3OK;
}
fmi3Status fmi3SetInt64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int64 value[],
                        size_t values) {
    (void)vr;
    (void)n;
    (void)values;
    ((Probe *)c)->mode = value[0];
    return fmi3OK;
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t values) {
    (void)values;
    Probe *p = c;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] == Y) *value++ = p->y;
        *value++ = vr[k] == Y ? target(p) : vr[k] == GAIN ? p->gain : p->u;
    }
    return fmi3OK;
}
fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Boolean value[], size_t values) {
    (void)vr;
    (void)values;
    for (size_t k = 0; k < n; k++) value[k] = ((Probe *)c)->u > 0.0;
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    (void)no_set;
    Probe *p = c;
    p->y = target(p) + (p->y - target(p)) * exp(-h / 0.1);
    *event = *terminate = *early = fmi3False;
    *last = t + h;
    return fmi3OK;
}

/* Not offered by this FMU; the names must be there. */
#define ABSENT(name) \
    int name(void) { return fmi3Error; }
ABSENT(fmi3SetDebugLogging)
ABSENT(fmi3InstantiateModelExchange)
ABSENT(fmi3InstantiateScheduledExecution)
ABSENT(fmi3EnterEventMode)
ABSENT(fmi3Reset)
ABSENT(fmi3GetFloat32)
ABSENT(fmi3GetInt8)
ABSENT(fmi3GetUInt8)
ABSENT(fmi3GetInt16)
ABSENT(fmi3GetUInt16)
ABSENT(fmi3GetInt32)
ABSENT(fmi3GetUInt32)
ABSENT(fmi3GetInt64)
ABSENT(fmi3GetUInt64)
ABSENT(fmi3GetString)
ABSENT(fmi3GetBinary)
ABSENT(fmi3GetClock)
ABSENT(fmi3SetFloat32)
ABSENT(fmi3SetInt8)
ABSENT(fmi3SetUInt8)
ABSENT(fmi3SetInt16)
ABSENT(fmi3SetUInt16)
ABSENT(fmi3SetInt32)
ABSENT(fmi3SetUInt32)
ABSENT(fmi3SetUInt64)
ABSENT(fmi3SetBoolean)
ABSENT(fmi3SetString)
ABSENT(fmi3SetBinary)
ABSENT(fmi3SetClock)
ABSENT(fmi3GetNumberOfVariableDependencies)
ABSENT(fmi3GetVariableDependencies)
ABSENT(fmi3GetFMUState)
ABSENT(fmi3SetFMUState)
ABSENT(fmi3FreeFMUState)
ABSENT(fmi3SerializedFMUStateSize)
ABSENT(fmi3SerializeFMUState)
ABSENT(fmi3DeserializeFMUState)
ABSENT(fmi3GetDirectionalDerivative)
ABSENT(fmi3GetAdjointDerivative)
ABSENT(fmi3EnterConfigurationMode)
ABSENT(fmi3ExitConfigurationMode)
ABSENT(fmi3GetIntervalDecimal)
ABSENT(fmi3GetIntervalFraction)
ABSENT(fmi3GetShiftDecimal)
ABSENT(fmi3GetShiftFraction)
ABSENT(fmi3SetIntervalDecimal)
ABSENT(fmi3SetIntervalFraction)
ABSENT(fmi3SetShiftDecimal)
ABSENT(fmi3SetShiftFraction)
ABSENT(fmi3EvaluateDiscreteStates)
ABSENT(fmi3UpdateDiscreteStates)
ABSENT(fmi3EnterContinuousTimeMode)
ABSENT(fmi3CompletedIntegratorStep)
ABSENT(fmi3SetTime)
ABSENT(fmi3SetContinuousStates)
ABSENT(fmi3GetContinuousStateDerivatives)
ABSENT(fmi3GetEventIndicators)
ABSENT(fmi3GetContinuousStates)
ABSENT(fmi3GetNominalsOfContinuousStates)
ABSENT(fmi3GetNumberOfEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates)
ABSENT(fmi3EnterStepMode)
ABSENT(fmi3GetOutputDerivatives)
ABSENT(fmi3ActivateModelPartition)
