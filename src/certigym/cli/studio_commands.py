"""The command that opens a page on which a task is drawn, written and certified: ``studio``."""

from __future__ import annotations

import sys
import webbrowser
from argparse import Namespace
from pathlib import Path

from ..validation.presentation.studio import Studio, open_studio
from .given import show


def studio(options: Namespace) -> int:
    """Serve the page of a file until Ctrl-C."""
    page = _opened(options)
    folder = page.session.folder
    text = (
        f"{page.session.file.name} in {folder}\nopen   {page.address}\n"
        "       for this machine alone, and for who knows the address; writes to this folder alone; Ctrl-C stops it"
    )
    show(options, text, {"address": page.address, "file": page.session.file.name, "folder": str(folder)})
    sys.stdout.flush()
    if options.open:
        webbrowser.open(page.address)
    try:
        page.wait()
    except KeyboardInterrupt:
        print("\nstopped; pages that are open keep their text", file=sys.stderr)
    finally:
        page.stop()
    return 0


def _opened(options: Namespace) -> Studio:
    """Return the page of the file, or of a new one with a small task."""
    if options.port is not None and not 0 <= options.port < 65536:
        raise ValueError(f"`--port`: expected a number from 0 to 65535, got {options.port}")
    if options.file is None:
        return open_studio(Path.cwd(), None, options.port)
    path = Path(options.file)
    if not path.absolute().parent.is_dir():
        raise ValueError(f"`{path}`: expected a file name in a folder that exists; make the folder first")
    return open_studio(path.absolute().parent, path.name, options.port)
