#!/bin/sh
# The record of Merced (doc/real_arm.md says what to clone) without a choice by hand, in the folder of
# the data with a link to the examples in it: sh example/real_arm/merced_auto.sh
timo_sim fit Optimal_SysID/Data/data_vm.mat --scene example/real_arm/merced.yaml \
    --mapping example/real_arm/merced_columns.yaml --hold-out 0.5 --auto --time 900 --quick \
    -o merced_auto.yaml --png merced_auto.png
