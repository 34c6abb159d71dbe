# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Text from outside does nothing to a terminal."""

from hypothesis import given, strategies as st
import pytest
from rich.console import Console

from starcal_ros.files.foreign import clean, literal
from starcal_ros.messages.cdr import RecordError


@pytest.mark.parametrize('text, shown', [
    ('/imu/data_raw', '/imu/data_raw'), ('σ °/h Ψ ″ […]', 'σ °/h Ψ ″ […]'),
    ('\x1b[31mred\x07', '\\x1b[31mred\\x07'), ('\x9b31m', '\\x9b31m'), ('a\rb\nc', 'a\\rb\\nc'),
    ('\u202eevil', '\\u202eevil'), ('run\udcff', 'run\\udcff'), ('\x7f', '\\x7f')])
def test_what_has_no_form_is_written_out(text, shown):
    assert clean(text) == shown


@given(st.text(st.characters(), max_size=30))
def test_no_text_does_anything_to_a_terminal(text):
    assert clean(text).isprintable() and clean(clean(text)) == clean(text)
    assert all(line.isprintable() for line in clean(text, keep='\n').split('\n'))
    assert str(RecordError(text)).isprintable()


@given(st.text(st.sampled_from('[]/abred \\:x\x1b\n'), max_size=30))
def test_brackets_are_no_styles(text):
    console = Console(record=True, width=1000, force_terminal=False, soft_wrap=True)
    console.print(literal(text))
    assert console.export_text().rstrip('\n') == clean(text, keep='\n').rstrip('\n')
