"""Pictures and films of a run; each file appears whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import PendingFile

if TYPE_CHECKING:
    from PIL import Image as Pillow

FILM_RATE = 60  # simulated frames a second of an .mp4: real time, however slow the window was
GIF_DELAY = 2  # hundredths of a second: 50 a second, the most that viewers honour
IMAGE_KINDS, FILM_KINDS = (".png",), (".mp4", ".gif")


def _pending(path: str | os.PathLike, flag: str, kinds: tuple[str, ...]) -> PendingFile:
    """The file `path` in the making; InputError, naming `flag`, where it cannot be written."""
    path = Path(path)
    if path.suffix.lower() not in kinds:
        raise InputError(f"{flag} {path}: the file's name must end in {' or '.join(kinds)}")
    return PendingFile(path)


def fitted(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """`pixels` (h, w, 3) uint8 scaled to `size` (width, height), whole and centred."""
    from PIL import Image, ImageOps

    if (pixels.shape[1], pixels.shape[0]) == tuple(size):
        return pixels
    corner = tuple(int(c) for c in pixels[0, 0])
    return np.asarray(ImageOps.pad(Image.fromarray(pixels), size, color=corner))


def _is_whole(film: Path) -> bool:
    """True if ffmpeg finished an .mp4: its last box says where the frames are."""
    if not film.exists():
        return False
    with open(film, "rb") as file:
        while len(head := file.read(8)) == 8:
            if head[4:] == b"moov":
                return True
            file.seek(max(int.from_bytes(head[:4], "big"), 8) - 8, os.SEEK_CUR)
    return False


def has_ffmpeg() -> bool:
    """True if an .mp4 can be made."""
    try:
        import imageio  # noqa: F401
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return False
    return True


class Image:
    """One picture, written at the end of a run. InputError where it cannot be."""

    def __init__(self, path: str | os.PathLike):
        self._file = _pending(path, "--image", IMAGE_KINDS)

    def save(self, pixels: np.ndarray) -> None:
        """Write `pixels` (h, w, 3) uint8 to the file."""
        from PIL import Image as Pillow

        self._file.fill(lambda file: Pillow.fromarray(pixels).save(file, format="PNG"))

    def discard(self) -> None:
        """Leave no file behind, unless the picture was saved."""
        self._file.discard()


class Film:
    """A film of a run: .mp4 at 60 frames a second, .gif at 50 with the same speed.

    Frames of another size than the first (a resized window) are scaled to it. InputError where
    the file cannot be written, or ffmpeg is missing.
    """

    def __init__(self, path: str | os.PathLike):
        self._kind = Path(path).suffix.lower()
        self._file = _pending(path, "--video", FILM_KINDS)
        if self._kind == ".mp4":
            if not has_ffmpeg():
                self._file.discard()
                raise InputError(
                    f"--video {path}: .mp4 needs ffmpeg, which is not there "
                    "(pip install imageio imageio-ffmpeg), or choose a .gif"
                )
            import imageio

            self._imageio = imageio
            # ffmpeg writes by name and seeks back in its file, so it gets one of its own.
            self._folder = tempfile.TemporaryDirectory(prefix="taichi-cloth-")
        self._size: tuple[int, int] | None = None
        self._writer: Any = None  # of imageio, from the first frame of an .mp4 on
        self._pictures: list[Pillow.Image] = []
        self._frames = 0

    def wants(self) -> bool:
        """True if the next frame is kept (a .gif leaves some out): call once a frame."""
        self._frames += 1
        if self._kind == ".mp4":
            return True
        # Of 60 frames 50 are kept, beginning with the first: as many as the speed needs.
        a, b = (-(-n * 100 // (GIF_DELAY * FILM_RATE)) for n in (self._frames - 1, self._frames))
        return b > a

    def add(self, pixels: np.ndarray) -> None:
        """Append the frame `pixels` (h, w, 3) uint8."""
        if self._size is None:
            self._size = (pixels.shape[1], pixels.shape[0])
        pixels = fitted(pixels, self._size)
        if self._kind == ".gif":
            from PIL import Image as Pillow

            self._pictures.append(
                Pillow.fromarray(pixels).quantize(
                    128, method=Pillow.Quantize.FASTOCTREE, dither=Pillow.Dither.NONE
                )
            )
            return
        if self._writer is None:
            self._writer = self._imageio.get_writer(
                self._raw, format="FFMPEG", mode="I", fps=FILM_RATE, codec="libx264", quality=8,
                macro_block_size=1, ffmpeg_log_level="quiet",  # `_refuse` says it
            )  # fmt: skip
        # H.264 with the usual colour sampling takes even sizes only.
        h, w = pixels.shape[:2]
        even = np.pad(pixels, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge")
        try:
            self._writer.append_data(even)
        except OSError as error:  # ffmpeg ended
            self._refuse(error)

    def _refuse(self, error: OSError | None = None) -> NoReturn:
        """Leave no file behind, and say why: the disk on which ffmpeg works may be full."""
        self._writer = None
        self.discard()
        raise InputError(
            f"{self._file.path}: cannot be written: ffmpeg failed in "
            f"{self._raw.parent.parent}; is there room?"
        ) from error

    @property
    def _raw(self) -> Path:
        return Path(self._folder.name) / "film.mp4"

    def save(self) -> None:
        """Finish the file. With no frame at all, no file is left."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None
            if not _is_whole(self._raw):
                self._refuse()
            with open(self._raw, "rb") as made:
                self._file.fill(lambda file: shutil.copyfileobj(made, file))
        elif self._pictures:
            first, *rest = self._pictures
            self._file.fill(
                lambda file: first.save(
                    file,
                    format="GIF",
                    save_all=True,
                    append_images=rest,
                    duration=10 * GIF_DELAY,
                    loop=0,
                    optimize=False,
                )  # fmt: skip
            )
        self.discard()

    def discard(self) -> None:
        """Leave no file behind, unless the film was saved."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None
        self._file.discard()
        if self._kind == ".mp4":
            self._folder.cleanup()
