#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2K3_6_-5_213' --hold-out 0.5 \
    --scene example/real_arm/boulder_213.yaml --mapping example/real_arm/boulder_213_columns.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.28e+12 --bounds arm.damping_ratio=0.001:0.1 --bounds \
    motor.rotor.inertia=7.6839e-08:7.6839e-06 --bounds motor.rotor.viscous_friction=5.3787e-08:5.3787e-06 --bounds \
    motor.rotor.coulomb_friction=2.6033e-05:0.0026033 --bounds motor.rotor.coulomb_speed=0.484:48.4 --bounds \
    motor.rotor.coulomb_presliding=0.0968:9.68 --bounds motor.rotor.coulomb_static=0.01:1 --bounds \
    motor.gear.stiffness=0.504:50.4 --bounds motor.gear.damping=0.001008:0.1008 --bounds \
    motor.gear.backlash=0.001:0.1 --bounds motor.dc.torque_constant=0.00107:0.107 --bounds voltage.gain=0.1:10 \
    --bounds root_strain.gain=0.1:10 \
    --set motor.dc.gear_ratio=48.4 motor.shaft_inertia=0.0002 motor.viscous_friction=0 motor.coulomb_friction=0 \
    motor.coulomb_speed=0 motor.gear.stiffness=5.04 motor.gear.damping=0.01008 motor.gear.backlash=0.01 \
    motor.rotor.inertia=7.6839e-07 motor.rotor.viscous_friction=5.37873e-07 motor.rotor.coulomb_friction=0.000260331 \
    motor.rotor.coulomb_speed=4.84 motor.rotor.coulomb_static=0.5 motor.rotor.coulomb_presliding=0.968 \
    --free arm.young_modulus=2.2474e+10,arm.damping_ratio=0.001012,motor.rotor.inertia=9.718e-07 \
    --free motor.rotor.viscous_friction=5.3893e-08,motor.rotor.coulomb_friction,motor.rotor.coulomb_speed \
    --free motor.rotor.coulomb_presliding,motor.rotor.coulomb_static,motor.gear.stiffness=4.6521 \
    --free motor.gear.damping=0.027778,motor.gear.backlash,motor.dc.torque_constant=0.0010713 \
    --free initial.shaft=-0.099546,voltage.gain=0.5236,voltage.delay=0.19685,voltage.lag=0.44242 \
    --free root_strain.gain=0.80908,root_strain.bias=2.2764e-06,root_strain.delay,root_strain.lag \
    --free initial.modal_coordinates[0]=-0.0011861,initial.modal_rates[0]=0.0010514,~inf \
    -o fitted.yaml --png fit.png "$@"
