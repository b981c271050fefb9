# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Changes of the load at the tip in a log: by its scene, and by parameters that were set."""


def payloads_of(recording):
    """Return the changes by step, mass [kg] and inertia [kg m2], as `Scene.payloads` does."""
    scene, changes = recording.scene, [(step, values) for step, _, values in recording.changes]
    starts, found = [0, *recording.resets.tolist()], []
    own = now = (scene.values['end_effector.mass'], scene.values['end_effector.inertia'])
    for start, end in zip(starts, [*starts[1:], float('inf')]):
        # A reset goes back to the mass and inertia that were set last.
        events = [(start, own), *((start + step, tuple(tip)) for step, *tip in scene.payloads)]
        for step, values in changes:
            if start <= step < end:
                before, own = own, tuple(values.get(f'end_effector.{name}', value)
                                         for name, value in zip(('mass', 'inertia'), own))
                # As in a simulator, a value that is set again changes nothing.
                events += [(step, own)] * (own != before)
        for step, tip in sorted(events, key=lambda event: event[0]):
            if step < end and tip != now:
                found.append((step, *tip))
                now = tip
    return tuple(found)
