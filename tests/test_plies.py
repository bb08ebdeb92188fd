"""selvedge-render --model plies: what it refuses, that its bits do not depend on how it was run, that plane, cylinder and turned fabrics
show the same cloth, that it meets the surface model where that is exact, and the suite and page made with it. Closed forms, relief,
reciprocity and furnace are in tests/cpp/plies_test.cpp.

Seen red with the turn of a cylinder's fabric left out, with a mesh bent to the inside, with objects turned whose plies were not, with
lamps that camera rays do not see, and with metal taken for matte."""
import json
import math
import os
import subprocess
import sys

import OpenEXR
import pytest

import evaluate
import plies_tables

sys.path.insert(0, str(evaluate.ROOT / "tests" / "bench"))

import plies  # noqa: E402

FABRIC = {"name": "satin", "pattern": "satin 5", "resolution": 64, "irregularity": {"twist": 0},
          "warp": {"plies": 1, "spacing": .0003, "width": .00029, "fibre_twist": 0, "roughness": .2},
          "weft": {"plies": 1, "spacing": .0003, "width": .00028, "fibre_twist": 0, "roughness": .2}}
OPAQUE = {"aspect": .3, "thickness": 20, "diffuse": .3, "diffuse_transmission": 0, "albedo_transmission": 0}
SUN = {"type": "directional", "direction": [-.35, -.9, -.25], "irradiance": 3}


def fabric_of(**keys):
    return FABRIC | {yarn: FABRIC[yarn] | keys for yarn in ("warp", "weft")}


def scene_of(shape="plane", size=(.03, 1, .03), uv=(.03, .03), light=SUN, **keys):
    """Seen from above, or a cylinder's foremost strip: a square of 5 mm in its middle."""
    front = shape == "cylinder"   # its front is z, where a plane's is y
    eye, up = ([0, 0, .5 + size[0]], [0, 1, 0]) if front else ([0, .5, 0], [0, 0, -1])
    if front and "direction" in light:
        x, y, z = light["direction"]
        light = light | {"direction": [x, -z, y]}
    return {"camera": {"position": eye, "target": [0, 0, size[0] if front else 0], "up": up, "fov": math.degrees(2 * math.atan(.0025 / .5))},
            "film": {"resolution": [16, 16]}, "lights": [light],
            "objects": [{"shape": shape, "scale": list(size), "fabric": FABRIC, "uv_scale": list(uv)} | keys]}


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return os.environ | {"SELVEDGE_CACHE": str(tmp_path_factory.mktemp("cache"))}


@pytest.fixture
def render(program, tmp_path, cache):
    """render(scene, arguments…) -> CompletedProcess of selvedge-render --model plies, whose picture is tmp_path/out.exr."""
    def run(scene, *arguments, model=("--model", "plies")):
        (tmp_path / "scene.json").write_text(json.dumps(scene))
        return subprocess.run([program("render"), tmp_path / "scene.json", "-o", tmp_path / "out.exr", "-q", *model, *map(str, arguments)],
                              capture_output=True, text=True, timeout=120, env=cache, cwd=tmp_path)
    return run


@pytest.fixture
def mean(render, tmp_path):
    def run(scene, *arguments, **keys):
        done = render(scene, *arguments, **keys)
        assert done.returncode == 0, done.stderr
        return plies.mean_of(tmp_path / "out.exr")
    return run


@pytest.mark.parametrize("scene, words", [
    (scene_of("sphere", uv=(.2, .1)), "objects.0 (sphere): found a fabric on another shape, plies expect plane or cylinder"),
    (scene_of(size=(-.03, 1, .03)), "found a mirroring scale"),
    (scene_of("cylinder", size=(.03, .1, .02), uv=(.19, .1)), "found an oval cylinder"),
    (scene_of("cylinder", size=(.03, .1, .03), uv=(.188, .1), uv_rotation=30), "found the fabric turned by other than quarter turns"),
    (scene_of(uv=(.03, .02)), "found the fabric stretched by"),
    (scene_of(size=(3, 1, 3), uv=(3, 3)), "repeats of the fabric, plies expect 1048576 at most")])
def test_what_cannot_be_instanced_is_refused(render, tmp_path, scene, words):
    done = render(scene, "--spp", 1)
    assert done.returncode == 1 and words in done.stderr and done.stderr.count("\n") == 1, done.stderr
    assert not (tmp_path / "out.exr").exists()


def test_the_surface_models_options_are_refused(render):
    done = render(scene_of(), "--mode", "paper")
    assert done.returncode == 2 and "--model plies: found --mode" in done.stderr
    done = render(scene_of(), "--aov", "normal,delta")
    assert done.returncode == 2 and "a layer of the surface model in --aov" in done.stderr
    done = render(scene_of(), model=("--model", "curves"))
    assert done.returncode == 2 and "expected one of surface, plies" in done.stderr


def test_bits_do_not_depend_on_threads_or_resuming(render, tmp_path):
    sky = scene_of(light={"type": "environment", "colour": 1})

    def bits(*arguments, resumed=0):
        report = json.loads(render(sky, *arguments, "--json").stdout)
        assert report["geometry"] == "plies" and report["integrator"] == "path" and report["bad_samples"] == 0
        assert report["instances"] == 400 and report["triangles"] > 1000   # 20 x 20 repeats of 1.5 mm
        assert report["resumed_samples"] == resumed
        return OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True).channels()["G"].pixels.tobytes()
    half = bits("--threads", 1, "--spp", 8, "--checkpoint", 1000)
    whole = bits("--spp", 16, "--resume", "--checkpoint", 1000, resumed=8)
    assert bits("--threads", 2, "--spp", 8) == half != whole
    assert bits("--threads", 2, "--spp", 16) == whole


def test_a_plys_checkpoint_is_not_the_surfaces(render):
    assert render(scene_of(), "--spp", 2, "--checkpoint", 1000).returncode == 0
    done = render(scene_of(), "--spp", 4, "--resume", "--integrator", "path", model=())
    assert done.returncode == 1 and "checkpoint" in done.stderr


def test_plane_cylinder_and_turned_fabrics_show_the_same_cloth(mean):
    """Near its foremost line a cylinder is a plane. Opaque, for else light comes back out of the cylinder's inside."""
    around = 2 * math.pi * .15
    seen = {}
    for turn in (0, 90):
        keys = {"uv_rotation": turn, "fabric": fabric_of(**OPAQUE)}
        flat, flat_sigma = mean(scene_of(**keys), "--spp", 128)
        bent, bent_sigma = mean(scene_of("cylinder", size=(.15, .015, .15), uv=(around, .015), **keys), "--spp", 128)
        # Across 5 mm the normal turns by a degree to either side, which the mean over both takes away but for its square.
        assert abs(flat - bent) < 4 * math.hypot(flat_sigma, bent_sigma) + 2e-3 * flat
        seen[turn] = flat
    assert abs(seen[0] / seen[90] - 1) > .1   # warp shows at four to one, and shines along


def test_a_turntable_turns_the_plies(render, mean, tmp_path):
    scene = scene_of(fabric=fabric_of(**OPAQUE))
    still, still_sigma = mean(scene, "--spp", 64)
    scene["objects"][0]["rotate"] = [0, 90, 0]
    turned, turned_sigma = mean(scene, "--spp", 64)
    del scene["objects"][0]["rotate"]
    done = render(scene, "--spp", 64, "--turntable", 4, "--frames", "1-1", "--seed", 5)
    assert done.returncode == 0, done.stderr
    found, found_sigma = plies.mean_of(tmp_path / "out_0001.exr")
    assert abs(found - turned) < 4 * math.hypot(found_sigma, turned_sigma)
    assert abs(found - still) > 8 * math.hypot(found_sigma, still_sigma)


def test_what_is_no_cloth_looks_as_beside_the_surface(mean):
    """A lamp and a ball of metal before a ground, the cloth out of sight."""
    scene = scene_of(light={"type": "environment", "colour": [.2, .3, .4]}, translate=[2, 0, 0])
    scene["camera"] |= {"fov": 60}
    scene["objects"] += [{"shape": "sphere", "scale": .12, "translate": [-.15, 0, 0], "metal": {"roughness": .3}},
                         {"shape": "sphere", "scale": .04, "translate": [.15, .05, 0], "emission": 3},
                         {"shape": "plane", "scale": 2, "translate": [0, -.15, 0], "matte": {"albedo": .5}}]
    truth, truth_sigma = mean(scene, "--spp", 64, "--integrator", "path", "--max-depth", 4, model=())
    found, found_sigma = mean(scene, "--spp", 64, "--max-depth", 4, "--seed", 1)
    assert abs(found - truth) < 4 * math.hypot(found_sigma, truth_sigma)
    assert found_sigma < .01 * found


def test_where_nothing_hides_or_passes_the_surface_is_exact(mean):
    """Flat opaque yarns, seen and lit from above: no visibility, walls or transmission to differ by."""
    scene = scene_of(light=SUN | {"direction": [-.1, -1, -.15]}, fabric=fabric_of(**OPAQUE | {"aspect": .1}) | {"resolution": 256})
    truth, truth_sigma = mean(scene, "--spp", 128)
    found, found_sigma = mean(scene, "--spp", 128, "--integrator", "direct", model=())
    # The soft step of the horizons is worth .06 of a sine at creases of a tenth of a yarn's height.
    assert abs(found - truth) < 4 * math.hypot(found_sigma, truth_sigma) + 5e-3 * truth


def test_the_suite_measures_every_mode_and_the_page_shows_it(tmp_path, monkeypatch, cache):
    for name, value in {"FABRICS": {"satin": "satin"}, "MODES": {mode: plies.MODES[mode] for mode in ("ours", "unstacked")}, "LIGHTS": ("sky",), "PICTURE": 8}.items():
        monkeypatch.setattr(plies, name, value)
    monkeypatch.setenv("SELVEDGE_CACHE", cache["SELVEDGE_CACHE"])
    options = plies.LONG | {"fabrics": ("satin",), "angles": (45,), "samples": 1 << 13, "picture_spp": 1}
    cells = plies.measure(options, tmp_path)
    assert len(cells) == 2 * 2 + 2
    for cell in cells:
        own = cell["modes"]["ours"]
        # What nothing passes is nearly exact. Of light that crosses a yarn, stacks mend the larger part.
        limit = .05 if cell["opaque"] else .6 * abs(cell["modes"]["unstacked"]["error"])
        assert abs(own["error"]) < limit + own["error_95"], cell
    plies.picture(options, tmp_path, tmp_path / "out")
    assert (tmp_path / "out" / "plies.png").stat().st_size > 100
    figures = plies.figures_of(cells)
    assert {"error.reflected.near.ours", "error.transmitted.far.ours", "error.opaque.ours", "rms.reflected.near.ours"} <= set(figures)
    page = plies_tables.document({"date": "2026-11-25", "git": "0", "cpu": "one", "tables": {"cells": cells, "angles": (45,), "samples": 1}})
    assert page.count("| satin, sky, 45° |") == 6 and "| satin, transmitted |" in page
