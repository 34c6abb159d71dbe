# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The schema of editors and the page of parameters are those of the declared parameters."""

import copy
import importlib.util
import json
import re

import pytest
import yaml

from instruments import CONFIG, TOP
from starcal_ros.config import parameter_file, presets
from starcal_ros.config.new_file import new_file
from starcal_ros.config.parameter import groups
from starcal_ros.config.scenario import Scenario, parameters
from starcal_ros.config.schema import schema

SPEC = importlib.util.spec_from_file_location('make_parameters',
                                              TOP / 'scripts' / 'make_parameters.py')
MAKE = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(MAKE)


@pytest.mark.parametrize('name', MAKE.MADE)
def test_what_is_made_of_the_declarations_is_up_to_date(name):
    assert (TOP / name).read_text() == MAKE.MADE[name](), 'python scripts/make_parameters.py'


def test_each_parameter_and_group_is_on_the_page_once_and_explained():
    text = (TOP / 'docs' / 'parameters.md').read_text()
    for key, parameter in parameters().items():
        row, = re.findall(rf'^\| `{re.escape(key)}` \|.*$', text, re.MULTILINE)
        assert parameter.spec.text in row and f'[{parameter.spec.unit}]' in row + '[]'
    for name, about in groups(Scenario()):
        assert re.match(r'[A-Z][^(=]+[a-z`]$', about.replace('16-state', '')), (name, about)


@pytest.fixture(scope='module')
def complaints():
    """Return a function that gives what the schema says of the parameters of one section."""
    jsonschema = pytest.importorskip('jsonschema')
    jsonschema.Draft7Validator.check_schema(schema())
    validator = jsonschema.Draft7Validator(schema())

    def of(values, section='/**'):
        return [error.message for error in validator.iter_errors(
            {section: {'ros__parameters': values}})]
    return of


def test_files_are_valid_by_the_schema(complaints):
    texts = [CONFIG.read_text(), *(new_file(presets.scenario(name), name)
                                   for name in presets.PRESETS)]
    for text in texts:
        assert complaints(yaml.safe_load(text)['/**']['ros__parameters']) == []
    assert complaints({'use_sim_time': True, 'qos_overrides': {'/clock': 1},
                       'truth': {'gyro.arw_deg_sqrt_h': 1.0}, 'estimator.tolerance.k1': 1.0}) == []


@pytest.mark.parametrize('values, said', [
    ({'camera': {'focal_lenght_mm': 25.0}}, 'focal_lenght_mm'),
    ({'camera': {'width': 10}}, 'minimum'),
    ({'camera': {'width': 640.5}}, 'integer'),
    ({'camera.distortion': [0.0]}, 'too short'),
    ({'observer': {'velocity': 'fast'}}, 'is not one of'),
    ({'estimator.feedback': 1}, 'boolean')])
def test_what_is_wrong_is_told_by_the_schema(complaints, values, said):
    found, = complaints(copy.deepcopy(values))
    assert said in found


def test_the_schema_takes_every_default_and_knows_sections_of_any_depth(complaints):
    for key, parameter in parameters().items():
        if parameter.default not in (None, ()):
            assert complaints({key: json.loads(json.dumps(parameter.default))}) == [], key
    jsonschema = pytest.importorskip('jsonschema')
    jsonschema.validate({'ns': {'estimator': {'ros__parameters': {'gyro.rate_hz': 50.0}}}},
                        schema())


def test_a_file_says_what_it_is_checked_with():
    assert '$schema=parameters.schema.json' in CONFIG.read_text()
    first = new_file(Scenario(), 'mine').splitlines()[0]
    path = first.partition('$schema=file://')[2]
    assert json.loads(open(path).read()) == schema()
    assert parameter_file.parse(new_file(Scenario(), 'mine'), 'x') == Scenario()
