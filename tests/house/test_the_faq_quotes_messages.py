"""The FAQ is found by the message that was printed: what it quotes stands in the code, word by word."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "faq.md").read_text(encoding="utf-8")


def quoted() -> list[str]:
    """Messages in the first column of tables headed by one, in the pieces between dots and numbers."""
    found = []
    for table in PAGE.split("| message |")[1:]:
        for row in table.splitlines()[2:]:
            if not row.startswith("|"):
                break
            found += re.findall(r"`([^`]+)`", row.split(" | ")[0])
    pieces = [piece.strip() for message in found for piece in re.split(r"\.\.\.|\d+", message)]
    return [piece for piece in pieces if len(piece) >= 6]


def source() -> str:
    """All strings of the code, those over several lines as one."""
    files = [path for wing in ("envs", "synthesis", "validation", "src") for path in (ROOT / wing).rglob("*.py")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    return re.sub(r"\s+", " ", re.sub(r'"\s*\n\s*f?"', "", text)).replace("`", "")


def test_messages_of_the_faq_are_printed_by_the_code() -> None:
    pieces, text = quoted(), source()
    assert len(pieces) >= 10
    assert [piece for piece in pieces if piece not in text] == []
