#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'computer-control/model_identification/code/responses_files/scope_data_PRBS.mat' --hold-out 0.5 \
    --scene example/real_arm/lisbon.yaml --mapping example/real_arm/lisbon_2017.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds arm.young_modulus=2e+10:2e+12 \
    --bounds arm.damping_ratio=0.001:0.1 --bounds motor.rotor.inertia=3.8571e-08:3.8571e-06 --bounds \
    motor.rotor.viscous_friction=3.0612e-07:3.0612e-05 --bounds motor.rotor.coulomb_friction=1.4714e-05:0.0014714 \
    --bounds motor.rotor.coulomb_speed=0.7:70 --bounds motor.rotor.coulomb_presliding=0.14:14 --bounds \
    motor.rotor.coulomb_static=0.01:1 --bounds motor.gear.stiffness=0.412:41.2 --bounds \
    motor.gear.damping=0.000824:0.0824 --bounds motor.gear.backlash=0.001:0.1 --bounds \
    motor.dc.torque_constant=0.000768:0.0768 --bounds voltage.gain=0.1:10 --bounds root_strain.gain=0.1:10 \
    --set motor.dc.gear_ratio=70 motor.shaft_inertia=0.00021 motor.viscous_friction=0 motor.coulomb_friction=0 \
    motor.coulomb_speed=0 motor.gear.stiffness=4.12 motor.gear.damping=0.00824 motor.gear.backlash=0.01 \
    motor.rotor.inertia=3.85714e-07 motor.rotor.viscous_friction=3.06122e-06 \
    motor.rotor.coulomb_friction=0.000147143 motor.rotor.coulomb_speed=7 motor.rotor.coulomb_static=0.5 \
    motor.rotor.coulomb_presliding=1.4 \
    --free arm.young_modulus=1.2022e+11,arm.damping_ratio=0.014047,motor.rotor.inertia=5.1024e-07 \
    --free motor.rotor.viscous_friction=1.4832e-06,motor.rotor.coulomb_friction=0.0013644 \
    --free motor.rotor.coulomb_speed=0.70261,motor.rotor.coulomb_asymmetry=-0.0085423,motor.rotor.coulomb_presliding \
    --free motor.rotor.coulomb_static=0.8677,motor.gear.stiffness=15.118,motor.gear.damping=0.012833 \
    --free motor.gear.backlash=0.0014308,motor.dc.torque_constant=0.0069949,initial.shaft=-0.025166 \
    --free voltage.gain=1.2352,voltage.delay,voltage.lag,root_strain.gain=1.1183,root_strain.bias=-3.1058e-06 \
    --free root_strain.delay,root_strain.lag=0.0093285,initial.modal_coordinates[0]=-0.00054406 \
    --free initial.modal_rates[0]=-0.0020041,~inf \
    -o fitted.yaml --png fit.png "$@"
