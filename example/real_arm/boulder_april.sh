#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2_6_-5' --hold-out 0.5 \
    --scene example/real_arm/boulder_april.yaml --mapping example/real_arm/boulder_april_columns.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.28e+12 --bounds arm.damping_ratio=0.001:0.1 --bounds \
    motor.shaft_inertia=0.0002:0.02 --bounds motor.viscous_friction=0.000101:0.0101 --bounds \
    motor.coulomb_friction=0.00101:0.101 --bounds motor.coulomb_speed=0.01:1 --bounds \
    motor.coulomb_presliding=0.002:0.2 --bounds motor.coulomb_static=0.01:1 --bounds \
    motor.dc.torque_constant=0.00107:0.107 --bounds voltage.gain=0.1:10 --bounds root_strain.gain=0.1:10 \
    --set motor.coulomb_static=0.5 motor.coulomb_presliding=0.02 \
    --free arm.young_modulus=1.672e+11,arm.damping_ratio=0.0046025,motor.shaft_inertia=0.0052568 \
    --free motor.viscous_friction=0.0023705,motor.coulomb_friction,motor.coulomb_speed=0.11779 \
    --free motor.coulomb_asymmetry,motor.coulomb_presliding=0.013199,motor.coulomb_static=0.92349 \
    --free motor.dc.torque_constant=0.013181,initial.shaft=-0.093179,voltage.gain=0.92251,voltage.delay=0.038349 \
    --free voltage.lag=0.0053952,root_strain.gain=1.033,root_strain.bias=-7.3018e-07,root_strain.delay=0.030959 \
    --free root_strain.lag=0.010529,initial.modal_coordinates[0]=0.00041127,initial.modal_rates[0]=0.036076,~inf \
    -o fitted.yaml --png fit.png "$@"
