# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo: many runs of one scenario, or of several that differ in one parameter.

Batches of runs share a process (the filter's leading axis) and are spread over cores, or over a
Dask cluster, by joblib. Each finished batch is kept in a folder beside the result until all are
there, so that a killed study goes on where it was.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
import json
from pathlib import Path
import shutil
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, parameters
from starcal_ros.core.arrays import Array
from starcal_ros.evaluation import bounds, consistency
from starcal_ros.evaluation.batch import Runs, nominal, run_batch, state_error
from starcal_ros.files.output import whole, write_text
from starcal_ros.filter.augmentation import Augmentation
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.simulation.truth import Truth

BATCH = 25              # runs in a batch: enough to share the work of a frame, and to keep often
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

    def seeds(self) -> list[list[int]]:
        """Return the seeds of each batch: those from the scenario's own on."""
        first = self.scenario.simulation.seed
        seeds = list(range(first, first + self.runs))
        return [seeds[low:low + BATCH] for low in range(0, self.runs, BATCH)]


def run(study: MonteCarlo, parts: Path, jobs: int = -1, backend: str = 'loky',
        on_progress: Callable[[float], None] = lambda part: None) -> list[Runs]:
    """Run a study, or what is missing of it.

    Parameters
    ----------
    study : MonteCarlo
        What to run.
    parts : Path
        Folder of the finished batches.
    jobs : int
        Processes, -1 for one a core.
    backend : str
        joblib's: ``loky``, or ``dask`` where a ``distributed.Client`` is open.
    on_progress : callable
        Called with the part done, 0 to 1.

    Returns
    -------
    list of Runs
        One for each value.
    """
    parts.mkdir(parents=True, exist_ok=True)
    tasks = [(study.at(value), seeds, study.judged)
             for value in study.values for seeds in study.seeds()]
    names = [parts / f'{scenario.replace({"simulation.seed": 0}).sha256[:16]}'
             f'_{seeds[0]}_{len(seeds)}{"_judged" if study.judged else ""}.npz'
             for scenario, seeds, _ in tasks]
    complete(names, _task, tasks, jobs, backend, on_progress)
    batches = [_load(name) for name in names]
    each = len(study.seeds())
    return [Runs.concatenate(batches[low:low + each]) for low in range(0, len(batches), each)]


def complete(names: Sequence[Path], task: Callable[..., dict[str, NDArray[Any]]],
             arguments: Sequence[tuple[Any, ...]], jobs: int = -1, backend: str = 'loky',
             on_progress: Callable[[float], None] = lambda part: None) -> None:
    """Run the tasks whose file is not there yet; keep what each returns as soon as it is done.

    Parameters
    ----------
    names : sequence of Path
        An NPZ file for each task, in a folder that exists.
    task : callable
        Returns the arrays of one file.
    arguments : sequence of tuple
        Of each task.
    jobs, backend, on_progress
        As for `run`.
    """
    missing = [k for k, name in enumerate(names) if not name.exists()]
    on_progress(1.0 - len(missing) / len(names))
    with joblib.parallel_config(backend=backend, n_jobs=jobs):
        results = joblib.Parallel(return_as='generator_unordered')(
            joblib.delayed(_numbered)(k, task, arguments[k]) for k in missing)
        for done, (k, arrays) in enumerate(results, start=1):
            save(names[k], arrays)
            on_progress(1.0 - (len(missing) - done) / len(names))


def _numbered(index: int, task: Callable[..., dict[str, NDArray[Any]]],
              arguments: tuple[Any, ...]) -> tuple[int, dict[str, NDArray[Any]]]:
    return index, task(*arguments)


def _task(scenario: Scenario, seeds: Sequence[int], judged: bool) -> dict[str, NDArray[Any]]:
    batch = run_batch(scenario, seeds, judged=judged)
    return {field.name: getattr(batch, field.name) for field in fields(Runs)}


def save(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write an NPZ file so that it is there whole or not at all."""
    with whole(path) as draft, draft.open('wb') as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _load(path: Path) -> Runs:
    with np.load(path) as arrays:
        return Runs(**{field.name: arrays[field.name] for field in fields(Runs)})


def bound(scenario: Scenario) -> Array:
    """Return the Cramér–Rao bound on the 16 + m states after the last frame, (16 + m,) sigmas."""
    return _bound(scenario).sigma


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


def summarize(scenario: Scenario, runs: Runs) -> dict[str, Any]:
    """Return what the runs of one scenario say, with the 95 % intervals of a true filter.

    RMS, bound and sigma are in the units of STATE_UNITS; values of optional states have theirs at
    the end of their name. Where `prior` is near 1 the data shows nothing of a state: sigma and
    bound are then the initial sigma, and the RMS what the nominal value is off by.
    """
    n = len(runs.seed)
    augmentation = Augmentation.of(scenario.estimator.augment)
    names = (*STATE_NAMES, *augmentation.names)
    units = (*STATE_UNITS, *(name.rpartition('_')[2] for name in augmentation.names))
    unit = np.append(UNIT, augmentation.units)
    best = _bound(scenario)
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
    points = [{**({study.key: value} if study.key else {}), **summarize(study.at(value), runs)}
              for value, runs in zip(study.values, results)]
    summary = {'sweep': study.key, 'points': points} if study.key else points[0]
    text = parameter_file.dump(study.scenario)
    merged = asdict(Runs.concatenate(results))
    merged['value'] = np.repeat([str(value) for value in study.values], study.runs)
    save(out.with_suffix('.npz'), {**merged, 'config': np.array(text),
                                   'sweep': np.array(study.key)})
    write_text(out, json.dumps(summary, indent=1, allow_nan=False) + '\n')
    shutil.rmtree(parts)
    return summary
