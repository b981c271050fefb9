# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Colours and style of the figures of doc/paper.md, and how they are saved."""

from io import BytesIO

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from benchmark import ROOT
from timo_sim.model import FORMULATIONS

FIGURES = ROOT / 'doc' / 'paper'
MODES = 5
NAMES = {'0': '0', 'l4': 'l/4', 'l2': 'l/2', '3l4': '3l/4', 'l': 'l'}
# Okabe and Ito's colours, which colour-blind readers tell apart.
BLACK, ORANGE, BLUE, GREEN, RED = '#000000', '#E69F00', '#0072B2', '#009E73', '#D55E00'
COLOURS = dict(zip(FORMULATIONS, (BLUE, ORANGE, GREEN, RED)))
matplotlib.use('Agg')
plt.rcParams.update({'font.size': 9, 'axes.grid': True, 'grid.alpha': 0.3,
                     'lines.linewidth': 1.2, 'figure.constrained_layout.use': True,
                     'svg.fonttype': 'none', 'svg.hashsalt': 'timo_sim',
                     'path.simplify_threshold': 1.0})


def same_picture(old, new):
    """Return whether two pictures differ by round-off alone, which shades edges of lines."""
    pixels = [np.asarray(Image.open(each).convert('RGB'), dtype=int) for each in (old, new)]
    return pixels[0].shape == pixels[1].shape and np.abs(np.subtract(*pixels)).max() <= 16


def save(figure, number, text):
    """Save a figure as PNG and SVG unless it is there already; return its Markdown."""
    path, new = FIGURES / f'fig{number}.png', BytesIO()
    figure.savefig(new, dpi=110)
    if not path.exists() or not same_picture(path, new):
        path.write_bytes(new.getvalue())
        figure.savefig(path.with_suffix('.svg'), metadata={'Date': None})
    plt.close(figure)
    return f'![{text}](paper/fig{number}.png)\n\n*{text}* ([SVG](paper/fig{number}.svg))\n'
