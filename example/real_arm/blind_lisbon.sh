#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'FlexibleArmControl/LabData/Lab3Data/3_lab_a12_f04_square.mat' --hold-out 0.5 \
    --scene example/real_arm/lisbon.yaml --mapping example/real_arm/blind_lisbon_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
