#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'AutomationShield/matlab/examples/LinkShield/resultID.mat' --hold-out 0.5 \
    --scene example/real_arm/bratislava.yaml --mapping example/real_arm/bratislava_columns.yaml \
    --bounds arm.young_modulus=2e+10:2e+12 --bounds arm.damping_ratio=0.001:0.1 \
    --free arm.young_modulus,arm.damping_ratio,tip_acceleration.bias,initial.modal_coordinates[0] \
    --free initial.modal_rates[0],~inf \
    -o fitted.yaml --png fit.png "$@"
