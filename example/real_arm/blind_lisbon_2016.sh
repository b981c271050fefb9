#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'CC-Lab/cc_lab2/4a_sim_prbs_fa_150Hz/workspace.mat' --hold-out-record 'CC-Lab/cc_lab2/5a_sim_prbs_b_0.2/workspace.mat' \
    --scene example/real_arm/blind_lisbon.yaml --mapping example/real_arm/blind_lisbon_2016_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
