#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'piezo_control/matlab/db/Old/2014-06-23 15h21m58s_table.csv' --hold-out-record 'piezo_control/matlab/db/Old/2014-06-23 15h23m39s_table.csv' \
    --scene example/real_arm/blind_buenos_aires.yaml --mapping example/real_arm/blind_buenos_aires_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
