# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a user should know is said in order, each kind as often as is useful."""

from starcal_ros.measurements.notices import Notices


def test_sentences_are_taken_once_in_their_order():
    notices = Notices()
    notices.say('a')
    notices.once('kind', 'b')
    notices.say('a')
    assert notices.take() == ['a', 'b', 'a']
    assert notices.take() == []


def test_a_kind_is_said_once_whatever_is_taken_between():
    notices = Notices()
    notices.once(('frame', True), 'first')
    notices.once(('frame', True), 'second')
    notices.once(('frame', False), 'other')
    assert notices.take() == ['first', 'other']
    notices.once(('frame', True), 'third')
    assert notices.take() == []


def test_numbers_add_up_until_they_are_told_and_begin_again():
    notices = Notices()
    notices.count('stars rejected', 2)
    notices.count('frames rejected', 0)
    notices.count('stars rejected', 5)
    assert notices.take() == ['7 stars rejected']
    notices.count('stars rejected', 1)
    assert notices.take() == ['1 stars rejected']
    assert notices.take() == []
