"""selvedge-lookdev --headless: the reference's picture, both back ends, ends, reports, wrong use.

Seen red with the shadow rays left out, with the raster's jitter left out, with the back side's maps on the front, and with a
block merged before its last frame."""
import json
import os
import pathlib
import signal
import subprocess
import time

import numpy as np
import OpenEXR
import pytest

ROOT = pathlib.Path(__file__).parents[1]
BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", ROOT / "build" / "bin"))
SCENES = ROOT / "assets" / "scenes"
SPHERE = {"camera": {"position": [0, 0, 4], "target": [0, 0, 0], "fov": 40}, "film": {"resolution": [24, 16]},
          "lights": [{"type": "directional", "direction": [0, -1, -1], "irradiance": [3, 2, 1], "angular_diameter": 0}],
          "objects": [{"shape": "sphere", "matte": {"albedo": [0.5, 0.5, 0.5]}}]}


def lookdev(*arguments, status=0, environment=None, timeout=300):
    done = subprocess.run([BIN / "selvedge-lookdev", *map(str, arguments)], capture_output=True, text=True, timeout=timeout,
                          env=os.environ | (environment or {}))
    assert done.returncode == status, done.stderr
    return done


def render(scene, path, *arguments, **options):
    done = lookdev(scene, "--headless", "-o", path, "--json", *arguments, **options)
    return json.loads(done.stdout)


def read(path):
    """Channel name -> (rows, columns), float32; and the header."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}, dict(file.header())


def compare(a, b):
    done = subprocess.run([BIN / "selvedge-compare", a, b, "--json", "--fail", "max_abs=inf"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def assert_same_mean(a, b):
    """A Z-test of every pixel and the mean of every channel. Variances from 30 blocks (240 frames, 8 to a block) let 0.5 % of the
    pixels of a fair pair have |z| > 3. The means of pictures are less certain than independent pixels would make them: all
    pixels of a frame share its jitter."""
    found = compare(a, b)
    assert found["z_outliers"] < 0.01, found
    for channel in "RGB":
        assert abs(found[f"mean_relative_bias.{channel}"]) < 0.005, found


@pytest.fixture
def sphere(tmp_path):
    path = tmp_path / "sphere.json"
    path.write_text(json.dumps(SPHERE))
    return path


# ---- the picture ---------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name, arguments", [
    ("layers", []), ("plane_plain", []), ("curtain", []), ("cylinder_satin", []), ("furnace", []),
    ("layers", ["--mode", "paper"]), ("plane_plain", ["--bsdf", "micro"]), ("plane_plain", ["--visibility", "none"]),
], ids=lambda value: value if isinstance(value, str) else "-".join(value).strip("-"))
def test_the_expected_picture_is_the_references(tmp_path, name, arguments):
    size = ["--resolution", "96,96"]
    report = render(SCENES / f"{name}.json", tmp_path / "preview.exr", "--frames", 240, "--seed", 1, *size, *arguments)
    assert report["frames"] == 240
    subprocess.run([BIN / "selvedge-render", SCENES / f"{name}.json", "-o", tmp_path / "reference.exr", "--spp", "240", "--seed", "2",
                    "--integrator", "direct", "-q", *size, *arguments], check=True, timeout=300)
    assert_same_mean(tmp_path / "preview.exr", tmp_path / "reference.exr")
    # Coverage: what the window composites with.
    a, b = read(tmp_path / "preview.exr")[0]["A"], read(tmp_path / "reference.exr")[0]["A"]
    assert abs(a.mean() - b.mean()) < 0.005


def test_osmesa_and_egl_draw_the_same(tmp_path):
    reports = [render(SCENES / "layers.json", tmp_path / f"{name}.exr", "--frames", 60, "--resolution", "64,64", "--backend", name)
               for name in ("egl", "osmesa")]
    assert [report["gl"]["backend"] for report in reports] == ["egl", "osmesa"]
    assert_same_mean(tmp_path / "egl.exr", tmp_path / "osmesa.exr")


def test_the_same_seed_gives_the_same_bits_and_another_one_others(tmp_path, sphere):
    pictures = []
    for k, seed in enumerate((5, 5, 6)):
        render(sphere, tmp_path / f"{k}.exr", "--frames", 8, "--seed", seed)
        pictures.append(read(tmp_path / f"{k}.exr")[0])
    assert all((pictures[0][name] == pictures[1][name]).all() for name in pictures[0])
    assert (pictures[0]["R"] != pictures[2]["R"]).any()


@pytest.mark.parametrize("arguments", [(), ("--footprint-samples", 4), ("--target-error", 2e-3)], ids=["one", "several", "tiles"])
@pytest.mark.parametrize("name", ["cylinder_satin", "layers"])
def test_rays_find_what_the_rasteriser_finds(tmp_path, name, arguments):
    """But where an edge runs through the middle of what a pixel samples: there the rasteriser rounds, to 1/256 pixel on llvmpipe.
    Seen red with tiles that the vertex shader of rays did not know."""
    for primary in ("raster", "rays"):
        report = render(SCENES / f"{name}.json", tmp_path / f"{primary}.exr", "--frames", 160, "--resolution", "40,40", "--primary", primary, *arguments)
        assert ("shade-rays" in report["passes"]) == (primary == "rays")
        assert ("visibility" in report["passes"] or "visibility-gaps" in report["passes"]) == (primary == "raster")
    a, b = (read(tmp_path / f"{primary}.exr")[0] for primary in ("raster", "rays"))
    assert (a["samples"] == b["samples"]).mean() > .7   # tiles end by what their pixels are
    noise = a["variance.G"] + b["variance.G"]
    assert (np.abs(a["G"] - b["G"]) <= 2 * np.sqrt(noise)).all() and np.median(np.abs(a["G"] - b["G"])) < 1e-3 * a["G"].mean()


def test_rays_are_for_software_gl_with_few_pixels_for_a_triangle(tmp_path):
    """16896 triangles: 67584 pixels."""
    passes = [render(SCENES / "cylinder_satin.json", tmp_path / "a.exr", "--frames", 1, "--resolution", f"{side},{side}")["passes"] for side in (40, 300)]
    assert "shade-rays" in passes[0] and "visibility-gaps" in passes[1]


def test_sheets_in_the_same_place_are_followed_to_their_end(tmp_path):
    """Seen red with the distance to a layer worked out anew for the walk to the next: two triangles in one place then come behind each
    other again and again. Software GL gives a loop up after 65535 turns, a card hangs."""
    sheet = {"shape": "plane", "scale": 1, "rotate": [13, 27, 5], "fabric": str(SCENES.parent / "fabrics" / "organza.json"), "uv_scale": 3}
    path = tmp_path / "two.json"
    path.write_text(json.dumps(SPHERE | {"camera": {"position": [0.2, 1.1, 2.3], "target": [0, 0, 0], "fov": 30}, "objects": [sheet, sheet]}))
    # In reference and rays, what lies in exactly the same place counts as one.
    for name, arguments in {"one": ("--primary", "rays", "--frames", 960), "several": ("--footprint-samples", 4, "--frames", 960)}.items():
        report = render(path, tmp_path / f"{name}.exr", "--resolution", "48,48", *arguments)
    assert "LAYERS" in report["features"]
    assert_same_mean(tmp_path / "one.exr", tmp_path / "several.exr")


def test_more_footprint_samples_make_less_noise_and_the_same_mean(tmp_path):
    noise = []
    for count in (1, 4):
        report = render(SCENES / "layers.json", tmp_path / f"{count}.exr", "--frames", 240, "--resolution", "48,48",
                        "--footprint-samples", count, "--seed", count)
        assert report["footprint_samples"] == count and ("FOOTPRINT" in report["features"]) == (count > 1)
        noise.append(report["error_estimate"])
    # Where in the pixel is one draw for all four, all else is each one's own.
    assert noise[1] < 0.32 * noise[0]
    assert_same_mean(tmp_path / "1.exr", tmp_path / "4.exr")


@pytest.mark.parametrize("spp, frames, samples, length", [(3, 3, 1, 1), (64, 8, 8, 2), (300, 19, 16, 4)])
def test_samples_a_pixel_are_spread_over_frames(tmp_path, spp, frames, samples, length):
    """--spp: few frames of many samples, at least as many as asked for, that are worth nearly as much as frames of one."""
    report = render(SCENES / "layers.json", tmp_path / "few.exr", "--spp", spp, "--resolution", "64,64")
    assert (report["frames"], report["footprint_samples"], report["block_length"]) == (frames, samples, length)
    assert report["spp_mean"] == frames * samples >= spp and report["samples"] == 64 * 64 * frames * samples
    assert (read(tmp_path / "few.exr")[0]["samples"] == frames * samples).all()
    if spp < 300:
        return
    one = render(SCENES / "layers.json", tmp_path / "one.exr", "--frames", frames * samples, "--resolution", "64,64", "--seed", 1)
    # 19 places in the pixel instead of 304: 17 % more when this was written.
    assert report["error_estimate"] < 1.3 * one["error_estimate"]
    assert_same_mean(tmp_path / "few.exr", tmp_path / "one.exr")


def test_many_blocks_lose_nothing(tmp_path, sphere):
    """A constant sky: every sample is 0.7 but for rounding, and so is the mean of 4096 of them in 64 blocks; a plain float sum of
    as many would be 1e-5 off. The spread is nothing."""
    scene = SPHERE | {"lights": [{"type": "environment", "colour": [0.7, 0.7, 0.7]}], "objects": [], "film": {"resolution": [4, 4]}}
    sphere.write_text(json.dumps(scene))
    render(sphere, tmp_path / "sky.exr", "--frames", 4096)
    layers, header = read(tmp_path / "sky.exr")
    assert np.abs(layers["R"] - np.float32(0.7)).max() < 1e-6
    assert layers["variance.R"].max() < 1e-14 and (layers["A"] == 0).all() and (layers["samples"] == 4096).all()


def test_the_error_estimate_tells_the_error(tmp_path):
    """Estimate of a short run against what it really is, found with a long run of another seed."""
    report = render(SCENES / "plane_plain.json", tmp_path / "short.exr", "--frames", 64, "--resolution", "64,64", "--seed", 1)
    render(SCENES / "plane_plain.json", tmp_path / "long.exr", "--frames", 2048, "--resolution", "64,64", "--seed", 2)
    assert report["error_estimate"] == pytest.approx(compare(tmp_path / "short.exr", tmp_path / "long.exr")["relmse"], rel=0.15)


# ---- ends and reports ----------------------------------------------------------------------------------------------------

def test_the_report_and_the_header_say_what_was_done(tmp_path, sphere):
    report = render(sphere, tmp_path / "a.exr", "-o", tmp_path / "a.png", "--frames", 32, "--seed", 7)
    for key in ("load", "bake", "build", "render"):
        assert report["seconds"][key] >= 0
    assert report["samples"] == 24 * 16 * 32 and report["spp_mean"] == report["frames"] == 32
    assert report["milliseconds_per_frame"]["p95"] >= report["milliseconds_per_frame"]["median"] > 0
    assert report["gl"].keys() == {"renderer", "version", "backend"} and "peak_rss_bytes" in report and "rays" in report
    assert report["features"] == ["FEW_LIGHTS", "MATTE"] and report["skipped"]["gaps"] and report["passes"] == ["visibility", "shade", "background", "merge"]
    assert (tmp_path / "a.png").stat().st_size > 0
    layers, header = read(tmp_path / "a.exr")
    assert {"R", "G", "B", "A", "variance.R", "variance.G", "variance.B", "samples"} <= layers.keys()
    assert (layers["samples"] == 32).all() and layers["R"].shape == (16, 24)
    for key in ("selvedge:version", "selvedge:command", "selvedge:scene_hash", "selvedge:seed", "selvedge:samples", "selvedge:seconds"):
        assert key in header, key
    assert header["selvedge:seed"] == "7" and header["selvedge:scene_hash"] == report["scene_hash"]


def test_time_and_error_end_the_work(tmp_path, sphere):
    report = render(sphere, tmp_path / "a.exr", "--time", 1)
    assert report["stopped_by"] == "time" and 1 <= report["seconds"]["render"] < 3 and report["frames"] > 3
    report = render(sphere, tmp_path / "a.exr", "--target-error", 1e-4, "--time", 60)
    assert report["stopped_by"] == "error" and report["error_estimate"] <= 1e-4


def test_an_interrupt_finishes_the_picture(tmp_path, sphere):
    process = subprocess.Popen([BIN / "selvedge-lookdev", sphere, "--headless", "-o", tmp_path / "a.exr", "--time", "60"],
                               stdout=subprocess.DEVNULL)
    time.sleep(2)
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    assert read(tmp_path / "a.exr")[0]["samples"].min() >= 1


def test_a_back_end_that_is_missing_is_named_and_the_other_one_taken(tmp_path, sphere):
    broken = {"__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path)}
    assert render(sphere, tmp_path / "a.exr", "--frames", 1, environment=broken)["gl"]["backend"] == "osmesa"
    done = lookdev(sphere, "--headless", "-o", tmp_path / "b.exr", "--frames", 1, "--backend", "egl", status=1, environment=broken)
    assert "EGL default display" in done.stderr and not (tmp_path / "b.exr").exists()


def test_a_shader_error_names_file_and_line(tmp_path, sphere):
    for file in (ROOT / "glsl").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    text = (tmp_path / "cloth_direct.h").read_text()
    line = text[:text.index("CLOTH_FN ClothShading cloth_shade_matte")].count("\n") + 1
    (tmp_path / "cloth_direct.h").write_text(text.replace("CLOTH_FN ClothShading cloth_shade_matte", "CLOTH_FN Nonsense cloth_shade_matte"))
    done = lookdev(sphere, "--headless", "-o", tmp_path / "a.exr", "--frames", 1, status=1, environment={"SELVEDGE_GLSL": str(tmp_path)})
    assert f"cloth_direct.h:{line}: error" in done.stderr and not (tmp_path / "a.exr").exists()


# ---- wrong use: one line, the right status, no file --------------------------------------------------------------------------

@pytest.mark.parametrize("arguments", [
    ["--no-such-option"], ["--frames", "0"], ["--frames", "-1"], ["--frames", "nan"], ["--frames", "two"], ["--time", "nan"],
    ["--time", "-1"], ["--target-error", "0"], ["--resolution", "0,5"], ["--resolution", "64"], ["--resolution", "64,64x"],
    ["--resolution", "99999,1"], ["--backend", "glx"], ["--max-depth", "0"], ["--integrator", "foo"], ["--bsdf", "macro"],
    ["--mode", "theirs"], ["--visibility", "shadows"], ["--footprint-samples", "0"], ["--spp", "0"], ["--spp", "8", "--frames", "8"], ["--spp", "8", "--footprint-samples", "2"], ["--seed", "-1"], ["--exit-after-frames", "3"],
    ["-o", "a.jpg"],
], ids="=".join)
def test_wrong_use_is_refused(tmp_path, sphere, arguments):
    out = tmp_path / "a.exr"
    stop = [] if arguments[0] in ("--frames", "--spp", "--time", "--target-error") else ["--frames", "1"]
    output = [] if arguments[0] == "-o" else ["-o", out]
    done = lookdev(sphere, "--headless", *output, *stop, *arguments, status=2)
    assert done.stderr.startswith("selvedge-lookdev: ") and done.stderr.count("\n") == 1 and done.stdout == "", done.stderr
    assert not out.exists()


@pytest.mark.parametrize("arguments", [[], ["--headless", "--frames", "1"], ["--headless", "-o", "a.exr"], ["--frames", "1"],
                                       ["-o", "a.exr"], ["--json"]], ids=" ".join)
def test_missing_halves_are_refused(tmp_path, sphere, arguments):
    done = lookdev(*([sphere] if arguments else []), *arguments, status=2)
    assert done.stderr.count("\n") == 1, done.stderr


@pytest.mark.parametrize("what", ["missing", "broken", "folder", "override"])
def test_bad_input_is_told_and_nothing_is_written(tmp_path, sphere, what):
    out = tmp_path / "a.exr"
    if what == "missing":
        sphere.unlink()
    if what == "broken":
        sphere.write_text('{\n "camera": {\n')
    if what == "folder":
        out = tmp_path / "no" / "such" / "a.exr"
    override = ["-D", "nothing.like.this=1"] if what == "override" else []
    done = lookdev(sphere, "--headless", "-o", out, "--frames", 1, *override, status=1)
    assert done.stderr.count("\n") == 1 and done.stdout == "" and not out.exists(), done.stderr


def test_an_old_picture_survives_a_failure(tmp_path, sphere):
    out = tmp_path / "a.exr"
    out.write_bytes(b"precious")
    (tmp_path / "cloth.h").write_text("")   # a folder of shaders in which all but one is missing
    lookdev(sphere, "--headless", "-o", out, "--frames", 1, status=1, environment={"SELVEDGE_GLSL": str(tmp_path)})
    assert out.read_bytes() == b"precious"


def test_help_and_version():
    assert "--headless" in lookdev("--help").stdout
    version = lookdev("--version").stdout
    assert "selvedge-lookdev" in version and "GL back end egl" in version and "GL back end osmesa" in version and "Dear ImGui" in version
