"""Efficiency of selvedge-render against Mitsuba 3 (llvm_ad_rgb) on scenes that both render: figures `efficiency_over_mitsuba.SCENE`.

The figure is against Mitsuba with the sampler that suits it best here, multijitter; the note says what its default, independent, gives.
Efficiency is 1 / (relMSE x seconds): what does not depend on how many samples were taken. Two threads each, the same meshes, resolution
and depth of path; seconds of rendering alone, Mitsuba's kernels compiled before. The error is against a long render by the reference,
less that render's own noise. That both have the same expected picture is what tests/test_mitsuba.py proves."""
import json
import math
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import bench_report
import mitsuba_cloth
import mitsuba_scene

ASSETS = bench_report.ROOT / "assets"
THREADS = 2
DEPTH = 5
TRUTH_SEED = 90001   # apart from those of the runs
LONG = {"resolution": 256, "truth_seconds": 90.0, "run_seconds": 4.0, "runs": 5}
SHORT = {"resolution": 128, "truth_seconds": 12.0, "run_seconds": 0.8, "runs": 3}
TARGET = 1.0         # issue 5: aim to be ahead

# A yarn without gaps, so that Mitsuba's plain path tracer will do. Everything stated, as the plugin needs it.
YARN = {"spacing": 0.0005, "width": 0.0005, "plies": 1, "fibre_twist": -15, "albedo": [0.5, 0.3, 0.2], "diffuse": [0.2, 0.15, 0.1],
        "diffuse_transmission": 0.1, "roughness": 0.3, "thickness": 1.2, "diffuse_mix": 1}
FABRIC = {"name": "twill", "pattern": "twill 2/1", "resolution": 64, "warp": YARN, "weft": YARN | {"roughness": 0.15, "fibre_twist": 25}}
SKY = {"type": "environment", "image": str(ASSETS / "lights" / "sky.exr")}
GROUND = {"shape": "plane", "scale": 6, "matte": {"albedo": [0.5, 0.6, 0.7]}}
BALL = {"mesh": "ball.ply", "scale": 0.6, "translate": [0.3, 0.6, 0], "matte": {"albedo": [0.8, 0.4, 0.2]}}
BOARD = {"shape": "plane", "scale": [1, 1, 1.4], "translate": [-0.8, 0.7, -0.2], "rotate": [70, 20, 10], "matte": {"albedo": 0.6}}
# The drape's repeats are small against a pixel at every resolution here: 5 mm of cloth to one at 256 rows, times 7.
DRAPE = {"shape": "drape", "fabric": FABRIC, "uv_scale": 7}
SCENES = {
    "matte_environment": {"lights": [SKY], "objects": [GROUND, BALL, BOARD]},
    "matte_area": {"lights": [{"type": "area", "position": [0.5, 2.5, 0.8], "target": [0, 0.3, 0], "size": [0.6, 1.2], "radiance": [6, 5, 4]}],
                   "objects": [GROUND, BALL, BOARD]},
    "matte_point": {"lights": [{"type": "point", "position": [1, 2, 1], "intensity": [6, 5, 4]}], "objects": [GROUND, BALL, BOARD]},
    "cloth_drape": {"lights": [SKY], "objects": [GROUND, DRAPE]},
}
CAMERA = {"position": [0.4, 1.2, 3], "target": [0, 0.5, 0], "fov": 38}
MODEL = {"bsdf": "micro", "unscattered": False, "stacked": False, "twist_noise": False}


class Ours:
    def __init__(self, path, folder):
        self.path, self.picture, self.name = path, folder / "ours.exr", "selvedge-render"

    def render(self, spp, seed, picture=None, seconds=None):
        """Seconds of rendering."""
        limit = ["--time", seconds] if seconds else []
        report = bench_report.run_program("selvedge-render", self.path, "-o", picture or self.picture, "--spp", spp, "--integrator", "path",
                                          "--max-depth", DEPTH, "--seed", seed, "--threads", THREADS, "-q", *limit)
        return report["seconds"]["render"]


class Theirs:
    def __init__(self, mi, scene, folder, cloth, sampler):
        import drjit
        self.mi, self.drjit, self.picture, self.name = mi, drjit, folder / "theirs.exr", f"Mitsuba, {sampler}"
        drjit.set_thread_count(THREADS)
        translated = mitsuba_scene.translate(mi, scene, folder, ASSETS, DEPTH, cloth)
        translated["sensor"]["sampler"] = {"type": sampler}
        self.scene = mi.load_dict(translated)

    def render(self, spp, seed):
        self.drjit.sync_thread()
        start = time.perf_counter()
        image = self.mi.render(self.scene, spp=spp, seed=seed)
        self.drjit.eval(image)
        self.drjit.sync_thread()
        seconds = time.perf_counter() - start
        mitsuba_scene.write_picture(self.picture, image.numpy().astype(float)[None])
        return seconds


def cloth_of(mi, folder):
    (folder / "fabric.json").write_text(json.dumps(FABRIC))
    done = subprocess.run([bench_report.BIN / "selvedge-bake", folder / "fabric.json", "-o", folder / "baked", "-q"])
    if done.returncode:
        sys.exit("selvedge-bake failed")
    fabric, cloth = mitsuba_cloth.Fabric(FABRIC, folder / "baked"), mitsuba_cloth.plugin(mi)
    return lambda entry: cloth(fabric, entry["uv_scale"], mitsuba_cloth.REPEAT)


def samples_for(renderer, seconds):
    """A power of four of samples that takes about so long: a square, as multijitter wants it. The first call warms kernels and caches."""
    renderer.render(16, 1)
    rate = 16 / renderer.render(16, 2)
    return 4 ** max(2, round(math.log(rate * seconds, 4)))


def error(renderer, truth):
    compare = bench_report.run_program("selvedge-compare", renderer.picture, truth, "--fail", "max_abs=inf")
    return compare["relmse"] - compare["relmse_reference_noise"], compare["mean_relative_bias"]


def measure(name, mi, folder, options):
    """The figure of one scene."""
    scene = SCENES[name] | {"camera": CAMERA, "film": {"resolution": [options["resolution"]] * 2}, "model": MODEL}
    mitsuba_scene.write_ball(folder / "ball.ply", 192, 96)
    (folder / "scene.json").write_text(json.dumps(scene))
    cloth = cloth_of(mi, folder)
    ours = Ours(folder / "scene.json", folder)
    best, default = (Theirs(mi, scene, folder, cloth, sampler) for sampler in ("multijitter", "independent"))
    truth = folder / "truth.exr"
    ours.render(1 << 16, TRUTH_SEED, picture=truth, seconds=options["truth_seconds"])
    samples = {renderer: samples_for(renderer, options["run_seconds"]) for renderer in (ours, best, default)}
    seen = {renderer: [] for renderer in samples}
    for run in range(options["runs"]):   # in turn, so that all meet the same machine
        for renderer, spp in samples.items():
            seconds = renderer.render(spp, 11 + run)
            seen[renderer].append((seconds, *error(renderer, truth)))

    def ratio(theirs):
        return statistics.median(error_b * seconds_b / (error_a * seconds_a)
                                 for (seconds_a, error_a, _), (seconds_b, error_b, _) in zip(seen[ours], seen[theirs]))

    words = [f"{renderer.name}: {samples[renderer]} samples a pixel, {statistics.median(s for s, _, _ in seen[renderer]):.3g} s, "
             f"relMSE {statistics.median(e for _, e, _ in seen[renderer]):.2g}" for renderer in (ours, best)]
    bias = statistics.mean(bias for _, _, bias in seen[best])
    note = "; ".join(words) + f"; over {default.name}: {ratio(default):.2g}; means {100 * bias:+.2f} % apart"
    note += f"; {options['resolution']} x {options['resolution']}, path of {DEPTH}"
    if any("fabric" in entry for entry in scene["objects"]):
        note += "; cloth by a plugin of the tests"
    return bench_report.figure(ratio(best), "x", "higher", target=TARGET, runs=options["runs"], note=note)


def figures(quick):
    """{"efficiency_over_mitsuba.SCENE": figure} for the suite `reference`; about two minutes if `quick`."""
    mi = mitsuba_scene.use("llvm_ad_rgb")
    result = {}
    for name in SCENES:
        print(f"mitsuba: {name}", file=sys.stderr)
        with tempfile.TemporaryDirectory(prefix="selvedge-bench-") as folder:
            result[f"efficiency_over_mitsuba.{name}"] = measure(name, mi, pathlib.Path(folder), SHORT if quick else LONG)
    return result
