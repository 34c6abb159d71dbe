#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Change the filter's code, one place at a time, and see whether a test notices.

Usage, from the top of a checkout, with the Python of `.venv`::

    .venv/bin/python scripts/mutations.py --sample 300
    .venv/bin/python scripts/mutations.py --modules core/kalman.py --sample 0
    .venv/bin/python scripts/mutations.py --only filter/verdict.py:57 --slow 60

Prints how many mutants of each module were killed and how many survived, and writes the survivors
with their diffs to `build/mutations/survivors.txt`. Judged survivors are kept in
`docs/mutations.md`.

A mutant is one of mutmut's changes (a number plus one, an operator for its opposite, an argument
left out, a condition turned round, ...) or one of two more, a comparison negated and a transpose
left out, at one place of one module. Left out are those that put None where a value stood, which
whatever runs the line notices. Only mutmut's changes are used: its own runner leaves properties
and the constants of a module as they are, which much of the filter is made of.

First the tests are run once, to learn which of them come by each statement and how long they take.
Each mutant then has a process of its own, forked where numpy and scipy are imported and the
package is not; it imports the changed text in the place of the module and runs the tests that
come by, until one fails. The checkout is left as it is. Tests that take longer than `--slow`
seconds, which are statistics of many runs, are left out.

mutmut and coverage are installed into `build/mutations/tools` where they are missing. The first
run of the tests takes three minutes, and again when a file has changed; then 300 mutants take some
25 minutes, of which a survivor takes up to half a minute. Ctrl-C ends the run and prints what
there is. The same seed gives the same mutants as long as the modules are the same.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Iterator
import difflib
from importlib import invalidate_caches
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import find_spec, spec_from_file_location
import os
from pathlib import Path
import pickle
import random
import signal
import subprocess
import sys
import time
from typing import Any, NamedTuple

os.environ['OPENBLAS_NUM_THREADS'] = '1'

TOP = Path(__file__).resolve().parents[1]
OUT = TOP / 'build' / 'mutations'
TOOLS = ('mutmut==3.8.1', 'libcst==1.9.0', 'coverage==7.17.5')
TESTS = ('test/core/test_kalman.py', 'test/filter', 'test/measurements',
         'test/results/test_initial.py')
MODULES = ('core/kalman.py', *sorted(
    f'filter/{path.name}' for path in (TOP / 'starcal_ros' / 'filter').glob('[!_]*.py')))
OPTIONS = ('-q', '--tb=no', '-p', 'no:cacheprovider', '-p', 'no:xdist')

sys.path[:0] = [str(TOP)]
sys.path.append(str(OUT / 'tools'))             # behind what .venv has itself
if not all(map(find_spec, ('mutmut', 'libcst', 'coverage'))):
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--target',
                    str(OUT / 'tools'), *TOOLS], check=True)
    invalidate_caches()

import coverage  # noqa: E402
import libcst as cst  # noqa: E402
from libcst.metadata import MetadataWrapper, PositionProvider  # noqa: E402
from mutmut.mutation import mutators  # noqa: E402
import numpy  # noqa: E402, F401
import pytest  # noqa: E402
import scipy.optimize  # noqa: E402, F401
import scipy.sparse.csgraph  # noqa: E402, F401
import scipy.spatial.transform  # noqa: E402, F401
import scipy.stats  # noqa: E402, F401

NEGATED = {cst.LessThan: cst.GreaterThanEqual, cst.GreaterThanEqual: cst.LessThan,
           cst.GreaterThan: cst.LessThanEqual, cst.LessThanEqual: cst.GreaterThan}


class Mutant(NamedTuple):
    """One change: its module, its number there, its line, and the whole text with it."""

    module: str
    number: int
    line: int
    text: str

    @property
    def name(self) -> str:
        """What --only takes."""
        return f'{self.module}:{self.number}'

    @property
    def diff(self) -> str:
        """The lines that differ."""
        lines = difflib.unified_diff(source(self.module).read_text().splitlines(),
                                     self.text.splitlines(), lineterm='', n=0)
        return '\n'.join(line for line in list(lines)[2:] if not line.startswith('@@'))


def source(module: str) -> Path:
    """Return the file of a module."""
    return TOP / 'starcal_ros' / module


# What is changed


def changes(node: cst.CSTNode) -> Iterator[cst.CSTNode]:
    """Yield what may stand in the place of a node."""
    for kind, operator in mutators.mutation_operators:
        if isinstance(node, kind) and operator not in (
                mutators.operator_assignment, mutators.operator_lambda):
            for other in operator(node):
                if operator is not mutators.operator_arg_removal or (
                        len(other.args) < len(node.args)):
                    yield other
                if operator is mutators.operator_string:
                    break                       # one change of a text says enough
    if isinstance(node, cst.ComparisonTarget) and type(node.operator) in NEGATED:
        yield node.with_changes(operator=NEGATED[type(node.operator)]())
    if isinstance(node, cst.Attribute) and node.attr.value == 'T':
        yield node.value


class Collector(cst.CSTVisitor):
    """Collects the changes of a module: line, node, what stands in its place."""

    METADATA_DEPENDENCIES = (PositionProvider,)

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[int, cst.CSTNode, cst.CSTNode]] = []

    def on_visit(self, node: cst.CSTNode) -> bool:
        """Collect from all but type annotations and imports."""
        if isinstance(node, (cst.Annotation, cst.Import, cst.ImportFrom)):
            return False
        where = self.get_metadata(PositionProvider, node, None)
        self.found += [(where.start.line, node, other) for other in changes(node) if where]
        return True


def mutants_of(module: str, numbers: list[int] | None, share: float,
               rng: random.Random) -> tuple[int, list[Mutant]]:
    """Return how many there are, and those of the numbers, else a random share."""
    wrapper, collector = MetadataWrapper(cst.parse_module(source(module).read_text())), Collector()
    wrapper.visit(collector)
    n = len(collector.found)
    chosen = sorted(rng.sample(range(n), round(share * n))) if numbers is None else numbers
    return n, [Mutant(module, k, line, wrapper.module.deep_replace(node, other).code)
               for k in chosen for line, node, other in [collector.found[k]]]


# Which tests come by


class Baseline:
    """Follows the tests: which come by a line, and how long each takes with its fixtures."""

    def __init__(self) -> None:
        self.cover = coverage.Coverage(data_file=None, config_file=False,
                                       include=[str(source(module)) for module in MODULES])
        self.now = ['']
        self.fixtures: Counter[str] = Counter()
        self.tests: dict[str, tuple[float, list[str]]] = {}     # seconds, contexts

    def _within(self, context: str) -> Iterator[None]:
        self.now.append(context)
        self.cover.switch_context(context)
        try:
            yield
        finally:
            self.now.pop()
            self.cover.switch_context(self.now[-1])

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: Any) -> Any:
        """Note what the import of a file of tests runs."""
        context = collector.nodeid if isinstance(collector, pytest.Module) else self.now[-1]
        for _ in self._within(context):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        """Note what a fixture runs that tests share."""
        if fixturedef.scope == 'function':
            return (yield)
        begin, context = time.monotonic(), f'{request.node.nodeid}#{fixturedef.argname}'
        for _ in self._within(context):
            done = yield
            self.fixtures[context] += time.monotonic() - begin
            return done

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Any:
        """Note what a test runs."""
        begin, before = time.monotonic(), self.fixtures.total()
        for _ in self._within(item.nodeid):
            done = yield
            path = item.nodeid.partition('::')[0]
            shared = [key for name in item.fixturenames for key in (f'{path}#{name}', f'#{name}')
                      if key in self.fixtures]
            own = time.monotonic() - begin - (self.fixtures.total() - before)
            self.tests[item.nodeid] = (own + sum(self.fixtures[key] for key in shared),
                                       [item.nodeid, path, *shared])
            return done


class Covered(NamedTuple):
    """What the first run of the tests has found."""

    seconds: dict[str, float]
    tests: dict[str, dict[int, set[str]]]       # by module and line

    def of(self, mutant: Mutant, slow: float) -> list[str]:
        """Return the tests that come by a mutant's statement, the cheapest first by file."""
        lines = self.tests[mutant.module]
        found = set().union(*(lines.get(line, ()) for line in statement(mutant)))
        own = f'test_{Path(mutant.module).name}'
        files: Counter[str] = Counter()
        found = {test for test in found if self.seconds[test] <= slow}
        for test in found:
            files[test.partition('::')[0]] += self.seconds[test]
        return sorted(found, key=lambda test: (
            own not in test, files[test.partition('::')[0]], test.partition('::')[0],
            self.seconds[test], test))


def statement(mutant: Mutant) -> range:
    """Return the lines of the statement, of its head alone if it has a body."""
    nodes = [node for node in ast.walk(ast.parse(source(mutant.module).read_text()))
             if isinstance(node, ast.stmt) and node.lineno <= mutant.line <= node.end_lineno]
    if not nodes:                               # a decorator
        return range(mutant.line, mutant.line + 1)
    inner = max(nodes, key=lambda node: node.lineno)
    body = getattr(inner, 'body', None)
    last = body[0].lineno - 1 if body else inner.end_lineno
    return range(inner.lineno, max(inner.lineno, mutant.line, last) + 1)


def follow(file: Path) -> int:
    """Run all tests once; write what they come by."""
    baseline = Baseline()
    baseline.cover.start()
    for module in MODULES:                      # under no test's name
        __import__('starcal_ros.' + module[:-3].replace('/', '.'))
    code = pytest.main([*OPTIONS, *TESTS], plugins=[baseline])
    baseline.cover.stop()
    data, tests = baseline.cover.get_data(), {}
    for module in MODULES:
        lines = data.contexts_by_lineno(str(source(module)))
        # What the import runs concerns all that come by a function of the module, or by none.
        known = {context for contexts in lines.values() for context in contexts} - {''}
        tests[module] = {line: {
            test for test, (_, own) in baseline.tests.items()
            if not (known if '' in contexts else set(contexts)).isdisjoint(own)
            or not known} for line, contexts in lines.items()}
    seconds = {test: taken for test, (taken, _) in baseline.tests.items()}
    file.write_bytes(pickle.dumps(Covered(seconds, tests)))
    return int(code)


# The run


class Finder(MetaPathFinder):
    """Gives the changed text where the module is imported."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant

    def find_spec(self, fullname: str, *_: Any) -> ModuleSpec | None:
        """Answer for the one module."""
        name = 'starcal_ros.' + self.mutant.module[:-3].replace('/', '.')
        if fullname != name:
            return None
        path, text = str(source(self.mutant.module)), self.mutant.text

        class Loader(SourceFileLoader):
            def get_data(self, _: str) -> bytes:
                return text.encode()

            def path_stats(self, _: str) -> Any:
                raise OSError('no file, hence no cached bytecode')

        return spec_from_file_location(fullname, path, loader=Loader(fullname, path))


class Chosen:
    """Leaves these tests, in this order."""

    def __init__(self, tests: list[str]) -> None:
        self.place = {test: k for k, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Do so."""
        items[:] = sorted((item for item in items if item.nodeid in self.place),
                          key=lambda item: self.place[item.nodeid])


def attack(mutant: Mutant, tests: list[str]) -> int:
    """Run tests on a mutant until one fails."""
    sys.meta_path.insert(0, Finder(mutant))
    files = dict.fromkeys(test.partition('::')[0] for test in tests)
    return int(pytest.main([*OPTIONS, '-x', *files], plugins=[Chosen(tests)]))


def apart(function: Any, *arguments: Any, limit_s: float) -> int | None:
    """Return what a function returns in a process of its own; None where it takes too long."""
    pid = os.fork()
    if not pid:
        code = 99
        try:
            os.setpgid(0, 0)
            quiet = os.open(os.devnull, os.O_RDWR)
            for stream in range(3):
                os.dup2(quiet, stream)
            code = function(*arguments)
        finally:
            os._exit(code)
    end = time.monotonic() + limit_s
    try:
        while time.monotonic() < end:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
    except KeyboardInterrupt:
        os.killpg(pid, signal.SIGKILL)
        raise
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return None


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--sample', type=int, default=300, metavar='N',
                        help='mutants, shared among the modules by their size; 0: all')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--modules', nargs='+', default=list(MODULES), choices=MODULES,
                        metavar='MODULE', help='such as filter/verdict.py')
    parser.add_argument('--only', nargs='+', metavar='MODULE:NUMBER', help='no sample, but these')
    parser.add_argument('--slow', type=float, default=2.0, metavar='S',
                        help='leave out tests that take longer')
    options = parser.parse_args()
    os.chdir(TOP)
    OUT.mkdir(parents=True, exist_ok=True)

    rng, total, mutants = random.Random(options.seed), Counter(), []
    if options.only:
        for name in options.only:
            module, _, number = name.partition(':')
            total[module], found = mutants_of(module, [int(number)], 1.0, rng)
            mutants += found
    else:
        sizes = {module: mutants_of(module, [], 1.0, rng)[0] for module in options.modules}
        share = min(1.0, options.sample / sum(sizes.values())) if options.sample else 1.0
        for module in options.modules:
            total[module], found = mutants_of(module, None, share, rng)
            mutants += found
        rng.shuffle(mutants)                    # a run that is ended early is a sample as well
    print(f'{len(mutants)} of {total.total()} mutants', flush=True)

    file = OUT / 'covered.pickle'
    newest = max(path.stat().st_mtime for folder in ('starcal_ros', 'test')
                 for path in (TOP / folder).rglob('*.py'))
    if not file.exists() or file.stat().st_mtime < newest:
        if apart(follow, file, limit_s=3600.0):
            file.unlink(missing_ok=True)
            sys.exit('The tests fail as it is: see to them first.')
    covered: Covered = pickle.loads(file.read_bytes())
    count: Counter[tuple[str, str]] = Counter()
    survivors, begin = [], time.monotonic()
    try:
        for k, mutant in enumerate(mutants):
            tests = covered.of(mutant, options.slow)
            files = {test.partition('::')[0] for test in tests}
            limit_s = 10.0 + 2.0 * len(files) + 5.0 * sum(covered.seconds[t] for t in tests)
            code = apart(attack, mutant, tests, limit_s=limit_s) if tests else 0
            what = 'timeout' if code is None else 'killed' if code else 'survived'
            count[mutant.module, what] += 1
            if what == 'survived':
                survivors.append(f'{mutant.name} line {mutant.line}, {len(tests)} tests\n'
                                 f'{mutant.diff}\n')
                (OUT / 'survivors.txt').write_text('\n'.join(survivors))
            print(f'{k + 1:4} {time.monotonic() - begin:6.0f} s  {what:8}  {mutant.name}',
                  flush=True)
    except KeyboardInterrupt:
        pass
    (OUT / 'survivors.txt').write_text('\n'.join(survivors))
    print(f'\n{"module":30} {"mutants":>8} {"tried":>8} {"killed":>8} {"timeout":>8} '
          f'{"survived":>8}')
    for module in total:
        row = [count[module, what] for what in ('killed', 'timeout', 'survived')]
        print(f'{module:30}', *(f'{n:8}' for n in (total[module], sum(row), *row)))
    print(f'Survivors: {OUT / "survivors.txt"}')


if __name__ == '__main__':
    main()
