# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Equations as MathML, which browsers draw themselves: no script, no image, no network."""

import re

from docutils.nodes import SkipNode
from latex2mathml.converter import convert
from sphinx.util import logging

_LOG = logging.getLogger(__name__)


def _visit_inline(self, node):
    self.body.append(_mathml(node, 'inline'))
    raise SkipNode


def _visit_block(self, node):
    self.body.append(self.starttag(node, 'div', CLASS='math') + _mathml(node, 'block')
                     + '</div>\n')
    raise SkipNode


def _mathml(node, display):
    # The converter knows the environment that may stand alone, and lets pass what it knows not.
    mathml = convert(node.astext().replace('{aligned}', '{align*}'), display=display)
    if re.search(r'\\[a-zA-Z]|>&<', mathml):
        _LOG.warning('an equation with what has no MathML: %s', node.astext(), location=node)
    return mathml


def setup(app):
    """Add the renderer ``mathml``."""
    app.add_html_math_renderer('mathml', (_visit_inline, None), (_visit_block, None))
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
