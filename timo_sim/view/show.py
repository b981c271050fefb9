# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Tracks shown in rerun, saved for it, or drawn to a picture."""

from pathlib import Path
import tempfile

from tqdm import tqdm

from timo_sim.view.convert import write
from timo_sim.view.viewer import picture, show


def show_tracks(makers, save=None, png=None, at=None, web=False, fps=30.0):
    """
    Convert tracks, and show them unless a file or picture is wanted.

    Parameters
    ----------
    makers : list of function() -> Track
    save, png : str, optional
        Files to write.
    at : float, optional
        Sim time of the picture [s]; by default the end.
    web : bool
        Whether to show it in the browser.
    fps : float
        See `write`.

    """
    with tempfile.TemporaryDirectory(prefix='timo_sim_') as folder:
        path = Path(save or Path(folder, 'run.rrd'))
        with tqdm(total=1000, desc='converting', bar_format='{l_bar}{bar}', delay=1.0,
                  disable=None, leave=False) as bar:
            tracks = []
            for maker in makers:
                tracks.append(maker())
                bar.update(500 // len(makers))
            write(tracks, path, fps, lambda done: bar.update(round(500 * done)), at)
        if png:
            picture(path, png, at)
        if web or not (save or png):
            show(path, web)
