#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'CC/lab2_pbrs3.mat' --hold-out-record 'CC/lab2_pbrs2.mat' \
    --scene example/real_arm/blind_lisbon.yaml --mapping example/real_arm/blind_lisbon_2018_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
