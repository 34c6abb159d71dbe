# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Launch files, with the few classes of launch and launch_ros that they use played by others.

The real ones load them in test_package.py where they are installed.
"""

from pathlib import Path
import runpy
import signal
import sys
from types import ModuleType

import pytest

from starcal_ros.config.scenario import parameters

TOP = Path(__file__).parents[1]
FILES = sorted((TOP / 'launch').glob('*.launch.py'))
EXECUTABLES = {path.stem for path in (TOP / 'starcal_ros' / 'nodes').glob('*.py')}
ROS_OWN = {'use_sim_time': bool}


class Call:
    """What was called, with which words."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs

    def perform(self, context):
        """Return the value of a substitution."""
        return context.perform(self)


def classes(*names):
    """Return classes that remember their arguments."""
    return {name: type(name, (Call,), {}) for name in names}


MODULES = {
    'launch': classes('LaunchDescription'),
    'launch.actions': classes('DeclareLaunchArgument', 'EmitEvent', 'OpaqueFunction',
                              'RegisterEventHandler', 'Shutdown'),
    'launch.event_handlers': classes('OnProcessExit'),
    'launch.events': classes('matches_action'),
    'launch.events.process': classes('SignalProcess'),
    'launch.conditions': classes('IfCondition', 'UnlessCondition'),
    'launch.substitutions': classes('LaunchConfiguration', 'PathJoinSubstitution',
                                    'PythonExpression'),
    'launch_ros': {},
    'launch_ros.actions': classes('Node'),
    'launch_ros.parameter_descriptions': classes('ParameterValue'),
    'launch_ros.substitutions': classes('FindPackageShare'),
}


@pytest.fixture(params=FILES, ids=lambda path: path.name)
def entities(request, monkeypatch):
    """Return what a launch file describes."""
    for name, members in MODULES.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(request.param))['generate_launch_description']()
    return description.args[0]


def of(entities, name):
    """Return the entities of a class."""
    return [entity for entity in entities if type(entity).__name__ == name]


def ending(entities, linger='false'):
    """Return what is called when a node ends, and the context in which it was registered."""
    function, = of(entities, 'OpaqueFunction')
    context = Context(linger)
    handler, = found(function.kwargs['function'](context), 'OnProcessExit')
    return handler.kwargs['on_exit'], context


def found(value, name):
    """Yield the arguments of all calls of a class in what was given to another."""
    if isinstance(value, Call):
        if type(value).__name__ == name:
            yield value
        yield from found([value.args, value.kwargs], name)
    elif isinstance(value, dict):
        yield from found(list(value.values()), name)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from found(item, name)


def test_every_argument_is_described_and_used_and_none_else(entities):
    declared = of(entities, 'DeclareLaunchArgument')
    names = [argument.args[0] for argument in declared]
    used = {call.args[0] for call in found(of(entities, 'Node'), 'LaunchConfiguration')}
    used.update(ending(entities)[1].asked)
    assert len(set(names)) == len(names) and set(names) == used
    assert all(len(argument.kwargs['description']) > 10 for argument in declared)
    assert 'namespace' in names and 'config' in names


def test_nodes_are_executables_in_the_namespace(entities):
    nodes = of(entities, 'Node')
    for node in nodes:
        assert node.kwargs['package'] == 'starcal_ros'
        assert node.kwargs['executable'] in EXECUTABLES
        assert node.kwargs['namespace'].args == ('namespace',)
        assert float(node.kwargs['sigterm_timeout']) >= 55.0    # longer than any waits to end
    assert 'estimator' in [node.kwargs['executable'] for node in nodes]


def test_parameters_are_declared_ones_of_their_types(entities):
    known = parameters()
    for node in of(entities, 'Node'):
        file, *given = node.kwargs['parameters']
        assert file.args == ('config',)
        for name, value in ((name, value) for values in given for name, value in values.items()):
            kind = ROS_OWN.get(name) or known[name].element
            if isinstance(value, Call):
                assert value.kwargs['value_type'] == (
                    list[kind] if name in known and known[name].is_array else kind), name
            elif name in known and known[name].is_array:
                assert all(type(each) is kind for each in value), name
            else:
                assert type(value) is kind, name


def test_defaults_are_values_of_their_types(entities):
    kinds = {call.args[0].args[0]: call.kwargs['value_type']
             for call in found(of(entities, 'Node'), 'ParameterValue')
             if type(call.args[0]).__name__ == 'LaunchConfiguration'}
    for argument in of(entities, 'DeclareLaunchArgument'):
        default, kind = argument.kwargs.get('default_value'), kinds.get(argument.args[0], str)
        if isinstance(default, str):
            assert kind is str or default in ('true', 'false') or kind(default) >= 0.0


def test_transforms_stay_in_the_namespace(entities):
    """Two estimators would else contradict each other about the same two frames."""
    estimators = [node for node in of(entities, 'Node')
                  if node.kwargs['executable'] == 'estimator']
    assert estimators and all(
        ('/tf_static', 'tf_static') in node.kwargs['remappings'] for node in estimators)


def runs(node, with_images):
    """Tell whether a node is started."""
    condition = node.kwargs.get('condition')
    return condition is None or (type(condition).__name__ == 'IfCondition') == with_images


@pytest.mark.parametrize('with_images', [False, True])
def test_one_estimator_runs_and_counts_the_trail_of_a_star_once(entities, with_images):
    """The sigma of a centroid that is extracted from an image holds it already."""
    if 'images' not in [argument.args[0] for argument in of(entities, 'DeclareLaunchArgument')]:
        with_images = False
    estimator, = (node for node in of(entities, 'Node')
                  if node.kwargs['executable'] == 'estimator' and runs(node, with_images))
    given = {key: value for values in estimator.kwargs['parameters'][1:]
             for key, value in values.items()}
    assert given.get('star_tracker.smear', True) is not with_images


def value_of(value, images, wait_for=''):
    """Return a parameter, where `images` and `wait_for` decide about it, for one choice."""
    if not isinstance(value, Call):
        return value
    expression = next(found(value, 'PythonExpression')).args[0]
    given = {'images': images, 'wait_for': wait_for}
    return eval(''.join(given[part.args[0]] if isinstance(part, Call) else part
                        for part in expression))


@pytest.mark.parametrize('images', ['false', 'true', 'True', '1'])
def test_nothing_is_missed_at_the_beginning(entities, images):
    """Who speaks waits for who listens, by name: others that listen are not they."""
    with_images = images != 'false' and 'images' in [
        argument.args[0] for argument in of(entities, 'DeclareLaunchArgument')]
    nodes = {node.kwargs['executable']: node for node in of(entities, 'Node')
             if runs(node, with_images)}
    waits = {name: {each for given in node.kwargs['parameters'][1:] for key, value in given.items()
                    if key.endswith('wait_for_nodes') for each in value_of(value, images)}
             for name, node in nodes.items()}
    recorders = nodes.keys() & {'recorder'}
    behind_images = {'centroid_extractor'} if with_images else {'estimator'}
    identifiers = nodes.keys() & {'star_identifier'}
    assert bool(identifiers) == with_images
    listeners = {'gyro_sim': {'estimator'} | identifiers, 'star_tracker_sim': behind_images,
                 'player': {'estimator'}, 'estimator': set(), 'star_identifier': {'estimator'},
                 'centroid_extractor': {'star_identifier'}}
    for name in nodes.keys() & listeners.keys():
        assert waits[name] == listeners[name] | recorders, name


@pytest.mark.parametrize('entities', [TOP / 'launch' / 'simulate.launch.py'], indirect=True)
@pytest.mark.parametrize('wait_for', ['rosbag2_recorder', '/rosbag2_recorder, logger'])
def test_all_that_speak_wait_for_others_that_are_named(entities, wait_for):
    waits = [value for node in of(entities, 'Node') for given in node.kwargs['parameters'][1:]
             for key, value in given.items() if key.endswith('wait_for_nodes')]
    assert len(waits) == 6          # all but the recorder; the estimator stands there twice
    for value in waits:
        assert set(value_of(value, 'true', wait_for)) - set(value_of(value, 'true')) == set(
            wait_for.replace(' ', '').split(','))


class Event:
    """The end of a node."""

    def __init__(self, node, returncode=0):
        self.action, self.returncode = node, returncode
        self.process_name = node.kwargs['executable']


class Context:
    """A launch that goes on, where each argument has one value, or none has any more."""

    is_shutdown = False

    def __init__(self, value=None):
        self.value, self.asked = value, []

    def perform(self, configuration):
        """Return an argument of launch."""
        self.asked += configuration.args
        if self.value is None:
            raise LookupError(f'launch configuration {configuration.args} does not exist')
        return self.value


def asked(actions):
    """Return which node is asked to end, 'all' for all of them, None for none."""
    if not actions:
        return None
    action, = actions
    if type(action).__name__ == 'Shutdown':
        return 'all'
    event = action.kwargs['event']
    assert event.kwargs['signal_number'] == signal.SIGINT
    return event.kwargs['process_matcher'].args[0].kwargs['executable']


def begun(entities, linger='false'):
    """Let the nodes run that do without images, and return them by name, and what ends them."""
    for node in of(entities, 'Node'):
        node.process_details = {'pid': 1} if runs(node, False) else None
    nodes = sorted(of(entities, 'Node'), key=lambda node: node.process_details is not None)
    return {node.kwargs['executable']: node for node in nodes}, ending(entities, linger)[0]


def test_each_node_ends_after_those_that_speak_to_it(entities):
    """Without the arguments, too: where a group includes the file, they are gone by then."""
    nodes, at_end = begun(entities)
    last = None
    for source in at_end.sources:
        assert last is None
        last = asked(at_end(Event(source), Context()))
    order = [last]
    while order[-1] is not None:
        order.append(asked(at_end(Event(nodes[order[-1]]), Context())))
    running = [name for name, node in nodes.items() if node.process_details]
    over = 'gyro_sim' in running or 'player' in running
    assert order == [name for name in ('estimator', 'recorder') if over and name in running] + [
        None]                           # which ends a launch that runs nothing else


def test_what_else_a_launch_runs_neither_ends_it_nor_is_ended(entities):
    """Such as the run in another namespace, of the same file."""
    at_end = begun(entities)[1]
    for status in 0, 3:
        assert at_end(Event(Call(executable='rviz2'), status), Context()) == []


def test_nodes_linger_where_they_are_asked_to(entities):
    _, at_end = begun(entities, 'true')
    for source in at_end.sources:
        assert asked(at_end(Event(source), Context())) is None


def test_node_that_fails_ends_the_launch_with_an_error(entities):
    nodes, at_end = begun(entities)
    for name, node in nodes.items():
        with pytest.raises(RuntimeError, match=f'{name} ended with status 2'):
            at_end(Event(node, 2), Context())
    assert asked(at_end(Event(nodes['estimator']), Context())) == 'all'


def test_the_others_go_on_where_the_recorder_has_failed_and_the_launch_tells_in_the_end(
        entities):
    nodes, at_end = begun(entities)
    if 'recorder' not in nodes:
        assert at_end.spare is None
        return
    assert at_end(Event(nodes['recorder'], 1), Context()) == []
    if not at_end.sources:              # a launch that ends when it is asked to
        return
    last = None
    for source in at_end.sources:
        last = asked(at_end(Event(source), Context()))
    assert last == 'estimator'
    with pytest.raises(RuntimeError, match='recorder ended with status 1'):
        at_end(Event(nodes['estimator']), Context())
