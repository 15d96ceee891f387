"""Makes docs/gallery.md and its pictures: `python docs/gallery.py [SCENE ...] [tour] [animation]`.

Without words it makes all of them anew. Each picture is made by the command that stands beside it,
in the folder of the repository; `tour` is the first of docs/tour.md, `animation` is README's.
"""

from __future__ import annotations

import itertools
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import imageio
from PIL import Image

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "images" / "gallery"
LARGEST = (960, 720)  # pixels of a picture
MOST_BYTES = 60_000  # of a picture


@dataclass(frozen=True)
class Entry:
    """A picture of the gallery.

    says: what one sees. flags: of the run that makes it, but for the picture's file.
    """

    says: str
    flags: str


WIDE, TALL = "--no-status --size 960x640", "--no-status --size 960x720"
ENTRIES = {
    "cloth": Entry(
        "A cloth that the mouse has torn: a recorded session, replayed.",
        f"--events docs/logs/cloth.jsonl --frames 118 --show surface,springs {WIDE}",
    ),
    "box": Entry(
        "Balls and two chains, which were clicked into the box.",
        f"--events docs/logs/box.jsonl --frames 60 {WIDE}",
    ),
    "sandbox": Entry(
        "The same in the plane: chains hang from grey particles, which are fixed.",
        f"--events docs/logs/sandbox.jsonl --frames 110 {WIDE}",
    ),
    "drape": Entry("A cloth has fallen over a ball and onto the floor.", f"--frames 55 {TALL}"),
    "flag": Entry("A flag in gusts.", f"--frames 60 {TALL}"),
    "curtain": Entry("Gusts have torn a curtain off half of its rings.", f"--frames 330 {TALL}"),
    "trampoline": Entry(
        "Three balls have fallen into a net; the red one, which is heavy, went through.",
        f"--frames 90 {TALL}",
    ),
    "stack": Entry("Five sheets have fallen on each other.", f"--frames 49 {TALL}"),
    "pull": Entry("A table cloth is drawn from under plates of balls.", f"--frames 39 {TALL}"),
    "twist": Entry("Two bars have turned a strip by its ends, twice.", f"--frames 239 {TALL}"),
    "shirt": Entry("A shirt out of a mesh file, held at its collar.", f"--frames 20 {TALL}"),
    "net": Entry("A net of 65 536 knots, held along its edges.", f"--frames 60 {TALL}"),
    "warp": Entry("The cloth of Warp's benchmark.", f"--frames 40 {TALL}"),
    "slinky": Entry(
        "A hanging chain was let go at its top: its bottom waits for the collapse.",
        "--frames 45 --no-status --size 400x800",
    ),
    "chain": Entry(
        "A chain in its third normal mode, which has a closed form.",
        "--particles 24 --mode 3 --frames 1 --no-status --size 960x320",
    ),
    "oscillator": Entry(
        "One mass on one spring, which has a closed form, too.",
        "--frames 1 --no-status --size 960x480",
    ),
}

HEAD = """# Gallery

Every built-in scene, drawn without a window by the command under its picture,
and made smaller where that is large.
`taichi-cloth run SCENE` alone opens it in one, where the mouse takes part:
[the first ten minutes](tour.md) say how. `taichi-cloth run SCENE --help` says what it takes.

Compilers take the instructions that a processor has, so last digits differ from one kind to
another: in `box` and `sandbox`, where chance grows with each bounce, some balls then lie elsewhere.

The pictures are made anew, and this page with them, by `python docs/gallery.py`.
"""


def command(name: str, picture: str) -> str:
    """The command that makes a scene's picture."""
    return f"taichi-cloth run {name} --headless {ENTRIES[name].flags} --image {picture}"


def page() -> str:
    """The page's text."""
    parts = [HEAD]
    for name, entry in ENTRIES.items():
        parts.append(
            f"## {name}\n\n{entry.says}\n\n![{entry.says}](images/gallery/{name}.webp)\n\n"
            f"```sh\n{command(name, f'{name}.png')}\n```\n"
        )
    return "\n".join(parts)


def run(line: str) -> None:
    """Run a command of the program in the repository's folder."""
    print(line, flush=True)
    words = [sys.executable, "-m", "taichi_cloth", *shlex.split(line)[1:], "--quiet"]
    subprocess.run(words, cwd=ROOT, check=True)


def smallest(picture: Image.Image, to: Path) -> None:
    """Save a picture as finely as `MOST_BYTES` allow."""
    picture = picture.convert("RGB")
    picture.thumbnail(LARGEST, Image.Resampling.LANCZOS)
    for quality in range(90, 20, -5):
        picture.save(to, quality=quality, method=6)
        if to.stat().st_size <= MOST_BYTES:
            return


# The tour's first picture: what its first command shows, once it has come to rest.
TOUR = "cloth --frames 300 --no-status --size 960x640"
FIRST_OF_TOUR = ROOT / "docs" / "images" / "tour.webp"

# README's animation.
FILMED = "drape --spin 120"
FILM_FLAGS = "--frames 150 --size 960x720 --no-status"
ANIMATION = ROOT / "docs" / "images" / "drape.webp"
EVERY, FRAME_MS = 2, 33  # frames of the film that are kept, and how long each is shown
MIDDLE = (40, 90, 920, 631)  # pixels of the film: left, top, right, bottom of what is kept
FILM_WIDTH, FILM_QUALITY = 720, 80


def animate(folder: Path) -> None:
    """Make README's animation from a film of the program."""
    film = folder / "film.mp4"
    run(f"taichi-cloth run {FILMED} --headless {FILM_FLAGS} --video {film}")
    frames = []
    with imageio.get_reader(film) as made:
        for pixels in itertools.islice(made, 0, None, EVERY):
            frame = Image.fromarray(pixels).crop(MIDDLE)
            height = round(frame.height * FILM_WIDTH / frame.width)
            frames.append(frame.resize((FILM_WIDTH, height), Image.Resampling.LANCZOS))
    first, *rest = frames
    first.save(
        ANIMATION, save_all=True, append_images=rest, duration=FRAME_MS, loop=0,
        quality=FILM_QUALITY, method=6,
    )  # fmt: skip


def main(words: list[str]) -> None:
    """Make what is named, or everything; then write the page."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in words or [*ENTRIES, "tour", "animation"]:
            made = folder / f"{name}.png"
            if name == "animation":
                animate(folder)
            elif name == "tour":
                run(f"taichi-cloth run {TOUR} --headless --image {made}")
                smallest(Image.open(made), FIRST_OF_TOUR)
            else:
                run(command(name, str(made)))
                smallest(Image.open(made), PICTURES / f"{name}.webp")
    PAGE.write_text(page())


if __name__ == "__main__":
    main(sys.argv[1:])
