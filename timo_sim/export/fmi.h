/*
 * Copyright 2026 The timo_sim authors
 * SPDX-License-Identifier: Apache-2.0
 *
 * What the functions of FMI 2 and FMI 3 share: instances, their variables, steps and saved states.
 * The file that includes this one defines FMI(name), the name of a function of its version, the
 * types STATUS, LOGGER, FLAG and BYTE, the function `tell`, and NOT_DONE, the status of a step whose
 * size is wrong.
 *
 * Value references are the numbers of the outputs of arm.h, followed by those of its inputs.
 */
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "arm.h"
#include "token.h"

/* Values of fmi2Status and of fmi3Status. */
#define OK 0
#define DISCARD 2
#define ERROR 3

/* First value references of inputs and of parameters; those of outputs begin at 0. */
#define INPUT ((unsigned)ARM_OUTPUTS)
#define PARAMETER ((unsigned)(ARM_OUTPUTS + ARM_INPUTS))

#define NEVER 1e300 /* sim time [s] */

/* What an instance waits for; bits, of which a function may accept several. */
enum { INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, FAILED = 8, TERMINATED = 16, ANY = 31 };

struct instance {
    LOGGER logger;
    void *environment;
    char *name;
    int phase;
    double stop; /* sim time that no step may pass [s] */
    double memory[(ARM_SIZE + 7) / 8];
};

struct saved {
    char token[sizeof TOKEN]; /* shows that the state is one of this unit */
    int32_t phase;
    uint32_t checksum; /* of all else, while it is serialised */
    double stop;
    double values[ARM_STATE_SIZE];
};

/* Go on with a checksum by FNV-1a: any byte that was changed changes it. */
static uint32_t add_bytes(uint32_t sum, const void *bytes, size_t size)
{
    for (size_t k = 0; k < size; ++k)
        sum = (sum ^ ((const unsigned char *)bytes)[k]) * 16777619u;
    return sum;
}

/* The checksum of a state without itself, and without what pads the structure. */
static uint32_t checksum_of(const struct saved *state)
{
    uint32_t sum = add_bytes(2166136261u, state->token, sizeof state->token);
    sum = add_bytes(sum, &state->phase, sizeof state->phase);
    sum = add_bytes(sum, &state->stop, sizeof state->stop);
    return add_bytes(sum, state->values, sizeof state->values);
}

static void tell(struct instance *me, int status, const char *text);

static int fail(struct instance *me, int status, const char *format, ...)
{
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (me->logger)
        tell(me, status, text);
    return status;
}

/* Begin a function of the interface, which may be called in some phases. */
#define ENTER(instance, phases) \
    struct instance *me = instance; \
    if (!me) \
        return ERROR; \
    if (!(me->phase & (phases))) \
        return fail(me, ERROR, "%s must not be called in this state", __func__)

/* Define a function that serves `count` variables of a kind that this unit does not have. */
#define ABSENT(name, count, ...) \
    STATUS FMI(name)(__VA_ARGS__) \
    { \
        ENTER(instance, ANY); \
        return (count) ? fail(me, ERROR, "%s: this unit does not have that", __func__) : OK; \
    }

#define ONE void *instance
#define SOME void *instance, const unsigned references[], size_t count

typedef const char *string;

#define REQUIRE(condition, what) \
    if (!(condition)) \
        return fail(me, ERROR, "%s: %s", __func__, what)

static arm *arm_of(struct instance *me)
{
    return (arm *)me->memory;
}

static double time_of(struct instance *me)
{
    double time = 0.0;
    arm_get_output(arm_of(me), ARM_TIME, &time);
    return time;
}

static struct instance *make(const char *name, const char *token, LOGGER logger,
                             void *environment)
{
    struct instance *me = calloc(1, sizeof *me);
    name = name ? name : "";
    if (!me || !(me->name = malloc(strlen(name) + 1))) {
        free(me);
        return NULL;
    }
    strcpy(me->name, name);
    me->logger = logger;
    me->environment = environment;
    me->phase = INSTANTIATED;
    me->stop = NEVER;
    int code = arm_create(me->memory, sizeof me->memory);
    if (code == ARM_OK && token && !strcmp(token, TOKEN))
        return me;
    fail(me, ERROR, "%s", code ? arm_error_text(code) : "the token is that of another unit");
    free(me->name);
    free(me);
    return NULL;
}

static int set_times(struct instance *me, double start, bool stops, double stop)
{
    if (start != 0.0)
        return fail(me, ERROR, "the start time must be 0 s, got %g s", start);
    if (stops && !(stop >= 0.0))
        return fail(me, ERROR, "the stop time must be >= 0 s, got %g s", stop);
    me->stop = stops ? stop : NEVER;
    return OK;
}

static int get_values(struct instance *me, const unsigned *references, size_t count,
                      double *values)
{
    REQUIRE(!count || (references && values), "a pointer is null");
    for (size_t k = 0; k < count; ++k) {
        unsigned number = references[k];
        int code = number < INPUT
            ? arm_get_output(arm_of(me), (int)number, &values[k])
            : number < PARAMETER
            ? arm_get_input(arm_of(me), (int)(number - INPUT), &values[k])
            : arm_get_parameter(arm_of(me), (int)(number - PARAMETER), &values[k]);
        if (code != ARM_OK)
            return fail(me, ERROR, "there is no variable with the reference %u", number);
    }
    return OK;
}

/* Set all values, or none of them if one is wrong. */
static int set_values(struct instance *me, const unsigned *references, size_t count,
                      const double *values)
{
    REQUIRE(!count || (references && values), "a pointer is null");
    for (size_t k = 0; k < count; ++k) {
        unsigned number = references[k];
        if (number < INPUT || number >= PARAMETER + ARM_PARAMETERS)
            return fail(me, ERROR, "the variable with the reference %u is no input or parameter",
                        number);
        if (number < PARAMETER && values[k] - values[k] != 0.0)
            return fail(me, DISCARD, "%s must be finite, got %g",
                        arm_input_name((int)(number - INPUT)), values[k]);
        if (number >= PARAMETER && !(values[k] > 0.0))
            return fail(me, DISCARD, "%s must be > 0, got %g",
                        arm_parameter_name((int)(number - PARAMETER)), values[k]);
    }
    for (size_t k = 0; k < count; ++k) {
        if (references[k] < PARAMETER)
            arm_set_input(arm_of(me), (int)(references[k] - INPUT), values[k]);
        else
            arm_set_parameter(arm_of(me), (int)(references[k] - PARAMETER), values[k]);
    }
    return OK;
}

/* Return the longest time step up to that of the scene that divides a communication step. */
static double divided(double size)
{
    double count = size / ARM_STEP;
    if (!(count > 0.0 && count < 1e15))
        return ARM_STEP;
    int64_t whole = (int64_t)count;
    return size / (double)(whole + (count > (double)whole));
}

/* Times are those of the master, which may have added up round-off. */
static int step(struct instance *me, double point, double size)
{
    double now = time_of(me), count = size / ARM_STEP;
    double far = (point - now) / ARM_STEP;
    if (!(far > -0.5 && far < 0.5))
        return fail(me, ERROR, "the communication point must be %.17g s, got %.17g s", now, point);
    int64_t steps = count >= 0.5 && count < 1e15 ? (int64_t)(count + 0.5) : 0;
    double off = count - (double)steps, most = 1e-6 + 1e-15 * (now + size) / ARM_STEP;
    if (!steps || off > most || off < -most)
        return fail(me, NOT_DONE, "the communication step must be a whole multiple of %.17g s, "
                    "got %.17g s: export with --set integrator.step=%.17g", (double)ARM_STEP, size,
                    divided(size));
    if (now + ((double)steps - 0.5) * ARM_STEP > me->stop)
        return fail(me, ERROR, "a step of %g s from %g s passes the stop time, %g s", size, now,
                    me->stop);
    int code = arm_step(arm_of(me), steps);
    if (code == ARM_OK)
        return OK;
    me->phase = FAILED;
    return fail(me, ERROR, "at %g s: %s", time_of(me), arm_error_text(code));
}

/* The functions that differ in no more than their names. */

void FMI(FreeInstance)(void *instance)
{
    struct instance *me = instance;
    if (me)
        free(me->name);
    free(me);
}

/* Only errors are logged, and these always. */
STATUS FMI(SetDebugLogging)(void *instance, FLAG logging, size_t count,
                            const char *const categories[])
{
    ENTER(instance, ANY);
    return OK;
}

STATUS FMI(ExitInitializationMode)(void *instance)
{
    ENTER(instance, INITIALIZING);
    me->phase = STEPPING;
    return OK;
}

STATUS FMI(Terminate)(void *instance)
{
    ENTER(instance, STEPPING);
    me->phase = TERMINATED;
    return OK;
}

STATUS FMI(Reset)(void *instance)
{
    ENTER(instance, ANY);
    arm_create(me->memory, sizeof me->memory); /* parameters have their first values again */
    me->phase = INSTANTIATED;
    me->stop = NEVER;
    return OK;
}

STATUS FMI(GetFMUState)(void *instance, void **state)
{
    ENTER(instance, ANY);
    REQUIRE(state, "a pointer is null");
    struct saved *saved = *state ? *state : calloc(1, sizeof *saved);
    REQUIRE(saved, "there is no memory left");
    memcpy(saved->token, TOKEN, sizeof TOKEN);
    saved->phase = me->phase;
    saved->stop = me->stop;
    arm_get_state(arm_of(me), saved->values);
    *state = saved;
    return OK;
}

STATUS FMI(SetFMUState)(void *instance, void *state)
{
    ENTER(instance, ANY);
    const struct saved *saved = state;
    REQUIRE(saved && !memcmp(saved->token, TOKEN, sizeof TOKEN), "this is no state of this unit");
    int phase = saved->phase;
    REQUIRE(phase > 0 && phase < ANY && !(phase & (phase - 1)), "the state is damaged");
    int code = arm_set_state(arm_of(me), saved->values);
    REQUIRE(code == ARM_OK, arm_error_text(code));
    me->phase = phase;
    me->stop = saved->stop;
    return OK;
}

STATUS FMI(FreeFMUState)(void *instance, void **state)
{
    ENTER(instance, ANY);
    REQUIRE(state, "a pointer is null");
    free(*state);
    *state = NULL;
    return OK;
}

STATUS FMI(SerializedFMUStateSize)(void *instance, void *state, size_t *size)
{
    ENTER(instance, ANY);
    REQUIRE(state && size, "a pointer is null");
    *size = sizeof(struct saved);
    return OK;
}

STATUS FMI(SerializeFMUState)(void *instance, void *state, BYTE bytes[], size_t size)
{
    ENTER(instance, ANY);
    REQUIRE(state && bytes, "a pointer is null");
    REQUIRE(size >= sizeof(struct saved), "there is too little room for the state");
    struct saved saved = *(const struct saved *)state;
    saved.checksum = checksum_of(&saved);
    memcpy(bytes, &saved, sizeof saved);
    return OK;
}

STATUS FMI(DeserializeFMUState)(void *instance, const BYTE bytes[], size_t size, void **state)
{
    ENTER(instance, ANY);
    REQUIRE(bytes && state, "a pointer is null");
    REQUIRE(size == sizeof(struct saved) && !memcmp(bytes, TOKEN, sizeof TOKEN),
            "these bytes are no state of this unit");
    struct saved read;
    memcpy(&read, bytes, sizeof read);
    REQUIRE(read.checksum == checksum_of(&read), "the state is damaged");
    struct saved *saved = malloc(sizeof *saved);
    REQUIRE(saved, "there is no memory left");
    *saved = read;
    *state = saved;
    return OK;
}
