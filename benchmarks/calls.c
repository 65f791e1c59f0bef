/* The reference loop with the FMI calls of cosim written out: trajectory, controller and plant, 10 s at 10 kHz.
 *
 * calls TRAJECTORY CONTROLLER PLANT: the libraries of the FMUs; references.h has their GUIDs, value references and start
 * values (whole_run.py writes it). Prints the processor time in seconds from the start values to fmi2Terminate, and the
 * last position.
 */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "callbacks.h"
#include "references.h"

typedef struct {
    fmi2Component instance;
    fmi2SetRealTYPE *set;
    fmi2GetRealTYPE *get;
    fmi2DoStepTYPE *step;
    fmi2SetIntegerTYPE *set_integer;
    fmi2EnterInitializationModeTYPE *enter;
    fmi2ExitInitializationModeTYPE *leave;
    fmi2TerminateTYPE *terminate;
} Fmu;

static Fmu loaded(const char *path, const char *guid) {
    void *library = dlopen(path, RTLD_NOW);
    if (!library) exit(3);
    fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)dlsym(library, "fmi2Instantiate");
    fmi2SetupExperimentTYPE *setup = (fmi2SetupExperimentTYPE *)dlsym(library, "fmi2SetupExperiment");
    Fmu fmu = {
        instantiate("x", fmi2CoSimulation, guid, "", &callbacks, fmi2False, fmi2False),
        (fmi2SetRealTYPE *)dlsym(library, "fmi2SetReal"),
        (fmi2GetRealTYPE *)dlsym(library, "fmi2GetReal"),
        (fmi2DoStepTYPE *)dlsym(library, "fmi2DoStep"),
        (fmi2SetIntegerTYPE *)dlsym(library, "fmi2SetInteger"),
        (fmi2EnterInitializationModeTYPE *)dlsym(library, "fmi2EnterInitializationMode"),
        (fmi2ExitInitializationModeTYPE *)dlsym(library, "fmi2ExitInitializationMode"),
        (fmi2TerminateTYPE *)dlsym(library, "fmi2Terminate"),
    };
    if (!fmu.instance || setup(fmu.instance, fmi2False, 0.0, 0.0, fmi2True, 10.0)) exit(4);
    return fmu;
}

int main(int argc, char **argv) {
    if (argc < 4) return 2;
    Fmu trajectory = loaded(argv[1], TRAJECTORY), controller = loaded(argv[2], CONTROLLER);
    Fmu plant = loaded(argv[3], PLANT);
    const double shape[] = START_OF_SHAPE, sampling = 1e-4;
    const fmi2Integer kind = KIND;
    const clock_t begin = clock();
    int failed = trajectory.set(trajectory.instance, shape_references, 2, shape) |
                 trajectory.set_integer(trajectory.instance, &kind_reference, 1, &kind) |
                 controller.set(controller.instance, &sampling_reference, 1, &sampling);
    Fmu *all[] = {&trajectory, &controller, &plant};
    for (int i = 0; i < 3; i++) failed |= all[i]->enter(all[i]->instance) | all[i]->leave(all[i]->instance);
    const int n = 100000;
    double *rows = malloc(sizeof(double) * 3 * (size_t)(n + 1)), u[5], command;
    failed |= trajectory.get(trajectory.instance, trajectory_outputs, 3, u);
    failed |= plant.get(plant.instance, plant_outputs, 2, u + 3);
    for (int k = 0; k <= n; k++) {
        failed |= controller.set(controller.instance, controller_inputs, 5, u);
        failed |= controller.get(controller.instance, &controller_output, 1, &command);
        failed |= plant.set(plant.instance, &plant_input, 1, &command);
        rows[3 * k] = u[0];
        rows[3 * k + 1] = u[3];
        rows[3 * k + 2] = command;
        if (k == n) break;
        failed |= trajectory.step(trajectory.instance, k * 1e-4, 1e-4, fmi2True);
        failed |= trajectory.get(trajectory.instance, trajectory_outputs, 3, u);
        failed |= controller.step(controller.instance, k * 1e-4, 1e-4, fmi2True);
        failed |= controller.get(controller.instance, &controller_output, 1, &command);
        failed |= plant.step(plant.instance, k * 1e-4, 1e-4, fmi2True);
        failed |= plant.get(plant.instance, plant_outputs, 2, u + 3);
        if (failed) return 1;
    }
    for (int i = 0; i < 3; i++)
        if (all[i]->terminate(all[i]->instance) > fmi2Warning) return 1;
    printf("%.9f %.17g\n", (double)(clock() - begin) / CLOCKS_PER_SEC, rows[3 * n + 1]);
    return 0;
}
