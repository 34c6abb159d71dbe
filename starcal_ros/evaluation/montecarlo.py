# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo: many runs of one scenario, or of several that differ in one parameter.

Batches of runs share a process (the filter's leading axis) and are spread over cores, or over a
Dask cluster (`tasks`), in sizes by which all workers end at about the same time; the bound is one
of their tasks. Each finished batch is kept in a folder beside the result until all are there, so
that a killed study goes on where it was, with any number of workers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
import json
from pathlib import Path
import shutil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, parameters
from starcal_ros.core.arrays import Array
from starcal_ros.evaluation import bounds, consistency, tasks
from starcal_ros.evaluation.batch_results import Runs, run_batch
from starcal_ros.evaluation.estimation_error import nominal, state_error
from starcal_ros.files.output import write_text
from starcal_ros.filter.augmentation import Augmentation
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.simulation.truth import Truth

BATCH = 25
"""Runs in a batch, at most: enough to share the work of a frame, and to keep often."""

_JUDGED = '_judged'
_PROBABILITY = 0.95


@dataclass(frozen=True)
class MonteCarlo:
    """A scenario to be run many times, at each value of a parameter that is swept.

    Attributes
    ----------
    scenario : Scenario
        What all runs have in common.
    runs : int
        Number of runs, at each value.
    key : str
        Parameter that is swept, '' for none.
    values : tuple
        Its values; one None where nothing is swept.
    judged : bool
        Whether each run gets a verdict.
    """

    scenario: Scenario
    runs: int
    key: str = ''
    values: tuple[Any, ...] = (None,)
    judged: bool = False

    @classmethod
    def of(cls, scenario: Scenario, runs: int, sweep: str | None) -> MonteCarlo:
        """Read a sweep ``key=value,value,…``.

        Raises
        ------
        ConfigError
            Where the key or a value is not a parameter's.
        """
        if runs < 1:
            raise ConfigError(f'runs: got {runs}, needs at least 1')
        if not sweep:
            return cls(scenario, runs)
        key, _, listed = sweep.partition('=')
        if key not in parameters():
            scenario.replace({key: None})       # which says what is wrong with the key
        if not listed:
            raise ConfigError(f'{key}: got no values, needs {key}=value,value,…')
        element = parameters()[key].element
        try:
            values = tuple(element(text) for text in listed.split(','))
        except ValueError:
            raise ConfigError(f'{key}: got {listed!r}, needs {element.__name__} values with '
                              'commas between them') from None
        study = cls(scenario, runs, key, values)
        for value in values:
            study.at(value)
        return study

    def at(self, value: Any) -> Scenario:
        """Return the scenario at one value."""
        return self.scenario.replace({self.key: value}) if self.key else self.scenario

    @property
    def seeds(self) -> range:
        """Seeds of the runs at one value: those from the scenario's own on."""
        first = self.scenario.simulation.seed
        return range(first, first + self.runs)


def run(study: MonteCarlo, parts: Path,
        on_progress: Callable[[float], None] = lambda part: None, bounded: bool = False
        ) -> list[Runs]:
    """Run a study, or what is missing of it.

    Parameters
    ----------
    study : MonteCarlo
        What to run.
    parts : Path
        Folder of the finished batches.
    on_progress : callable
        Called with the part done, 0 to 1.
    bounded : bool
        Make the bound at each value, too, for `bound_at`.

    Returns
    -------
    list of Runs
        One for each value.
    """
    parts.mkdir(parents=True, exist_ok=True)
    scenarios = [study.at(value) for value in study.values]
    missing = [(scenario, seed) for scenario in scenarios for seed in study.seeds
               if seed not in _seeds_done(scenario, study.judged, parts)]
    size = batch_size(len(missing), tasks.workers())
    done = 1.0 - len(missing) / (len(scenarios) * study.runs)
    new = [scenario for scenario in scenarios
           if bounded and not _bound_name(scenario, parts).exists()]
    names = [_bound_name(scenario, parts) for scenario in new]
    todo: list[tuple[Any, ...]] = [(_bound_task, scenario) for scenario in new]
    for scenario in scenarios:
        seeds = [seed for of, seed in missing if of is scenario]
        for group in _together(seeds, size):
            names.append(parts / (f'{_key(scenario)}_{group[0]}_{group[-1]}'
                                  f'{_JUDGED if study.judged else ""}.npz'))
            todo.append((_task, scenario, group, study.judged))
    tasks.complete(names, _called, todo, lambda part: on_progress(done + (1.0 - done) * part))
    return [_loaded(scenario, study, parts) for scenario in scenarios]


def batch_size(runs: int, workers: int) -> int:
    """Return how many runs share a process, so that all workers end at about the same time."""
    rounds = max(1, -(-runs // (BATCH * workers)))
    return max(1, -(-runs // (rounds * workers)))


def _together(seeds: Sequence[int], size: int) -> Iterator[list[int]]:
    """Yield seeds that follow each other, as many as `size` at once."""
    group: list[int] = []
    for seed in seeds:
        if group and (len(group) == size or seed != group[-1] + 1):
            yield group
            group = []
        group.append(seed)
    if group:
        yield group


def _key(scenario: Scenario) -> str:
    return scenario.replace({'simulation.seed': 0}).sha256[:16]


def _files(scenario: Scenario, judged: bool, parts: Path) -> Iterator[tuple[Path, range]]:
    """Yield the batches of a scenario that are done, of any size, and their seeds."""
    for path in sorted(parts.glob(f'{_key(scenario)}_*.npz')):
        first, last, *rest = path.stem.split('_')[1:] + ['']
        if last and (path.stem.endswith(_JUDGED)) == judged:
            yield path, range(int(first), int(last) + 1)


def _seeds_done(scenario: Scenario, judged: bool, parts: Path) -> set[int]:
    return {seed for _, seeds in _files(scenario, judged, parts) for seed in seeds}


def _loaded(scenario: Scenario, study: MonteCarlo, parts: Path) -> Runs:
    whole = Runs.concatenate([_load(path) for path, _ in _files(scenario, study.judged, parts)])
    # In the order of the seeds, each once.
    seeds, rows = np.unique(whole.seed, return_index=True)
    rows = rows[np.isin(seeds, study.seeds)]
    return Runs(*(getattr(whole, field.name)[rows] for field in fields(Runs)))


def _called(function: Callable[..., dict[str, NDArray[Any]]], *given: Any
            ) -> dict[str, NDArray[Any]]:
    return function(*given)


def _task(scenario: Scenario, seeds: Sequence[int], judged: bool) -> dict[str, NDArray[Any]]:
    batch = run_batch(scenario, seeds, judged=judged)
    return {field.name: getattr(batch, field.name) for field in fields(Runs)}


def _load(path: Path) -> Runs:
    with np.load(path) as arrays:
        return Runs(**{field.name: arrays[field.name] for field in fields(Runs)})


def bound(scenario: Scenario) -> Array:
    """Return the Cramér–Rao bound on the 16 + m states after the last frame, (16 + m,) sigmas."""
    return _bound(scenario).sigma


def bound_at(scenario: Scenario, parts: Path) -> bounds.Bound:
    """Return the bound that `run` has left in its folder."""
    with np.load(_bound_name(scenario, parts)) as arrays:
        return bounds.Bound(arrays['root'], arrays['prior'])


def _bound_name(scenario: Scenario, parts: Path) -> Path:
    return parts / f'{_key(scenario)}_bound.npz'


def _bound_task(scenario: Scenario) -> dict[str, NDArray[Any]]:
    return asdict(_bound(scenario))


def _bound(scenario: Scenario) -> bounds.Bound:
    return bounds.at(scenario, [scenario.simulation.duration_s])[0]


def nees_interval(scenario: Scenario, limit: bounds.Bound, runs: int) -> consistency.Interval:
    """Return the interval of the mean NEES of a true filter in runs of a scenario.

    All begin with the same errors, those of the nominal values. What the data shows of a state
    does not depend on that; of what they do not show the first error stays, the same in all runs.
    """
    filter_, truth = Filter(scenario), Truth.from_scenario(scenario)
    true = nominal(truth, truth.motion.start_ns, filter_.augmentation)
    first = (state_error(filter_.start, true) / filter_.initial_sigma)[CALIBRATED.start:]
    return consistency.matched_interval(*limit.nees_moments(first), runs, _PROBABILITY)


def summarize(scenario: Scenario, runs: Runs, best: bounds.Bound | None = None
              ) -> dict[str, Any]:
    """Return what the runs of one scenario say, with the 95 % intervals of a true filter.

    RMS, bound and sigma are in the units of STATE_UNITS; values of optional states have theirs at
    the end of their name. Where `prior` is near 1 the data shows nothing of a state: sigma and
    bound are then the initial sigma, and the RMS what the nominal value is off by. The bound is
    made where it is not given.
    """
    best = best or _bound(scenario)
    n = len(runs.seed)
    augmentation = Augmentation.of(scenario.estimator.augment)
    names = (*STATE_NAMES, *augmentation.names)
    units = (*STATE_UNITS, *(name.rpartition('_')[2] for name in augmentation.names))
    unit = np.append(UNIT, augmentation.units)
    limit, prior = best.sigma, best.prior_part
    rms = np.sqrt(np.mean(runs.error[:, -1]**2, axis=0))
    nees = nees_interval(scenario, best, n)
    degrees = float(runs.nis_degrees.sum())
    nis = consistency.nis_interval(degrees, scenario.estimator.gate_probability, _PROBABILITY)
    ratio = consistency.rms_interval(n, _PROBABILITY)
    return {
        'runs': n,
        'duration_s': scenario.simulation.duration_s,
        'nees_degrees': len(names),
        'nees_mean': float(runs.nees[:, -1].mean()), 'nees_interval_95': list(nees),
        'nis_mean': float(runs.nis.sum() / degrees),
        'nis_interval_95': list(nis),
        'ratio_interval_95': list(ratio),
        'verdicts': dict(Counter(word for word in runs.verdict.tolist() if word)),
        'failed_tests': dict(Counter(
            name for each in runs.failed.tolist() for name in each.split('; ') if name)),
        'attitude_rms_arcsec': (np.sqrt(np.mean(runs.attitude_rms**2, axis=0))
                                / UNIT[0]).tolist(),
        'reprojection_rms_px': np.sqrt(np.mean(runs.reprojection_rms**2, axis=0)).tolist(),
        'states': {name: {'unit': units[k], 'rms': float(rms[k] / unit[k]),
                          'bound': float(limit[k] / unit[k]), 'ratio': float(rms[k] / limit[k]),
                          'prior': float(prior[k]),
                          'sigma': float(runs.sigma[:, -1, k].mean() / unit[k])}
                   for k, name in enumerate(names)},
    }


def finish(study: MonteCarlo, results: Sequence[Runs], out: Path, parts: Path) -> dict[str, Any]:
    """Write the summary (JSON) and beside it all runs (NPZ), drop the parts; return the summary.

    With a sweep the summary has one entry a value under ``points``.
    """
    points = [{**({study.key: value} if study.key else {}),
               **summarize(study.at(value), runs, bound_at(study.at(value), parts))}
              for value, runs in zip(study.values, results)]
    summary = {'sweep': study.key, 'points': points} if study.key else points[0]
    text = parameter_file.dump(study.scenario)
    merged = asdict(Runs.concatenate(results))
    merged['value'] = np.repeat([str(value) for value in study.values], study.runs)
    tasks.save(out.with_suffix('.npz'), {
        **merged, 'config': np.array(text), 'sweep': np.array(study.key)})
    write_text(out, json.dumps(summary, indent=1, allow_nan=False) + '\n')
    shutil.rmtree(parts)
    return summary
