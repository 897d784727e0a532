"""Where the values of a TOML text stand, so that one can be replaced and every comment and blank stays.

The text has been read by ``tomllib`` before, so that this scanner meets valid TOML only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

Path = tuple[str | int, ...]
"""Keys and positions that lead to a value, such as ``("agents", 0, "dynamics", 1)``."""

_BLANK = " \t"
_QUOTES = ('"""', "'''", '"', "'")
_ESCAPES = {'\\"': '"', "\\\\": "\\"}


@dataclass(frozen=True)
class Span:
    """A value ``text[start:end]`` and where its key begins; elements of arrays begin at their key."""

    key: int
    start: int
    end: int


@dataclass
class Places:
    """What stands where: values by their paths, and the headings of tables, as (path, begin, end of the heading)."""

    values: dict[Path, Span] = field(default_factory=dict)
    headings: list[tuple[Path, int, int]] = field(default_factory=list)


def places(text: str) -> Places:
    """Return where the values and headings of a valid TOML text stand.

    Examples
    --------
    >>> text = 'a = 1 # one\\n[[b]]\\nc = [2, "x"]'
    >>> {path: text[span.start:span.end] for path, span in places(text).values.items()}
    {('a',): '1', ('b', 0, 'c', 0): '2', ('b', 0, 'c', 1): '"x"', ('b', 0, 'c'): '[2, "x"]'}
    """
    return _Scanner(text).run()


class _Scanner:
    def __init__(self, text: str) -> None:
        self._text, self._at = text, 0
        self._found = Places()
        self._counts: dict[Path, int] = {}

    def run(self) -> Places:
        """Go through the text line by line."""
        table: Path = ()
        while self._skip_lines():
            if self._text[self._at] == "[":
                table = self._heading()
            else:
                self._entry(table)
        return self._found

    def _skip_lines(self) -> bool:
        """Go to the next character that is no blank, line end or comment; False at the end of the text."""
        while self._at < len(self._text):
            if self._text[self._at] == "#":
                end = self._text.find("\n", self._at)
                self._at = len(self._text) if end < 0 else end
            elif self._text[self._at] in " \t\r\n":
                self._at += 1
            else:
                return True
        return False

    def _heading(self) -> Path:
        """Read ``[a.b]`` or ``[[a.b]]``, and return the path of the table that it opens."""
        begin = self._at
        is_array = self._text.startswith("[[", begin)
        self._at += 2 if is_array else 1
        keys = list(self._keys("]"))
        self._at += 2 if is_array else 1
        path: Path = ()
        for number, key in enumerate(keys):
            path = (*path, key)
            if is_array and number == len(keys) - 1:
                self._counts[path] = self._counts.get(path, 0) + 1
            # A table within an array of tables belongs to its last element.
            if path in self._counts:
                path = (*path, self._counts[path] - 1)
        self._found.headings.append((path, begin, self._at))
        return path

    def _keys(self, end: str) -> Iterator[str]:
        """Yield the parts of a dotted key, up to a character behind it."""
        while True:
            self._blanks()
            yield self._key()
            self._blanks()
            if self._text[self._at] == end:
                return
            self._at += 1  # the dot

    def _key(self) -> str:
        begin = self._at
        if self._text[begin] in "\"'":
            self._string()
            inner = self._text[begin + 1 : self._at - 1]
            return inner if self._text[begin] == "'" else _unescaped(inner)
        while self._text[self._at].isalnum() or self._text[self._at] in "_-":
            self._at += 1
        return self._text[begin : self._at]

    def _entry(self, table: Path) -> None:
        """Read ``key = value``."""
        key = self._at
        path = (*table, *self._keys("="))
        self._at += 1
        self._blanks()
        self._value(path, key)

    def _value(self, path: Path, key: int) -> None:
        start = self._at
        opening = self._text[start]
        if opening in "\"'":
            self._string()
        elif opening == "[":
            self._array(path)
        elif opening == "{":
            self._table(path)
        else:
            while self._at < len(self._text) and self._text[self._at] not in ",]}#\r\n":
                self._at += 1
        end = start + len(self._text[start : self._at].rstrip())
        self._found.values[path] = Span(key, start, end)

    def _array(self, path: Path) -> None:
        self._at += 1
        number = 0
        while self._skip_lines() and self._text[self._at] != "]":
            self._value((*path, number), self._at)
            number += 1
            self._skip_lines()
            self._at += self._text[self._at] == ","
        self._at += 1

    def _table(self, path: Path) -> None:
        self._at += 1
        while self._skip_lines() and self._text[self._at] != "}":
            self._entry(path)
            self._skip_lines()
            self._at += self._text[self._at] == ","
        self._at += 1

    def _string(self) -> None:
        """Go behind a string of any of the four kinds."""
        quote = next(q for q in _QUOTES if self._text.startswith(q, self._at))
        self._at += len(quote)
        while not self._text.startswith(quote, self._at):
            self._at += 2 if quote[0] == '"' and self._text[self._at] == "\\" else 1
        self._at += len(quote)
        # Up to two quotes may stand directly before the three that end a long string.
        while len(quote) == 3 and self._text.startswith(quote[0], self._at):
            self._at += 1

    def _blanks(self) -> None:
        while self._at < len(self._text) and self._text[self._at] in _BLANK:
            self._at += 1


def _unescaped(key: str) -> str:
    """Return a quoted key as it is meant; escapes beyond quotes and backslashes stay, and then no edit is made."""
    for written, meant in _ESCAPES.items():
        key = key.replace(written, meant)
    return key
