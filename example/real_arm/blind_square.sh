#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'CC-Lab/cc_lab2/3a_sim_square_fa_150Hz/workspace.mat' --hold-out 0.5 \
    --scene example/real_arm/blind_lisbon.yaml --mapping example/real_arm/blind_lisbon_2016_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
