/* The calls of a master on two coupled FMUs, written out: the floor that a general master is measured against.
 *
 * floor LIBRARY STEPS: sets, steps and reads two instances of the library's FMU, coupled y -> u both ways, keeps both
 * outputs of every step in memory, and prints the seconds of the steps.
 */
#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "callbacks.h"

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    void *library = dlopen(argv[1], RTLD_NOW);
    if (!library) return 3;
    const long steps = atol(argv[2]);
    fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)dlsym(library, "fmi2Instantiate");
    fmi2SetRealTYPE *set = (fmi2SetRealTYPE *)dlsym(library, "fmi2SetReal");
    fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)dlsym(library, "fmi2GetReal");
    fmi2DoStepTYPE *step = (fmi2DoStepTYPE *)dlsym(library, "fmi2DoStep");
    fmi2Component a = instantiate("a", fmi2CoSimulation, "probe", "", &callbacks, fmi2False, fmi2False);
    fmi2Component b = instantiate("b", fmi2CoSimulation, "probe", "", &callbacks, fmi2False, fmi2False);
    const fmi2ValueReference u = 0, y = 1, y_start = 5;
    double ya = 1.0, yb = 0.0;
    double *rows = malloc((size_t)(steps + 1) * 2 * sizeof(double));
    set(a, &y_start, 1, &ya);
    struct timespec begin, end;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    for (long k = 0; k < steps; k++) {
        int failed = set(a, &u, 1, &yb) | set(b, &u, 1, &ya);
        rows[2 * k] = ya;
        rows[2 * k + 1] = yb;
        failed |= step(a, k * 0.1, 0.1, fmi2True) | get(a, &y, 1, &ya);
        failed |= step(b, k * 0.1, 0.1, fmi2True) | get(b, &y, 1, &yb);
        if (failed) return 1;
    }
    clock_gettime(CLOCK_MONOTONIC, &end);
    printf("%.9g\n", (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec));
    return 0;
}
