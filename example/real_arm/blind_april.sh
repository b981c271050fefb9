#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/flexarm_k1k2_6_-3' --hold-out 0.5 \
    --scene example/real_arm/boulder_april.yaml --mapping example/real_arm/blind_april_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
