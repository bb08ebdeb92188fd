"""What the preview leaves out is not missed: with the work done all the same (--keep), every bit of the picture stays, and so it does in
the program that can do everything. Programs come from the disk, and a damaged one is compiled again.

Seen red with SHADOWS left out of a scene of two spheres, with a light kind left out of CLOTH_LIGHT_KINDS, and with a
cache that trusts a file without looking at its checksum."""
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest

import evaluate

sys.path.insert(0, str(evaluate.ROOT / "tests" / "bench"))

import preview as preview_suite  # noqa: E402

SCENES = evaluate.ROOT / "assets" / "scenes"
CAMERA = {"position": [0, 0.4, 4], "target": [0, 0, 0], "fov": 40}
SUN = {"type": "directional", "direction": [1, -1, -1], "irradiance": [3, 2, 1], "angular_diameter": 0}
MATTE = {"matte": {"albedo": [0.5, 0.4, 0.3]}}


@pytest.fixture
def preview(program, tmp_path):
    """preview(scene, *arguments) -> (report, {channel: pixels}); scene: a dictionary, or the name of one of ours."""
    def run(scene, *arguments, frames=6, size=40, environment=None):
        if isinstance(scene, dict):
            path = tmp_path / "scene.json"
            path.write_text(json.dumps({"camera": CAMERA, "film": {}} | scene))
        else:
            path = SCENES / f"{scene}.json"
        done = subprocess.run([program("lookdev"), path, "--headless", "-o", tmp_path / "a.exr", "--json", "-q", "--frames", str(frames),
                               "--resolution", f"{size},{size}", *arguments], capture_output=True, text=True, timeout=300,
                              env=os.environ | (environment or {}))
        assert done.returncode == 0, done.stderr
        with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
            return json.loads(done.stdout), {name: channel.pixels.copy() for name, channel in file.channels().items()}
    return run


def left_out(report):
    return {name for name, out in report["skipped"].items() if out}


def assert_same_bits(a, b):
    assert a.keys() == b.keys()
    for name in a:
        assert np.array_equal(a[name], b[name]), f"{name}: {(a[name] != b[name]).mean():.2%} of the pixels differ"


SPHERE = {"lights": [SUN], "objects": [{"shape": "sphere"} | MATTE]}
PLANE = {"lights": [SUN, {"type": "point", "position": [1, 1, 1], "intensity": [2, 2, 2]}],
         "objects": [{"shape": "plane", "rotate": [60, 0, 0], "scale": 2} | MATTE]}


@pytest.mark.parametrize("scene, skips", [
    (SPHERE, {"fabric", "gaps", "shadows", "lights", "model", "noise", "interreflection", "stacks"}),
    (PLANE, {"shadows"}),
    ("plane_plain", {"matte", "shadows", "lights", "model"}),
    ("cylinder_satin", {"matte", "shadows", "lights", "search"}),
    ("layers", {"lights", "model", "search"}),
], ids=["sphere", "plane", "plane_plain", "cylinder_satin", "layers"])
def test_the_program_that_can_do_everything_draws_the_same_bits(preview, scene, skips):
    lean, picture = preview(scene, "--primary", "raster")   # which decides about triangles' edges
    full, everything = preview(scene, "--primary", "raster", "--keep", "all")
    assert skips <= left_out(lean) and not left_out(full)
    assert set(lean["features"]) - {"CONVEX", "FEW_LIGHTS", "SKY", "FOUND"} <= set(full["features"])
    assert {"FABRIC", "GAPS", "MATTE", "SHADOWS"} <= set(full["features"])
    assert_same_bits(picture, everything)


@pytest.mark.parametrize("name", ["fabric", "gaps", "interreflection", "lights", "matte", "model", "noise", "search", "shadows", "stacks", "unseen"])
def test_each_skip_alone_changes_no_bit(preview, name):
    """A plane of opaque cloth without noise leaves out all but what it is made of."""
    yarn = {"spacing": 0.001, "width": 0.0012, "thickness": 20}
    cloth = {"name": "cloth", "pattern": "plain 1/1", "resolution": 64, "warp": yarn, "weft": yarn, "irregularity": {"twist": 0}}
    scene = {"lights": [SUN], "model": {"unscattered": False},
             "objects": [{"shape": "plane", "rotate": [60, 0, 0], "scale": 2, "fabric": cloth, "uv_scale": 0.02}]}
    if name in ("fabric", "interreflection", "stacks"):
        scene = SPHERE
    if name == "search":   # points are found by the visibility pass where rays may pass
        scene = scene | {"model": {}}
    if name == "gaps":   # every cloth has some: two bodies without, so that shadow rays have something to meet
        scene = SPHERE | {"objects": SPHERE["objects"] + [{"shape": "sphere", "scale": 0.4, "translate": [-0.8, 0.9, 0.9]} | MATTE]}
    lean, picture = preview(scene, "--primary", "raster")
    kept, again = preview(scene, "--primary", "raster", "--keep", name)
    assert name in left_out(lean) and left_out(lean) - left_out(kept) == {name}
    assert_same_bits(picture, again)


def test_points_are_searched_once_where_the_visibility_pass_finds_them_all(preview):
    """Not where some cloth stops all rays, nor where points have weights that are not handed over, nor where samples share a ray."""
    cloth = {"name": "cloth", "pattern": "plain 1/1", "resolution": 64, "irregularity": {"twist": 0}}
    cloth |= dict.fromkeys(("warp", "weft"), {"spacing": 0.001, "width": 0.0009, "thickness": 20})
    opaque = cloth | dict.fromkeys(("warp", "weft"), {"spacing": 0.001, "width": 0.001, "plies": 1, "thickness": 20})
    plane  = {"shape": "plane", "rotate": [60, 0, 0], "scale": 2, "uv_scale": 0.02, "fabric": cloth}
    behind = plane | {"translate": [0, -0.5, -0.5], "scale": 3}
    model  = {"model": {"unscattered": False}}
    two    = {"lights": [SUN], "objects": [plane, behind]} | model
    mixed  = {"lights": [SUN], "objects": [plane, behind | {"fabric": opaque}]} | model
    def searched(scene, *arguments):
        report, picture = preview(scene, *arguments, size=64)
        assert ("FOUND" in report["features"]) == (report["skipped"]["search"] and "CAMERA_RAYS" not in report["features"])
        return not report["skipped"]["search"], picture
    for primary in ("raster", "rays"):
        again, picture = searched(two, "--primary", primary)
        kept, same = searched(two, "--primary", primary, "--keep", "search")
        assert not again and kept
        assert_same_bits(picture, same)
        again, picture = searched(mixed, "--primary", primary)
        assert again
        _, same = searched(mixed, "--primary", primary, "--keep", "all")
        assert_same_bits(picture, same)
    assert searched(two, "-D", "model.weight=tile")[0]
    assert searched(two, "--footprint-samples", "2")[0]
    assert not searched(two, "--bsdf", "micro")[0]


@pytest.mark.parametrize("primary", ["raster", "rays"])
@pytest.mark.parametrize("arguments", [(), ("--footprint-samples", "2"), ("--target-error", "0.02"), ("--integrator", "path", "--denoise")],
                         ids=["one", "several", "tiles", "path"])
def test_what_sees_nothing_is_not_shaded_and_no_bit_changes(preview, tmp_path, primary, arguments):
    """Of a picture with sky behind the cloth, edges that filter and lens spread, and cloth that shows the sky and the cloth behind."""
    sky = tmp_path / "sky.hdr"
    subprocess.run(["oiiotool", "--pattern", "fill:topleft=4,1,0.2:topright=0.2,1,4:bottomleft=1,1,1:bottomright=0,0,0.5", "16x8", "3", "-o", sky], check=True)
    cloth = {"name": "cloth", "pattern": "plain 1/1", "resolution": 64}
    cloth |= dict.fromkeys(("warp", "weft"), {"spacing": 0.001, "width": 0.0007, "thickness": 1})
    sphere = {"shape": "sphere", "scale": 0.3, "uv_scale": 0.05, "fabric": cloth}
    scene = {"camera": CAMERA | {"lens_radius": 0.05}, "film": {"filter": "tent"},
             "lights": [{"type": "environment", "image": "sky.hdr"}, SUN],
             "objects": [sphere | {"translate": [-0.8, 0.3, 0.9]}, sphere | {"translate": [0.6, -0.2, 0]},
                         {"shape": "plane", "scale": 0.2, "translate": [0.5, -0.7, 1]} | MATTE]}
    lean, picture = preview(scene, "--primary", primary, *arguments, frames=40, size=61)
    kept, again = preview(scene, "--primary", primary, *arguments, "--keep", "unseen", frames=40, size=61)
    shared = primary == "rays" and "--footprint-samples" in arguments   # rays that few walk
    assert lean["skipped"]["unseen"] != shared and not kept["skipped"]["unseen"]
    assert 0.05 < (picture["A"] > 0).mean() < 0.6 and ((picture["A"] > 0) & (picture["A"] < 1)).mean() > 0.02
    assert (picture["R"][picture["A"] == 0] > 0).mean() > 0.9
    assert_same_bits(picture, again)


def test_a_view_that_settles_goes_on_as_it_began(program, tmp_path):
    """Its blocks of pixels are told apart after some frames: of a view, of one that was moved to, and where it is said how long it will be."""
    def accumulated(name, *commands):
        done = subprocess.run([program("drive-preview"), SCENES / "cylinder_satin.json", "96,96"], capture_output=True, text=True, timeout=300,
                              input="\n".join([*commands, f"accumulated {tmp_path / name}"]) + "\n")
        assert done.returncode == 0, done.stderr
        with OpenEXR.File(str(tmp_path / name), separate_channels=True) as file:
            return {name: channel.pixels.copy() for name, channel in file.channels().items()}
    for k, commands in enumerate((["frames 12"], ["frames 12", "camera 0.1 0.2 0.3 0 0.02 0", "frames 12"], ["frames 3", "plan 64", "frames 12"],
                                  ["frames 12", "resize 64 80", "frames 12"])):
        assert_same_bits(accumulated(f"lean{k}.exr", *commands), accumulated(f"kept{k}.exr", "keep unseen", *commands))


def test_yarns_that_reflect_nothing_but_let_light_through_still_light_each_other(preview):
    """Seen red with yarns of no reflectance taken for yarns that give nothing on."""
    yarn = {"spacing": 0.001, "width": 0.0009, "thickness": 20, "albedo": 0, "diffuse": 0, "diffuse_transmission": 0.8}
    cloth = {"name": "cloth", "pattern": "plain 1/1", "resolution": 64, "warp": yarn, "weft": yarn}
    behind = SUN | {"direction": [0.1, 0.9, 0.3]}   # the plane faces y
    scene = {"camera": CAMERA | {"position": [0, 4, 0.4]}, "lights": [behind],
             "objects": [{"shape": "plane", "fabric": cloth, "uv_scale": 0.02}]}
    lean, picture = preview(scene)
    kept, again = preview(scene, "--keep", "interreflection")
    assert "interreflection" not in left_out(lean)
    assert_same_bits(picture, again)


@pytest.mark.parametrize("objects, position, shadows", [
    ([{"shape": "sphere"}], [0, 0.4, 4], False),
    ([{"shape": "sphere"}], [0, 0.1, 0.5], True),                                    # from inside, the far wall is lit
    ([{"shape": "sphere"}, {"shape": "sphere", "translate": [0, 3, 0]}], [0, 0.4, 4], True),
    ([{"shape": "cylinder", "rotate": [30, 20, 10]}], [0, 0.4, 4], False),
    ([{"shape": "plane"}, {"shape": "plane", "translate": [2, 0, 0]}], [0, 0.4, 4], False),   # two in one plane
    ([{"shape": "plane"}, {"shape": "plane", "translate": [0, 1, 0]}], [0, 0.4, 4], True),
    ([{"shape": "drape"}], [0, 2, 4], True),
], ids=["sphere", "inside", "two", "cylinder", "one-plane", "two-planes", "drape"])
def test_shadow_rays_are_left_out_where_nothing_can_be_in_the_way(preview, objects, position, shadows):
    scene = {"camera": CAMERA | {"position": position}, "lights": [SUN], "objects": [each | MATTE for each in objects]}
    report, _ = preview(scene, frames=1, size=8)
    assert ("SHADOWS" in report["features"]) == shadows
    assert report["skipped"]["shadows"] or shadows


def test_buffers_hold_only_what_is_used(preview):
    """Heights only under relief, horizons only where they are asked, no BVH where no ray is traced."""
    size = {name: preview("plane_plain", *arguments, frames=1, size=8)[0]["buffer_bytes"]
            for name, arguments in {"ours": (), "no relief": ("-D", "model.weight=tile"), "no visibility": ("--visibility", "none")}.items()}
    assert size["no relief"] < size["ours"] and size["no visibility"] < size["ours"]
    sphere = {"lights": [SUN], "objects": [{"shape": "sphere"} | MATTE]}
    lean, _ = preview(sphere, frames=1, size=8)
    kept, _ = preview(sphere, "--keep", "shadows", frames=1, size=8)
    assert lean["buffer_bytes"] < 0.7 * kept["buffer_bytes"]


def test_the_stripped_shader_of_the_benchmarks_draws_our_picture(preview, tmp_path):
    """What the program with everything off is held to: written by hand, it has to follow the buffers' layout."""
    glsl = tmp_path / "glsl"
    shutil.copytree(evaluate.ROOT / "glsl", glsl)
    shutil.copy(preview_suite.STRIPPED, glsl / "shade.frag")
    arguments = ("--primary", "raster", "--shade", "fragment")
    hidden    = {"shape": "plane", "translate": [0, -1, 0], "matte": {"albedo": [0.1, 0.2, 0.9]}}
    scene     = preview_suite.BARE | {"objects": [hidden, *preview_suite.BARE["objects"]]}
    _, ours = preview(scene, *arguments)
    _, stripped = preview(scene, *arguments, environment={"SELVEDGE_GLSL": str(glsl)})
    assert ours["R"].min() > 0
    for name in "RGB":
        np.testing.assert_allclose(stripped[name], ours[name], rtol=1e-5)


# ---- programs on disk ------------------------------------------------------------------------------------------------------

def test_programs_are_compiled_once(preview, tmp_path):
    cache = tmp_path / "cache"
    environment = {"SELVEDGE_CACHE": str(cache)}
    first, picture = preview(SPHERE, environment=environment)
    assert first["programs"] == {"compiled": 4, "cached": 0}   # visibility, shade, background, merge; nothing is presented
    second, again = preview(SPHERE, environment=environment)
    assert second["programs"] == {"compiled": 0, "cached": 4}
    assert_same_bits(picture, again)
    # Another program is another file.
    third, _ = preview(SPHERE, "--keep", "shadows", "--primary", "raster", environment=environment)
    assert third["programs"] == {"compiled": 1, "cached": 3}


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "another driver's"])
def test_a_damaged_program_is_compiled_again(preview, tmp_path, damage):
    cache = tmp_path / "cache"
    environment = {"SELVEDGE_CACHE": str(cache)}
    _, picture = preview(SPHERE, environment=environment)
    files = sorted((cache / "programs").iterdir())
    assert len(files) == 4
    for path in files:
        data = bytearray(path.read_bytes())
        if damage == "cut":
            del data[len(data) // 2:]
        if damage == "changed":
            data[-5] ^= 255
        if damage == "empty":
            data = b""
        if damage == "another driver's":
            data[8:12] = (0x1234).to_bytes(4, "little")   # the format, which the checksum does not cover: the driver has to refuse it
        path.write_bytes(bytes(data))
    report, again = preview(SPHERE, environment=environment)
    assert report["programs"] == {"compiled": 4, "cached": 0}
    assert_same_bits(picture, again)
    repaired, _ = preview(SPHERE, environment=environment)
    assert repaired["programs"]["compiled"] == 0


def test_a_cache_that_cannot_be_written_is_no_error(preview, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    report, _ = preview(SPHERE, environment={"SELVEDGE_CACHE": str(tmp_path / "file")}, frames=1)
    assert report["programs"]["compiled"] == 4


def test_an_unknown_part_is_refused(program, tmp_path):
    done = subprocess.run([program("lookdev"), SCENES / "sphere_matte.json", "--headless", "-o", tmp_path / "a.exr", "--frames", "1", "--keep", "hair"],
                          capture_output=True, text=True)
    assert done.returncode == 2 and "hair" in done.stderr and "shadows" in done.stderr and not (tmp_path / "a.exr").exists()
