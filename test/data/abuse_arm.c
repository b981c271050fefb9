/* Call an exported arm with bad arguments and in the wrong order; print what is not as it should. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "arm.h"

static int wrong = 0;

#define EXPECT(condition) \
    do { if (!(condition)) { ++wrong; printf("line %d: %s\n", __LINE__, #condition); } } while (0)

enum { GUARD = 64 };

int main(void)
{
    unsigned char *room = malloc(ARM_SIZE + 2 * GUARD);
    memset(room, 0x5a, ARM_SIZE + 2 * GUARD);
    arm *instance = (arm *)(room + GUARD);
    double value = 1.0, outputs[ARM_OUTPUTS], state[ARM_STATE_SIZE], other[ARM_STATE_SIZE];
    const int counts[] = {-1, 1000000, ARM_INPUTS, ARM_OUTPUTS, ARM_PARAMETERS,
                          -2147483647 - 1};

    EXPECT(arm_size() == ARM_SIZE);
    /* Before it is created. */
    EXPECT(arm_reset(instance) == ARM_NOT_CREATED);
    EXPECT(arm_step(instance, 1) == ARM_NOT_CREATED);
    EXPECT(arm_set_input(instance, 0, 1.0) == ARM_NOT_CREATED);
    EXPECT(arm_get_output(instance, 0, &value) == ARM_NOT_CREATED);
    EXPECT(arm_get_outputs(instance, outputs) == ARM_NOT_CREATED);
    EXPECT(arm_get_state(instance, state) == ARM_NOT_CREATED);
    memset(state, 0, sizeof state);
    EXPECT(arm_set_state(instance, state) == ARM_NOT_CREATED);
    /* Memory. */
    EXPECT(arm_create(NULL, ARM_SIZE) == ARM_NULL_POINTER);
    EXPECT(arm_create(room + GUARD + 4, ARM_SIZE) == ARM_BAD_MEMORY);
    EXPECT(arm_create(room + GUARD, ARM_SIZE - 1) == ARM_BAD_MEMORY);
    EXPECT(arm_create(room + GUARD, 0) == ARM_BAD_MEMORY);
    EXPECT(arm_reset(instance) == ARM_NOT_CREATED);
    EXPECT(arm_create(room + GUARD, ARM_SIZE) == ARM_OK);
    EXPECT(arm_create(room + GUARD, ARM_SIZE) == ARM_OK);
    /* Null pointers. */
    EXPECT(arm_reset(NULL) == ARM_NULL_POINTER);
    EXPECT(arm_step(NULL, 1) == ARM_NULL_POINTER);
    EXPECT(arm_set_input(NULL, 0, 1.0) == ARM_NULL_POINTER);
    EXPECT(arm_get_input(instance, 0, NULL) == ARM_NULL_POINTER);
    EXPECT(arm_get_output(instance, 0, NULL) == ARM_NULL_POINTER);
    EXPECT(arm_get_outputs(instance, NULL) == ARM_NULL_POINTER);
    EXPECT(arm_get_state(instance, NULL) == ARM_NULL_POINTER);
    EXPECT(arm_set_state(instance, NULL) == ARM_NULL_POINTER);
    EXPECT(arm_step((arm *)(room + 1), 1) == ARM_NOT_CREATED);
    /* Numbers and values. */
    for (size_t k = 0; k < sizeof counts / sizeof *counts; ++k) {
        if (counts[k] < 0 || counts[k] >= ARM_INPUTS) {
            EXPECT(arm_set_input(instance, counts[k], 1.0) == ARM_UNKNOWN_NUMBER);
            EXPECT(arm_get_input(instance, counts[k], &value) == ARM_UNKNOWN_NUMBER);
            EXPECT(!strcmp(arm_input_name(counts[k]), "unknown"));
        }
        if (counts[k] < 0 || counts[k] >= ARM_PARAMETERS) {
            EXPECT(arm_set_parameter(instance, counts[k], 1.0) == ARM_UNKNOWN_NUMBER);
            EXPECT(arm_get_parameter(instance, counts[k], &value) == ARM_UNKNOWN_NUMBER);
            EXPECT(!strcmp(arm_parameter_name(counts[k]), "unknown"));
        }
        if (counts[k] < 0 || counts[k] >= ARM_OUTPUTS) {
            EXPECT(arm_get_output(instance, counts[k], &value) == ARM_UNKNOWN_NUMBER);
            EXPECT(!strcmp(arm_output_unit(counts[k]), "unknown"));
        }
    }
    EXPECT(arm_set_input(instance, 0, NAN) == ARM_NOT_FINITE);
    EXPECT(arm_set_input(instance, 0, INFINITY) == ARM_NOT_FINITE);
    EXPECT(arm_get_input(instance, 0, &value) == ARM_OK && value == 0.0);
    EXPECT(arm_set_parameter(instance, 0, NAN) == ARM_NOT_POSITIVE);
    EXPECT(arm_set_parameter(instance, 0, 0.0) == ARM_NOT_POSITIVE);
    EXPECT(arm_set_parameter(instance, 0, -1.0) == ARM_NOT_POSITIVE);
    EXPECT(arm_set_parameter(NULL, 0, 1.0) == ARM_NULL_POINTER);
    EXPECT(arm_get_parameter(instance, 0, NULL) == ARM_NULL_POINTER);
    EXPECT(arm_get_parameter(instance, 0, &value) == ARM_OK && value == INFINITY);
    EXPECT(arm_step(instance, -1) == ARM_NEGATIVE_STEPS);
    EXPECT(arm_step(instance, INT64_MIN) == ARM_NEGATIVE_STEPS);
    EXPECT(arm_step(instance, 0) == ARM_OK);
    EXPECT(!strcmp(arm_error_text(-1), "unknown") && !strcmp(arm_error_text(99), "unknown"));
    for (int code = ARM_OK; code <= ARM_NOT_POSITIVE; ++code)
        EXPECT(strlen(arm_error_text(code)) > 5);
    /* States. */
    EXPECT(arm_step(instance, 5) == ARM_OK);
    EXPECT(arm_get_state(instance, state) == ARM_OK);
    for (int k = 0; k < ARM_STATE_SIZE; ++k) {
        memcpy(other, state, sizeof state);
        other[k] = NAN;
        EXPECT(arm_set_state(instance, other) != ARM_OK);
        other[k] = -INFINITY;
        EXPECT(arm_set_state(instance, other) != ARM_OK);
    }
    memcpy(other, state, sizeof state);
    other[0] = 0.5;
    EXPECT(arm_set_state(instance, other) == ARM_BAD_STATE);
    other[0] = -1.0;
    EXPECT(arm_set_state(instance, other) == ARM_BAD_STATE);
    other[0] = 1e300;
    EXPECT(arm_set_state(instance, other) == ARM_BAD_STATE);
    EXPECT(arm_get_state(instance, other) == ARM_OK && !memcmp(state, other, sizeof state));
    EXPECT(arm_set_state(instance, state) == ARM_OK);
    /* States and inputs without sense: codes, and the last good step. */
    for (int k = 2; k < ARM_STATE_SIZE; ++k) {
        memcpy(other, state, sizeof state);
        other[k] = 1e300;
        if (arm_set_state(instance, other) == ARM_OK) {
            int code = arm_step(instance, 3);
            EXPECT(code == ARM_OK || code == ARM_DIVERGED);
            EXPECT(arm_get_outputs(instance, outputs) == ARM_OK);
        }
    }
    /* The last number is one of the motion. */
    memcpy(other, state, sizeof state);
    other[ARM_STATE_SIZE - 1] = 1e300;
    EXPECT(arm_set_state(instance, other) == ARM_BAD_STATE);
    other[ARM_STATE_SIZE - 1] = 1e10;
    EXPECT(arm_set_state(instance, other) == ARM_OK);
    /* Outputs are finite where one or more of its last numbers are large and it is taken. */
    for (double large = 1e60; large > 1.0; large *= 1e-5) {
        memcpy(other, state, sizeof state);
        for (int last = 1; last <= 8; ++last) {
            other[ARM_STATE_SIZE - last] = last % 2 ? large : -large;
            if (arm_set_state(instance, other) != ARM_OK)
                continue;
            EXPECT(arm_get_outputs(instance, outputs) == ARM_OK);
            for (int k = 0; k < ARM_OUTPUTS; ++k)
                EXPECT(isfinite(outputs[k]));
        }
    }
    EXPECT(arm_set_state(instance, state) == ARM_OK);
    for (int k = 0; k < ARM_INPUTS; ++k)
        EXPECT(arm_set_input(instance, k, 1e300) == ARM_OK);
    EXPECT(arm_step(instance, 1000) == ARM_DIVERGED);
    EXPECT(arm_get_output(instance, ARM_TIME, &value) == ARM_OK && value < 10.0 * ARM_STEP);
    EXPECT(arm_get_output(instance, ARM_SHAFT, &value) == ARM_OK && isfinite(value));
    EXPECT(arm_step(instance, 1) == ARM_DIVERGED);
    EXPECT(arm_reset(instance) == ARM_OK && arm_step(instance, 10) == ARM_OK);
    for (size_t k = 0; k < GUARD; ++k)
        EXPECT(room[k] == 0x5a && room[GUARD + ARM_SIZE + k] == 0x5a);
    free(room);
    return wrong != 0;
}
