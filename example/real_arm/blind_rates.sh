#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2K3_6_-3_213' --hold-out-record 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2K3k4_6_-3_213_2' \
    --scene example/real_arm/boulder_213.yaml --mapping example/real_arm/blind_rates_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
