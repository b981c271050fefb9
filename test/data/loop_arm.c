/*
 * A closed loop of an exported arm whose error is estimated: a PD controller holds the shaft at the angle GOAL. With
 * an argument the finer run has a controller of its own, else it gets the inputs of the scene's run. Prints the
 * largest estimated error and, for each step, the place of the tip, exactly, as hexadecimal floats.
 */
#include <stdio.h>

#include "arm.h"

static double memory[ARM_SIZE / 8];

static double torque(double angle, double speed)
{
    return KP * (GOAL - angle) - KD * speed;
}

int main(int count, char **arguments)
{
    arm *instance = (arm *)memory;
    double value[ARM_OUTPUTS], finer[9];
    int code = arm_create(memory, sizeof memory);
    for (int k = 0; k < COUNT && code == ARM_OK; ++k) {
        arm_get_outputs(instance, value);
        code = arm_set_input(instance, ARM_TORQUE, torque(value[ARM_SHAFT], value[ARM_SHAFT_VELOCITY]));
        if (count > 1) {
            arm_get_finer(instance, finer);
            arm_set_finer_input(instance, ARM_TORQUE, torque(finer[2], finer[5]));
        }
        if (code == ARM_OK)
            code = arm_step(instance, 1);
        arm_get_outputs(instance, value);
        printf("%a %a\n", value[ARM_TIP_X], value[ARM_TIP_Y]);
    }
    printf("%a\n", value[ARM_ESTIMATED_TIP_ERROR]);
    (void)arguments;
    return code;
}
