"""selvedge-render as people call it: closed forms, layers and header, bits under threads, interruption and resume, refusals.

Seen red with the unfinished block left out of the checkpoint."""
import json
import os
import pathlib
import signal
import subprocess
import time

import numpy as np
import OpenEXR
import PIL.Image
import pytest

BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", pathlib.Path(__file__).parents[1] / "build" / "bin"))
RENDER = BIN / "selvedge-render"

GAUZE = {"name": "gauze", "pattern": "plain 1/1", "resolution": 64, "warp": {"width": 0.0003}, "weft": {"width": 0.0003}}
CLOTH = {
    "camera": {"position": [0, 0.6, 0.8], "target": [0, 0.1, 0], "fov": 40},
    "film": {"resolution": [48, 32]},
    "lights": [{"type": "environment", "colour": [0.4, 0.5, 0.7]},
               {"type": "directional", "direction": [0.3, -1, -0.2], "irradiance": 3, "angular_diameter": 0.5}],
    "objects": [{"shape": "plane", "scale": 4, "matte": {"albedo": 0.5}},
                {"shape": "plane", "scale": 0.5, "translate": [0, 0.2, 0], "rotate": [20, 10, 0], "uv_scale": 0.5, "fabric": GAUZE}],
}
SPHERE = {
    "camera": {"position": [0, 0, 5], "target": [0, 0, 0], "fov": 28},
    "film": {"resolution": [64, 64]},
    "lights": [{"type": "point", "position": [2, 3, 4], "intensity": [60, 30, 15]}],
    "objects": [{"shape": "sphere", "matte": {"albedo": [0.5, 0.4, 0.3]}}],
}


def write(folder, scene, name="scene.json"):
    path = folder / name
    path.write_text(json.dumps(scene, indent=1))
    return path


def run(*arguments, **options):
    return subprocess.run([RENDER, *map(str, arguments)], capture_output=True, text=True, timeout=300, **options)


def render(*arguments):
    """The JSON object of a run that must succeed."""
    done = run(*arguments, "--json", "-q")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return json.loads(done.stdout)


def layers(path):
    """Channel name -> float32 array (rows, columns); and the header."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}, dict(file.header())


def colour(path):
    channels, _ = layers(path)
    return np.stack([channels[c] for c in "RGB"], -1)


def test_a_matte_sphere_under_a_point_light_is_as_bright_as_the_formula_says(tmp_path):
    out = tmp_path / "sphere.exr"
    render(write(tmp_path, SPHERE), "-o", out, "--spp", 256)
    got = colour(out)
    n = 64
    x, y = (np.arange(n) + .5) / n * 2 - 1, 1 - (np.arange(n) + .5) / n * 2
    d = np.stack([*np.broadcast_arrays(x[None, :] * np.tan(np.radians(14)), y[:, None] * np.tan(np.radians(14)), -1.0)], -1)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    origin = np.array([0, 0, 5.0])
    b = d @ origin
    inside = b * b - 24
    hit = inside > .05   # away from the rim: the centre stands for the pixel
    p = origin + d * (-b - np.sqrt(np.maximum(inside, 0)))[..., None]
    to = np.array([2, 3, 4.0]) - p
    r2 = (to * to).sum(-1)
    cosine = np.maximum((to * p).sum(-1) / np.sqrt(r2), 0)
    want = (cosine / r2 / np.pi)[..., None] * np.array([30, 12, 4.5])
    lit = hit & (cosine > .1)
    assert lit.sum() > 800
    # The mean over the pixel against its centre, and facets: 3 % where light grazes; in the mean over the sphere 0.3 %.
    assert np.abs(got[lit] / want[lit] - 1).max() < .03
    assert abs(got[lit].mean() / want[lit].mean() - 1) < .003
    assert got[hit & (cosine == 0) & ((to * p).sum(-1) / np.sqrt(r2) < -.1)].max(initial=0) == 0


def test_the_file_has_the_layers_and_the_header_of_the_contract(tmp_path):
    scene, out, png = write(tmp_path, CLOTH), tmp_path / "out.exr", tmp_path / "out.png"
    report = render(scene, "-o", out, "-o", png, "--spp", 32, "--seed", 5, "--aov", "normal,depth", "--aov", "uv,albedo,variance")
    channels, header = layers(out)
    assert set(channels) == {*"RGBA", "variance.R", "variance.G", "variance.B", "samples", "normal.X", "normal.Y", "normal.Z",
                             "depth.Z", "uv.U", "uv.V", "albedo.R", "albedo.G", "albedo.B"}
    assert (channels["samples"] == 32).all()
    assert all(np.isfinite(c).all() for c in channels.values())
    assert 0 < channels["A"].mean() < 1 and channels["A"].max() == 1
    length = np.sqrt(sum(channels["normal." + c] ** 2 for c in "XYZ"))
    assert (length[channels["A"] == 1] > .5).all() and length.max() < 1 + 1e-5
    # The camera is 1 m from its target.
    assert .5 < channels["depth.Z"][16, 24] < 1.1
    assert channels["uv.U"].min() >= 0 and channels["uv.U"].max() < 1
    assert header["selvedge:seed"] == "5" and header["selvedge:samples"] == "32"
    assert header["selvedge:scene_hash"] == report["scene_hash"]
    assert float(header["selvedge:seconds"]) > 0
    assert "--seed 5" in header["selvedge:command"] and header["selvedge:version"]
    with PIL.Image.open(png) as picture:
        assert picture.size == (48, 32) and picture.mode == "RGB"

    assert report["samples"] == 32 * 48 * 32 and report["spp_mean"] == 32
    assert set(report["seconds"]) == {"load", "bake", "build", "render"}
    assert report["rays"] > report["samples"]
    assert report["error_estimate"] > 0 and report["peak_rss_bytes"] > 1e6
    assert report["skipped"]["occlusion_filter"] is False and report["skipped"]["environment_table"] is True
    assert report["skipped"]["shadow_rays_without_value"] > 0


def test_without_gaps_no_filter_is_set_and_the_report_says_so(tmp_path):
    report = render(write(tmp_path, SPHERE), "-o", tmp_path / "out.exr", "--spp", 1)
    assert report["skipped"]["occlusion_filter"] is True
    assert {"albedo", "normal", "depth", "uv", "object", "delta"} < set(report["skipped"]["aovs"])
    assert report["error_estimate"] is None   # one sample tells nothing of its error


@pytest.mark.parametrize("integrator", ["direct", "path"])
def test_thread_counts_leave_every_bit_of_the_file(tmp_path, integrator):
    scene = write(tmp_path, CLOTH)
    for threads in (1, 2, 3):
        render(scene, "-o", tmp_path / f"{threads}.exr", "--spp", 24, "--threads", threads, "--integrator", integrator)
    want, _ = layers(tmp_path / "1.exr")
    for threads in (2, 3):
        got, _ = layers(tmp_path / f"{threads}.exr")
        assert all(np.array_equal(got[name], want[name]) for name in want)


def test_a_region_has_the_bits_of_the_whole_picture(tmp_path):
    scene = write(tmp_path, CLOTH)
    render(scene, "-o", tmp_path / "whole.exr", "--spp", 8)
    render(scene, "-o", tmp_path / "part.exr", "--spp", 8, "--region", "10,4,30,20")
    whole, _ = layers(tmp_path / "whole.exr")
    part, _ = layers(tmp_path / "part.exr")
    for name, values in part.items():
        assert np.array_equal(values[4:20, 10:30], whole[name][4:20, 10:30])
        values[4:20, 10:30] = 0
        assert (values == 0).all()


def wait_for(path, process):
    limit = time.monotonic() + 60
    while not path.exists():
        assert process.poll() is None and time.monotonic() < limit, "no checkpoint appeared"
        time.sleep(.005)


def test_killed_and_resumed_runs_end_with_the_same_bits(tmp_path):
    scene, out = write(tmp_path, CLOTH), tmp_path / "out.exr"
    options = ["--spp", "800", "--integrator", "path", "--threads", "1"]
    render(scene, "-o", tmp_path / "whole.exr", *options)
    checkpoint = tmp_path / "out.exr.checkpoint"
    for _ in range(3):   # killed outright, each time a little further
        process = subprocess.Popen([RENDER, scene, "-o", out, "-q", "--resume", "--checkpoint", "0.02", *options], stdout=subprocess.DEVNULL)
        wait_for(checkpoint, process)
        time.sleep(.1)
        process.kill()
        process.wait()
        assert not out.exists()
    report = render(scene, "-o", out, "--resume", *options)
    assert 0 < report["resumed_samples"] < 800
    whole, _ = layers(tmp_path / "whole.exr")
    got, _ = layers(out)
    assert all(np.array_equal(got[name], whole[name]) for name in whole)
    assert not list(tmp_path.glob("*.tmp*"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_pass_and_writes_what_there_is(tmp_path, number):
    scene, out = write(tmp_path, CLOTH), tmp_path / "out.exr"
    process = subprocess.Popen([RENDER, scene, "-o", out, "-q", "--json", "--spp", "1000000", "--checkpoint", "0.02"],
                               stdout=subprocess.PIPE, text=True)
    wait_for(tmp_path / "out.exr.checkpoint", process)
    process.send_signal(number)
    report = json.loads(process.communicate(timeout=60)[0])
    assert process.returncode == 0
    assert report["stopped_by"] == "signal" and 0 < report["spp_mean"] < 1000000
    channels, _ = layers(out)
    assert (channels["samples"] == report["spp_mean"]).all()


def test_a_checkpoint_of_another_scene_is_refused(tmp_path):
    scene, out = write(tmp_path, CLOTH), tmp_path / "out.exr"
    render(scene, "-o", out, "--spp", 4, "--checkpoint", 10)
    out.unlink()
    for change in (["-D", "objects.0.matte.albedo=0.6"], ["--seed", "1"], ["--integrator", "path"], ["-D", "fabric.warp.roughness=0.11"]):
        done = run(scene, "-o", out, "--spp", 8, "--resume", *change)
        assert done.returncode == 1 and done.stderr.count("\n") == 1
        assert "found a checkpoint of other work" in done.stderr
        assert not out.exists()


def test_time_and_target_error_end_a_run(tmp_path):
    scene = write(tmp_path, CLOTH)
    report = render(scene, "-o", tmp_path / "time.exr", "--time", 1)
    assert report["stopped_by"] == "time" and .9 < report["seconds"]["render"] < 2.5
    report = render(scene, "-o", tmp_path / "error.exr", "--target-error", 2e-3)
    assert report["stopped_by"] == "error" and report["error_estimate"] <= 2e-3
    assert report["skipped"]["samples"] > 0
    channels, _ = layers(tmp_path / "error.exr")
    reference = tmp_path / "reference.exr"
    render(scene, "-o", reference, "--spp", 4000, "--seed", 9)
    a, b = colour(tmp_path / "error.exr"), colour(reference)
    true = ((a - b) ** 2 / (b ** 2 + .01)).mean()
    assert .8 < true / report["error_estimate"] < 1.25


def test_overrides_reach_scene_and_fabric(tmp_path):
    scene = write(tmp_path, CLOTH)
    hashes = {render(scene, "-o", tmp_path / "out.exr", "--spp", 1, *options)["scene_hash"]
              for options in ([], ["-D", "objects.0.matte.albedo=0.7"], ["-D", "fabric.warp.roughness=0.11"],
                              ["-D", "objects.1.fabric.weft.albedo=[0.1,0.2,0.3]"], ["-D", "film.resolution=[8,8]"])}
    assert len(hashes) == 5


def test_stdout_holds_json_alone_and_quiet_is_quiet(tmp_path):
    scene = write(tmp_path, CLOTH)
    done = run(scene, "-o", tmp_path / "out.exr", "--spp", 2)
    assert done.returncode == 0 and done.stderr == "" and done.stdout.count("\n") == 1   # no progress bar off a terminal
    done = run(scene, "-o", tmp_path / "out.exr", "--spp", 2, "-q")
    assert (done.stdout, done.stderr) == ("", "")


def test_help_and_version_answer(tmp_path):
    for option in ("-h", "--help"):
        done = run(option)
        assert done.returncode == 0 and "--target-error" in done.stdout and done.stderr == ""
    for option in ("-V", "--version"):
        done = run(option)
        assert done.returncode == 0 and done.stdout.startswith("selvedge-render 0.") and "Embree" in done.stdout


USAGE = {
    "unknown option": ["--sppp", "3"],
    "no number": ["--spp", "many"],
    "zero samples": ["--spp", "0"],
    "negative samples": ["--spp", "-4"],
    "not a number": ["--time", "nan"],
    "no such integrator": ["--integrator", "bdpt"],
    "no such visibility": ["--visibility", "exakt"],
    "no such mode": ["--mode", "theirs"],
    "layer of a later version": ["--aov", "normal,yarns"],
    "half a resolution": ["--resolution", "64"],
    "empty resolution": ["--resolution", "0,64"],
    "region outside": ["--region", "0,0,49,10"],
    "empty region": ["--region", "5,5,5,10"],
    "broken override": ["-D", "film"],
    "no threads": ["--threads", "0"],
    "two scenes": ["other.json"],
}


@pytest.mark.parametrize("options", USAGE.values(), ids=USAGE.keys())
def test_wrong_usage_is_one_line_and_exit_2(tmp_path, options):
    out = tmp_path / "out.exr"
    out.write_text("mine")
    done = run(write(tmp_path, CLOTH), "-o", out, *options)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("selvedge-render: ") and done.stderr.count("\n") == 1
    assert done.stdout == "" and out.read_text() == "mine"


def test_missing_arguments_and_odd_endings_are_wrong_usage(tmp_path):
    scene = write(tmp_path, CLOTH)
    for arguments in ([], [scene], ["-o", tmp_path / "out.exr"], [scene, "-o", tmp_path / "out.jpeg"]):
        done = run(*arguments)
        assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr


def test_bad_places_for_the_output_are_told_before_any_work(tmp_path):
    scene = write(tmp_path, CLOTH)
    (tmp_path / "folder.exr").mkdir()
    for out in (tmp_path / "no" / "out.exr", tmp_path / "folder.exr"):
        start = time.monotonic()
        done = run(scene, "-o", out, "--spp", 100000)
        assert done.returncode == 1 and done.stderr.count("\n") == 1 and str(out) in done.stderr
        assert time.monotonic() - start < 5


def test_a_full_disk_leaves_the_old_file_and_no_half_one(tmp_path):
    scene, out = write(tmp_path, CLOTH), tmp_path / "out.exr"
    out.write_text("mine")
    # A limit on file size stands for the full disk: the kernel answers a write beyond it with an error.
    done = subprocess.run(["bash", "-c", f"trap '' XFSZ; ulimit -f 8; exec {RENDER} {scene} -o {out} --spp 1"], capture_output=True, text=True)
    assert done.returncode == 1 and "selvedge-render: " in done.stderr
    assert out.read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.exr", "scene.json"]
