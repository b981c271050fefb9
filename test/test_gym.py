# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The environments of gymnasium: its own checks, its own vector environment, and the simulator."""

import warnings

import gymnasium
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
import numpy as np
import pytest

import timo_sim
from timo_sim.gym import ReachEnv, ReachVectorEnv

FREE = {'initial.shaft': 0.3, 'integrator.step': 0.01, 'motor.torque_limit': 20.0}
SHORT = {'duration': 0.2}


def test_gymnasium_accepts_it():
    environment = gymnasium.make('timo_sim.gym:timo_sim/Reach-v0')
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        warnings.filterwarnings('ignore', message='.*Box observation space .*infinity')
        check_env(environment.unwrapped)
    many = gymnasium.make_vec('timo_sim.gym:timo_sim/Reach-v0', num_envs=3,
                              vectorization_mode='vector_entry_point', duration=1.0)
    assert many.num_envs == 3 and many.reset(seed=1)[0] in many.observation_space


@pytest.mark.parametrize('mode', AutoresetMode)
def test_it_is_what_gymnasium_makes_of_single_environments(mode):
    """To the last bit, over the ends of episodes: observations, rewards, ends, infos."""
    ours = ReachVectorEnv(3, autoreset_mode=mode, **SHORT)
    theirs = SyncVectorEnv([lambda: ReachEnv(**SHORT)] * 3, autoreset_mode=mode)
    assert ours.metadata['autoreset_mode'] == theirs.metadata['autoreset_mode']
    random = np.random.default_rng(0)
    for found, expected in zip(ours.reset(seed=5), theirs.reset(seed=5)):
        np.testing.assert_equal(found, expected)
    for _ in range(25):
        actions = random.uniform(-1.5, 1.5, (3, 1)).astype(np.float32)
        found, expected = ours.step(actions), theirs.step(actions)
        np.testing.assert_equal(found[:4], expected[:4])
        assert data_equivalence(found[4], expected[4], exact=True)
        over = found[2] | found[3]
        if mode is AutoresetMode.DISABLED and over.any():
            for each in (ours, theirs):
                each.reset(options={'reset_mask': over.copy()})


def test_what_it_observes_is_what_the_simulator_does():
    variations = [{}, {'end_effector.mass': 3.0, 'motor.coulomb_friction': 2.0,
                       'motor.coulomb_presliding': 0.01}]
    environments = ReachVectorEnv(2, FREE, variations, force=30.0)
    environments.reset(seed=1, options={'goal': [0.5, -0.2]})
    simulators = [timo_sim.Simulator(timo_sim.load_scene(FREE, each)) for each in variations]
    random = np.random.default_rng(3)
    for _ in range(20):
        actions = random.uniform(-1.2, 1.2, (2, 3))
        found, rewards, *_ = environments.step(actions)
        acts = np.clip(actions, -1.0, 1.0)
        for k, simulator in enumerate(simulators):
            motion = simulator.step(torque=20.0 * acts[k, 0], force=30.0 * acts[k, 1:],
                                    duration=0.02)
            place = simulator.model.tip(motion.values)
            bend = np.arctan2(place[1], place[0])
            cosine, sine = np.cos(motion.shaft), np.sin(motion.shaft)
            velocity = np.array([[cosine, sine], [-sine, cosine]]) @ motion.carrier_velocity
            left = [0.5, -0.2][k] - motion.shaft - bend
            assert found[k, [0, 1, 2, 4, 5]] == pytest.approx(
                [left, float(motion.shaft_velocity), bend, *velocity], abs=1e-6)
            # Rate of the tip's direction as seen from the shaft, less that of the shaft.
            model = simulator.model
            moving = model.velocities(motion.values[np.newaxis], model.tip_point)[0][0, 0]
            relative = np.array([[cosine, sine], [-sine, cosine]]) @ moving - velocity
            turning = (place[0] * relative[1] - place[1] * relative[0]) / (
                place[0]**2 + place[1]**2)
            assert found[k, 3] == pytest.approx(turning - motion.shaft_velocity, rel=0.01,
                                                abs=1e-3)
            assert rewards[k] == pytest.approx(-0.02 * (
                abs(left) + 0.1 * abs(motion.shaft_velocity + found[k, 3])
                + 0.01 * np.mean(acts[k]**2)), abs=1e-6)


def test_directions_are_seen_from_the_axis_of_a_shaft_with_a_hub():
    environments = ReachVectorEnv(1, {**FREE, 'hub.radius': 0.5})
    environments.reset(seed=1, options={'goal': 0.4})
    for _ in range(10):
        left, speed, bend, _, *_ = environments.step(np.ones((1, 1)))[0][0]
    motion = environments.batch.motion
    across, along = (environments.batch.position() - motion.carrier)[0, ::-1]
    assert left == pytest.approx(0.4 - np.arctan2(across, along), abs=1e-6)
    assert abs(bend) > 1e-3 and speed > 0.0


def test_goals_are_about_the_direction_in_which_an_arm_begins_to_hang():
    hangs = {**FREE, 'carrier.held': 'both', 'gravity': [0.0, -9.81], 'initial.equilibrium': True}
    environments = ReachVectorEnv(8, hangs, farthest_goal=0.1)
    environments.reset(seed=1)
    assert environments.batch.motion.shaft == pytest.approx(-np.pi / 2, abs=1e-6)
    assert np.abs(environments.goal + np.pi / 2).max() <= 0.1 + 1e-6


def test_variations_may_have_another_step_and_a_free_carrier():
    environments = ReachVectorEnv(2, variations=2 * [
        {'integrator.step': 0.001, 'carrier.held': 'none'}])
    environments.reset(seed=1)
    found = environments.step(np.ones((2, 1)))[0]
    assert environments.batch.t == pytest.approx([0.02, 0.02]) and found.shape == (2, 6)


def test_an_arm_that_breaks_ends_its_episode_and_the_others_go_on():
    environments = ReachVectorEnv(
        2, {**FREE, 'model.formulation': 'newton'}, [{}, {'initial.shaft_velocity': 1e5}],
        duration=1.0)
    environments.reset(seed=1)
    _, rewards, failed, ended, _ = environments.step(np.ones((2, 1)))
    assert failed.tolist() == [False, True] and not ended.any()
    assert rewards[1] == pytest.approx(-np.pi)
    found, rewards, failed, *_ = environments.step(np.zeros((2, 1)))  # it begins anew
    assert not failed.any() and rewards[1] == 0.0 and np.isfinite(found).all()


REFUSED = [
    (dict(num_envs=0), 'num_envs must be .*>= 1 .*, got 0'),
    (dict(scene={}), 'motor.torque_limit must be finite'),
    (dict(force=1.0), 'force must be 0 with a carrier that is held .* x and y, got 1 N'),
    (dict(period=0.0021), 'period = 0.0021 must be a whole multiple of integrator.step'),
    (dict(duration=0.05), 'duration = 0.05 must be a whole multiple of period'),
    (dict(num_envs=2, variations=[{}]), 'variations must have num_envs = 2 elements, got 1')
]


def test_refusals():
    for given, text in REFUSED:
        with pytest.raises(timo_sim.ParameterError, match=text):
            ReachVectorEnv(**given)


def test_refusals_in_use():
    environments = ReachVectorEnv(2, autoreset_mode='Disabled', duration=0.02)
    for call, text in [
            (lambda: environments.reset(seed=[1]), 'seed must be an int or num_envs = 2'),
            (lambda: environments.reset(options={'goal': np.nan}), 'goal must be a finite number'),
            (lambda: environments.reset(options={'reset_mask': [True]}), 'mask must be 2 times'),
            (lambda: environments.step([[np.nan], [0.0]]), 'actions must be finite'),
            (lambda: environments.step(np.zeros(2)), r'of shape \(2, 1\)')]:
        with pytest.raises(timo_sim.ParameterError, match=text):
            call()
    environments.reset(seed=1)
    environments.step(np.zeros((2, 1)))
    with pytest.raises(timo_sim.ParameterError, match=r'environments \[0, 1\] are over: reset'):
        environments.step(np.zeros((2, 1)))
