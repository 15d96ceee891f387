"""Names of files and folders that are made of names of scenes."""

from __future__ import annotations

import re

MOST_BYTES = 100  # of a name: what begins and ends it has room besides


def name_for_file(name: str, otherwise: str) -> str:
    """A scene's name as part of a file's: it names no other folder, and what a shell reads
    otherwise is a dash; otherwise: where nothing is left of it.
    """
    plain = re.sub(r"[^\w.-]+", "-", name).encode()[:MOST_BYTES].decode(errors="ignore")
    return plain.strip("-.") or otherwise
