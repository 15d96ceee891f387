"""Pictures and films taken by keys, by Python, and in notebooks: what they hold, where they go."""

import numpy as np
import pytest
from null_view import NullView
from PIL import Image

from taichi_cloth.errors import InputError
from taichi_cloth.scene import library
from taichi_cloth.ui import app, film
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.shutter import Shutter

SCENE = library.build("cloth", columns=4, rows=3)
SIZE = 320, 240


class Pressed(NullView):
    """A window whose user presses keys: one word of them for each turn, "" for none."""

    visible = True

    def __init__(self, turns):
        super().__init__(SCENE.world, SIZE)
        self.turns, self.titles, self.shown = list(turns), [], []

    def poll(self):
        if not self.turns:
            return [Event("press", key="escape")]
        return [Event("press", key=key) for key in self.turns.pop(0)]

    def entitle(self, title):
        self.titles.append(title)

    def draw(self, picture):
        self.shown.append("\n".join(panel.words for panel in picture.overlay))

    def grab(self):
        pixels = np.full((SIZE[1], SIZE[0], 3), 200, np.uint8)
        room = self.room
        pixels[room.y : room.y + room.height] = 40
        return pixels


def test_keys_save_pictures_and_films_that_replace_none(pool, tmp_path, capsys):
    """A film has the frames that were simulated, not those of the window: one pause has 3."""
    (tmp_path / "cloth-1.png").write_bytes(b"mine")
    view = Pressed(["s", "", "v", "", "p", "", "", "p", "", "v", "s", "", "v", ""])
    app.run(pool(SCENE), view, pictures=str(tmp_path), device="cpu")
    names = ["cloth-1.mp4", "cloth-1.png", "cloth-2.mp4", "cloth-2.png", "cloth-3.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert (tmp_path / "cloth-1.png").read_bytes() == b"mine"
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"saved {tmp_path}/cloth-2.png" and len(said) == 4
    # Frames 3, 4, then (after three turns of pause) 8 and 9: four.
    assert said[1] == f"saved {tmp_path}/cloth-1.mp4 (0.1 s)"
    import imageio

    frames = [imageio.get_reader(tmp_path / f"cloth-{n}.mp4").count_frames() for n in (1, 2)]
    assert frames == [4, 2]
    recording = ["recording" in words for words in view.shown]
    assert recording[:3] == [False] * 3 and recording[3:9] == [True] * 6 and not recording[10]
    assert any("recording 0 s, paused" in title for title in view.titles)
    first = np.asarray(Image.open(tmp_path / "cloth-2.png"))
    assert (first == 40).all() and first.shape[:2] == SIZE[
        ::-1
    ]  # the world alone, in all of the window


def test_what_cannot_be_saved_is_told_and_ends_nothing(tmp_path, capsys, monkeypatch):
    missing = Shutter("cloth", str(tmp_path / "gone"))
    missing.begin_or_end()
    missing.take(np.zeros((4, 4, 3), np.uint8))
    assert not missing.wants() and "there is no folder" in missing.notice
    assert capsys.readouterr().out.count("not saved: ") == 2
    monkeypatch.setattr(film, "has_ffmpeg", lambda: False)
    monkeypatch.chdir(tmp_path)
    there = Shutter("a/b scene", quiet=True)
    there.begin_or_end()
    assert there.wants()
    there.add(np.zeros((8, 8, 3), np.uint8))
    there.begin_or_end()
    assert there.notice == f"saved {tmp_path}/a-b-scene-1.gif, 0.0 s"
    there.begin_or_end()  # this one has no frame, and leaves no file
    there.save()
    assert [path.name for path in tmp_path.iterdir()] == ["a-b-scene-1.gif"]
    assert not capsys.readouterr().out


@pytest.mark.skipif(not film.has_ffmpeg(), reason="needs ffmpeg")
def test_a_film_that_ffmpeg_cannot_write_is_refused_in_one_line(tmp_path, capfd):
    """ffmpeg said so itself, in up to seven lines, as of a full disk."""
    made = film.Film(tmp_path / "a.mp4")
    made._raw.symlink_to("missing/a.mp4")

    def make():
        for _ in range(5):
            made.add(np.zeros((64, 64, 3), np.uint8))
        made.save()

    with pytest.raises(InputError, match="a.mp4: cannot be written: ffmpeg failed"):
        make()
    assert capfd.readouterr() == ("", "") and list(tmp_path.iterdir()) == []
