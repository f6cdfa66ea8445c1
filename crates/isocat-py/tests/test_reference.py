"""The reference in the documentation is what the docstrings say: UPDATE_GOLDEN=1 writes it."""

from __future__ import annotations

import inspect
import os
import re
from pathlib import Path
from typing import Any

import isocat
import isocat._isocat
import pytest

PAGE = Path(__file__).resolve().parents[3] / "docs" / "python-api.md"
STUB = Path(isocat.__file__).with_name("_isocat.pyi")

HEAD = """# Reference of the library for Python

Made of the docstrings of the package; `help(isocat)` says the same. [python.md](python.md) is the
way in. 
"""


def signature(of: Any) -> str:
    try:
        text = str(inspect.signature(of))
    except (TypeError, ValueError):
        return "(...)"
    return re.sub(r"^\(\$?self(, /(?=[,)]))?(, )?", "(", text)


def document(of: Any) -> str:
    """A docstring of numpy's style as Markdown."""
    text = inspect.getdoc(of) or ""
    lines, section = [], ""
    rows = text.splitlines()
    at = 0
    while at < len(rows):
        row = rows[at]
        if at + 1 < len(rows) and re.fullmatch(r"-{3,}", rows[at + 1]):
            section = row
            lines += (
                [f"*{section}*", ""] if section != "Examples" else ["*Examples*", "", "```python"]
            )
            at += 2
            continue
        if section == "Examples":
            lines.append(row)
        elif section and row and not row.startswith(" "):
            lines.append(f"- `{row}`")
        elif section and row:
            lines.append(f"  {row.strip()}")
        else:
            lines.append(row)
        at += 1
    if section == "Examples":
        lines.append("```")
    # Markdown's marks of code in the place of those of reStructuredText.
    return re.sub(r"(?<!`)``([^`]+)``(?!`)", r"`\1`", "\n".join(lines)).strip()


def members(of: type) -> list[tuple[str, Any]]:
    return [(name, value) for name, value in vars(of).items() if not name.startswith("_")]


def page() -> str:
    parts = [HEAD]
    for name in isocat.__all__:
        value = getattr(isocat, name)
        if inspect.isclass(value):
            bare = issubclass(value, BaseException) or value.__module__ == "isocat"
            head = "" if bare and name != "Segment" else signature(value)
            parts.append(f"## `isocat.{name}{head}`\n\n{document(value)}\n")
            for member, inside in sorted(members(value)):
                inner = getattr(value, member)
                if callable(inner):
                    parts.append(f"### `{name}.{member}{signature(inner)}`\n\n{document(inner)}\n")
                elif inspect.getdoc(inside):
                    parts.append(f"### `{name}.{member}`\n\n{document(inside)}\n")
        elif callable(value):
            parts.append(f"## `isocat.{name}{signature(value)}`\n\n{document(value)}\n")
    return "\n".join(parts)


def test_the_page_is_what_the_docstrings_say() -> None:
    if not PAGE.parent.exists():
        pytest.skip("no documentation beside these tests")
    text = page()
    if os.environ.get("UPDATE_GOLDEN"):
        PAGE.write_text(text, encoding="utf-8")
    assert PAGE.read_text(encoding="utf-8") == text, "UPDATE_GOLDEN=1 writes it anew"


def test_everything_public_is_documented() -> None:
    bare = []
    for name in isocat.__all__:
        value = getattr(isocat, name)
        if name == "__version__":
            continue
        if not inspect.getdoc(value):
            bare.append(name)
        if inspect.isclass(value) and not issubclass(value, BaseException):
            bare += [
                f"{name}.{member}"
                for member, inside in members(value)
                if not inspect.getdoc(inside)
            ]
    assert not bare


def test_the_stub_tells_what_there_is() -> None:
    """Names of classes and of their members in the stub are those of the module, and the other way
    round.
    """
    told: dict[str, set[str]] = {}
    current = ""
    for line in STUB.read_text(encoding="utf-8").splitlines():
        if found := re.match(r"class (\w+)", line):
            current = found[1]
            told[current] = set()
        elif found := re.match(r"    def (\w+)\(", line):
            told[current].add(found[1])
        elif found := re.match(r"def (\w+)\(", line):
            told[found[1]] = set()
    there = vars(isocat._isocat)
    names = {name for name in there if not name.startswith("_")}
    assert {name for name in told if not name.startswith("_")} == names
    for name, members_told in told.items():
        if inspect.isclass(there.get(name)):
            own = {member for member in vars(there[name]) if not member.startswith("_")}
            assert {member for member in members_told if not member.startswith("_")} == own, name
