#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'flexible-beam-control/StepDampingData.csv' --hold-out 0.5 \
    --scene example/real_arm/delft.yaml --mapping example/real_arm/blind_delft_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
