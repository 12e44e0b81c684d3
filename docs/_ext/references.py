"""Finds names of the Python domain by an index.

Sphinx looks through all objects for each name that is written without its module, as annotations
are; with some ten thousand objects that was a quarter of the time of a build.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from sphinx.domains.python import ObjectEntry, PythonDomain
from sphinx.environment import BuildEnvironment


class IndexedPythonDomain(PythonDomain):
    """The Python domain, which finds a name without its module in an index of last parts."""

    _size = -1
    _by_last: dict[str, list[str]]

    def find_obj(
        self,
        env: BuildEnvironment,
        modname: str,
        classname: str,
        name: str,
        type: str | None,
        searchmode: int = 0,
    ) -> list[tuple[str, ObjectEntry]]:
        """The objects that a name means, as the parent class finds them."""
        name = name.removesuffix("()")
        if searchmode != 1 or not name:
            return super().find_obj(env, modname, classname, name, type, searchmode)
        objects = self.objects
        if len(objects) != self._size:
            index = defaultdict(list)
            for each in objects:
                index[each.rpartition(".")[2]].append(each)
            self._size, self._by_last = len(objects), index
        kinds = list(self.object_types) if type is None else self.objtypes_for_role(type) or []
        exact = [
            ".".join(filter(None, parts)) for parts in ((modname, classname, name), (modname, name))
        ]
        for full in (*(exact if modname else ()), name):
            if full in objects and objects[full].objtype in kinds:
                return [(full, objects[full])]
        return [
            (full, objects[full])
            for full in self._by_last.get(name.rpartition(".")[2], ())
            if full.endswith(f".{name}") and objects[full].objtype in kinds
        ]


def setup(app: Any) -> dict[str, object]:
    """Sphinx's hook of an extension."""
    app.add_domain(IndexedPythonDomain, override=True)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
