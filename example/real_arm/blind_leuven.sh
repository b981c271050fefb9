#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'QNN/data/robot_arm.dat' --hold-out 0.5 \
    --scene example/real_arm/blind_leuven.yaml --mapping example/real_arm/blind_leuven_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
