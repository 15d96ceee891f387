"""Interaction logs: what is written is read back; what is malformed is refused by its line."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_cloth.errors import InputError
from taichi_cloth.files.events import Recorder
from taichi_cloth.ui import inputs, interaction
from taichi_cloth.ui.inputs import Event

# Once Taichi has started, the processor takes subnormal numbers for zero in the whole process.
finite = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)
pos = st.tuples(finite, finite)
any_event = st.one_of(
    st.builds(Event, st.just("move"), pos),
    st.builds(
        Event, st.sampled_from(("press", "release")), pos, button=st.sampled_from(inputs.BUTTONS)
    ),
    st.builds(
        Event,
        st.just("press"),
        pos,
        button=st.sampled_from(inputs.BUTTONS),
        about=st.tuples(finite, finite, finite),
    ),
    st.builds(
        Event,
        st.sampled_from(("press", "release")),
        st.none() | pos,
        key=st.sampled_from(sorted(inputs.KEYS)),
    ),
    st.builds(
        Event,
        st.just("wheel"),
        st.none() | pos,
        delta=finite,
        about=st.none() | st.tuples(finite, finite, finite),
    ),
)
header = st.none() | st.fixed_dictionaries({"seed": st.integers(0, 2**63 - 1)})


@settings(max_examples=150, deadline=None)
@given(header, st.lists(st.tuples(st.integers(0, 9), any_event)))
def test_what_is_recorded_is_read_back(tmp_path_factory, header, happened):
    path = tmp_path_factory.mktemp("log") / "log.jsonl"
    happened = sorted(happened, key=lambda entry: entry[0])
    with Recorder(path, header) as recorder:
        for frame, event in happened:
            recorder.write(frame, event)
    log = interaction.load(path)
    assert log.header == (header or {})
    assert [(f, e) for f, of_frame in log.by_frame.items() for e in of_frame] == happened


def test_a_disk_that_fills_up_ends_a_log_in_one_line_and_leaves_nothing(tmp_path):
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = Recorder(tmp_path / "log.jsonl")
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
        with pytest.raises(InputError, match="cannot be written"):
            for frame in range(1000):
                recorder.write(frame, Event("move", (1.0, 2.0)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_the_golden_log_is_read(request):
    log = interaction.load(request.path.parent / "golden" / "cloth_blow.jsonl")
    assert log.last_frame == 599 and len(log.by_frame) == 600
    assert log.by_frame[1] == [Event("move", (327.445, 207.047))]


GOOD = '{"frame": 3, "event": "move", "pos": [1, 2]}'


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("{", "is not JSON"),
        ("[]", "must be an object"),
        ("3", "must be an object"),
        ('{"frame": 4}', "'event' is missing"),
        ('{"event": "move"}', "'frame' is missing"),
        ('{"frame": 4, "evnt": "move", "pos": [1, 2]}', "did you mean 'event'?"),
        ('{"frame": 2, "event": "move", "pos": [1, 2]}', "after frame 3"),
        ('{"frame": -1, "event": "move", "pos": [1, 2]}', "frame must be"),
        ('{"frame": 3.5, "event": "move", "pos": [1, 2]}', "frame must be"),
        ('{"frame": true, "event": "move", "pos": [1, 2]}', "frame must be"),
        ('{"frame": 4, "event": "mvoe", "pos": [1, 2]}', "did you mean 'move'?"),
        ('{"frame": 4, "event": [], "pos": [1, 2]}', "unknown event"),
        ('{"frame": 4, "event": "move"}', "'pos' is missing"),
        ('{"frame": 4, "event": "move", "pos": [1]}', "pos must be two"),
        ('{"frame": 4, "event": "move", "pos": [1, null]}', "pos must be two"),
        ('{"frame": 4, "event": "move", "pos": [NaN, 1]}', "found NaN"),
        ('{"frame": 4, "event": "move", "pos": [1e999, 1]}', "pos must be two"),
        ('{"frame": 4, "event": "move", "pos": [1' + "0" * 400 + ", 1]}", "pos must be two"),
        ('{"frame": 4, "event": "move", "pos": [1, 2], "key": "a"}', "unknown key 'key'"),
        ('{"frame": 4, "event": "move", "pos": [1, 2], "pos": [1, 2]}', "given twice"),
        ('{"frame": 4, "event": "press", "pos": [1, 2]}', "either 'button' or 'key'"),
        ('{"frame": 4, "event": "press", "pos": [1, 2], "button": "lft"}', "did you mean 'left'?"),
        ('{"frame": 4, "event": "press", "button": "left"}', "'pos' is missing"),
        ('{"frame": 4, "event": "press", "key": "spcae"}', "did you mean 'space'?"),
        ('{"frame": 4, "event": "press", "key": 5}', "unknown key 5"),
        (
            '{"frame": 4, "event": "press", "key": "a", "about": [1, 2, 3]}',
            "'about' goes with a button",
        ),
        ('{"frame": 4, "event": "wheel"}', "'delta' is missing"),
        ('{"frame": 4, "event": "view"}', "a view event needs either 'drag' or 'pose'"),
        ('{"frame": 4, "event": "view", "pose": [1, 2, 3, 0, 5, 6]}', "distance must be positive"),
        ('{"frame": 4, "event": "wheel", "delta": "x"}', "delta must be"),
        ('{"frame": 4, "event": "tool", "name": "grap"}', "name \"grap\"; did you mean 'grab'?"),
        ('{"frame": 4, "event": "tool", "name": 3}', "known: blow, chain, cut, grab"),
        ('{"frame": 4, "event": "tie", "particles": [0]}', "a list of 2 whole numbers, is [0]"),
        ('{"frame": 4, "event": "tie", "particles": [0, 1, 2]}', "must be a list of 2 whole"),
        (
            '{"frame": 4, "event": "link", "pos": [1, 2], "fixed": true, "tied_to": [0, 1]}',
            "tied_to must be a list of 0 to 1 whole numbers, is [0, 1]",
        ),
        ('{"header": {}}', "only be the first line"),
        ("\xff\xfe", "is not JSON"),
    ],
)
def test_a_malformed_line_is_refused_by_its_number(tmp_path, line, says):
    path = tmp_path / "log.jsonl"
    path.write_text(f'{{"header": {{}}}}\n{GOOD}\n\n{line}\n{GOOD}\n', encoding="utf-8")
    with pytest.raises(InputError, match="log.jsonl line 4: ") as refused:
        interaction.load(path)
    assert says in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "header", ["[]", '{"seed": -1}', '{"seed": "x"}', '{"window": [0, 3]}', '{"window": 5}']
)
def test_a_header_that_makes_no_sense_is_refused(tmp_path, header):
    path = tmp_path / "log.jsonl"
    path.write_text(f'{{"header": {header}}}\n')
    with pytest.raises(InputError, match="log.jsonl line 1: "):
        interaction.load(path)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_bytes(GOOD.encode() + b"\n\xff\n")
    with pytest.raises(InputError, match="line 2: is not text in UTF-8"):
        interaction.load(path)


@pytest.mark.parametrize("name", ["missing.jsonl", "."])
def test_a_log_that_is_not_there_is_refused(tmp_path, name):
    with pytest.raises(InputError):
        interaction.load(tmp_path / name)


def test_a_log_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text("what was there before")
    recorder = Recorder(path)
    recorder.write(0, Event("move", (1.0, 2.0)))
    assert path.read_text() == "what was there before"
    recorder.discard()
    assert [p.name for p in tmp_path.iterdir()] == ["log.jsonl"]
    with pytest.raises(KeyboardInterrupt), Recorder(path) as recorder:
        recorder.write(0, Event("move", (1.0, 2.0)))
        raise KeyboardInterrupt
    assert json.loads(path.read_text()) == {"frame": 0, "event": "move", "pos": [1.0, 2.0]}
    assert [p.name for p in tmp_path.iterdir()] == ["log.jsonl"]


def test_frames_cannot_go_back_while_recording(tmp_path):
    recorder = Recorder(tmp_path / "log.jsonl")
    recorder.write(5, Event("move", (1.0, 2.0)))
    with pytest.raises(ValueError, match="after"):
        recorder.write(4, Event("move", (1.0, 2.0)))
    recorder.discard()


def test_a_log_that_goes_back_forgets_what_was_done_from_that_frame_on(tmp_path):
    """Events of a frame are done before it is made: those of the frame itself are gone, too."""
    path = tmp_path / "log.jsonl"
    with Recorder(path) as recorder:
        for frame in (1, 3, 3, 5):
            recorder.write(frame, Event("move", (float(frame), 0.0)))
        recorder.rewind(3)
        recorder.write(4, Event("move", (9.0, 0.0)))
    assert interaction.load(path).by_frame == {
        1: [Event("move", (1.0, 0.0))],
        4: [Event("move", (9.0, 0.0))],
    }
