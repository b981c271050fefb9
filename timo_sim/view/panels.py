# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Layout of the viewer: the plane beside the curves that a control engineer looks at first."""

from dataclasses import dataclass
import math

import rerun.blueprint as rrb

from timo_sim.view.entities import ABOUT, CURVES, PLANE, TIMELINE

# In the order in which they are shown.
TITLES = {
    'tip_deflection': 'tip deflection w [m]',
    'tip_rotation': 'tip rotation phi [rad]',
    'difference': 'difference of w [m]',
    'carrier': 'carrier [m]',
    'shaft': 'shaft theta [rad]',
    'force': 'force on carrier [N]',
    'torque': 'torque on shaft [N m]',
    'modal': 'modes q [m sqrt(kg)]',
    'energy': 'energy [J]',
    'balance': 'energy - work + losses [J]',
    'shaft_speed': 'shaft speed [rad/s]',
    'carrier_velocity': 'carrier velocity [m/s]',
    'tip_axial': 'tip deflection u, along [m]',
    'shaft_difference': 'difference of shaft [rad]',
    'carrier_difference': 'difference of carrier [m]',
}
_ON_FIRST_PAGE = 10
# Panels with a legend when there are several runs.
_WITH_LEGEND = 'tip_deflection', 'difference'


@dataclass
class Panel:
    """What a panel shows: number of curves, lowest and highest value, least limit of its axis."""

    curves: int = 0
    low: float = math.inf
    high: float = -math.inf
    least: float = 0.0

    def see(self, values):
        """Take note of values that are shown."""
        self.low = min(self.low, float(values.min()))
        self.high = max(self.high, float(values.max()))

    def title(self, key):
        """Return quantity, unit, and its lowest and highest value."""
        if self.low > self.high:
            return TITLES[key]
        # Round-off beside larger values is shown as 0.
        nothing = 1e-12 * max(abs(self.low), abs(self.high))
        low, high = (0.0 if abs(end) < nothing else end for end in (self.low, self.high))
        return f'{TITLES[key]}: {low:.3g} to {high:.3g}'

    def axis(self):
        """Return the vertical axis, -`least` to `least`; None if values exceed it: rerun fits."""
        small = max(self.high, -self.low) < self.least
        return rrb.ScalarAxis(range=(-self.least, self.least)) if small else None


def blueprint(panels, bounds, runs=1, live=False):
    """
    Return the layout of panels (by key of TITLES) and of the plane between two corners (2, 2) [m].

    With several runs only some panels have a legend. Of a live run the last ten seconds are shown.
    """
    ranges = rrb.VisibleTimeRange(
        TIMELINE, start=rrb.TimeRangeBoundary.cursor_relative(seconds=-10.0),
        end=rrb.TimeRangeBoundary.cursor_relative()) if live else None

    views = [rrb.TimeSeriesView(
        origin=f'{CURVES}/{key}', name=panels[key].title(key), time_ranges=ranges,
        axis_y=panels[key].axis(), plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=(
            key in _WITH_LEGEND if runs > 1 else panels[key].curves > 1)))
        for key in TITLES if key in panels]
    (left, bottom), (right, top) = bounds
    plane = rrb.Spatial2DView(
        origin='/', contents=f'{PLANE}/**', name='plane of motion, x right, y up [m]',
        visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(-top, -bottom)))
    pages = [rrb.Grid(*views[:_ON_FIRST_PAGE], grid_columns=2, name='motion')]
    if len(views) > _ON_FIRST_PAGE:
        pages.append(rrb.Grid(*views[_ON_FIRST_PAGE:], grid_columns=2, name='more'))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(plane, rrb.TextDocumentView(origin=ABOUT, name='about'),
                         row_shares=[4, 1]),
            rrb.Tabs(*pages, active_tab=0), column_shares=[1, 1]),
        rrb.TimePanel(timeline=TIMELINE, expanded=False,
                      play_state='following' if live else 'paused'),
        rrb.BlueprintPanel(expanded=False), rrb.SelectionPanel(expanded=False))
