#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'systemid/example/2009-04-21/swept1-0-10hz.txt' --hold-out-record 'systemid/example/2009-04-21/step1.txt' \
    --scene example/real_arm/blind_ruler.yaml --mapping example/real_arm/blind_ruler_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
