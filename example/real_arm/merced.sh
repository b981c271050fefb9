#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'Optimal_SysID/Data/data_vm.mat' --hold-out 0.5 \
    --scene example/real_arm/merced.yaml --mapping example/real_arm/merced_columns.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds arm.young_modulus=2e+10:2e+12 \
    --bounds arm.damping_ratio=0.001:0.1 --bounds motor.rotor.inertia=3.8571e-08:3.8571e-06 --bounds \
    motor.rotor.viscous_friction=3.0612e-07:3.0612e-05 --bounds motor.rotor.coulomb_friction=9.1429e-05:0.0091429 \
    --bounds motor.rotor.coulomb_speed=0.7:70 --bounds motor.gear.stiffness=2.56:256 --bounds \
    motor.gear.damping=0.00512:0.512 --bounds motor.gear.backlash=0.001:0.1 --bounds \
    motor.dc.torque_constant=0.000768:0.0768 --bounds voltage.gain=0.1:10 --bounds root_strain.gain=0.1:10 \
    --set motor.dc.gear_ratio=70 motor.shaft_inertia=0.00021 motor.viscous_friction=0 motor.coulomb_friction=0 \
    motor.coulomb_speed=0 motor.gear.stiffness=25.6 motor.gear.damping=0.0512 motor.gear.backlash=0.01 \
    motor.rotor.inertia=3.85714e-07 motor.rotor.viscous_friction=3.06122e-06 \
    motor.rotor.coulomb_friction=0.000914286 motor.rotor.coulomb_speed=7 \
    --free arm.young_modulus=1.089e+11,arm.damping_ratio=0.0093581,motor.rotor.inertia=3.783e-07 \
    --free motor.rotor.viscous_friction=8.1743e-07,motor.rotor.coulomb_friction=0.00047147 \
    --free motor.rotor.coulomb_speed=6.8512,motor.rotor.coulomb_asymmetry=0.3339,motor.gear.stiffness=32.843 \
    --free motor.gear.damping=0.0051755,motor.gear.backlash=0.001559,motor.dc.torque_constant=0.0067555 \
    --free initial.shaft=0.00034565,voltage.gain=0.85886,voltage.delay=-0.0019421,voltage.lag \
    --free root_strain.gain=1.1256,root_strain.bias=-2.8316e-07,root_strain.delay,root_strain.lag=0.007704 \
    --free initial.modal_coordinates[0]=7.0489e-05,initial.modal_rates[0]=-0.00089584,~inf \
    -o fitted.yaml --png fit.png "$@"
