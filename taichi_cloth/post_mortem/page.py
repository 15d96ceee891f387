"""A post-mortem as one HTML file, which needs no network: pictures and graphs are in it."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import milliseconds
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.kernels import methods
from taichi_cloth.post_mortem import graphs
from taichi_cloth.post_mortem.examine import PostMortem, flags
from taichi_cloth.post_mortem.survivors import Trial
from taichi_cloth.post_mortem.wording import spring_of
from taichi_cloth.settings.options import PROGRAM
from taichi_cloth.version import __version__

if TYPE_CHECKING:
    from taichi_cloth.post_mortem.trace import Trace

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
  color: #1b1f24; background: #fff }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem }
.cause { border-left: .4rem solid #c0392b; background: #fbeeec; padding: .6rem 1rem }
.cause.physics { border-color: #2874a6; background: #ebf3f9 }
.remedy { border-left: .4rem solid #1e8449; background: #eaf6ee; padding: .6rem 1rem }
.proof, figcaption, footer { color: #57606a; font-size: .9rem }
code, pre { font: 13px/1.4 ui-monospace, monospace; background: #f2f4f6; padding: .1rem .3rem }
pre { padding: .6rem 1rem; overflow-x: auto; user-select: all; white-space: pre-wrap }
table { border-collapse: collapse } td, th { padding: .2rem .8rem .2rem 0; text-align: left;
  border-bottom: 1px solid #d9dee3; vertical-align: top } td.n { text-align: right }
.frames { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); gap: 1rem }
figure { margin: 0 } img, svg { max-width: 100%; height: auto; border-radius: 4px }
"""


def write(found: PostMortem, file: PendingFile) -> None:
    """Write the page into a file that was begun; it appears whole."""
    file.write(page(found).encode())
    file.commit()


def page(found: PostMortem) -> str:
    """The whole page."""
    trace = found.trace
    title = f"{trace.scene}: {'what failed' if trace.failure else 'how the run stands'}"
    body = "\n".join(_sections(found, title))
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_text(title)}</title>\n<style>{STYLE}</style></head>\n<body>\n{body}\n"
        f"<footer><p>{PROGRAM} {__version__}</p></footer>\n</body></html>\n"
    )


def _sections(found: PostMortem, title: str) -> Iterator[str]:
    trace, cause = found.trace, found.cause
    yield f"<h1>{_text(title)}</h1>"
    if trace.failure is not None:
        yield f"<p>Frame {trace.failure.frame}: particle {trace.failure.particle} "
        yield f"{_text(trace.failure.what)}. The last good frame, {trace.failure.frame - 1}, is "
        yield "kept.</p>"
    kind = "Numerics" if cause.numerical else "Not numerics"
    colour = "" if cause.numerical else " physics"
    yield f'<div class="cause{colour}"><strong>{kind}: {_text(cause.says)}.</strong>'
    yield f'<br><span class="proof">{_text(cause.proof)}</span></div>'
    if trace.failure is not None:
        yield from _remedy(found)
    if trace.pictures:
        yield f"<h2>The frames before{' it' if trace.failure else ''}</h2>"
        yield '<div class="frames">'
        for frame, pixels in trace.pictures:
            yield f'<figure><img alt="frame {frame}" src="{_inline(pixels)}">'
            yield f"<figcaption>frame {frame}</figcaption></figure>"
        yield "</div>"
    yield "<h2>What led there</h2>"
    span = f"frames {trace.samples[0].frame} to {trace.samples[-1].frame}"
    shaded = "; red: the frame that failed, step by step" if trace.failure else ""
    first = "; dotted: where the cause is first seen" if cause.sample >= 0 else ""
    yield f"<figure>{graphs.draw(found)}<figcaption>{span}{shaded}{first}</figcaption></figure>"
    yield "<h2>The run</h2>"
    yield _table([], _of_run(trace))


def _remedy(found: PostMortem) -> Iterator[str]:
    best = found.search.best
    if best is None:
        yield f"<p>{_text(found.search.says)}.</p>"
    else:
        yield '<div class="remedy"><strong>The cheapest setting found that survives: '
        yield f"{_text(found.setting)}</strong>"
        yield f'<br><span class="proof">{_text(found.search.says)}; '
        yield f"{milliseconds(best.seconds)} ms a frame</span></div>"
        yield f"<pre>{_text(found.command)}</pre>"
        if found.search.without:
            yield "<p>What it is without is to be taken out of the log or the script, too.</p>"
    if found.search.trials:
        rows = [_of_trial(trial, found) for trial in found.search.trials]
        yield "<h2>What was tried</h2>"
        yield _table(["setting", "frames", "ms a frame", "how it ended"], rows)


def _of_trial(trial: Trial, found: PostMortem) -> list[str]:
    given = " ".join(flags(trial.settings, found.trace.settings)) or "as it was"
    ended = "survived" if trial.survived else trial.says
    return [given, f"{trial.frames} of {trial.wanted}", milliseconds(trial.seconds), ended]


def _of_run(trace: Trace) -> list[list[str]]:
    settings, last = trace.settings, trace.samples[-1]
    claims = methods.load(settings.method).claims
    limit = "none" if claims.stability_limit == float("inf") else f"{claims.stability_limit:.4g}"
    rows = [
        ["method", f"{settings.method} (limit of h omega: {limit})"],
        ["step", f"{trace.h:.4g}: frames of {settings.dt:.4g} in {settings.substeps} steps"],
        ["numbers", trace.precision],
        ["size", f"{len(trace.last.particles)} particles, {len(trace.last.springs)} springs hold"],
        ["h omega at the end", f"{last.reach:.4g}, set by {spring_of(last)}"],
        ["broken springs", f"{last.broken}, {last.broken - trace.samples[0].broken} of them here"],
        ["largest strain", f"{100 * last.strain:.3g} %, of spring {last.spring}"],
        ["largest speed", f"{last.speed:.3g} of at most {trace.speed_limit:.3g}"],
    ]
    if trace.depth is not None:
        rows.append(["deepest penetration", f"{trace.depth:.3g}"])
    if trace.unconverged:
        rows.append(["steps not converged", f"{trace.unconverged} of {trace.steps}"])
    if trace.acts:
        done = [f"frame {act.frame}: {act.words}" for act in trace.acts[-8:]]
        more = f"{len(trace.acts) - 8} others, " if len(trace.acts) > 8 else ""
        rows.append(["done by hand", more + ", ".join(done)])
    return rows


def _table(headers: list[str], rows: list[list[str]]) -> str:
    head = "".join(f"<th>{_text(header)}</th>" for header in headers)
    body = "".join(
        "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>\n" for row in rows
    )
    return f"<table>{f'<tr>{head}</tr>' if headers else ''}\n{body}</table>"


def _inline(pixels: np.ndarray) -> str:
    """A picture (h, w, 3) uint8 as an address that holds it."""
    from PIL import Image

    buffer = io.BytesIO()
    image = Image.fromarray(pixels)
    image.thumbnail((640, 640))
    image.save(buffer, format="PNG")
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _text(words: str) -> str:
    return html.escape(words)
