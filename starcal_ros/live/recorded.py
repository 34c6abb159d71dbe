# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What was heard of an estimator, out of a recording that has its results.

A run of hours has thousands of frames: of at most `MOST` of them, spread evenly, a moment is kept,
with all that was heard before the next frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from pathlib import Path
from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Ints
from starcal_ros.live.heard import TOPICS, Seen
from starcal_ros.messages import topics
from starcal_ros.messages.cdr import Messages, RecordError
from starcal_ros.recording.bag import open_bag
from starcal_ros.recording.mcap_chunks import LATEST
from starcal_ros.recording.writer import typestore

MOST = 500
"""Moments of a recording that are kept, unless all are asked for."""


class Moment(NamedTuple):
    """What had been heard by a time.

    Attributes
    ----------
    stamp_ns, log_ns : int
        Of the state: of which frame it is, and when it was recorded.
    prefix : str
        Namespace of the estimator, as in '/left'; '' of none.
    seen : Seen
    """

    stamp_ns: int
    log_ns: int
    prefix: str
    seen: Seen


def moments(path: Path, namespace: str | None = None,
            on_progress: Callable[[float], None] = lambda part: None, most: int | None = None
            ) -> Iterator[Moment]:
    """Yield what a recording says of a calibration, in the order of time; never nothing.

    Parameters
    ----------
    path : Path
        A recording with the results of an estimator.
    namespace : str, optional
        Of the estimator, where there are several.
    on_progress : callable, optional
        Called with the part that has been read, 0 to 1.
    most : int, optional
        How many moments at most, evenly spread; MOST by default.

    Raises
    ------
    RecordError
        Where the recording can not be read or has no results.
    """
    bag = open_bag(path)
    prefix = _prefix([topic.name for topic in bag.topics()], path, namespace)
    named = {prefix + topic.recorded: topic for topic in TOPICS}
    state = prefix + topics.STATE.recorded
    ends = _ends(np.sort(bag.log_times(state)), MOST if most is None else most, path)
    log_ns = 0
    seen, newest, waiting = Seen(silent_s=0.0), dict[str, bytes](), list[tuple[int, str, bytes]]()
    for stretch in bag.in_order(named):
        for name, log_time, messages in stretch.messages:
            waiting += zip(log_time.tolist(), [name] * len(messages), _each(messages))
        waiting.sort(key=lambda each: each[0])
        done = 0
        for time_ns, name, data in waiting:
            if time_ns >= stretch.before_ns:
                break
            done += 1
            while time_ns >= ends[0]:
                ends.pop(0)
                yield Moment(_take(seen, named, newest, path), log_ns, prefix, copy(seen))
            newest[name] = data
            log_ns = time_ns if name == state else log_ns
        del waiting[:done]
        on_progress(stretch.done)
    yield Moment(_take(seen, named, newest, path), log_ns, prefix, copy(seen))


def _prefix(names: list[str], path: Path, namespace: str | None) -> str:
    """Return the namespace of the estimator whose results a recording has, as in '/left'."""
    end = topics.STATE.recorded
    found = sorted(name.removesuffix(end) for name in names if name.endswith(end))
    if not found:
        raise RecordError(f'{path} has no results of an estimator (no topic {end}): calibrate it, '
                          'starcal calibrate BAG --out RESULT.json, and give RESULT.json')
    of = ', '.join(each or '/' for each in found)
    if namespace is not None:
        wanted = namespace.strip('/')
        if wanted not in (each.strip('/') for each in found):
            raise RecordError(f'{path} has no results of an estimator in /{wanted}; --namespace '
                              f'chooses one of {of}')
        return f'/{wanted}' if wanted else ''
    if len(found) > 1:
        raise RecordError(f'{path} has the results of {len(found)} estimators: --namespace '
                          f'chooses one of {of}')
    return found[0]


def _ends(frames_ns: Ints, most: int, path: Path) -> list[int]:
    """Return before which times the moments end: each with the next frame, the last never."""
    if not len(frames_ns):
        raise RecordError(f'{path} has no result of an estimator: no frame gave an attitude')
    k = np.unique(np.linspace(0, len(frames_ns) - 1, min(most, len(frames_ns))).astype(int))
    ends: list[int] = [*frames_ns, LATEST][1:]
    return [int(ends[each]) for each in k]


def _each(messages: Messages) -> Iterator[bytes]:
    whole = messages.data.data
    for start, size in zip(messages.start.tolist(), messages.size.tolist()):
        yield bytes(whole[start:start + size])


def _take(seen: Seen, named: dict[str, topics.Topic], newest: dict[str, bytes], path: Path
          ) -> int:
    """Hear the newest messages of each topic, and return the stamp of the state."""
    for name, data in newest.items():
        topic = named[name]
        try:
            seen.take(topic, typestore().deserialize_cdr(data, topic.type_name))
        except Exception as error:      # rosbags raises what the bytes lead it to
            raise RecordError(f'{path}: a message of {name} cannot be read: '
                              f'{type(error).__name__} {error}') from None
    newest.clear()
    return 0 if seen.state is None else round(float(seen.state[0]) * 1e9)
