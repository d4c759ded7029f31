"""HTML pages from the Jinja2 templates of a package, everything inserted being escaped.

Apart from `paths`, which every command imports: Jinja2 takes a fifth of their start.
"""

from __future__ import annotations

import base64
from collections.abc import Callable

import jinja2


def template(package: str, name: str, **filters: Callable[..., object]) -> jinja2.Template:
    """Return a template from the folder `templates` of a package (`lunar_rover_sim.judge.slam`).

    Values are escaped as HTML. A value that is missing is an error, not an empty text.
    filters: functions that the template knows by these names, besides those of Jinja2
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(filters)
    return environment.get_template(name)


def data_uri(content: bytes, media_type: str) -> str:
    """Return a file as a data URI, which holds it in the page itself."""
    return f'data:{media_type};base64,{base64.b64encode(content).decode("ascii")}'
