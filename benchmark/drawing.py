# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The rule of the pictures of doc/, which `save` checks: readable as wide as a page shows them.

Axes have at most MOST curves with names, at their ends or in a legend. What was measured, or is
the truth, what is predicted, and their difference have the same colours everywhere.
"""

from io import BytesIO

from matplotlib.figure import Figure
from matplotlib.text import Text
import numpy as np
from PIL import Image

from benchmark import ROOT
from timo_sim.view.plot import COLOURS, DIFFERENCE, MEASURED, PREDICTED  # noqa: F401

BLUE, RED, GREEN, PINK, ORANGE, SKY = COLOURS
BLACK, GREY = '#000000', '#808080'
PAGE, DPI = 840, 100  # width of a page [px], and what pictures are drawn with
SMALLEST, MOST = 9.0, 6  # size of letters on the page [px], curves of axes with names
_SHADES = 128  # colours of a file
_APART = 1.3  # distance of names, in sizes of their letters


def sheet(rows=1, columns=1, height=4.0, **more):
    """Return a figure as wide as a page, of a height [inch], and its axes, as `subplots` does."""
    figure = Figure(figsize=(PAGE / DPI, height), layout='constrained')
    return figure, figure.subplots(rows, columns, **more)


def name_ends(*panels, first=False):
    """
    Write the names of the curves of axes beside their last points, or first ones, and apart.

    The limits of the axes must be set. A curve without a label has no name.
    """
    panels[0].figure.draw_without_rendering()  # places the axes
    for axes in panels:
        curves = [line for line in axes.lines if line.get_label()[0] != '_' and len(
            line.get_xdata())]
        places = [line.get_xydata()[0 if first else -1] for line in curves]
        heights = axes.transAxes.inverted().transform(
            axes.transData.transform(places))[:, 1].clip(0.0, 1.0)
        order = np.argsort(heights, kind='stable')
        lines = np.array([1 + curves[k].get_label().count('\n') for k in order])
        steps = np.cumsum(0.5 * (lines + np.roll(lines, 1)))
        steps *= _APART * 10.0 * axes.figure.dpi / 72.0 / axes.bbox.height
        steps -= steps[0]
        # Pushed up or down, or between the two, heights keep their order and distance.
        wanted = heights[order] - steps
        moved = 0.5 * (np.maximum.accumulate(wanted) + np.minimum.accumulate(wanted[::-1])[::-1])
        for number, height in zip(order, steps + moved.clip(0.0, max(1.0 - steps[-1], 0.0))):
            colour = curves[number].get_color()
            axes.annotate(curves[number].get_label(), places[number], (
                -0.02 if first else 1.02, height), textcoords='axes fraction', color=colour,
                ha='right' if first else 'left', va='center', fontsize=10.0, arrowprops={
                    'arrowstyle': '-', 'color': colour, 'lw': 0.7, 'alpha': 0.7, 'shrinkA': 1,
                    'shrinkB': 2, 'relpos': (1.0 if first else 0.0, 0.5)})


def save(figure, name):
    """
    Write doc/`name`.png, as wide as a page at most, unless it is there but for round-off.

    Returns whether it was written. A picture that breaks the rule is a ValueError.
    """
    _check(figure, name)
    content = BytesIO()
    figure.savefig(content, dpi=DPI)
    return quantised(Image.open(content).convert('RGB'), name)


def quantised(picture, name):
    """Write a picture, (h, w, 3) of bytes, with few colours, see `save`."""
    path = ROOT / 'doc' / f'{name}.png'
    new = Image.fromarray(np.asarray(picture)).quantize(_SHADES, dither=Image.Dither.NONE)
    if path.exists():
        old, now = (np.asarray(each.convert('RGB'), dtype=int) for each in (Image.open(path), new))
        # Round-off shades the edges of lines.
        if old.shape == now.shape and np.abs(old - now).max() <= 24:
            return False
    new.save(path, optimize=True)
    return True


def _check(figure, name):
    figure.set_dpi(DPI)
    figure.draw_without_rendering()
    (left, bottom), (right, top) = figure.get_tightbbox().get_points()  # [inch]
    width, height = figure.get_size_inches()
    if min(left, bottom, width - right, height - top) < -0.01:
        raise ValueError(f'{name}: something is outside of the picture')
    scale = min(1.0, PAGE / figure.bbox.width) * DPI / 72.0
    for text in figure.findobj(Text):
        if not text.get_visible() or not text.get_text().strip():
            continue
        if text.get_fontsize() * scale < SMALLEST:
            raise ValueError(f'{name}: {text.get_text()!r} is smaller than {SMALLEST:g} px')
    for axes in figure.axes:
        named = [line for line in axes.lines if line.get_label()[0] != '_']
        if len(named) > MOST:
            raise ValueError(f'{name}: {len(named)} curves in one of its axes, above {MOST}')
