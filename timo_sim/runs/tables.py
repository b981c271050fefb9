# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A run as tables: columns, data frames, files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from timo_sim.extras import optional
from timo_sim.messages.outputs import outputs, with_angles
from timo_sim.physics.layout import FORCE_X, FORCE_Y, LOADS, TORQUE
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.simulation.snapshot import Snapshot

if TYPE_CHECKING:
    import pandas


class Tables:
    """A part of `Run`, whose attributes it uses."""

    scene: Any
    model: Any
    t: np.ndarray
    motion: Any
    effort: Any
    _pieces: Any

    def columns(self) -> dict[str, np.ndarray]:
        """Return what the node publishes, except sensors, as columns named with units, (n,)."""
        from timo_sim.log.export import named
        snapshots, found = list(self._snapshots()), {'time_s': self.t}
        for output in self._outputs():
            values = np.array([output.numbers(snapshot) for snapshot in snapshots])
            names, values = with_angles(output.columns, values)
            found.update(zip(named(output.name, names), values.T))
        return found

    def to_pandas(self) -> pandas.DataFrame:
        """Return `columns` as a pandas.DataFrame with the time as index."""
        with optional():
            import pandas
        return pandas.DataFrame(self.columns()).set_index('time_s')

    def save(self, path: str | Path) -> Path:
        """
        Write the run to a file.

        Parameters
        ----------
        path : str or Path
            `*.mcap`: a log, as the node writes it, which `timo_sim.open_log` reads; `*.parquet` or
            `*.csv`: a table. Existing logs are never overwritten; `_1`, `_2`, ... is appended. An
            existing table is a LogError.

        Returns
        -------
        Path
            The file that was written.

        """
        from timo_sim.log.export import write_table
        from timo_sim.log.recorder import NewLog
        path = Path(path)
        if path.suffix != '.mcap':
            write_table(self.columns(), path)
            return path
        values = {name: parameter.default for name, parameter in PARAMETERS.items()}
        log = NewLog(path, self.scene, {**values, **self.scene.values}, saved_by='Run.save')
        try:
            for snapshot in self._snapshots():
                for output in self._outputs():
                    log.output(output.name, snapshot, output.numbers(snapshot))
        finally:
            log.close()
        return log.path

    def _outputs(self):
        # Topics that follow from the motion alone; sensors need the simulator.
        return [output for output in outputs(self.scene.modal_count)
                if output.columns and not output.delay]

    def _snapshots(self):
        steps = np.rint(self.t / self.scene.step).astype(int).tolist()
        models = [model for model, part in self._pieces for _ in range(*part.indices(len(steps)))]
        for step, model, motion, effort in zip(steps, models, self.motion, self.effort):
            # Before the first step nothing has acted, but constraints hold.
            shown = effort if step else np.where(self.model.constrained, effort, 0.0)
            load = [0.0] * LOADS
            load[FORCE_X], load[FORCE_Y], load[TORQUE] = shown.tolist()
            yield Snapshot(self.scene, model, step, round(step * self.scene.step * 1e9),
                           motion, load)
