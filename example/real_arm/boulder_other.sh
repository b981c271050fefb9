#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'Control-Systems-Rotary-Control/flexibleArm_test_3' --hold-out-record 'Control-Systems-Rotary-Control/flexibleArm_test_4' \
    --scene example/real_arm/boulder.yaml --mapping example/real_arm/boulder_other.yaml \
    --bounds voltage.delay=-0.002:0.074106:0.2 --bounds root_strain.delay=-0.002:-0.0019867:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.1687e+11:1.28e+12 --bounds arm.damping_ratio=0.001:0.091291:0.1 --bounds \
    motor.rotor.inertia=7.6839e-08:1.2394e-07:7.6839e-06 --bounds \
    motor.rotor.viscous_friction=1.9637e-07:1.9999e-07:1.9637e-05 --bounds \
    motor.rotor.coulomb_friction=9.5041e-05:0.0037404:0.0095041 --bounds motor.rotor.coulomb_speed=0.484:6.1935:48.4 \
    --bounds motor.gear.stiffness=1.84:4.1832:184 --bounds motor.gear.damping=0.00368:0.021706:0.368 --bounds \
    motor.gear.backlash=0.001:0.0070366:0.1 --bounds motor.dc.torque_constant=0.00107:0.003431:0.107 --bounds \
    voltage.gain=0.1:2.8171:10 --bounds root_strain.gain=0.1:0.97759:10 --bounds initial.shaft=:0.38546: --bounds \
    voltage.lag=:2.7239e-05: --bounds root_strain.lag=:0.038356: --bounds initial.modal_coordinates[0]=:0.00035981: \
    --bounds initial.modal_rates[0]=:0.011038: \
    --set motor.dc.gear_ratio=48.4 motor.shaft_inertia=0.0002 motor.viscous_friction=0 motor.coulomb_friction=0 \
    motor.coulomb_speed=0 motor.gear.stiffness=18.4 motor.gear.damping=0.0368 motor.gear.backlash=0.01 \
    motor.rotor.inertia=7.6839e-07 motor.rotor.viscous_friction=1.96366e-06 motor.rotor.coulomb_friction=0.000950413 \
    motor.rotor.coulomb_speed=4.84 \
    --free arm.young_modulus,arm.damping_ratio,motor.rotor.inertia,motor.rotor.viscous_friction \
    --free motor.rotor.coulomb_friction,motor.rotor.coulomb_speed,motor.rotor.coulomb_asymmetry,motor.gear.stiffness \
    --free motor.gear.damping,motor.gear.backlash,motor.dc.torque_constant,initial.shaft,voltage.gain,voltage.delay \
    --free voltage.lag,root_strain.gain,root_strain.delay,root_strain.lag,initial.modal_coordinates[0] \
    --free initial.modal_rates[0] \
    -o fitted.yaml --png fit.png "$@"
