#!/bin/sh
# The fit of doc/real_arm.md, in the folder of the records, with a link to example/ in it.
timo_sim fit 'ASEN2003/Lab 6: Rotary Arm/4PM_Group37_FlexArm_Unit6' --hold-out 0.5 \
    --scene example/real_arm/boulder.yaml --mapping example/real_arm/boulder_6.yaml \
    --bounds voltage.delay=-0.002:0.2 --bounds root_strain.delay=-0.002:0.2 --bounds \
    arm.young_modulus=1.28e+10:1.28e+12 --bounds arm.damping_ratio=0.001:0.1 --bounds \
    motor.shaft_inertia=0.0002:0.02 --bounds motor.viscous_friction=0.00046:0.046 --bounds \
    motor.coulomb_friction=0.0046:0.46 --bounds motor.coulomb_speed=0.01:1 --bounds \
    motor.coulomb_presliding=0.002:0.2 --bounds motor.coulomb_static=0.01:1 --bounds \
    motor.dc.torque_constant=0.00107:0.107 --bounds voltage.gain=0.1:10 --bounds root_strain.gain=0.1:10 \
    --set motor.coulomb_static=0.5 motor.coulomb_presliding=0.02 \
    --free arm.young_modulus=1.1615e+11,arm.damping_ratio=0.037954,motor.shaft_inertia=0.0014865 \
    --free motor.viscous_friction=0.00046115,motor.coulomb_friction=0.30859,motor.coulomb_speed=0.24907 \
    --free motor.coulomb_presliding,motor.coulomb_static=0.033503,motor.dc.torque_constant=0.0022457 \
    --free initial.shaft=0.39362,voltage.gain=6.2339,voltage.delay=0.030882,voltage.lag=0.011061 \
    --free root_strain.gain=0.73874,root_strain.bias=-6.373e-06,root_strain.delay=0.02191,root_strain.lag=0.032347 \
    --free initial.modal_coordinates[0]=0.0033644,initial.modal_rates[0]=-0.003978,~inf \
    -o fitted.yaml --png fit.png "$@"
