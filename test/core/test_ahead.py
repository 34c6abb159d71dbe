# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Items made ahead are those of the iterator, made in one thread, and one ahead alone."""

from itertools import islice
import threading

import pytest

from starcal_ros.core.ahead import ahead


def test_items_come_in_their_order_from_one_other_thread():
    threads = set()

    def items():
        for k in range(100):
            threads.add(threading.get_ident())
            yield k
    assert list(ahead(items())) == list(range(100))
    assert len(threads) == 1 and threading.get_ident() not in threads
    assert list(ahead(iter([]))) == [] and list(ahead(iter([None, None]))) == [None, None]


def test_one_item_is_made_ahead():
    made = []
    given = ahead(made.append(k) or k for k in range(10))
    assert [next(given) for _ in range(3)] == [0, 1, 2]
    given.close()
    assert made == [0, 1, 2, 3]


def test_an_error_comes_where_its_item_would_have_come():
    def items():
        yield 1
        yield 2
        raise ValueError('the third')
    given = ahead(items())
    assert list(islice(given, 2)) == [1, 2]
    with pytest.raises(ValueError, match='the third'):
        next(given)


def test_a_generator_ends_in_its_thread_though_not_all_is_taken():
    """As sqlite demands, whose connections belong to the thread that made them."""
    threads = []

    def items():
        try:
            while True:
                threads.append(threading.get_ident())
                yield 0
        finally:
            threads.append(threading.get_ident())
    given = ahead(items())
    next(given)
    given.close()
    assert len(threads) == 3 and len(set(threads)) == 1
