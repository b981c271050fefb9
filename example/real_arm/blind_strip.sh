#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ben_fea_vs_exp/swept_sine_kp_1_amp_50.txt' --hold-out-record 'ben_fea_vs_exp/OL_pulse_test_sys_check_SLFR_RTP_OL_Test_uend=0.txt' \
    --scene example/real_arm/blind_strip.yaml --mapping example/real_arm/blind_strip_columns.yaml \
    --auto --quick --time 180 -o fitted.yaml --png fit.png "$@"
