#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'Control-Systems-Rotary-Control/flexibleArm_test_2' --hold-out 0.5 \
    --scene example/real_arm/boulder.yaml --mapping example/real_arm/blind_boulder_other_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
