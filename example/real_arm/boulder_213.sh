#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2K3_6_-5_213' --hold-out 0.5 \
    --scene example/real_arm/boulder_213.yaml --mapping example/real_arm/boulder_213_columns.yaml \
    --bounds voltage.delay=-0.002:0.0055975:0.2 --bounds root_strain.delay=-0.002:0.021153:0.2 --bounds \
    arm.young_modulus=1.28e+10:2.2154e+11:1.28e+12 --bounds arm.damping_ratio=0.001:0.0024168:0.1 --bounds \
    motor.rotor.inertia=7.6839e-08:7.9577e-07:7.6839e-06 --bounds \
    motor.rotor.viscous_friction=5.3787e-08:2.8402e-07:5.3787e-06 --bounds \
    motor.rotor.coulomb_friction=2.6033e-05:0.000784:0.0026033 --bounds motor.rotor.coulomb_speed=0.484:16.732:48.4 \
    --bounds motor.rotor.coulomb_presliding=0.0968:0.13873:9.68 --bounds motor.rotor.coulomb_rest=0.01:0.79768:1 \
    --bounds motor.gear.stiffness=0.504:22.212:50.4 --bounds motor.gear.damping=0.001008:0.0050142:0.1008 --bounds \
    motor.gear.backlash=0.001:0.0010015:0.1 --bounds motor.dc.torque_constant=0.00107:0.0028564:0.107 --bounds \
    voltage.gain=0.1:2.6087:10 --bounds root_strain.gain=0.1:2.9841:10 --bounds initial.shaft=:-0.099278: --bounds \
    voltage.lag=:0.09959: --bounds root_strain.bias=:2.1968e-06: --bounds root_strain.lag=:0.093456: --bounds \
    initial.modal_coordinates[0]=:-0.00019973: --bounds initial.modal_rates[0]=:0.0065: \
    --set motor.dc.gear_ratio=48.4 motor.shaft_inertia=0.0002 motor.viscous_friction=0 motor.coulomb_friction=0 \
    motor.coulomb_speed=0 motor.gear.stiffness=5.04 motor.gear.damping=0.01008 motor.gear.backlash=0.01 \
    motor.rotor.inertia=7.6839e-07 motor.rotor.viscous_friction=5.37873e-07 motor.rotor.coulomb_friction=0.000260331 \
    motor.rotor.coulomb_speed=4.84 motor.rotor.coulomb_rest=0.5 motor.rotor.coulomb_presliding=0.968 \
    --free arm.young_modulus,arm.damping_ratio,motor.rotor.inertia,motor.rotor.viscous_friction \
    --free motor.rotor.coulomb_friction,motor.rotor.coulomb_speed,motor.rotor.coulomb_presliding \
    --free motor.rotor.coulomb_rest,motor.gear.stiffness,motor.gear.damping,motor.gear.backlash \
    --free motor.dc.torque_constant,initial.shaft,voltage.gain,voltage.delay,voltage.lag,root_strain.gain \
    --free root_strain.bias,root_strain.delay,root_strain.lag,initial.modal_coordinates[0],initial.modal_rates[0] \
    -o fitted.yaml --png fit.png "$@"
