#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'AutomationShield_R2/matlab/examples/LinkShield/LinkShield_ID_Data.mat' --hold-out 0.5 \
    --scene example/real_arm/blind_servo.yaml --mapping example/real_arm/blind_servo_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
