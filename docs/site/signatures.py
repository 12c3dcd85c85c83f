"""Signatures of the reference as `help` and editors show them, where a reader of sources alone cannot know them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import griffe


class Signatures(griffe.Extension):
    """Follows two decorators: `_with_arguments_of` shows a function with the arguments of another, `_record` makes a
    dataclass."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called when a package has been read."""
        for function in pkg.functions.values():
            for decorator in function.decorators:
                called, _, argument = str(decorator.value).partition("(")
                if called == "_with_arguments_of":
                    function.parameters = pkg.functions[argument.rstrip(")")].parameters
        for kind in _classes(pkg):
            for decorator in list(kind.decorators):
                if str(decorator.value) == "_record":
                    name = griffe.ExprName("dataclass", parent=kind.module)
                    line = decorator.lineno
                    kind.decorators.append(griffe.Decorator(name, lineno=line, endlineno=line))


def _classes(module: griffe.Module) -> Iterator[griffe.Class]:
    for member in module.members.values():
        if member.is_alias:
            continue
        if isinstance(member, griffe.Module):
            yield from _classes(member)
        elif isinstance(member, griffe.Class):
            yield member
