#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'Control-Systems-Rotary-Control/flexibleArm_test_3' --hold-out-record 'Control-Systems-Rotary-Control/flexibleArm_test_4' \
    --scene example/real_arm/boulder.yaml --mapping example/real_arm/boulder_other.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.28e+12 --bounds arm.damping_ratio=0.001:0.1 --bounds \
    motor.rotor.inertia=7.6839e-08:7.6839e-06 --bounds motor.rotor.viscous_friction=1.9637e-07:1.9637e-05 --bounds \
    motor.rotor.coulomb_friction=9.5041e-05:0.0095041 --bounds motor.rotor.coulomb_speed=0.484:48.4 --bounds \
    motor.gear.stiffness=1.84:184 --bounds motor.gear.damping=0.00368:0.368 --bounds motor.gear.backlash=0.001:0.1 \
    --bounds motor.dc.torque_constant=0.00107:0.107 --bounds voltage.gain=0.1:10 --bounds root_strain.gain=0.1:10 \
    --set motor.dc.gear_ratio=48.4 motor.shaft_inertia=0.0002 motor.viscous_friction=0 motor.coulomb_friction=0 \
    motor.coulomb_speed=0 motor.gear.stiffness=18.4 motor.gear.damping=0.0368 motor.gear.backlash=0.01 \
    motor.rotor.inertia=7.6839e-07 motor.rotor.viscous_friction=1.96366e-06 motor.rotor.coulomb_friction=0.000950413 \
    motor.rotor.coulomb_speed=4.84 \
    --free arm.young_modulus=1.1687e+11,arm.damping_ratio=0.091291,motor.rotor.inertia=1.2394e-07 \
    --free motor.rotor.viscous_friction=1.9999e-07,motor.rotor.coulomb_friction=0.0037404 \
    --free motor.rotor.coulomb_speed=6.1935,motor.rotor.coulomb_asymmetry,motor.gear.stiffness=4.1832 \
    --free motor.gear.damping=0.021706,motor.gear.backlash=0.0070366,motor.dc.torque_constant=0.003431 \
    --free initial.shaft=0.38546,voltage.gain=2.8171,voltage.delay=0.074106,voltage.lag=2.7239e-05 \
    --free root_strain.gain=0.97759,root_strain.delay=-0.0019867,root_strain.lag=0.038356 \
    --free initial.modal_coordinates[0]=0.00035981,initial.modal_rates[0]=0.011038,~inf \
    -o fitted.yaml --png fit.png "$@"
