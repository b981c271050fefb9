#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'matlab-scripts/heig-vd/regul/labos/lame-flexible/data/SBPA_lame.mat' --hold-out 0.5 \
    --scene example/real_arm/blind_yverdon.yaml --mapping example/real_arm/blind_yverdon_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
