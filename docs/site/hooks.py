"""What MkDocs does beside its own: pages of files outside `docs/`, and the API reference.

The reference is made from the public names of the package, so none is missing: each has its
docstring, a class with its public methods, also those it inherits.
"""

import importlib.util
import os
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[2]
# Pages of the site that are files of the repository.
OUTSIDE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
LINK = re.compile(r"(!?\[(?:[^\]\[]|\[[^\]]*\])*\])\(([^)\s#]*)(#[^)\s]*)?\)")
FENCE = re.compile(r"^( *)(```+).*?^\1\2\n", re.M | re.S)


def on_files(files, config):
    """Add the pages that are no files of the folder."""
    for path, name in OUTSIDE.items():
        files.append(File.generated(config, name, abs_src_path=str(ROOT / path)))
    files.append(File.generated(config, "reference.md", content=reference()))
    return files


def on_page_markdown(markdown, page, config, files):
    """Point links of the repository's files to the site's pages; what is no page is plain text."""
    source = next((path for path, name in OUTSIDE.items() if name == page.file.src_uri), None)
    here = ROOT / (source or f"docs/{page.file.src_uri}")

    def linked(found):
        words, path, anchor = found[1], found[2], found[3] or ""
        if not path or re.match(r"\w+:", path):
            return found[0]
        target = Path(os.path.normpath(here.parent / path)).relative_to(ROOT).as_posix()
        if target in OUTSIDE:
            return f"{words}({OUTSIDE[target]}{anchor})"
        if target.startswith("docs/"):
            return f"{words}({target.removeprefix('docs/')}{anchor})"
        return words.removeprefix("[").removesuffix("]")

    return outside_fences(markdown, lambda text: LINK.sub(linked, text))


def outside_fences(markdown, change):
    """The text with `change` made to what stands in no block of code."""
    out, at = [], 0
    for block in FENCE.finditer(markdown):
        out += [change(markdown[at : block.start()]), block[0]]
        at = block.end()
    return "".join([*out, change(markdown[at:])])


def public_names():
    """{public name: the dotted path it is defined at}, read from the package's `__init__`."""
    spec = importlib.util.find_spec("taichi_cloth")
    package = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(package)
    homes = package._HOMES
    return {
        name: ".".join(filter(None, ("taichi_cloth", module, attribute)))
        for name, (module, attribute) in homes.items()
    }


def reference():
    """The page of the API."""
    parts = [
        "# API reference",
        "Everything here is a name of the package: `import taichi_cloth as tc`, then "
        "`tc.Simulation`. Arrays are NumPy's; shapes and units stand beside them. What makes no "
        "sense raises `tc.InputError` in one line.",
    ]
    for name, path in public_names().items():
        parts.append(f"::: {path}\n    options: {{heading: {name}, toc_label: {name}}}")
    return "\n\n".join(parts) + "\n"
