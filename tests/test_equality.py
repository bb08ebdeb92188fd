"""The preview's expected image is the reference's. Bias is told from noise by the images' own variance, not by a tolerance on
pixels: at `direct`, each colour channel's mean relative bias stays under 0.5 %, and |z| > 3 under 1 % of pixels.
With 16 to 32 blocks a pixel's z follows Student's t: 0.3 to 0.6 % beyond 3 is what no bias at all gives."""
import json
import subprocess

import evaluate
import pytest

SCENES = evaluate.ROOT / "assets" / "scenes"


def run(program, *arguments):
    done = subprocess.run([str(program), *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def compare_renderers(program, folder, scene, samples, *options, size=256, backend="egl"):
    preview, reference = folder / "preview.exr", folder / "reference.exr"
    common = ["--resolution", f"{size},{size}", "--json", "-q", *options]
    run(program("lookdev"), scene, "--headless", "--backend", backend, "-o", preview, "--frames", samples, *common)
    # Another seed: the two shall agree in expectation, not by drawing the same numbers.
    run(program("render"), scene, "-o", reference, "--spp", samples, "--integrator", "direct", "--seed", 7, *common)
    done = subprocess.run([str(program("compare")), str(preview), str(reference), "--json"], capture_output=True, text=True)
    assert done.returncode in (0, 1, 2), done.stderr
    return json.loads(done.stdout)


def assert_equal(found):
    bias = {channel: found[f"mean_relative_bias.{channel}"] for channel in "RGB"}
    assert all(abs(b) < 0.005 for b in bias.values()), bias
    assert found["z_outliers"] < 0.01, found
    # A variance that is too large would let anything pass, one that is too small nothing.
    assert 0.8 < found["z_std"] < 1.2, found["z_std"]


def test_demo_scene(program, tmp_path):
    assert_equal(compare_renderers(program, tmp_path, SCENES / "demo.json", 256))


@pytest.mark.parametrize("scene", ["plane_plain", "layers", "cylinder_satin"])
@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_small_scenes(program, tmp_path, scene, backend):
    assert_equal(compare_renderers(program, tmp_path, SCENES / f"{scene}.json", 256, size=96, backend=backend))


@pytest.mark.parametrize("options", [("--mode", "paper"), ("--mode", "jin"), ("--bsdf", "micro"), ("--visibility", "none"),
                                     ("--visibility", "horizon16"), ("--visibility", "cap"), ("--visibility", "exact")], ids=" ".join)
def test_every_mode(program, tmp_path, options):
    assert_equal(compare_renderers(program, tmp_path, SCENES / "layers.json", 256, *options, size=96))


@pytest.mark.shared_data
def test_real_draft_mesh_and_light(program, tmp_path, shared_data):
    fabric = {"name": "draft 8452", "pattern": {"wif": str(shared_data / "wif" / "hwn_8452_28shaft_84x100.wif")},
              "use_draft_colours": True, "resolution": 1024,
              "warp": {"spacing": 0.001, "width": 0.0009, "roughness": 0.2}, "weft": {"spacing": 0.001, "width": 0.0009, "roughness": 0.1}}
    (tmp_path / "fabric.json").write_text(json.dumps(fabric))
    scene = {"camera": {"position": [0, 0.5, 4.2], "target": [0, -0.3, 0], "fov": 30}, "film": {"resolution": [256, 256]},
             "lights": [{"type": "environment", "image": str(shared_data / "hdr" / "potsdamer_platz_1k.hdr")}],
             "objects": [{"mesh": str(shared_data / "mesh" / "towel.obj"), "scale": 0.25, "fabric": "fabric.json", "uv_scale": 0.6}]}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    assert_equal(compare_renderers(program, tmp_path, tmp_path / "scene.json", 256))
