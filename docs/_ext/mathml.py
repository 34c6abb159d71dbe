# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Equations as MathML, which browsers draw themselves: no script, no image, no network."""

from docutils.nodes import SkipNode
from latex2mathml.converter import convert


def _visit_inline(self, node):
    self.body.append(convert(node.astext(), display='inline'))
    raise SkipNode


def _visit_block(self, node):
    self.body.append(self.starttag(node, 'div', CLASS='math'))
    self.body.append(convert(node.astext(), display='block') + '</div>\n')
    raise SkipNode


def setup(app):
    """Add the renderer ``mathml``."""
    app.add_html_math_renderer('mathml', (_visit_inline, None), (_visit_block, None))
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
