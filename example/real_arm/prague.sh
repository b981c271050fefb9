#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'quanser-2-dof-serial-flexible-link/software/quanser_updated/lqr_full_10deg.mat' --hold-out 0.5 \
    --scene example/real_arm/prague.yaml --mapping example/real_arm/prague_columns.yaml \
    --bounds torque.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds \
    arm.young_modulus=2.07e+10:2.07e+12 --bounds arm.damping_ratio=0.001:0.1 --bounds \
    motor.shaft_inertia=0.00635:0.635 --bounds motor.viscous_friction=0.4:40 --bounds \
    motor.coulomb_friction=0.034:3.4 --bounds motor.coulomb_speed=0.01:1 --bounds torque.gain=0.1:10 --bounds \
    root_strain.gain=0.1:10 --bounds end_effector.inertia=0.0056:0.56 --bounds tip_torque.gain=0.1:10 \
    --free arm.young_modulus=1.419e+11,arm.damping_ratio,motor.shaft_inertia,motor.viscous_friction=2.9288 \
    --free motor.coulomb_friction=2.6869,motor.coulomb_speed=0.12397,motor.coulomb_asymmetry,torque.gain=1.2791 \
    --free initial.shaft=-0.47558,torque.delay=0.080843,torque.lag=0.10024,root_strain.gain=0.78184 \
    --free root_strain.bias=-5.8691e-06,root_strain.delay,root_strain.lag=0.0046726 \
    --free initial.modal_coordinates[0]=-0.00010722,initial.modal_rates[0]=0.018322,end_effector.inertia \
    --free tip_torque.gain=2.6874,~inf \
    -o fitted.yaml --png fit.png "$@"
