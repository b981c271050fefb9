#!/bin/sh
# The record of NAME.sh without a choice by hand: sh example/real_arm/auto.sh NAME
eval "$(sed -n '3,4p' "example/real_arm/$1.sh" | tr -d '\\\n') --auto --quick --time 180 -o $1_auto.yaml"
