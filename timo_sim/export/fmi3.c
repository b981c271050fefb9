/*
 * Copyright 2026 The timo_sim authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The functions of FMI 3.0 for co-simulation.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The types of FMI 3.0, unless its own headers are included before. */
#ifndef fmi3FunctionTypes_h
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged
} fmi3IntervalQualifier;
typedef enum {
    fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent
} fmi3DependencyKind;
typedef void (*fmi3LogMessageCallback)(void *, fmi3Status, const char *, const char *);
typedef void (*fmi3ClockUpdateCallback)(void *);
typedef void (*fmi3IntermediateUpdateCallback)(void *, double, bool, bool, bool, bool, bool *,
                                               double *);
typedef void (*fmi3LockPreemptionCallback)();
typedef void (*fmi3UnlockPreemptionCallback)();
#endif

typedef fmi3LogMessageCallback LOGGER;
typedef fmi3Status STATUS;
typedef bool FLAG;
typedef uint8_t BYTE;
#define NOT_DONE DISCARD
#define FMI(name) fmi3##name

#include "fmi.h"

static void tell(struct instance *me, int status, const char *text)
{
    me->logger(me->environment, (fmi3Status)status, "logStatusError", text);
}

const char *fmi3GetVersion(void)
{
    return "3.0";
}

void *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging,
    bool event_mode, bool early_return, const uint32_t intermediate[], size_t count,
    void *environment, fmi3LogMessageCallback logger, fmi3IntermediateUpdateCallback update)
{
    return make(name, token, logger, environment);
}

void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
                                   bool visible, bool logging, void *environment,
                                   fmi3LogMessageCallback logger)
{
    return NULL;
}

void *fmi3InstantiateScheduledExecution(
    const char *name, const char *token, const char *resources, bool visible, bool logging,
    void *environment, fmi3LogMessageCallback logger, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}

fmi3Status fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance,
                                       double start, bool stops, double stop)
{
    ENTER(instance, INSTANTIATED);
    int status = set_times(me, start, stops, stop);
    if (status == OK)
        me->phase = INITIALIZING;
    return status;
}

fmi3Status fmi3GetFloat64(void *instance, const uint32_t references[], size_t count,
                          double values[], size_t value_count)
{
    ENTER(instance, ANY);
    REQUIRE(count == value_count, "each variable has one value");
    return get_values(me, references, count, values);
}

fmi3Status fmi3SetFloat64(void *instance, const uint32_t references[], size_t count,
                          const double values[], size_t value_count)
{
    ENTER(instance, INSTANTIATED | INITIALIZING | STEPPING);
    REQUIRE(count == value_count, "each variable has one value");
    return set_values(me, references, count, values);
}

fmi3Status fmi3DoStep(void *instance, double point, double size, bool never_back,
                      bool *event_needed, bool *terminates, bool *early_return, double *last)
{
    ENTER(instance, STEPPING);
    REQUIRE(event_needed && terminates && early_return && last, "a pointer is null");
    *event_needed = *terminates = *early_return = false;
    int status = step(me, point, size);
    *last = time_of(me);
    return status;
}

/*
 * What this unit does not have: variables of other types, derivatives, events, clocks, continuous
 * states.
 */

#define NO_VARIABLES(name, type) \
    ABSENT(Get##name, count, SOME, type values[], size_t value_count) \
    ABSENT(Set##name, count, SOME, const type values[], size_t value_count)

typedef const uint8_t *binary;

NO_VARIABLES(Float32, float)
NO_VARIABLES(Int8, int8_t)
NO_VARIABLES(UInt8, uint8_t)
NO_VARIABLES(Int16, int16_t)
NO_VARIABLES(UInt16, uint16_t)
NO_VARIABLES(Int32, int32_t)
NO_VARIABLES(UInt32, uint32_t)
NO_VARIABLES(Int64, int64_t)
NO_VARIABLES(UInt64, uint64_t)
NO_VARIABLES(Boolean, bool)
NO_VARIABLES(String, string)
ABSENT(GetBinary, count, SOME, size_t sizes[], binary values[], size_t value_count)
ABSENT(SetBinary, count, SOME, const size_t sizes[], const binary values[], size_t value_count)

ABSENT(GetClock, count, SOME, bool values[])
ABSENT(SetClock, count, SOME, const bool values[])
ABSENT(GetIntervalDecimal, count, SOME, double intervals[], fmi3IntervalQualifier qualifiers[])
ABSENT(GetIntervalFraction, count, SOME, uint64_t counters[], uint64_t resolutions[],
       fmi3IntervalQualifier qualifiers[])
ABSENT(GetShiftDecimal, count, SOME, double shifts[])
ABSENT(GetShiftFraction, count, SOME, uint64_t counters[], uint64_t resolutions[])
ABSENT(SetIntervalDecimal, count, SOME, const double intervals[])
ABSENT(SetIntervalFraction, count, SOME, const uint64_t counters[], const uint64_t resolutions[])
ABSENT(SetShiftDecimal, count, SOME, const double shifts[])
ABSENT(SetShiftFraction, count, SOME, const uint64_t counters[], const uint64_t resolutions[])

ABSENT(GetNumberOfVariableDependencies, 1, ONE, uint32_t reference, size_t *count)
ABSENT(GetVariableDependencies, 1, ONE, uint32_t dependent, size_t elements[],
       uint32_t independents[], size_t elements_of_independents[], fmi3DependencyKind kinds[],
       size_t count)
ABSENT(GetDirectionalDerivative, 1, ONE, const uint32_t unknowns[], size_t unknown_count,
       const uint32_t knowns[], size_t known_count, const double seed[], size_t seed_count,
       double sensitivity[], size_t sensitivity_count)
ABSENT(GetAdjointDerivative, 1, ONE, const uint32_t unknowns[], size_t unknown_count,
       const uint32_t knowns[], size_t known_count, const double seed[], size_t seed_count,
       double sensitivity[], size_t sensitivity_count)
ABSENT(GetOutputDerivatives, count, SOME, const int32_t orders[], double values[],
       size_t value_count)

ABSENT(EnterConfigurationMode, 1, ONE)
ABSENT(ExitConfigurationMode, 1, ONE)
ABSENT(EnterEventMode, 1, ONE)
ABSENT(EnterStepMode, 1, ONE)
ABSENT(EnterContinuousTimeMode, 1, ONE)
ABSENT(EvaluateDiscreteStates, 1, ONE)
ABSENT(UpdateDiscreteStates, 1, ONE, bool *needed, bool *terminates, bool *nominals_changed,
       bool *values_changed, bool *has_next, double *next)
ABSENT(CompletedIntegratorStep, 1, ONE, bool never_back, bool *event_needed, bool *terminates)
ABSENT(SetTime, 1, ONE, double time)
ABSENT(SetContinuousStates, 1, ONE, const double values[], size_t count)
ABSENT(GetContinuousStates, 1, ONE, double values[], size_t count)
ABSENT(GetContinuousStateDerivatives, 1, ONE, double values[], size_t count)
ABSENT(GetNominalsOfContinuousStates, 1, ONE, double values[], size_t count)
ABSENT(GetEventIndicators, 1, ONE, double values[], size_t count)
ABSENT(GetNumberOfContinuousStates, 1, ONE, size_t *count)
ABSENT(GetNumberOfEventIndicators, 1, ONE, size_t *count)
ABSENT(ActivateModelPartition, 1, ONE, uint32_t clock, double time)
