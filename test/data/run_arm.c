/*
 * Do what the lines of the standard input say with an exported arm:
 * i INPUT VALUE, l PARAMETER VALUE, s STEPS, r (reset), g (get the state), p (put the state of the last g back),
 * o (print all outputs), d (print the derivatives of a step), w (print the state), c (print the centre line). Numbers are printed exactly, as hexadecimal floats.
 */
#include <stdio.h>
#include <stdlib.h>

#include "arm.h"

int main(void)
{
    double *memory = malloc(arm_size()), state[ARM_STATE_SIZE], outputs[ARM_OUTPUTS], value;
    double shown[ARM_STATE_SIZE];
    arm *instance = (arm *)memory;
    int code = arm_create(memory, arm_size()), input;
    long steps;
    char what;
    while (scanf(" %c", &what) == 1) {
        if (what == 'i' && scanf("%d %lf", &input, &value) == 2)
            code = arm_set_input(instance, input, value);
        else if (what == 'l' && scanf("%d %lf", &input, &value) == 2)
            code = arm_set_parameter(instance, input, value);
        else if (what == 's' && scanf("%ld", &steps) == 1)
            code = arm_step(instance, steps);
        else if (what == 'r')
            code = arm_reset(instance);
        else if (what == 'g')
            code = arm_get_state(instance, state);
        else if (what == 'p')
            code = arm_set_state(instance, state);
        else if (what == 'o') {
            code = arm_get_outputs(instance, outputs);
            for (int k = 0; k < ARM_OUTPUTS; ++k)
                printf("%a ", outputs[k]);
            printf("\n");
#ifdef DERIVATIVES
        } else if (what == 'd') {
            double found[ARM_MOTION + ARM_INPUTS][ARM_MOTION];
            code = arm_step_derivatives(instance, found);
            for (int k = 0; k < (ARM_MOTION + ARM_INPUTS) * ARM_MOTION; ++k)
                printf("%a ", found[0][k]);
            printf("\n");
#endif
        } else if (what == 'c') {
            double line[ARM_SHAPE][2];
            code = arm_get_shape(instance, line);
            for (int k = 0; k < 2 * ARM_SHAPE; ++k)
                printf("%a ", line[0][k]);
            printf("\n");
        } else if (what == 'w') {
            code = arm_get_state(instance, shown);
            for (int k = 0; k < ARM_STATE_SIZE; ++k)
                printf("%a ", shown[k]);
            printf("\n");
        }
        if (code != ARM_OK) {
            printf("%s\n", arm_error_text(code));
            code = ARM_OK;
        }
    }
    free(memory);
    return 0;
}
