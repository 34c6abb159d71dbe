# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Sphinx: pages in Markdown, the reference out of the docstrings, nothing from the network."""

from importlib.util import find_spec
from pathlib import Path
import sys

sys.path[:0] = [str(Path(__file__).parent / '_ext'), str(Path(__file__).parents[1])]

from starcal_ros import __version__                                             # noqa: E402

project = 'starcal_ros'
copyright = '2026 starcal_ros contributors, Apache-2.0'
version = release = __version__
extensions = ['mathml', 'myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.autosummary',
              'sphinx.ext.napoleon']
exclude_patterns = ['_ext', '_templates']
templates_path = ['_templates']
default_role = 'py:obj'
highlight_language = 'none'

html_theme = 'furo'
html_math_renderer = 'mathml'
html_static_path = ['_static']
html_css_files = ['starcal.css']
html_title = f'starcal_ros {version}'

myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 3

autosummary_generate = ['api.rst']
suppress_warnings = ['ref.python']         # a field of two classes is no link
autodoc_default_options = {
    'members': True, 'member-order': 'bysource', 'ignore-module-all': True}
autodoc_typehints = 'none'                      # the docstrings say more: shapes, units, frames
autodoc_mock_imports = [] if find_spec('rclpy') else [
    'rclpy', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'rcl_interfaces',
    'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs']
napoleon_google_docstring = False
napoleon_use_ivar = True


def setup(app):
    """Leave out what a named tuple says of each of its fields; the docstring says more."""
    app.connect('autodoc-skip-member', lambda app, what, name, member, skip, options:
                True if type(member).__name__ == '_tuplegetter' else None)
