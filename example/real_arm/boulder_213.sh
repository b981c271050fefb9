#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2K3_6_-5_213' --hold-out 0.5 \
    --scene example/real_arm/boulder_213.yaml --mapping example/real_arm/boulder_213_columns.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.28e+12 --bounds arm.damping_ratio=0.001:0.1 --bounds \
    motor.shaft_inertia=0.0002:0.02 --bounds motor.viscous_friction=0.000126:0.0126 --bounds \
    motor.coulomb_friction=0.00126:0.126 --bounds motor.coulomb_speed=0.01:1 --bounds \
    motor.coulomb_presliding=0.002:0.2 --bounds motor.coulomb_static=0.01:1 --bounds \
    motor.dc.torque_constant=0.00107:0.107 --bounds voltage.gain=0.1:10 --bounds root_strain.gain=0.1:10 \
    --set motor.coulomb_static=0.5 motor.coulomb_presliding=0.02 \
    --free arm.young_modulus=1.3995e+11,arm.damping_ratio,motor.shaft_inertia=0.0018799 \
    --free motor.viscous_friction=0.010979,motor.coulomb_friction=0.12503,motor.coulomb_speed=0.031595 \
    --free motor.coulomb_presliding=0.0020168,motor.coulomb_static=0.28858,motor.dc.torque_constant=0.0077143 \
    --free initial.shaft=-0.099488,voltage.gain=0.27779,voltage.delay=0.0078553,voltage.lag=0.01086 \
    --free root_strain.gain=2.8678,root_strain.bias=-2.1931e-06,root_strain.delay,root_strain.lag \
    --free initial.modal_coordinates[0]=0.00026326,initial.modal_rates[0]=-0.00066192,~inf \
    -o fitted.yaml --png fit.png "$@"
