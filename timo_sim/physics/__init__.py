"""The physics: NumPy, SciPy and numba only; no files, no ROS."""

from timo_sim.physics.exact import Exact
from timo_sim.physics.newton import Newton
from timo_sim.physics.newton_rigid_axial import NewtonRigidAxial
from timo_sim.physics.newton_root_stress import NewtonRootStress

# A further formulation is one module and one line here.
FORMULATIONS = {
    'exact': Exact,
    'newton': Newton,
    'newton_root_stress': NewtonRootStress,
    'newton_rigid_axial': NewtonRigidAxial,
}
