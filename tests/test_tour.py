"""docs/tour.md and docs/gallery.md are true: their commands run, their keys do what they say."""

import importlib.util
import re
import shlex
import sys
from pathlib import Path

import pytest
from inside import not_starting
from selection import thorough

from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.scene import library
from taichi_cloth.ui import tools
from taichi_cloth.ui.inputs import COMMANDS

ROOT = Path(__file__).parent.parent
TOUR = (ROOT / "docs" / "tour.md").read_text()
BLOCKS = re.findall(r"^(?:<!-- exit (\d) -->\n)?```sh\n(.*?)^```", TOUR, re.M | re.S)
# What the tour has a reader do, and the exit status that it says.
COMMANDS_OF_TOUR = [
    (line, int(status or 0))
    for status, text in BLOCKS
    for line in text.replace("\\\n", "").splitlines()
    if line.startswith("taichi-cloth ")
]


def gallery():
    """The module that makes the gallery, which is no part of the package."""
    spec = importlib.util.spec_from_file_location("gallery", ROOT / "docs" / "gallery.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["gallery"] = module  # where dataclasses look for it
    spec.loader.exec_module(module)
    return module


def start(*_, **__):
    raise InputError("it would start now")


@pytest.mark.parametrize("line", [line for line, _ in COMMANDS_OF_TOUR if " run " in line])
def test_every_run_of_the_tour_is_accepted(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    not_starting(monkeypatch, start)
    assert main(shlex.split(line)[1:]) == 2
    assert capsys.readouterr().err == "taichi-cloth: error: it would start now\n"


@thorough
@pytest.mark.parametrize("line, status", COMMANDS_OF_TOUR)
def test_every_command_of_the_tour_ends_as_it_says(cli, line, status, tmp_path):
    """Without a display, and runs for half a second."""
    reduced = ["--headless", "--frames", "30"] if " run " in line else []
    words = [*shlex.split(line)[1:], *reduced]
    out, err = cli(*words, cwd=tmp_path, check=status)
    if status:
        assert "remedy: use" in err and "particle" in err
    if " tune " in line:
        chosen = out[out.rindex("taichi-cloth run cloth ") :].replace("\\\n", "")
        cli(*shlex.split(chosen)[1:], "--headless", "--frames", "5", cwd=tmp_path)
    if " trade " in line:
        assert (tmp_path / "trade-cloth" / "trade.png").exists()


def test_keys_do_what_the_tour_says():
    rows = re.findall(r"^\| ([^|]*`[^|]*) \| (.*?) \|", TOUR, re.M)
    by_key = {tool.key: name for name, tool in tools.load_all().items()}
    named = {key: says for keys, says in rows for key in re.findall(r"`([^`]+)`", keys)}
    taken = {key: says for key, says in named.items() if key in by_key}
    assert {key: by_key[key] for key in taken} == taken and len(taken) == 7
    rest = named.keys() - taken.keys()
    assert rest <= COMMANDS.keys() and {"p", ".", "r", "s"} <= rest
    assert {"f", "d", "v"} <= set(re.findall(r"`(\w)`", TOUR))


def test_the_gallery_shows_every_scene_by_commands_that_are_accepted(tmp_path, monkeypatch, capsys):
    made = gallery()
    assert set(made.ENTRIES) == set(library.names())
    assert made.page() == made.PAGE.read_text()
    not_starting(monkeypatch, start)
    monkeypatch.chdir(ROOT)
    for name in made.ENTRIES:
        picture = made.PICTURES / f"{name}.webp"
        assert picture.stat().st_size <= made.MOST_BYTES, name
        line = made.command(name, str(tmp_path / "a.png"))
        assert main(shlex.split(line)[1:]) == 2
        assert capsys.readouterr().err == "taichi-cloth: error: it would start now\n", line
    assert made.ANIMATION.stat().st_size <= 1.5e6
