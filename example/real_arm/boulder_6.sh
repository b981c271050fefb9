#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/4PM_Group37_FlexArm_Unit6' --hold-out 0.5 \
    --scene example/real_arm/boulder.yaml --mapping example/real_arm/boulder_6.yaml \
    --bounds voltage.delay=-0.002:0.030882:0.2 --bounds root_strain.delay=-0.002:0.02191:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.1615e+11:1.28e+12 --bounds arm.damping_ratio=0.001:0.037954:0.1 --bounds \
    motor.shaft_inertia=0.0002:0.0014865:0.02 --bounds motor.viscous_friction=0.00046:0.00046115:0.046 --bounds \
    motor.coulomb_friction=0.0046:0.30859:0.46 --bounds motor.coulomb_speed=0.01:0.24907:1 --bounds \
    motor.coulomb_presliding=0.002:0.2 --bounds motor.coulomb_static=0.01:0.033503:1 --bounds \
    motor.dc.torque_constant=0.00107:0.0022457:0.107 --bounds voltage.gain=0.1:6.2339:10 --bounds \
    root_strain.gain=0.1:0.73874:10 --bounds initial.shaft=:0.39362: --bounds voltage.lag=:0.011061: --bounds \
    root_strain.bias=:-6.373e-06: --bounds root_strain.lag=:0.032347: --bounds \
    initial.modal_coordinates[0]=:0.0033644: --bounds initial.modal_rates[0]=:-0.003978: \
    --set motor.coulomb_static=0.5 motor.coulomb_presliding=0.02 \
    --free arm.young_modulus,arm.damping_ratio,motor.shaft_inertia,motor.viscous_friction,motor.coulomb_friction \
    --free motor.coulomb_speed,motor.coulomb_presliding,motor.coulomb_static,motor.dc.torque_constant,initial.shaft \
    --free voltage.gain,voltage.delay,voltage.lag,root_strain.gain,root_strain.bias,root_strain.delay \
    --free root_strain.lag,initial.modal_coordinates[0],initial.modal_rates[0] \
    -o fitted.yaml --png fit.png "$@"
