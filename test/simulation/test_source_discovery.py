# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One file is an error source: dropped into the folder it is there, taken out it is gone."""

from contextlib import contextmanager
from dataclasses import fields
from importlib import invalidate_caches
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018, TOP
from starcal_ros.config import scenario, truth
from starcal_ros.config.parameter import ConfigError
from starcal_ros.core import rotation
from starcal_ros.reproduction.published import budget
from starcal_ros.simulation import errors, sensors
from starcal_ros.simulation.truth import Truth

VALUES = {**TAN2018.flat(), 'motion.dwell_s': 0.0,
          'truth.gyro.bias_deg_h': (0.0, 0.0, 0.0), 'truth.gyro.arw_deg_sqrt_h': 0.0}
SOURCE = """
from dataclasses import dataclass, replace
from typing import Annotated
import numpy as np
from starcal_ros.config.parameter import ConfigError, Spec

GROUP = {group!r}
ON = {{'much of it': {{{name!r}: 0.5}}}}
NOTE = 'much: a half.'

@dataclass(frozen=True)
class Config:
    {name}: Annotated[float, Spec('How much, 0 is off', 'px', 0.0, 1.0)] = 0.0

def check(scenario):
    if scenario.truth.of(Config).{name} and scenario.gyro.rate_hz == 1.0:
        raise ConfigError('too slow')

def {hook}(scenario, *stars):
    amount = scenario.truth.of(Config).{name}
    return ({effect}) if amount else None
"""


def source(hook='frames', effect='lambda frames: frames', group='star_tracker', name='amount'):
    return SOURCE.format(hook=hook, effect=effect, group=group, name=name)


@contextmanager
def dropped(folder, **texts):
    """Have these files among the error sources, given by their name and text."""
    for name, text in texts.items():
        (folder / f'{name}.py').write_text(text)
    errors.__path__.append(str(folder))
    invalidate_caches()
    try:
        yield
    finally:
        errors.__path__.remove(str(folder))
        for name in texts:
            sys.modules.pop(f'{errors.__name__}.{name}', None)
            vars(errors).pop(name, None)


def setting(**values):
    return scenario.from_flat({**VALUES, **values})


def observed(setting):
    """Return 500 readings and 10 frames."""
    return sensors.gyro(setting).next(500), sensors.star_tracker(setting).next(10)


def same(a, b):
    return all(np.array_equal(getattr(a, field.name), getattr(b, field.name))
               for field in fields(a))


def stars(frames):
    """Return the places of stars by their frame and number."""
    frame = np.repeat(np.arange(len(frames)), frames.star_counts)
    return dict(zip(zip(frame.tolist(), frames.catalog_id.tolist()), frames.uv_raster))


HOOKS = {
    'bias': 'lambda stamps: np.full((len(stamps), 3), amount)',
    'rate': 'lambda stamps, rate: rate + amount * (stamps[:, None] > 0) * rate',
    'readings': 'lambda samples: replace(samples, rate=np.round(samples.rate / amount) * amount)',
    'mounting': 'lambda stamps: np.full((len(stamps), 3), [0.0, 0.0, amount])',
    'images': 'lambda images: replace(images, uv=images.uv + amount)',
    'frames': 'lambda frames: replace(frames, sigma=frames.sigma + amount * len(stars))',
}


@pytest.mark.parametrize('hook', HOOKS)
def test_a_file_is_a_source(tmp_path, hook):
    group = 'gyro' if hook in ('bias', 'rate', 'readings') else 'star_tracker'
    key = f'truth.{group}.amount'
    before, plain = scenario.parameters(), observed(setting())
    with dropped(tmp_path, quake=source(hook, HOOKS[hook], group)):
        assert set(scenario.parameters()) - set(before) == {key}
        assert scenario.parameters()[key].spec.text == 'How much, 0 is off'
        assert (np.inf, {'much of it': {key: 0.5}}, 'much: a half.') in budget.budget()
        off, on = setting(), setting(**{key: 0.5})
        assert all(map(same, observed(off), plain))
        assert same(observed(on)[0], plain[0]) == (group != 'gyro')
        assert same(observed(on)[1], plain[1]) == (group == 'gyro')
    assert list(scenario.parameters()) == list(before)
    assert all(map(same, observed(setting()), plain))
    with pytest.raises(ConfigError, match=f'{key}: unknown parameter'):
        setting(**{key: 0.5})


@pytest.mark.parametrize('hook, expected', [
    ('bias', lambda rate: rate + 0.5), ('rate', lambda rate: 1.5 * rate),
    ('readings', np.zeros_like),
])
def test_hooks_of_the_gyro(tmp_path, hook, expected):
    with dropped(tmp_path, quake=source(hook, HOOKS[hook], 'gyro')):
        right, wrong = (observed(setting(**{'truth.gyro.amount': amount}))[0].rate
                        for amount in (0.0, 0.5))
    np.testing.assert_array_equal(wrong, expected(right))


def test_mountings_turn_one_after_the_other(tmp_path):
    drift = {'truth.mounting_drift.sigma_arcsec': 3600.0}
    first = Truth.from_scenario(setting(**drift))
    stamps = first.motion.start_ns + 10**9 * np.arange(3)
    with dropped(tmp_path, quake=source('mounting', HOOKS['mounting'])):
        both = Truth.from_scenario(setting(**drift, **{'truth.star_tracker.amount': 0.5}))
        np.testing.assert_array_equal(
            both.mounting_at(stamps),
            rotation.exp(np.array([0.0, 0.0, 0.5])) @ first.mounting_at(stamps))


def test_images_move_with_their_stars(tmp_path):
    """But for stars at the edge, which come and go."""
    with dropped(tmp_path, quake=source('images', HOOKS['images'])):
        still, moved = (stars(observed(setting(**{'truth.star_tracker.amount': amount}))[1])
                        for amount in (0.0, 0.5))
    both = still.keys() & moved.keys()
    assert len(both) > 0.9 * len(still)
    np.testing.assert_allclose([moved[star] - still[star] for star in both], 0.5, atol=1e-12)


def test_the_example_of_the_page_is_a_source(tmp_path):
    """All stars of a frame shift by the same, frame by frame by something else."""
    page = (TOP / 'docs' / 'howto' / 'add_error_source.md').read_text()
    text, = re.findall(r'^```python\n(.*?)^```', page, re.S | re.M)
    quiet = {'truth.star_tracker.centroid_sigma_px': 0.0}
    with dropped(tmp_path, flicker=text):
        still, moved = (stars(observed(setting(**quiet, **values))[1]) for values in (
            {}, {'truth.star_tracker.flicker_px': 0.1}))
    shifts = np.array([[moved[star] - still[star] for star in still.keys() & moved.keys()
                        if star[0] == frame][:10] for frame in range(10)])
    assert shifts.shape == (10, 10, 2)
    np.testing.assert_allclose(shifts, np.broadcast_to(shifts[:, :1], shifts.shape), atol=1e-12)
    low, high = chi2.ppf([0.0005, 0.9995], 20)
    assert low < np.sum((shifts[:, 0] / 0.1)**2) < high


def test_a_group_of_its_own_is_a_group_of_parameters(tmp_path):
    with dropped(tmp_path, quake=source(group='quake')):
        assert setting().truth.quake.amount == 0.0
        assert setting(**{'truth.quake.amount': 0.5}).flat()['truth.quake.amount'] == 0.5
        with pytest.raises(ConfigError, match='amount: got 2.0, allowed is 0 to 1 px'):
            setting(**{'truth.quake.amount': 2.0})
    assert not hasattr(setting().truth, 'quake')


def test_a_source_checks_its_values_against_others(tmp_path):
    slow = {'gyro.rate_hz': 1.0}
    with dropped(tmp_path, quake=source()):
        setting(**slow)
        with pytest.raises(ConfigError, match='^too slow$'):
            setting(**slow, **{'truth.star_tracker.amount': 0.5})


def test_sources_without_an_order_are_the_last_and_go_by_their_names(tmp_path):
    files = {'b': source(name='one'), 'a': source(name='two'), 'c': source(name='three')}
    files['c'] += 'ORDER = 45\n'
    with dropped(tmp_path, **files):
        names = [found.__name__.rpartition('.')[2] for found in truth.sources()]
    assert [name for name in names if name in ('smear', 'mounting_drift', *files)] == [
        'smear', 'c', 'mounting_drift', 'a', 'b']


@pytest.mark.parametrize('name, other', [
    ('smear', 'starcal_ros.simulation.errors.smear'),
    ('time_offset_s', 'starcal_ros.config.truth'),
])
def test_two_that_declare_one_parameter_are_named(tmp_path, name, other):
    with dropped(tmp_path, quake=source(name=name)), pytest.raises(ConfigError) as error:
        scenario.Scenario()
    assert str(error.value) == (f'truth.star_tracker.{name}: declared by {other} and by '
                                'starcal_ros.simulation.errors.quake')


def test_a_scenario_from_before_a_source_says_so(tmp_path):
    old = setting()
    with dropped(tmp_path, quake=source()), pytest.raises(LookupError) as error:
        sensors.star_tracker(old)
    assert str(error.value) == ('starcal_ros.simulation.errors.quake has no parameters in this '
                                'scenario')


def test_a_scenario_with_errors_is_pickled():
    wrong = setting(**{'truth.star_tracker.smear': True, 'truth.gyro.bias_deg_h': (1.0, 2.0, 3.0)})
    assert pickle.loads(pickle.dumps(wrong)) == wrong != setting()


def test_the_configuration_looks_for_the_sources_late_and_lightly():
    """They come with the first scenario, without what is slow to import."""
    code = """if True:
        import sys
        from starcal_ros.config.scenario import Scenario
        assert not any(name.startswith('starcal_ros.simulation') for name in sys.modules)
        Scenario()
        assert 'starcal_ros.simulation.errors.smear' in sys.modules
        assert not {'erfa', 'scipy'} & set(sys.modules)
        """
    done = subprocess.run([sys.executable, '-c', code], stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stderr
