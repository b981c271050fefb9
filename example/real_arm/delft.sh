#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'flexible-beam-control/ResonanceDataChirp20_clock.csv' --hold-out-record 'flexible-beam-control/ResonanceDataChirp45_clock.csv' \
    --scene example/real_arm/delft.yaml --mapping example/real_arm/delft_chirp20.yaml --mapping example/real_arm/delft_chirp45.yaml \
    --bounds tip_x.delay=-0.002:0.2 --bounds arm.young_modulus=7e+09:7e+11 --bounds arm.damping_ratio=0.001:0.1 \
    --bounds carrier.viscous_friction=12.5:1250 --bounds carrier.coulomb_friction=0.03:3 --bounds \
    carrier.coulomb_speed=0.001:0.1 --bounds carrier.coulomb_presliding=0.0002:0.02 --bounds \
    carrier.coulomb_static=0.01:1 --bounds force_x.gain=0.1:10 --bounds tip_x.gain=0.1:10 \
    --set carrier.coulomb_static=0.5 carrier.coulomb_presliding=0.002 \
    --free arm.young_modulus=7.8354e+10,arm.damping_ratio=0.0058359,carrier.viscous_friction=692.16 \
    --free carrier.coulomb_friction=1.1102,carrier.coulomb_speed=0.053506,carrier.coulomb_presliding=0.0029247 \
    --free carrier.coulomb_static=0.011316,force_x.gain=8.5533,force_x.lag,gravity[0]=-0.12219,tip_x.gain=0.99321 \
    --free tip_x.delay,tip_x.lag=0.0058543,initial.modal_coordinates[0]=0.00019659,initial.modal_rates[0]=0.013235 \
    --free ~inf \
    -o fitted.yaml --png fit.png "$@"
