"""selvedge-render against an independent renderer, Mitsuba 3, on the same scenes: matte under every kind of light, and the ply-level cloth
as a Mitsuba plugin that was typed from math.md. Images have to agree within the noise of both: single pixels, blocks of pixels, and the sum.

Seen red with the environment turned by one degree or by one texel, a spot whose rim fades linearly, a path one vertex shorter, the twist
of the back side not turned around, the slab's reflection 5 % darker, diffuse_mix left out, gaps taken as opaque."""
import json
import subprocess

import evaluate
import mitsuba_cloth
import mitsuba_scene
import numpy as np
import OpenEXR
import pytest
from scipy import stats

ASSETS = evaluate.ROOT / "assets"
RUNS = 32            # of Mitsuba
FALSE_ALARM = 1e-5   # of each test's sum and blocks, where both renderers are right
BLOCK = 8            # pixels along the side of a block


def own_picture(program, folder, scene, depth, spp):
    (folder / "scene.json").write_text(json.dumps(scene))
    done = subprocess.run([program("render"), folder / "scene.json", "-o", folder / "ours.exr", "--spp", str(spp), "--integrator", "path",
                           "--max-depth", str(depth), "--seed", "3", "-q"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return folder / "ours.exr"


def layers(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels, float) for name, channel in file.channels().items()}
    return [np.stack([channels[prefix + letter] for letter in "RGB"], -1) for prefix in ("", "variance.")]


def block_sums(image):
    rows, columns = (size // BLOCK * BLOCK for size in image.shape[:2])
    return image[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK, 3).sum((1, 3))


def assert_same_picture(program, folder, ours, pictures, largest_sigma):
    """largest_sigma  of the mean's relative noise: what the test has to be able to see"""
    theirs = folder / "theirs.exr"
    mitsuba_scene.write_picture(theirs, pictures)
    done = subprocess.run([program("compare"), ours, theirs, "--json", "--fail", "max_abs=inf"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["bad_pixels"] == {"a": 0, "b": 0} and found["z_values"] > .2 * found["values"]
    # Pixel by pixel, channels as if they were one: z follows Student's t, of 15 degrees of freedom at least.
    pixels = found["z_values"] // 3
    assert found["z_outliers"] * pixels <= stats.binom.isf(FALSE_ALARM, pixels, 2 * stats.t.sf(3, 15)), found
    assert .8 < found["z_std"] < 1.2, found   # a variance that is too large would let anything pass
    limit = stats.norm.isf(FALSE_ALARM / 2)
    assert found["mean_relative_bias_sigma"] < largest_sigma
    assert abs(found["mean_relative_bias"]) < limit * found["mean_relative_bias_sigma"], found
    # Blocks see what is too faint for single pixels and cancels in the sum: a shadow that is displaced, a highlight that is turned.
    (a, noise_a), (b, noise_b) = layers(ours), layers(theirs)
    difference, variance = block_sums(a - b), block_sums(noise_a + noise_b)
    # Two float renderers agree to about 1e-5 of a pixel where both are free of noise.
    sigma = np.sqrt(variance + (1e-5 * block_sums(b)) ** 2)
    z = difference[sigma > 0] / sigma[sigma > 0]
    assert np.abs(z).max() < stats.norm.isf(FALSE_ALARM / 2 / z.size), np.abs(z).max()


# ---- matte -------------------------------------------------------------------------------------------------------------------------

LIGHTS = {
    "environment": {"type": "environment", "image": str(ASSETS / "lights" / "sky.exr"), "rotation": 40, "scale": [1, 0.8, 0.6]},
    "hidden environment": {"type": "environment", "colour": [0.4, 0.5, 0.7], "visible": False},
    "directional": {"type": "directional", "direction": [0.3, -1, -0.2], "irradiance": [3, 2, 1], "angular_diameter": 0},
    "sun": {"type": "directional", "direction": [0.3, -1, -0.2], "irradiance": [3, 2, 1], "angular_diameter": 12},
    "point": {"type": "point", "position": [1, 2, 1], "intensity": [6, 5, 4]},
    "spot": {"type": "spot", "position": [1, 2, 1], "target": [0, 0.3, 0], "intensity": [6, 5, 4], "cone": 28, "penumbra": 12},
    "area": {"type": "area", "position": [0.5, 2.5, 0.8], "target": [0, 0.3, 0], "size": [0.6, 1.2], "radiance": [6, 5, 4]},
    "flash": {"type": "flash", "position": [0.3, 1, 2.2], "target": [0, 0.5, 0], "intensity": [6, 5, 4]},
}
CAMERA = {"position": [0.4, 1.2, 3], "target": [0, 0.5, 0], "fov": 38}
GROUND = {"shape": "plane", "scale": 6, "matte": {"albedo": [0.5, 0.6, 0.7]}}


def matte_scene(folder, lights):
    """A ball, and a board that is turned about all three axes and stretched."""
    mitsuba_scene.write_ball(folder / "ball.ply", 96, 48)
    ball = {"mesh": "ball.ply", "scale": 0.6, "translate": [0.3, 0.6, 0], "matte": {"albedo": [0.8, 0.4, 0.2]}}
    board = {"shape": "plane", "scale": [1, 1, 1.4], "translate": [-0.8, 0.7, -0.2], "rotate": [70, 20, 10], "matte": {"albedo": 0.6}}
    return {"camera": CAMERA, "film": {"resolution": [48, 32]}, "lights": lights, "objects": [GROUND, ball, board]}


def assert_matte(program, folder, lights, depth):
    mi = mitsuba_scene.use("scalar_rgb")
    scene = matte_scene(folder, lights)
    loaded = mi.load_dict(mitsuba_scene.translate(mi, scene, folder, ASSETS, depth))
    assert_same_picture(program, folder, own_picture(program, folder, scene, depth, 512), mitsuba_scene.render(mi, loaded, 12, RUNS), 2e-3)


@pytest.mark.parametrize("depth", [1, 4])
@pytest.mark.parametrize("light", LIGHTS)
def test_matte_under_each_light(program, tmp_path, light, depth):
    assert_matte(program, tmp_path, [LIGHTS[light]], depth)


def test_matte_under_several_lights(program, tmp_path):
    assert_matte(program, tmp_path, [LIGHTS["point"], LIGHTS["environment"], LIGHTS["spot"]], 3)


# ---- cloth -------------------------------------------------------------------------------------------------------------------------

# A twill with gaps, yarns apart in every number that the BSDF has. No noise on the twist: the plugin has none.
WARP = {"spacing": 0.0005, "width": 0.00048, "fibre_twist": -15, "albedo": [0.5, 0.3, 0.2], "albedo_transmission": [0.4, 0.3, 0.3],
        "diffuse": [0.2, 0.15, 0.1], "diffuse_transmission": [0.1, 0.1, 0.2], "roughness": 0.3, "roughness_transmission": 0.2,
        "thickness": 1.2, "diffuse_mix": 0.7}
WEFT = WARP | {"albedo": [0.2, 0.3, 0.5], "fibre_twist": 25, "roughness": 0.15, "thickness": 0.7, "diffuse_mix": 1}
FABRIC = {"name": "twill", "pattern": "twill 2/1", "resolution": 64, "warp": WARP, "weft": WEFT}
MICRO = {"bsdf": "micro", "unscattered": False, "stacked": False, "twist_noise": False}


@pytest.fixture
def render_cloth(program, bake, tmp_path):
    """render_cloth(scene, depth, footprint, spp) -> pictures of Mitsuba; footprint in metres of cloth."""
    def render(scene, depth, footprint, spp):
        mi = mitsuba_scene.use("llvm_ad_rgb")
        (tmp_path / "fabric.json").write_text(json.dumps(FABRIC))
        done = bake(tmp_path / "fabric.json", "-o", tmp_path / "baked", "-q")
        assert done.returncode == 0, done.stderr
        fabric = mitsuba_cloth.Fabric(FABRIC, tmp_path / "baked")
        assert all(0 < side["gap"].mean() < .2 for side in fabric.sides)
        cloth = mitsuba_cloth.plugin(mi)
        translated = mitsuba_scene.translate(mi, scene, tmp_path, ASSETS, depth, lambda entry: cloth(fabric, entry["uv_scale"], footprint))
        translated["integrator"]["type"] = "volpath"   # whose shadow rays pass through gaps
        return mitsuba_scene.render(mi, mi.load_dict(translated), spp, RUNS)
    return render


@pytest.mark.parametrize("seen_from", ["front", "behind"])
@pytest.mark.parametrize("light", ["front", "behind", "around"])
def test_cloth_close_up(program, tmp_path, render_cloth, light, seen_from):
    """Single plies. The camera looks straight at the sheet, so that every pixel has the same footprint on it; at the rim it sees 35 degrees
    along the axes and 44 at the corners."""
    size, fov, height = 32, 70, 0.002
    lights = {"front": {"type": "point", "position": [0.3, 0.5, 0.2], "intensity": [0.6, 0.5, 0.4]},
              "behind": {"type": "point", "position": [0.3, -0.5, 0.2], "intensity": [0.6, 0.5, 0.4]},
              "around": LIGHTS["environment"]}
    camera = {"position": [0.01, height if seen_from == "front" else -height, 0.015], "target": [0.01, 0, 0.015], "up": [0, 0, -1], "fov": fov}
    scene = {"camera": camera, "film": {"resolution": [size, size]}, "lights": [lights[light]], "model": MICRO,
             "objects": [{"shape": "plane", "scale": 0.5, "fabric": FABRIC, "uv_scale": 0.5}]}
    pixel = 2 * height * np.tan(np.radians(fov / 2)) / size
    assert_same_picture(program, tmp_path, own_picture(program, tmp_path, scene, 1, 1024), render_cloth(scene, 1, pixel, 48), 2e-3)


# So much cloth to a pixel that every point of the repeat is as likely as any other.
FAR = {"ball": {"shape": "sphere", "scale": 0.6, "translate": [0, 0.62, 0], "fabric": FABRIC, "uv_scale": [20, 10]},
       "drape": {"shape": "drape", "fabric": FABRIC, "uv_scale": 7}}


@pytest.mark.parametrize("light", ["point", "environment"])
@pytest.mark.parametrize("shape", FAR)
def test_cloth_from_afar(program, tmp_path, render_cloth, shape, light):
    """Light on, through and inside a closed ball of cloth, and between the folds of a drape; shadows of both on the ground."""
    scene = {"camera": {"position": [0.4, 1.2, 3], "target": [0, 0.6, 0], "fov": 34}, "film": {"resolution": [32, 32]},
             "lights": [LIGHTS[light]], "objects": [GROUND, FAR[shape]], "model": MICRO}
    repeat = mitsuba_cloth.REPEAT
    assert_same_picture(program, tmp_path, own_picture(program, tmp_path, scene, 4, 512), render_cloth(scene, 4, repeat, 24), 2e-3)
