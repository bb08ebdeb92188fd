"""While the view moves, the picture is stable; after it, nothing of the move is left. Parameters restart what they change.

Seen red with the past kept after carry_frames, with validation left out of carry.frag (ghosts of the sphere on the ground), with the past
picture fetched at the present place, and without what carry.frag does at edges (flicker)."""
import itertools
import json
import math

import numpy as np
import PIL.Image
import pytest

import evaluate
from preview_driver import drive, read

SIZE = (48, 36)
SCENE = {"film": {"resolution": list(SIZE), "filter": "box"}, "camera": {"position": [0, 0.7, 1.6], "target": [0, 0.1, 0], "fov": 35},
         "lights": [{"type": "environment", "image": str(evaluate.ROOT / "assets" / "lights" / "sky.exr"), "visible": True},
                    {"type": "directional", "direction": [0.4, -1, -0.3], "irradiance": [3, 3, 3], "angular_diameter": 0.5}],
         "objects": [{"shape": "plane", "scale": 3, "matte": {"albedo": [0.3, 0.25, 0.2]}},
                     {"shape": "sphere", "scale": 0.2, "translate": [0, 0.2, 0], "matte": {"albedo": [0.6, 0.1, 0.1]}},
                     {"shape": "plane", "scale": 0.5, "rotate": [90, 0, 0], "translate": [0.35, 0.25, 0.1], "uv_scale": 0.05,
                      "fabric": str(evaluate.ROOT / "assets" / "fabrics" / "organza.json")}]}
FRAMES = 120
LONG = 512              # frames that stand for the truth: 16 blocks
PAIRS = (39, 79, 118)   # frames that are looked at, with the one after each


def camera(k):
    """Frame k of the path: a quarter turn about the scene, with some zoom."""
    angle, distance = math.radians(90 * k / FRAMES - 45), 1.6 + 0.2 * math.sin(k / 15)
    return "camera %.6f 0.7 %.6f 0 0.1 0" % (distance * math.sin(angle), distance * math.cos(angle))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving")
    (folder / "scene.json").write_text(json.dumps(SCENE))
    return folder / "scene.json"


@pytest.fixture(scope="module")
def path(scene):
    """The folder in which the path was drawn: shown pictures of the frames in PAIRS with and without the past, converged ones, the end."""
    folder = scene.parent
    looked_at = sorted({k + step for k in PAIRS for step in (0, 1)})
    for way in (0, 1):
        commands = [f"reproject {way}", f"plan {LONG}"]
        for k in range(FRAMES):
            commands += [camera(k), "frames 1"]
            if k in looked_at:
                commands.append(f"shown {way}-{k}.exr")
        if way:
            commands += ["accumulated first.exr", "frames 31", "shown still.exr", "accumulated still.png", f"frames {LONG - 32}", "shown shown.exr",
                         "accumulated end.png", "accumulated end.exr"]
        drive(folder, scene, SIZE, commands)
    commands = ["reproject 0", f"plan {LONG}"]
    for k in looked_at:
        commands += [camera(k), "frames 128", f"shown truth-{k}.exr"]
    commands += [camera(FRAMES - 1), f"frames {LONG}", "accumulated fresh.exr"]
    drive(folder, scene, SIZE, commands)
    return folder


def test_120_moving_frames_are_stable(path):
    """Flicker: change of the error from a frame to the next, in display values; what moves by itself is in the converged pictures and
    cancels out. With the past it is a fraction of what single frames have, and so is the error itself."""
    flicker, error = {0: [], 1: []}, {0: [], 1: []}
    for k in PAIRS:
        truths = [read(path / f"truth-{k + step}.exr")[0] for step in (0, 1)]
        for way in (0, 1):
            pictures = [read(path / f"{way}-{k + step}.exr")[0] for step in (0, 1)]
            assert all(np.isfinite(picture).all() for picture in pictures)
            errors = [picture - truth for picture, truth in zip(pictures, truths)]
            flicker[way].append(np.mean((errors[1] - errors[0]) ** 2))
            error[way].append(np.mean(errors[1] ** 2))
    ratio = np.mean(flicker[1]) / np.mean(flicker[0])
    print(f"flicker with the past over without: {ratio:.4f}; error {np.mean(error[1]) / np.mean(error[0]):.4f}")
    # A running mean of weight w for the new frame changes by w^2 of what single frames do and has w / (2 - w) of their error. w is 1/25
    # on one object and 1/9 where objects mix (carry.frag): at most 0.012 and 0.059. To that comes what trails behind, and 1/128 of the
    # truth's own noise.
    assert ratio < 0.04
    assert np.mean(error[1]) < 0.1 * np.mean(error[0])


def test_after_the_stop_nothing_of_the_past_is_left(path):
    """The accumulated picture never has any; what is shown has none from the 32nd frame on."""
    assert read(path / "first.exr")[1]["samples"].max() == 1
    for shown, accumulated in (("still.exr", "still.png"), ("shown.exr", "end.png")):
        want = np.asarray(PIL.Image.open(path / accumulated)) / 255
        assert np.abs(read(path / shown)[0] - want).max() < 0.6 / 255 + 1e-4   # 8 bits in the PNG


def test_after_the_stop_it_converges_to_the_same_mean(path):
    """Z-test against a picture that never moved, of other random numbers: 16 blocks each, so Student's t with 30 degrees of freedom, of
    which 0.54 % lie beyond 3."""
    a, of_a = read(path / "end.exr")
    b, of_b = read(path / "fresh.exr")
    variance = np.stack([of_a[f"variance.{c}"] + of_b[f"variance.{c}"] for c in "RGB"], -1)
    seen = variance > 0
    z = (a - b)[seen] / np.sqrt(variance[seen])
    assert (np.abs(z) > 3).mean() < 0.012
    assert abs(z.mean()) < 0.1 and 0.8 < z.std() < 1.2
    assert abs(a.mean() / b.mean() - 1) < 0.005


def test_what_was_hidden_starts_afresh(scene, tmp_path):
    """A jump to the other side of the sphere: of what was behind it, the past knows nothing, and shows no ghost; the rest of the ground
    was seen, and is known at its new place. Red is the sphere's alone; at its edge pixels show it and the ground in any share."""
    front, back = "camera 0 0.7 1.6 0 0.1 0", "camera 0 0.7 -1.6 0 0.1 0"
    drive(tmp_path, scene, SIZE, [front, "frames 64", back, "frames 1", "shown with.exr"])
    drive(tmp_path, scene, SIZE, ["reproject 0", back, "frames 1", "shown without.exr", "frames 255", "shown truth.exr"])
    shown, single, truth = (read(tmp_path / name)[0] for name in ("with.exr", "without.exr", "truth.exr"))
    red = [picture[..., 0] > 1.5 * picture[..., 1] + 0.08 for picture in (shown, truth)]
    at_the_sphere = np.zeros_like(red[1])
    for y, x in itertools.product((-2, -1, 0, 1, 2), repeat=2):
        at_the_sphere |= np.roll(red[1], (y, x), (0, 1))
    assert 20 < red[1].sum() < at_the_sphere.sum() < 500
    assert (red[0] & ~at_the_sphere).sum() == 0
    # In the lower half all is ground. Of half of it and more the past knows what 64 frames have shown.
    ground = ~at_the_sphere & (np.arange(SIZE[1])[:, None] > SIZE[1] / 2)
    assert np.median(np.abs(shown - truth)[ground]) < 0.6 * np.median(np.abs(single - truth)[ground])


@pytest.mark.parametrize("edit", ["light 1 9 1 1", "yarn 0 0.1 0.2 0.9", "model weight 3"], ids=lambda text: text.split()[0])
def test_an_edit_shows_at_once_and_converges_to_what_a_fresh_start_does(scene, tmp_path, edit):
    """The same bits as a preview that has had the edit from the beginning: nothing of before is left, nothing that it needs is missing."""
    drive(tmp_path, scene, SIZE, ["frames 40", edit, "frames 24", "accumulated edited.exr"])
    drive(tmp_path, scene, SIZE, [edit, "frames 24", "accumulated fresh.exr"])
    edited, fresh = read(tmp_path / "edited.exr")[0], read(tmp_path / "fresh.exr")[0]
    drive(tmp_path, scene, SIZE, ["frames 24", "accumulated before.exr"])
    assert np.array_equal(edited, fresh)
    assert np.abs(edited - read(tmp_path / "before.exr")[0]).mean() > 1e-3


def test_every_size_is_drawn(scene, tmp_path):
    """Down to nothing, which is taken as one pixel, and back."""
    commands = ["frames 2", "resize 0 0", "frames 2", "resize 0 7", "frames 1", "shown thin.exr", "resize 64 48", "frames 24", "accumulated back.exr",
                "resize 33 17", "camera 0 0.7 1.6 0 0.1 0", "frames 1", "shown odd.exr"]
    drive(tmp_path, scene, SIZE, commands)
    assert read(tmp_path / "thin.exr")[0].shape == (7, 1, 3) and read(tmp_path / "odd.exr")[0].shape == (17, 33, 3)
    back = read(tmp_path / "back.exr")[0]
    assert back.shape == (48, 64, 3) and np.isfinite(back).all() and back.mean() > 0.05
