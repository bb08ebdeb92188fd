"""Light that bounces in the preview: `--integrator path` against the reference's, and against closed forms. Without it nothing changes.

Scenes where much of the light has bounced: colours of the walls of a box, a lamp in metal and cloth, sheer layers and what is behind them,
the inside of a cloth that light has crossed; and two furnaces, whose radiance is 1.

Seen red, in brackets where, with shaders whose bounce does not divide by its density (all of them), that leave a surface on the wrong side
(all), whose Russian roulette gives no weight to who survives (box, oven), and whose bounces stop at each sheet (lamp, sheer, inside)."""
import json
import os
import subprocess

import numpy as np
import OpenEXR
import pytest

import evaluate
import preview_driver
from test_preview_gl import OLD
from test_preview_proof import AREA, DELTA_SUN, GROUND, SHEETS, SUN, cloth, judge, looking, pictures
from test_preview_skips import PLANE, SPHERE, assert_same_bits


def wall(rotate, translate, albedo, scale=1.0):
    return {"shape": "plane", "scale": scale, "rotate": rotate, "translate": translate, "matte": {"albedo": albedo}}


WHITE, RED, GREEN = [0.8, 0.8, 0.8], [0.7, 0.08, 0.06], [0.1, 0.5, 0.12]
BOX = [wall([0, 0, 0], [0, 0, 0], WHITE), wall([180, 0, 0], [0, 1, 0], WHITE), wall([90, 0, 0], [0, 0.5, -0.5], WHITE),
       wall([0, 0, -90], [-0.5, 0.5, 0], RED), wall([0, 0, 90], [0.5, 0.5, 0], GREEN)]
FOUR = {
    "box": (looking([0, 0.5, 2], [0, 0.5, 0], 36), [AREA | {"position": [0, 0.98, 0], "target": [0, 0, 0], "size": [0.3, 0.3]}],
            [*BOX, cloth("plane", "cotton_twill", 0.4, scale=0.4, rotate=[60, 20, 0], translate=[0, 0.3, 0])]),
    "lamp": (looking([0, 0.5, 1.2], [0, 0.12, 0], 24), [],
             [GROUND, {"shape": "plane", "scale": 0.3, "rotate": [180, 0, 0], "translate": [0, 0.35, 0], "emission": [9, 7, 5]},
              {"shape": "sphere", "scale": 0.12, "translate": [-0.14, 0.12, 0], "metal": {"roughness": 0.2}},
              cloth("cylinder", "polyester_satin", [0.6, 0.25], scale=[0.1, 0.2, 0.1], translate=[0.14, 0.1, 0])]),
    "sheer": (looking([0.45, 0.42, 1.35], [0, 0.22, 0], 20), [SUN], [GROUND, wall([90, 0, 0], [0, 0.3, -0.25], RED, 0.8), *SHEETS]),
    "inside": (looking([0, 0.1, 0.4], fov=14), [DELTA_SUN | {"direction": [0, -0.3, 1]}],
               [cloth("cylinder", "organza", [0.22, 0.14], scale=[0.035, 0.14, 0.035])]),
}


@pytest.fixture(scope="module")
def four(tmp_path_factory):
    """{name: (z, bias, standard error, share of the light that has bounced)}"""
    folder, result = tmp_path_factory.mktemp("four"), {}
    for name, (camera, lights, objects) in FOUR.items():
        scene = {"camera": camera, "film": {}, "lights": lights, "objects": objects}
        a, b = pictures(folder, name, scene, 1024, 16, "path")
        direct, _ = pictures(folder, name, scene, 64, 16)
        result[name] = *judge(a, b), 1 - direct["G"].sum() / b["G"].sum()
    return result


@pytest.mark.parametrize("name", FOUR)
def test_paths_have_the_references_mean(four, name):
    """16 x 16 pixels in 16 blocks, Student's t with 30 degrees of freedom: 0.54 % beyond 3, and three standard deviations of that share."""
    z, bias, error, bounced = four[name]
    print(f"{name}: |z| > 3 {(np.abs(z) > 3).mean():.2%}, spread {z.std():.3f}, bias {bias}, standard error {error}, bounced {bounced:.1%}")
    assert len(z) > 200 and bounced > 5 * error.max(), "nothing to tell bounces by"
    assert (np.abs(z) > 3).mean() <= 0.015
    assert 0.85 < z.std() < 1.2
    assert (np.abs(bias) <= 0.002 + 3 * error).all()


# ---- furnaces: whatever is seen has radiance 1 -----------------------------------------------------------------------------------

PURE = {"matte": {"albedo": 1}}
FURNACES = {
    "sky": (looking([0, 2, 6], [0, 0.5, 0]), [{"type": "environment", "colour": 1}],
            [{"shape": "plane", "scale": 10} | PURE, {"shape": "sphere", "translate": [0, 1, 0]} | PURE]),
    # Half of the light is given back at each meeting, and half is given: 1 in all.
    "oven": (looking([0.1, 0.55, 0.45], [0, 0.4, 0], 70), [],
             [*(each | {"matte": {"albedo": 0.5}, "emission": 0.5} for each in [*BOX, wall([-90, 0, 0], [0, 0.5, 0.5], WHITE)]),
              {"shape": "sphere", "scale": 0.15, "translate": [0, 0.3, -0.1]} | PURE]),
}


def show(folder, scene, *arguments, environment=None):
    """What the preview draws: its report, and {channel: pixels}."""
    (folder / "scene.json").write_text(json.dumps({"film": {}} | scene))
    done = subprocess.run([evaluate.BIN / "selvedge-lookdev", folder / "scene.json", "--headless", "-o", folder / "a.exr", "--json", "-q",
                           *map(str, arguments)], capture_output=True, text=True, timeout=300, env=os.environ | (environment or {}))
    assert done.returncode == 0, done.stderr
    with OpenEXR.File(str(folder / "a.exr"), separate_channels=True) as file:
        return json.loads(done.stdout), {name: channel.pixels.copy() for name, channel in file.channels().items()}


@pytest.mark.parametrize("name", FURNACES)
def test_in_a_white_furnace_everything_is_as_bright_as_its_light(tmp_path, name):
    """A path of 256 surfaces has long left the sky's furnace; in the oven half of its light is gone at each."""
    camera, lights, objects = FURNACES[name]
    _, picture = show(tmp_path, {"camera": camera, "lights": lights, "objects": objects}, "--integrator", "path", "--max-depth", 256,
                      "--frames", 512, "--resolution", "16,16")
    seen = picture["A"] == 1
    mean, sigma = picture["G"][seen].mean(dtype="f8"), np.sqrt(picture["variance.G"][seen].mean(dtype="f8") / seen.sum())
    z = (picture["G"][seen] - 1) / np.sqrt(np.maximum(picture["variance.G"][seen], 1e-12))
    print(f"{name}: {mean:.5f} +- {sigma:.5f}, |z| > 4 {(np.abs(z) > 4).mean():.2%}")
    assert seen.mean() > 0.3 and sigma < 3e-3
    assert abs(mean - 1) < 4 * sigma + 1e-4
    # 16 blocks on one side alone, t with 15 degrees of freedom: 0.12 % beyond 4.
    assert (np.abs(z) > 4).mean() <= 0.015


# ---- what paths cost where there are none ----------------------------------------------------------------------------------------

LAYERS = {"camera": FOUR["sheer"][0], "lights": FOUR["sheer"][1], "objects": FOUR["sheer"][2]}
INSIDE = {"camera": FOUR["inside"][0], "lights": FOUR["inside"][1], "objects": FOUR["inside"][2]}
FEW = ("--frames", 4, "--resolution", "24,24")


def test_nothing_is_added_where_paths_are_not_asked_for(tmp_path):
    direct, picture = show(tmp_path, LAYERS, *FEW)
    once, same = show(tmp_path, LAYERS, *FEW, "--integrator", "path", "--max-depth", 1)
    assert (direct["integrator"], once["integrator"]) == ("direct", "path")
    assert "BOUNCES" not in direct["features"] and once["features"] == direct["features"]
    assert_same_bits(picture, same)
    twice, other = show(tmp_path, LAYERS, *FEW, "--integrator", "path", "--max-depth", 2)
    assert "BOUNCES" in twice["features"] and not twice["skipped"]["bounces"] and (other["G"] > picture["G"]).any()


@pytest.mark.parametrize("scene", [SPHERE, PLANE], ids=["sphere", "plane"])
def test_light_that_meets_no_second_surface_is_not_followed(tmp_path, scene):
    """A lone convex body, a lone plane: paths are direct light, bit for bit, without a program or a tree for them."""
    scene = {"camera": looking([0, 0.4, 4], fov=40)} | scene
    direct, picture = show(tmp_path, scene, *FEW)
    path, same = show(tmp_path, scene, *FEW, "--integrator", "path")
    assert path["skipped"]["bounces"] and path["features"] == direct["features"] and path["buffer_bytes"] == direct["buffer_bytes"]
    assert_same_bits(picture, same)
    # Without a tree there are no rays for what pixels see; the rasteriser decides otherwise about triangles' edges.
    kept, again = show(tmp_path, scene, *FEW, "--integrator", "path", "--keep", "bounces", "--primary", "raster")
    assert "BOUNCES" in kept["features"] and kept["buffer_bytes"] > direct["buffer_bytes"]
    assert_same_bits(picture, again)


@pytest.mark.parametrize("scene", [LAYERS, INSIDE], ids=["layers", "inside"])
def test_the_program_that_can_do_everything_follows_the_same_paths(tmp_path, scene):
    lean, picture = show(tmp_path, scene, *FEW, "--integrator", "path")
    full, everything = show(tmp_path, scene, *FEW, "--integrator", "path", "--keep", "all")
    assert "BOUNCES" in lean["features"] and len(full["features"]) > len(lean["features"]) - 2
    assert_same_bits(picture, everything)


def test_gl_4_1_follows_the_same_paths(tmp_path):
    _, picture = show(tmp_path, LAYERS, *FEW, "--integrator", "path")
    report, old = show(tmp_path, LAYERS, *FEW, "--integrator", "path", environment=OLD)
    assert report["gl"]["version"].startswith("4.1") and "BOUNCES" in report["features"]
    assert abs(old["G"].mean() / picture["G"].mean() - 1) < 1e-3


ROOM = {"film": {}, "lights": [{"type": "point", "position": [0, 0.5, 0], "intensity": [3, 3, 3]}],
        "objects": [{"shape": "sphere", "matte": {"albedo": [0.8, 0.5, 0.2]}}]}


def test_paths_are_switched_on_and_off(tmp_path):
    """As the window does it: what is drawn then is what a fresh preview draws. From outside, the ball is all that light meets, and nothing
    is there for rays to walk; from inside, it is."""
    for name, z in (("outside", 4), ("inside", 0.6)):
        (tmp_path / f"{name}.json").write_text(json.dumps(ROOM | {"camera": looking([0, 0.1, z], [0, 0.1, 0], 60)}))
    look = "camera 0 0.1 0.6 0 0.1 0"
    preview_driver.drive(tmp_path, "inside.json", (16, 16), ["frames 4", "accumulated direct.exr"])
    preview_driver.drive(tmp_path, "inside.json", (16, 16), ["max-depth 8", "frames 4", "accumulated path.exr"])
    preview_driver.drive(tmp_path, "outside.json", (16, 16), ["max-depth 8", look, "frames 4", "accumulated 1.exr", "max-depth 1", "frames 4",
                                                              "accumulated 2.exr", "max-depth 8", "frames 4", "accumulated 3.exr"])
    _, direct = preview_driver.read(tmp_path / "direct.exr")
    _, path = preview_driver.read(tmp_path / "path.exr")
    for name, want in (("1", path), ("2", direct), ("3", path)):
        assert_same_bits(preview_driver.read(tmp_path / f"{name}.exr")[1], want)
    assert (path["R"] > direct["R"]).mean() > 0.9
