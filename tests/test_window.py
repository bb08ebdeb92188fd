"""The window of selvedge-lookdev on a display of its own (Xvfb): what it shows, keys and mouse, sizes, rest.

Seen red with the picture upside down, without pan, and with a window that never rests."""
import contextlib
import json
import os
import pathlib
import subprocess
import time

import numpy as np
import PIL.Image
import pytest

ROOT = pathlib.Path(__file__).parents[1]
BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", ROOT / "build" / "bin"))
SCREEN = (480, 400)
SCENE = {
    "camera": {"position": [0, 0.6, 1.1], "target": [0, 0, 0], "fov": 30},
    "film": {"resolution": [240, 160]},
    "lights": [{"type": "directional", "direction": [0.4, -1, -0.2], "irradiance": [3, 3, 3], "angular_diameter": 0}],
    "objects": [{"shape": "sphere", "scale": 0.2, "translate": [0.25, 0.1, 0.1], "matte": {"albedo": [0.7, 0.1, 0.1]}},
                {"shape": "plane", "scale": 0.5, "fabric": {"name": "cloth", "pattern": "plain 1/1", "resolution": 64,
                 "warp": {"spacing": 0.05, "width": 0.045}, "weft": {"spacing": 0.05, "width": 0.045, "albedo": [0.1, 0.2, 0.6]}}}],
}
ACTIONS = {"mousedown", "mouseup", "mousemove_relative", "keydown", "keyup", "key", "click"}
PICTURE = np.s_[:160, :240]   # of the screen


class Display:
    """An X server and one window in it."""

    def __init__(self, folder, arguments=()):
        self.folder, self.arguments = folder, arguments

    def __enter__(self):
        read, write = os.pipe()
        self.server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{SCREEN[0]}x{SCREEN[1]}x24", "-fbdir", str(self.folder), "-nolisten", "tcp"],
            pass_fds=[write], stderr=subprocess.DEVNULL)
        os.close(write)
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        assert number, "Xvfb did not start"
        self.environment = os.environ | {"DISPLAY": f":{number}"}
        (self.folder / "scene.json").write_text(json.dumps(SCENE))
        self.program = subprocess.Popen([BIN / "selvedge-lookdev", self.folder / "scene.json", *self.arguments], env=self.environment,
                                        cwd=self.folder, stderr=subprocess.PIPE, text=True)
        return self

    def __exit__(self, *_):
        for process in (self.program, self.server):
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
            process.wait(20)
        self.program.stderr.close()

    def tool(self, *words):
        """xdotool."""
        return subprocess.run(["xdotool", *map(str, words)], env=self.environment, capture_output=True, text=True, check=True, timeout=20).stdout

    def window(self):
        return self.tool("search", "--sync", "--onlyvisible", "--name", "Selvedge").split()[0]

    def picture(self):
        """The screen as (rows, columns, 3) in [0, 1]: the X server keeps it in a file, an XWD."""
        data = (self.folder / "Xvfb_screen0").read_bytes()
        words = np.frombuffer(data, ">u4", 25)
        assert words[1] == 7 and words[11] == 32, "not an XWD with 32 bits a pixel"
        start, rows, stride = int(words[0] + 12 * words[19]), int(words[5]), int(words[12])
        order = "<" if words[7] == 0 else ">"
        pixels = np.frombuffer(data, order + "u4", rows * stride // 4, start).reshape(rows, stride // 4)[:, :int(words[4])]
        return np.stack([pixels >> shift & 255 for shift in (16, 8, 0)], -1) / 255

    def wait_for(self, what, condition, seconds=180):
        end = time.monotonic() + seconds
        while not condition():
            assert self.program.poll() is None, f"the window is gone: {self.program.stderr.read()}"
            assert time.monotonic() < end, f"{what}: not within {seconds} s"
            time.sleep(0.1)

    def wait_for_picture(self):
        """Without the panels: P."""
        self.wait_for("a window", lambda: self.picture()[PICTURE].std() > 0.02)
        self.tool("mousemove", 150, 60)
        time.sleep(0.3)
        self.tool("key", "p")
        self.wait_for("a picture", lambda: self.shows_the_picture())

    def shows_the_picture(self):
        """Black sky at the top left, where a panel would be, and cloth in the middle."""
        seen = self.picture()[PICTURE]
        return seen[:20, :20].max() < 0.05 < seen[60:100, 80:160].mean()


@pytest.fixture
def display(tmp_path):
    with Display(tmp_path) as shown:
        shown.wait_for_picture()
        yield shown


def headless(folder, name, frames=64, *arguments):
    subprocess.run([BIN / "selvedge-lookdev", folder / "scene.json", "--headless", "-o", folder / name, "--frames", str(frames), *arguments],
                   check=True, capture_output=True, timeout=120)
    return folder / name


@pytest.fixture
def difference(display, tmp_path):
    """How far the window is from the picture that headless writes; 64 frames there, any number here: what remains of noise is
    a few code values, 0.02 at the most after some frames; the same picture upside down is 0.1 away."""
    want = np.asarray(PIL.Image.open(headless(tmp_path, "want.png"))) / 255
    return lambda: np.abs(display.picture()[PICTURE] - want).mean()


def test_the_window_shows_the_picture_that_headless_writes(display, difference):
    display.wait_for("the picture of headless", lambda: difference() < 0.02)
    display.tool("key", "p")
    display.wait_for("the panel", lambda: difference() > 0.1)


@pytest.mark.parametrize("words", [
    ["mousedown", 1, "mousemove_relative", "--sync", 25, 20, "mouseup", 1],
    ["mousedown", 2, "mousemove_relative", "--sync", 25, 20, "mouseup", 2],
    ["keydown", "shift", "mousedown", 1, "mousemove_relative", "--sync", 25, 20, "mouseup", 1, "keyup", "shift"],
    ["click", "--repeat", 4, 4],
    ["keydown", "ctrl", "mousedown", 1, "mousemove_relative", "--sync", 60, 0, "mouseup", 1, "keyup", "ctrl"],
    ["key", "f"],
], ids=["orbit", "pan", "pan-shift", "zoom", "turn-lights", "fit"])
def test_the_mouse_and_keys_move_the_view(display, difference, words):
    display.wait_for("the picture of headless", lambda: difference() < 0.02)
    display.tool("mousemove", 150, 60)
    time.sleep(0.3)
    starts = [k for k, word in enumerate(words) if word in ACTIONS]
    for start, end in zip(starts, [*starts[1:], len(words)]):
        display.tool(*words[start:end])
        time.sleep(0.2)   # a press and a move within one frame would be no drag
    display.wait_for("another view", lambda: difference() > 0.03)
    if "ctrl" not in words:
        display.tool("key", "r")
        display.wait_for("the first view", lambda: difference() < 0.02)


def test_f12_writes_the_picture(display, tmp_path):
    display.tool("mousemove", 150, 60, "key", "F12")
    display.wait_for("selvedge.png", (tmp_path / "selvedge.png").exists)
    picture = np.asarray(PIL.Image.open(tmp_path / "selvedge.png"))
    assert picture.shape == (160, 240, 3) and picture.std() > 10


def test_every_size_is_survived(display):
    window = display.window()
    for size in ((1, 1), (37, 300), (3, 2), (400, 300)):
        display.tool("windowsize", window, *size)
        time.sleep(0.7)
        assert display.program.poll() is None, display.program.stderr.read()
    display.wait_for("a picture as large as the window", lambda: display.picture()[170:300, 250:400].std() > 0.01)


def test_a_paused_window_rests(display):
    display.tool("mousemove", 150, 60, "key", "space")
    assert_it_rests(display)


def test_a_window_whose_picture_has_its_error_rests(tmp_path):
    with Display(tmp_path, ["--target-error", "0.05"]) as shown:
        shown.wait_for_picture()
        assert_it_rests(shown)
        # And wakes: another view is drawn.
        before = shown.picture()
        shown.tool("mousemove", 150, 60, "click", "--repeat", 4, 4)
        shown.wait_for("another view", lambda: np.abs(shown.picture() - before)[PICTURE].mean() > 0.03)
        assert_it_rests(shown)


def assert_it_rests(shown):
    time.sleep(3)

    def ticks():
        fields = pathlib.Path(f"/proc/{shown.program.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return int(fields[11]) + int(fields[12])
    before = ticks()
    time.sleep(3)
    # Looking for saved shaders once a second is all: 1 % of one processor at most.
    assert ticks() - before <= 3


def test_a_saved_shader_shows_and_a_broken_one_does_not(tmp_path, monkeypatch):
    folder = tmp_path / "glsl"
    folder.mkdir()
    for file in (ROOT / "glsl").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    monkeypatch.setenv("SELVEDGE_GLSL", str(folder))
    with Display(tmp_path) as shown:
        shown.wait_for_picture()
        good = (folder / "present.frag").read_text()
        (folder / "present.frag").write_text(good.replace("void main()", "void main() broken"))
        line = shown.program.stderr.readline()
        assert line.startswith("selvedge-lookdev: present.frag:") and "error" in line
        assert shown.shows_the_picture(), "the last good program is gone"
        green = good.replace("colour     = vec4(cloth_display(shown_at(xy).rgb, exposure), 1.0)", "colour = vec4(0.0, 1.0, 0.0, 1.0)")
        assert green != good
        (folder / "present.frag").write_text(green)
        # All but the pointer, which some X servers draw into the screen.
        shown.wait_for("a green picture", lambda: (np.abs(shown.picture()[PICTURE] - [0, 1, 0]).max(-1) < 0.01).mean() > 0.99)


def test_it_closes_by_itself_when_asked_to(tmp_path):
    with Display(tmp_path, ["--exit-after-frames", "3"]) as shown:
        assert shown.program.wait(60) == 0


def test_without_a_display_it_says_so(tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run([BIN / "selvedge-lookdev", tmp_path / "scene.json"], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "--headless" in done.stderr and done.stderr.count("\n") == 1, done.stderr
