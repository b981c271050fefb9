#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/Unit7_Flex_trial1.csv' --hold-out 0.5 \
    --scene example/real_arm/boulder_7.yaml --mapping example/real_arm/boulder_7_columns.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.28e+12 --bounds arm.damping_ratio=0.001:0.1 --bounds \
    motor.rotor.inertia=7.6839e-08:7.6839e-06 --bounds motor.rotor.viscous_friction=8.6657e-08:8.6657e-06 --bounds \
    motor.rotor.coulomb_friction=4.1942e-05:0.0041942 --bounds motor.rotor.coulomb_speed=0.484:48.4 --bounds \
    motor.gear.stiffness=0.812:81.2 --bounds motor.gear.damping=0.001624:0.1624 --bounds \
    motor.gear.backlash=0.001:0.1 --bounds motor.dc.torque_constant=0.00107:0.107 --bounds voltage.gain=0.1:10 \
    --bounds root_strain.gain=0.1:10 \
    --set motor.dc.gear_ratio=48.4 motor.shaft_inertia=0.0002 motor.viscous_friction=0 motor.coulomb_friction=0 \
    motor.coulomb_speed=0 motor.gear.stiffness=8.12 motor.gear.damping=0.01624 motor.gear.backlash=0.01 \
    motor.rotor.inertia=7.6839e-07 motor.rotor.viscous_friction=8.66573e-07 motor.rotor.coulomb_friction=0.000419421 \
    motor.rotor.coulomb_speed=4.84 \
    --free arm.young_modulus=1.0333e+11,arm.damping_ratio=0.021271,motor.rotor.inertia=1.946e-06 \
    --free motor.rotor.viscous_friction=5.7576e-07,motor.rotor.coulomb_friction=0.00038634 \
    --free motor.rotor.coulomb_speed=0.50427,motor.gear.stiffness=13.877,motor.gear.damping=0.1621 \
    --free motor.gear.backlash=0.012378,motor.dc.torque_constant=0.013506,initial.shaft=-0.098415 \
    --free voltage.gain=0.80101,voltage.delay=0.031253,voltage.lag=0.0093449,root_strain.gain=1.0035 \
    --free root_strain.bias=-5.6079e-06,root_strain.delay=0.01873,root_strain.lag=0.01887 \
    --free initial.modal_coordinates[0]=0.00030097,initial.modal_rates[0]=0.0031559,~inf \
    -o fitted.yaml --png fit.png "$@"
