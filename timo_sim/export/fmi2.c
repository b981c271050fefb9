/*
 * Copyright 2026 The timo_sim authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The functions of FMI 2.0 for co-simulation.
 */
#include <stddef.h>

/* The types of FMI 2.0, unless its own headers are included before. */
#ifndef fmi2FunctionTypes_h
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated
} fmi2StatusKind;
typedef struct {
    void (*logger)(void *, const char *, fmi2Status, const char *, const char *, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;
#endif

typedef void (*LOGGER)(void *, const char *, fmi2Status, const char *, const char *, ...);
typedef fmi2Status STATUS;
typedef int FLAG;
typedef char BYTE;
#define NOT_DONE ERROR

#define JOIN(version, name) version##name
#define FMI(name) JOIN(fmi2, name)
#define GetFMUState GetFMUstate
#define SetFMUState SetFMUstate
#define FreeFMUState FreeFMUstate
#define SerializedFMUStateSize SerializedFMUstateSize
#define SerializeFMUState SerializeFMUstate
#define DeserializeFMUState DeSerializeFMUstate

#include "fmi.h"

static void tell(struct instance *me, int status, const char *text)
{
    /* It is a format; no text has a percent sign. */
    me->logger(me->environment, me->name, (fmi2Status)status, "logStatusError", text);
}

const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

const char *fmi2GetVersion(void)
{
    return "2.0";
}

void *fmi2Instantiate(const char *name, fmi2Type type, const char *guid, const char *resources,
                      const fmi2CallbackFunctions *functions, int visible, int logging)
{
    if (type != fmi2CoSimulation)
        return NULL;
    return make(name, guid, functions ? functions->logger : NULL,
                functions ? functions->componentEnvironment : NULL);
}

fmi2Status fmi2SetupExperiment(void *instance, int has_tolerance, double tolerance, double start,
                               int stops, double stop)
{
    ENTER(instance, INSTANTIATED);
    return set_times(me, start, stops, stop);
}

fmi2Status fmi2EnterInitializationMode(void *instance)
{
    ENTER(instance, INSTANTIATED);
    me->phase = INITIALIZING;
    return fmi2OK;
}

fmi2Status fmi2GetReal(void *instance, const unsigned references[], size_t count, double values[])
{
    ENTER(instance, ANY);
    return get_values(me, references, count, values);
}

fmi2Status fmi2SetReal(void *instance, const unsigned references[], size_t count,
                       const double values[])
{
    ENTER(instance, INSTANTIATED | INITIALIZING | STEPPING);
    return set_values(me, references, count, values);
}

fmi2Status fmi2DoStep(void *instance, double point, double size, int never_back)
{
    ENTER(instance, STEPPING);
    return step(me, point, size);
}

/* What this unit does not have: variables of other types, derivatives, steps in the background. */

ABSENT(GetInteger, count, SOME, int values[])
ABSENT(SetInteger, count, SOME, const int values[])
ABSENT(GetBoolean, count, SOME, int values[])
ABSENT(SetBoolean, count, SOME, const int values[])
ABSENT(GetString, count, SOME, string values[])
ABSENT(SetString, count, SOME, const string values[])
ABSENT(GetDirectionalDerivative, 1, ONE, const unsigned unknowns[], size_t results,
       const unsigned knowns[], size_t causes, const double seed[], double sensitivity[])
ABSENT(CancelStep, 1, ONE)
ABSENT(SetRealInputDerivatives, count, SOME, const int orders[], const double values[])
ABSENT(GetRealOutputDerivatives, count, SOME, const int orders[], double values[])

/* A master asks for the status of a step that was discarded or is pending, and none is. */
#define NO_STATUS(name, type) \
    fmi2Status fmi2Get##name(void *instance, const fmi2StatusKind kind, type *value) \
    { \
        ENTER(instance, ANY); \
        return fmi2Discard; \
    }

NO_STATUS(Status, fmi2Status)
NO_STATUS(RealStatus, double)
NO_STATUS(IntegerStatus, int)
NO_STATUS(BooleanStatus, int)
NO_STATUS(StringStatus, string)
