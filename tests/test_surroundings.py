"""Where windows are missing or slow, the program says so, and what works there."""

from contextlib import closing

import pytest
from commands import command

from taichi_cloth import runtime, vulkan
from taichi_cloth.scene import library
from taichi_cloth.ui import opening, presenters, surroundings
from taichi_cloth.ui.chrome.layout import arrange, at_start

SSH = {"SSH_CONNECTION": "10.0.0.1 5 10.0.0.2 22"}


@pytest.mark.parametrize(
    "env, name, words",
    [
        ({"JPY_PARENT_PID": "7", **SSH}, "notebook", "sim.show()"),
        ({"WAYLAND_DISPLAY": "wayland-0"}, "Wayland without XWayland", "install XWayland"),
        (SSH, "SSH", "ssh -Y"),
        ({"WSL_DISTRO_NAME": "Debian"}, "WSL", "wsl --update"),
        ({"container": "podman"}, "container", "-v /tmp/.X11-unix"),
    ],
)
def test_each_place_says_what_works_there(env, name, words):
    assert name in [place.name for place in surroundings.places(env)]
    assert words in surroundings.instead(env) and "--video FILE.mp4" in surroundings.instead(env)


def test_xwayland_and_forwarded_displays_are_told_from_others():
    both = {"WAYLAND_DISPLAY": "wayland-0", "DISPLAY": ":0"}
    assert "Wayland without XWayland" not in [place.name for place in surroundings.places(both)]
    forwarded = [{**SSH, "DISPLAY": name} for name in ("localhost:10.0", "127.0.0.1:11")]
    assert all(map(surroundings.is_forwarded, forwarded))
    others = ({**SSH, "DISPLAY": ":0"}, {"DISPLAY": "localhost:10.0"}, SSH)
    assert not any(map(surroundings.is_forwarded, others))


def test_a_run_without_a_display_says_what_to_do(cli):
    """Also in a notebook's `!`, whose processes have the kernel's environment."""
    said = command(
        *("run", "oscillator", "--frames", "2", "--quiet"),
        env={"DISPLAY": "", "WAYLAND_DISPLAY": "", "JPY_PARENT_PID": "7"},
    )[1]
    assert "running headless\nwhat works here: in a notebook's cell sim.show()" in said


def test_doctor_says_what_there_is_and_which_key_serves(display, monkeypatch):
    if not surroundings.equipment():
        pytest.skip("needs an X server")
    found = surroundings.equipment()
    assert found.has_f1 and found.has_wheel and found.scale == 1.0 and min(found.size) >= 600
    good = {report.name: report for report in surroundings.reports()}
    assert good["mouse"].good and good["keyboard"].good and good["display"].good
    poor = surroundings.Equipment((1280, 800), 2.0, has_f1=False, buttons=3)
    monkeypatch.setattr(surroundings, "equipment", lambda: poor)
    poor = {report.name: report for report in surroundings.reports()}
    assert not poor["mouse"].good and "+ and -" in poor["mouse"].text
    assert not poor["keyboard"].good and "tab" in poor["keyboard"].text
    assert "scale 2" in poor["screen"].text and "--text-size" in poor["screen"].text
    monkeypatch.setattr(runtime, "display_available", lambda: False)
    none = {report.name: report for report in surroundings.reports()}
    assert not none["display"].good and "does not answer" in none["display"].text
    assert "tab" in none["keys"].text and "+ and -" in none["keys"].text


def test_scale_is_read_from_the_servers_resources():
    assert surroundings._scale("*customization: -color\nXft.dpi:\t192\n") == 2.0
    assert surroundings._scale("") == 1.0


def test_auto_takes_ggui_only_where_a_graphics_card_has_vulkan(monkeypatch):
    """A window that was asked for by name opens all the same, and `doctor` says why."""
    for name, there in (("display_available", True), ("vulkan_available", True)):
        monkeypatch.setattr(runtime, name, lambda there=there: there)
    monkeypatch.setattr(surroundings, "is_forwarded", lambda: False)
    card, software = "NVIDIA H200", "llvmpipe (LLVM 15.0.6, 256 bits)"
    for devices, best in (([software], "gui"), ([card], "ggui"), ([software, card], "ggui")):
        monkeypatch.setattr(vulkan, "devices", lambda devices=devices: devices)
        assert opening._best(presenters.load_all()).name == best
        assert (opening.avoided_by_auto("ggui") is None) == (best == "ggui")
    assert opening.usable_views() == {"ggui": None, "gui": None, "none": None}


def test_text_is_as_large_as_the_screen_or_the_flag_wants(monkeypatch, display, device):
    """A window asks the screen; nothing leaves the world less than its room."""
    if not surroundings.equipment():
        pytest.skip("needs an X server")
    usual, large = (
        arrange((1280, 800), at_start(windowed=True, status=True, text=size)) for size in (1.0, 2.0)
    )
    assert large.text == 2 * usual.text and large.world.height < usual.world.height
    assert arrange((200, 100), at_start(windowed=True, status=True, text=4.0)).world.height >= 64
    sharp = surroundings.Equipment((3840, 2160), 2.0, has_f1=True, buttons=5)
    monkeypatch.setattr(surroundings, "equipment", lambda: sharp)
    world = library.build("cloth").world
    for asked, found in ((None, 2.0), (1.5, 1.5)):
        with closing(opening.open_view("gui", world, text_size=asked)) as view:
            assert view.text_size == found
    with closing(opening.open_view("none", world)) as view:
        assert view.text_size == 1.0
