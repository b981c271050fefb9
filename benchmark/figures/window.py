# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""What `timo_sim view` shows of the paper's run, for doc/view.md; part of `make gallery`."""

from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.image import imread, imsave

from benchmark import ROOT
import timo_sim
from timo_sim.view.rerun import picture, write
from timo_sim.view.track import track_of_run


def draw():
    """Draw the view at 1.81 s, doc/view.png."""
    run = timo_sim.simulate(timo_sim.load_scene(ROOT / 'config/paper.yaml'), 10.0)
    with TemporaryDirectory() as folder:
        write([track_of_run(run, 'paper')], Path(folder, 'run.rrd'), at=1.81)
        picture(Path(folder, 'run.rrd'), Path(folder, 'view.png'), 1.81, (1500, 940))
        # Without the viewer's menu, which says things about the machine.
        imsave(ROOT / 'doc' / 'view.png', imread(Path(folder, 'view.png'))[37:])
