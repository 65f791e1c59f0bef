/* The probe as a library without the functions that an importer calls only if the FMU has the capability. */
#include "fmi2Functions.h"
#undef fmi2GetFMUstate
#undef fmi2SetFMUstate
#undef fmi2FreeFMUstate
#undef fmi2SerializedFMUstateSize
#undef fmi2SerializeFMUstate
#undef fmi2DeSerializeFMUstate
#undef fmi2GetDirectionalDerivative
#undef fmi2CancelStep
#define fmi2GetFMUstate lean_1
#define fmi2SetFMUstate lean_2
#define fmi2FreeFMUstate lean_3
#define fmi2SerializedFMUstateSize lean_4
#define fmi2SerializeFMUstate lean_5
#define fmi2DeSerializeFMUstate lean_6
#define fmi2GetDirectionalDerivative lean_7
#define fmi2CancelStep lean_8
#include "probe.c"
