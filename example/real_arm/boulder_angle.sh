#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/4PM_Group37_FlexArm_Unit6' --hold-out 0.5 \
    --scene example/real_arm/boulder.yaml --mapping example/real_arm/boulder_angle.yaml \
    --bounds root_strain.delay=-0.002:0.2 --bounds arm.young_modulus=1.28e+10:1.28e+12 --bounds \
    arm.damping_ratio=0.001:0.1 --bounds root_strain.gain=0.1:10 \
    --free arm.young_modulus,arm.damping_ratio,root_strain.gain,root_strain.bias,root_strain.delay,root_strain.lag \
    --free initial.modal_coordinates[0],initial.modal_rates[0],~inf \
    -o fitted.yaml --png fit.png "$@"
