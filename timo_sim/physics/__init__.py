"""The physics: NumPy, SciPy and numba only; no files, no ROS."""

from timo_sim.physics.exact import Exact
from timo_sim.physics.newton import Newton

# A further formulation is one module and one line here.
FORMULATIONS = {
    'exact': Exact,
    'newton': Newton,
}
