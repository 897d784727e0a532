"""The one folder that the page may write to: which names it may use there, and nothing beyond."""

from __future__ import annotations

import re
from pathlib import Path

from ....envs.systems.arguments import shown, write_text

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_. -]{0,99}")


def place(folder: Path, name: object, *endings: str) -> Path:
    """Return the path of a file in a folder.

    Parameters
    ----------
    folder : Path
    name : object
        A file name as the page sends it.
    *endings : str
        What it has to end with, such as ``.toml``: one of these.

    Raises
    ------
    ValueError
        If it is no plain name with this ending, or stands for a place outside of the folder.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name) or not name.endswith(endings) or name in endings:
        wanted = " or ".join(endings)
        raise ValueError(
            f"`name`: expected a file name of letters, digits, -, _ that ends in {wanted}, got {shown(name)}"
        )
    path = folder / name
    # A link may lead anywhere: what counts is where the file is.
    if path.is_symlink() or path.resolve().parent != folder.resolve() or (path.exists() and not path.is_file()):
        raise ValueError(f"`name`: expected a file in the folder {folder}, got {shown(name)}, which leads elsewhere")
    return path


class TaskFile:
    """The file of a task, and what it held when it was last read or written.

    Parameters
    ----------
    folder : Path
    name : str

    Raises
    ------
    ValueError
        If the name is not that of a TOML file in the folder, or the file cannot be read.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name
        self._path = place(folder, name, ".toml")
        self.known = self.on_disk()

    def on_disk(self) -> str | None:
        """Return what the file holds now; None if it does not exist."""
        try:
            return self._path.read_bytes().decode("utf-8").replace("\r\n", "\n")
        except FileNotFoundError:
            return None
        except UnicodeDecodeError as error:
            raise ValueError(f"{shown(self.name)}: expected UTF-8 text, got an invalid byte at {error.start}") from None

    def save(self, text: str, anyway: bool) -> bool:
        """Write the text, and return True; False if somebody else has changed the file, unless it is written anyway."""
        path = place(self.folder, self.name, ".toml")
        if not anyway and self.on_disk() not in (self.known, text):
            return False
        write_text(path, text)
        self.known = text
        return True
