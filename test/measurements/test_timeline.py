# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which stamps are believed: rule by rule, and however the messages are cut into batches."""

import numpy as np
import pytest

from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.measurements.timeline import NEVER_NS, SET_BACK_S, Timeline

PERIOD_NS = 10**7
LEAP, SET_BACK = 5 * PERIOD_NS, round(SET_BACK_S * 1e9)


def samples(stamps_ns):
    """Return gyro samples with these stamps; the rate is the place in the order of arrival."""
    return GyroSamples(np.array(stamps_ns, np.int64),
                       np.arange(len(stamps_ns))[:, None] * np.ones(3))


def steady(begin, count):
    """Return stamps a period apart, from a number of periods on."""
    return [(begin + k) * PERIOD_NS for k in range(count)]


def stretches(stamps_ns, cuts=()):
    """Return the stretches, each the places of its messages, and the places of the dropped."""
    timeline = Timeline(PERIOD_NS, 10**6, 5.0)
    messages, current, dropped = samples(stamps_ns), [], 0
    bounds = [0, *cuts, len(messages)]
    for low, high in zip(bounds[:-1], bounds[1:]):
        current += timeline.add(messages[low:high])
        dropped += sum(number for number, *_ in timeline.take_dropped())
    found = [GyroSamples.concatenate(parts).rate[:, 0].astype(int).tolist()
             for parts in (current, *timeline.later)]
    return found, dropped


def one_by_one(stamps_ns):
    """Return the stretches by the rules of the module, message by message."""
    found, newest, held = [[]], NEVER_NS, []
    for k, stamp in enumerate(stamps_ns):
        while True:
            begun, reached = ((stamps_ns[held[0]], stamps_ns[held[-1]]) if held
                              else (NEVER_NS, NEVER_NS))
            if newest < stamp <= newest + LEAP:
                found[-1].append(k)
                newest, held = stamp, []
            elif held and begun > newest and stamp > reached:
                found[-1] += held
                newest, held = reached, []
                continue
            elif held and begun <= newest and reached < stamp <= newest:
                held.append(k)
                if stamp - begun >= SET_BACK:
                    found.append(held)
                    newest, held = stamp, []
            elif not (begun <= stamp <= reached or newest - SET_BACK < stamp <= newest):
                held = [k]
            break
    return found


def test_stamps_in_order_are_all_believed():
    assert stretches(steady(0, 50)) == ([list(range(50))], 0)


def test_first_message_is_believed_with_the_second():
    assert stretches(steady(0, 1)) == ([[]], 0)


@pytest.mark.parametrize('stamp', [7 * LEAP + 1, 10**18, -1, -10**18, 3 * PERIOD_NS])
def test_one_wrong_stamp_costs_one_message(stamp):
    stamps = steady(0, 20) + [stamp] + steady(21, 20)
    assert stretches(stamps) == ([[k for k in range(41) if k != 20]], 1)


@pytest.mark.parametrize('stamp', [10**18, -10**18])
def test_a_wrong_stamp_at_the_very_beginning_costs_one_message(stamp):
    found, _ = stretches([stamp, *steady(0, 20)])
    assert found == [list(range(1, 21))] or found == [list(range(21))]
    # far back it is older than all that follow: as before a long silence
    assert (found[0][0] == 0) == (stamp < 0)


@pytest.mark.parametrize('silence', [2, 6, 10**6])
def test_silence_costs_nothing(silence):
    stamps = steady(0, 20) + steady(20 + silence, 20)
    assert stretches(stamps) == ([list(range(40))], 0)


def test_message_after_a_silence_waits_for_the_next():
    timeline = Timeline(PERIOD_NS, 100, 5.0)
    timeline.add(samples(steady(0, 20)))
    assert timeline.add(samples(steady(30, 1))) == []
    assert len(timeline.add(samples(steady(31, 1)))) == 2


def test_messages_far_apart_are_all_believed():
    """The period may be stated wrong."""
    assert stretches([k * 100 * LEAP for k in range(20)]) == ([list(range(19))], 0)


@pytest.mark.parametrize('again', [1, 50, 299])
def test_what_is_sent_again_for_less_than_a_while_is_dropped(again):
    stamps = steady(0, 500) + steady(500 - again, again + 10)
    assert stretches(stamps) == ([[*range(500), *range(500 + again, 510 + again)]], again)


@pytest.mark.parametrize('start', [0, -10**9, 150])
def test_clock_that_is_set_back_begins_a_stretch_with_all_its_messages(start):
    stamps = steady(0, 500) + steady(start, 400)
    assert stretches(stamps) == ([list(range(500)), list(range(500, 900))], 0)


def test_each_time_the_clock_is_set_back_a_stretch_begins():
    found, dropped = stretches(steady(0, 400) * 4)
    assert dropped == 0
    assert found == [list(range(low, low + 400)) for low in range(0, 1600, 400)]


def test_sorting_follows_the_rules_however_the_messages_are_cut():
    """Random walks with silences, repeats, wrong stamps and clocks set back."""
    rng = np.random.default_rng(1)
    n_stretches = 0
    for _ in range(60):
        steps = rng.choice([1, 1, 1, 2, 0, -1, 7, -40, 300], 400,
                           p=[.4, .3, .2, .03, .02, .02, .01, .01, .01])
        steps[rng.integers(0, 400, 2)] = -1500
        stamps = np.cumsum(steps) * PERIOD_NS
        stamps[rng.integers(0, 400, 3)] += rng.integers(-10**4, 10**4, 3) * PERIOD_NS
        expected = one_by_one(stamps.tolist())
        cuts = np.sort(rng.integers(0, 400, int(rng.integers(0, 40)))).tolist()
        assert stretches(stamps)[0] == expected
        assert stretches(stamps, cuts)[0] == expected
        n_stretches += len(expected)
    assert n_stretches > 120


def test_overtaken_and_rejoined():
    """A stretch that passes the end of the one before it, and is made part of that."""
    timeline = Timeline(PERIOD_NS, 10**6, 5.0)
    timeline.add(samples(steady(0, 500)))
    assert timeline.add(samples(steady(100, 400))) == []
    assert timeline.overtaken_ns is None and len(timeline.later) == 1
    timeline.add(samples(steady(500, 10)))
    assert timeline.overtaken_ns == 500 * PERIOD_NS
    again = GyroSamples.concatenate(timeline.rejoin())
    assert again.stamp_ns.tolist() == steady(500, 10)
    assert sum(number for number, *_ in timeline.take_dropped()) == 400
    assert timeline.end_ns == 509 * PERIOD_NS and not timeline.later
    assert len(timeline.add(samples(steady(510, 1)))) == 1


def test_a_stretch_that_waits_keeps_its_newest_messages():
    timeline = Timeline(PERIOD_NS, 500, 5.0)
    timeline.add(samples(steady(0, 5000)))
    for begin in range(0, 4000, 100):
        timeline.add(samples(steady(begin, 100)))
    waiting = GyroSamples.concatenate(timeline.later[0])
    assert waiting.stamp_ns.tolist() == steady(3500, 500)
    assert sum(number for number, *_ in timeline.take_dropped()) == 3500
