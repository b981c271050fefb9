#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'quanser-2-dof-serial-flexible-link/software/quanser_updated/Results/data_psf_Im1.mat' --hold-out 0.5 \
    --scene example/real_arm/prague.yaml --mapping example/real_arm/blind_partial_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
