# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Train a small neural network to point the arm to a goal and to stop it there.

    python example/learn.py --plot learn.png

Augmented random search: the weights of the network are changed along random directions, forth and
back; each change is tried by manipulators of a `ReachVectorEnv`, and the weights move towards the
better ones. Source: Mania, Guy and Recht, Advances in Neural Information Processing Systems 31
(2018). Needs the extra `rl`.
"""

from argparse import ArgumentParser

import numpy as np
from timo_sim.gym import ReachVectorEnv

NEURONS = 16                    # of the only layer
SCALE = 0.2, 1.0, 0.01, 0.1     # of the observations
DIRECTIONS, BEST = 32, 16       # tried in a generation, and those of them that count
GOALS = 4                       # episodes for each change
CHANGE, RATE = 0.05, 0.1        # sizes of changes and of moves
UNSEEN, REST = 128, 1.0         # goals of the test; time at the end to be at rest [s]
LENGTH = 2.0                    # of the arm [m]


def network(weights, observations):
    """
    Return actions, (n, 1), for observations, (n, 4), and weights, (n, 5, NEURONS).

    Without biases a mirrored observation gives the opposite action.
    """
    inputs = np.einsum('nik,ni->nk', weights[:, :4], observations / SCALE)
    return np.tanh(np.sum(weights[:, 4] * np.tanh(inputs), axis=1))[:, np.newaxis]


def episodes(envs, weights, goals):
    """Return the return of an episode for each set of weights, and its observations."""
    observations, _ = envs.reset(options={'goal': goals})
    total, seen, over = np.zeros(envs.num_envs), [observations], np.zeros(envs.num_envs, bool)
    while not over.all():
        observations, rewards, failed, ended, _ = envs.step(network(weights, observations))
        total += np.where(over, 0.0, rewards)  # an episode that is over begins anew
        over |= failed | ended
        seen.append(observations)
    return total, np.array(seen)


def train(generations, random):
    """Return weights, (5, NEURONS), after each generation."""
    envs = ReachVectorEnv(2 * DIRECTIONS * GOALS)
    weights, history = np.zeros((5, NEURONS)), []
    weights[:4] = random.normal(size=(4, NEURONS)) / 2.0
    for _ in range(generations):
        change = random.normal(size=(DIRECTIONS, *weights.shape))
        tried = np.concatenate([weights + CHANGE * change, weights - CHANGE * change])
        goals = np.tile((np.arange(GOALS) + random.uniform()) / GOALS, 2 * DIRECTIONS)
        total, _ = episodes(envs, np.repeat(tried, GOALS, axis=0), goals)
        forth, back = total.reshape(2, DIRECTIONS, GOALS).mean(axis=2)
        best = np.argsort(np.maximum(forth, back))[-BEST:]
        spread = np.std([forth[best], back[best]])
        weights = weights + RATE / (BEST * spread) * np.tensordot(
            (forth - back)[best], change[best], 1)
        history.append(weights)
        if len(history) % 100 == 0:
            print(f'{len(history)} generations, mean return {total.mean():.3f}', flush=True)
    return history


def main():
    """Train, test on unseen goals, and draw."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument('--generations', type=int, default=500)
    parser.add_argument('--plot', help='write a picture to this file')
    options, random = parser.parse_args(), np.random.default_rng(1)
    history = train(options.generations, random)
    envs, goals = ReachVectorEnv(UNSEEN), np.random.default_rng(2).uniform(-1.0, 1.0, UNSEEN)
    periods = round(REST / envs.period)

    def test(weights):
        return episodes(envs, np.tile(weights, (UNSEEN, 1, 1)), goals)

    for name, tried in (('untrained', np.zeros_like(history[-1])), ('trained', history[-1])):
        total, seen = test(tried)
        far = 2.0 * LENGTH * np.abs(np.sin(0.5 * seen[-periods:, :, 0])).max(axis=0)
        print(f'{name}: mean return {total.mean():.3f}; in the last {REST:g} s the tip is at most '
              f'{1e3 * np.median(far):.1f} mm from its goal in half of {UNSEEN} unseen episodes, '
              f'{1e3 * far.max():.1f} mm in all')
    if options.plot:
        some = np.unique(np.geomspace(1, len(history), 30).astype(int))
        draw(options.plot, some, [test(history[k - 1])[0].mean() for k in some])


def draw(path, generations, returns):
    """Draw the mean return of the unseen episodes after some generations."""
    from matplotlib.figure import Figure
    figure = Figure(figsize=(8.4, 3.5), layout='constrained')
    axes = figure.subplots()
    axes.semilogx(generations, returns, 'o-', color='#d55e00')
    axes.set(xlabel='generations', ylabel=f'mean return of {UNSEEN} unseen episodes')
    axes.xaxis.set_major_formatter('{x:g}')
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


if __name__ == '__main__':
    main()
