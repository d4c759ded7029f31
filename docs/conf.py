"""Sphinx configuration: `./bootstrap docs` builds with warnings as errors."""

from __future__ import annotations

import os
from pathlib import Path
import sys

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT / 'docs'), str(ROOT)]
# The process that runs the notebook imports this tree too.
os.environ['PYTHONPATH'] = os.pathsep.join(filter(None, (str(ROOT), os.environ.get('PYTHONPATH'))))

import figures  # noqa: E402
import generate  # noqa: E402

import lunar_rover_sim  # noqa: E402

project = 'lunar_rover_sim'
author = 'lunar_rover_sim developers'
copyright = f'2026, {author}'  # noqa: A001
version = release = lunar_rover_sim.__version__

extensions = ['myst_nb', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
exclude_patterns = ['_build', '_generated/*.md']
source_suffix = {'.md': 'myst-nb', '.ipynb': 'myst-nb'}

myst_enable_extensions = ['colon_fence', 'deflist', 'substitution']
# Figures that pages take from docs/measurements/results.
myst_substitutions = figures.substitutions()
myst_heading_anchors = 3
# Included parts begin below the title of the page that includes them.
suppress_warnings = ['myst.header']
# The notebook runs at every build: what it shows is what the code does.
nb_execution_mode = 'force'
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

nitpicky = True
# Types of other packages are named in signatures; their documentation is not at hand offline.
nitpick_ignore_regex = [('py:.*', r'.*')]
# Docstrings have Google's sections; `code` in them is code.
default_role = 'literal'
napoleon_numpy_docstring = False
napoleon_use_ivar = True
autodoc_typehints = 'signature'
autodoc_member_order = 'bysource'
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ('Array', 'ArrayLike', 'F32', 'Stamps')}

html_theme = 'furo'
html_static_path = ['_static']
html_css_files = ['wide.css']
html_title = f'lunar_rover_sim {release}'
html_show_sourcelink = False
html_copy_source = False

# Names, and tables of measurements, come from the code.
generate.write_for_sphinx(Path(__file__).parent)
