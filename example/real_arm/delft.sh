#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'flexible-beam-control/ResonanceDataChirp20_clock.csv' --hold-out-record 'flexible-beam-control/ResonanceDataChirp45_clock.csv' \
    --scene example/real_arm/delft.yaml --mapping example/real_arm/delft_chirp20.yaml --mapping example/real_arm/delft_chirp45.yaml \
    --bounds tip_x.delay=-0.002:0.2 --bounds arm.young_modulus=7e+09:7.8354e+10:7e+11 --bounds \
    arm.damping_ratio=0.001:0.0058359:0.1 --bounds carrier.viscous_friction=12.5:692.16:1250 --bounds \
    carrier.coulomb_friction=0.03:1.1102:3 --bounds carrier.coulomb_speed=0.001:0.053506:0.1 --bounds \
    carrier.coulomb_presliding=0.0002:0.0029247:0.02 --bounds carrier.coulomb_static=0.01:0.011316:1 --bounds \
    force_x.gain=0.1:8.5533:10 --bounds tip_x.gain=0.1:0.99321:10 --bounds gravity[0]=:-0.12219: --bounds \
    tip_x.lag=:0.0058543: --bounds initial.modal_coordinates[0]=:0.00019659: --bounds \
    initial.modal_rates[0]=:0.013235: \
    --set carrier.coulomb_static=0.5 carrier.coulomb_presliding=0.002 \
    --free arm.young_modulus,arm.damping_ratio,carrier.viscous_friction,carrier.coulomb_friction \
    --free carrier.coulomb_speed,carrier.coulomb_presliding,carrier.coulomb_static,force_x.gain,force_x.lag \
    --free gravity[0],tip_x.gain,tip_x.delay,tip_x.lag,initial.modal_coordinates[0],initial.modal_rates[0] \
    -o fitted.yaml --png fit.png "$@"
