/* Runs a co-simulation FMU's library: host LIBRARY GUID STEP STEPS NI (REFERENCE VALUE)... NO REFERENCE...
   Prints the outputs after each step, one line a step, 17 digits. */
#include <stdio.h>
#include <stdlib.h>

#define FMI2_EXPORT
#include "fmi2.h"

#if defined _WIN32
#include <windows.h>
static void *load(const char *path) { return (void *)LoadLibraryA(path); }
static void *symbol(void *library, const char *name) { return (void *)GetProcAddress((HMODULE)library, name); }
#else
#include <dlfcn.h>
static void *load(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void *symbol(void *library, const char *name) { return dlsym(library, name); }
#endif

typedef fmi2Status (*Plain)(fmi2Component);

static void log_message(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                        fmi2String category, fmi2String message, ...) {
    (void)environment;
    fprintf(stderr, "%s, status %d, %s: %s\n", instance, (int)status, category, message);
}

static void *find(void *library, const char *name) {
    void *found = symbol(library, name);
    if (!found) {
        fprintf(stderr, "no %s\n", name);
        exit(2);
    }
    return found;
}

static void check(fmi2Status status, const char *what) {
    if (status == fmi2OK) return;
    fprintf(stderr, "%s returned %d\n", what, (int)status);
    exit(1);
}

int main(int count, char **arguments) {
    enum { MAX = 256 };
    fmi2CallbackFunctions callbacks = {log_message, calloc, free, NULL, NULL};
    fmi2ValueReference inputs[MAX], outputs[MAX];
    fmi2Real given[MAX], values[MAX];
    size_t n_inputs, n_outputs;
    int at = 5;
    void *library = count > 6 ? load(arguments[1]) : NULL;
    if (!library) {
        fprintf(stderr, "cannot load the library\n");
        return 2;
    }
    fmi2Component (*instantiate)(fmi2String, fmi2Type, fmi2String, fmi2String, const fmi2CallbackFunctions *,
                                 fmi2Boolean, fmi2Boolean) = find(library, "fmi2Instantiate");
    fmi2Status (*setup)(fmi2Component, fmi2Boolean, fmi2Real, fmi2Real, fmi2Boolean, fmi2Real) =
        find(library, "fmi2SetupExperiment");
    fmi2Status (*set)(fmi2Component, const fmi2ValueReference *, size_t, const fmi2Real *) =
        find(library, "fmi2SetReal");
    fmi2Status (*get)(fmi2Component, const fmi2ValueReference *, size_t, fmi2Real *) = find(library, "fmi2GetReal");
    fmi2Status (*step)(fmi2Component, fmi2Real, fmi2Real, fmi2Boolean) = find(library, "fmi2DoStep");
    void (*release)(fmi2Component) = find(library, "fmi2FreeInstance");
    const double size = atof(arguments[3]);
    const long steps = atol(arguments[4]);
    n_inputs = (size_t)atol(arguments[at++]);
    for (size_t i = 0; i < n_inputs; i++) {
        inputs[i] = (fmi2ValueReference)atol(arguments[at++]);
        given[i] = atof(arguments[at++]);
    }
    n_outputs = (size_t)atol(arguments[at++]);
    for (size_t i = 0; i < n_outputs; i++) outputs[i] = (fmi2ValueReference)atol(arguments[at++]);
    fmi2Component c = instantiate("host", fmi2CoSimulation, arguments[2], "", &callbacks, fmi2False, fmi2True);
    if (!c) return 1;
    check(setup(c, fmi2False, 0.0, 0.0, fmi2False, 0.0), "fmi2SetupExperiment");
    check(((Plain)find(library, "fmi2EnterInitializationMode"))(c), "fmi2EnterInitializationMode");
    if (n_inputs) check(set(c, inputs, n_inputs, given), "fmi2SetReal");
    check(((Plain)find(library, "fmi2ExitInitializationMode"))(c), "fmi2ExitInitializationMode");
    for (long k = 0; k < steps; k++) {
        check(step(c, (double)k * size, size, fmi2True), "fmi2DoStep");
        check(get(c, outputs, n_outputs, values), "fmi2GetReal");
        for (size_t i = 0; i < n_outputs; i++) printf("%.17g%c", values[i], i + 1 < n_outputs ? ' ' : '\n');
    }
    check(((Plain)find(library, "fmi2Terminate"))(c), "fmi2Terminate");
    release(c);
    return 0;
}
