#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'FlexibleArmControl/LabData/Lab3Data/3_lab_a00_f00_repeating.mat' --hold-out 0.5 \
    --scene example/real_arm/lisbon.yaml --mapping example/real_arm/lisbon_columns.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds arm.young_modulus=2e+10:2e+12 \
    --bounds arm.damping_ratio=0.001:0.1 --bounds motor.shaft_inertia=0.00021:0.021 --bounds \
    motor.viscous_friction=0.0015:0.15 --bounds motor.coulomb_friction=0.00103:0.103 --bounds \
    motor.coulomb_speed=0.01:1 --bounds motor.coulomb_presliding=0.002:0.2 --bounds motor.coulomb_static=0.01:1 \
    --bounds motor.dc.torque_constant=0.000768:0.0768 --bounds voltage.gain=0.1:10 --bounds root_strain.gain=0.1:10 \
    --set motor.coulomb_static=0.5 motor.coulomb_presliding=0.02 \
    --free arm.young_modulus=4.552e+11,arm.damping_ratio,motor.shaft_inertia=0.00028763 \
    --free motor.viscous_friction=0.0070951,motor.coulomb_friction,motor.coulomb_speed=0.68018 \
    --free motor.coulomb_asymmetry=0.41582,motor.coulomb_presliding,motor.coulomb_static \
    --free motor.dc.torque_constant=0.010492,initial.shaft=-0.22303,voltage.gain=2.6167,voltage.delay=-0.0019696 \
    --free voltage.lag=0.0030924,root_strain.gain=1.1595,root_strain.bias=4.9707e-05,root_strain.delay=0.0017385 \
    --free root_strain.lag=0.0055046,initial.modal_coordinates[0]=-7.3965e-05,initial.modal_rates[0]=0.034131,~inf \
    -o fitted.yaml --png fit.png "$@"
