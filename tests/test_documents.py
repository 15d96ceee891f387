"""The documents: every link leads somewhere, every public name says what it is, the site builds."""

import builtins
import dataclasses
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
from lacking import needs_mkdocs
from selection import thorough

import taichi_cloth as tc

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
FENCE = re.compile(r"^( *)(```+).*?^\1\2\n", re.M | re.S)
PUBLIC = re.compile(r"\btc\.(\w+)")
LINK = re.compile(r"\]\(([^)\s]+)\)|<img [^>]*src=\"([^\"]+)\"")


def prose(path):
    """A document without its blocks of code."""
    return FENCE.sub("", path.read_text())


def anchors(path):
    """The anchors of a document's headings, as GitHub and the site make them."""
    headings = re.findall(r"^#+ +(.*?) *$", prose(path), re.M)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_leads_to_what_is_there(path):
    for found in LINK.finditer(prose(path)):
        target, _, anchor = (found[1] or found[2]).partition("#")
        if re.match(r"\w+:", target):
            continue
        at = path if not target else path.parent / target
        assert at.exists(), f"{path.name}: {found[0]}"
        if anchor:
            assert anchor in anchors(at), f"{path.name}: {found[0]}"


def test_every_picture_is_shown_somewhere_and_small():
    """What no document shows is not kept."""
    shown = "".join(prose(path) for path in DOCUMENTS)
    pictures = [path for path in (ROOT / "docs" / "images").rglob("*.*")]
    assert all(path.name in shown for path in pictures)
    assert sum(path.stat().st_size for path in pictures) < 6e6


def members(kind):
    """The public methods and properties of a class, its own and inherited ones of ours."""
    for name, value in inspect.getmembers(kind):
        home = next((base for base in kind.__mro__ if name in vars(base)), object)
        if not name.startswith("_") and home.__module__.startswith("taichi_cloth"):
            kept = inspect.getattr_static(kind, name)
            if inspect.isroutine(value) or isinstance(kept, property) or hasattr(kept, "func"):
                yield f"{kind.__name__}.{name}", value if inspect.isroutine(value) else kept


def documented(value):
    said = inspect.getdoc(value)
    # A dataclass without words has its signature.
    generated = dataclasses.is_dataclass(value) and (said or "").startswith(f"{value.__name__}(")
    return bool(said) and not generated


def public_parts():
    """All that the reference has: (name, value), and members of classes and of modules."""
    for name in (name for name in tc.__all__ if name != "__version__"):
        value = getattr(tc, name)
        yield name, value
        if inspect.isclass(value):
            yield from members(value)
        if inspect.ismodule(value):
            for part, made in inspect.getmembers(value, inspect.isfunction):
                if made.__module__ == value.__name__ and not part.startswith("_"):
                    yield f"{name}.{part}", made


def test_every_public_name_says_what_it_is():
    parts = list(public_parts())
    assert not [part for part, what in parts if not documented(what)] and len(parts) > 100


def test_whatever_is_raised_by_its_words_can_be_caught_by_a_public_name():
    """`RunFailure` was not: a program could only look for it among the package's files."""
    known = {*dir(builtins), *tc.__all__}
    said = [
        (part, word)
        for part, what in public_parts()
        for word in re.findall(r"\b[A-Z]\w*(?:Error|Failure)\b", inspect.getdoc(what) or "")
    ]
    assert not [found for found in said if found[1] not in known] and len(said) > 50
    assert {"RunFailure", "InputError"} <= {word for _, word in said}


def test_every_public_name_in_the_documents_is_one():
    used = [(path.name, name) for path in DOCUMENTS for name in PUBLIC.findall(path.read_text())]
    assert not [found for found in used if found[1] not in tc.__all__] and len(used) > 20


def test_type_checkers_know_every_public_name(tmp_path):
    """To them all was `Any`, as `__getattr__` of the package says."""
    for name in ("py.typed", "__init__.pyi"):
        assert (Path(tc.__file__).parent / name).is_file()
    program = tmp_path / "program.py"
    asked = [f"reveal_type(tc.{name})" for name in tc.__all__]
    program.write_text("\n".join(["import taichi_cloth as tc", *asked]))
    # What is not strict in the package is no fault of the program: what is installed is not judged.
    words = ["--strict", "--follow-imports", "silent", "--no-error-summary"]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *words, program],
        **{"cwd": ROOT, "capture_output": True, "text": True, "timeout": 300},
        check=False,
    )
    told = done.stdout.splitlines()
    assert done.returncode == 0 and len(told) == len(asked), done.stdout + done.stderr
    assert not [line for line in told if '"Any"' in line]


@thorough
@needs_mkdocs
def test_the_site_builds_strictly_and_its_reference_has_every_name(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0 and "WARNING" not in done.stderr, done.stdout + done.stderr
    page = (tmp_path / "reference.html").read_text()
    for name in tc.__all__:
        if name != "__version__":
            assert re.search(rf'href="#[\w.]+">(<[^>]*>|\s)*{name}\b', page), name
    for name, _ in members(tc.Simulation):
        assert name in page, name
    for path in DOCUMENTS:
        name = "index" if path.name == "README.md" else path.stem.lower()
        html = (tmp_path / f"{name}.html").read_text()
        for target in re.findall(r'(?:href|src)="([^":#?]+)[#?"]', html):
            assert (tmp_path / target).exists(), f"{name}.html: {target}"
