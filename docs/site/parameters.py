"""Docstrings as the reference shows them: what is said of each parameter is an entry of a list."""

import re

from griffe import Extension

# "size: ...", "film, image: ...": the start of a line that says what a parameter is.
ENTRY = re.compile(r"^((?:\w+, )*\w+): (?=\S)", re.M)


class Parameters(Extension):
    """Rewrites the docstring of everything that is loaded."""

    def on_object(self, *, obj, **_):
        """Called for each module, class, function and attribute."""
        if obj.docstring:
            obj.docstring.value = "\n\n".join(map(listed, obj.docstring.value.split("\n\n")))


def listed(paragraph):
    """A paragraph whose first line says what a parameter is, as a list; any other as it is."""
    if not ENTRY.match(paragraph):
        return paragraph
    entries = ENTRY.sub(lambda found: f"\0- **{found[1]}**: ", paragraph).split("\0")[1:]
    return "\n".join(" ".join(entry.split()) for entry in entries)
