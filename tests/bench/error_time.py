"""Suite error-time: how many seconds the preview, with and without its filter, and the reference take to a given relMSE. Run by ./dev bench error-time."""
import argparse
import json
import math
import pathlib
import statistics
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_report  # noqa: E402

SCENES = ["assets/scenes/demo.json", "assets/scenes/cylinder_satin.json", "assets/scenes/layers.json"]
TARGETS = {"1e-2": 1e-2, "1e-3": 1e-3}
DELTA_LIGHTS = {"directional", "point", "spot", "flash"}
TRUTH_SEED = 90001   # apart from those of the runs, 1, 2, ...
# Seconds for one scene: the long reference, and then each renderer's runs. Three scenes in the short form: under 4 minutes.
LONG = {"resolution": 256, "truth_seconds": 150.0, "truth_spp": 65536, "series_seconds": 120.0, "passes": 7, "stop": 3e-4, "step": 2}
SHORT = {"resolution": 96, "truth_seconds": 14.0, "truth_spp": 16384, "series_seconds": 18.0, "passes": 3, "stop": 7e-4, "step": 4}

RENDERERS = {"preview": lambda scene, n: ("selvedge-lookdev", scene, "--headless", "--spp", n),
             "denoised": lambda scene, n: ("selvedge-lookdev", scene, "--headless", "--denoise", "--spp", n),   # preview, filter included
             "reference": lambda scene, n: ("selvedge-render", scene, "--spp", n)}


class Series:
    """One renderer's runs on one scene: runs[n] is a list of (seconds, relMSE), one for each pass."""

    def __init__(self, renderer, budget_s):
        self.renderer, self.left_s, self.runs, self.wall_s, self.details, self.finished = renderer, budget_s, {}, {}, [], False

    def points(self):
        """[(samples, seconds, relMSE, lowest, highest), ...] of the medians, by rising number of samples."""
        result = []
        for count, runs in sorted(self.runs.items()):
            seconds, errors = zip(*runs)
            result.append((count, statistics.median(seconds), statistics.median(errors), min(errors), max(errors)))
        return result

    def curve(self):
        return [list(point[1:]) for point in self.points()]

    def cost_of_next(self, count, step):
        """Wall seconds of a run of step * count samples, as the one of `count` lets expect."""
        rendering = self.runs[count][0][0]
        return max(self.wall_s[count] - rendering, 0.0) + step * rendering


def seconds_to(points, target):
    """(seconds, note) at which (samples, seconds, relMSE, ...) first comes down to `target`, or (None, why)."""
    points = [point[:3] for point in points if point[1] > 0 and point[2] > 0]
    if not points:
        return None, "not reached: no point above the long reference's own noise"
    if points[0][2] <= target:
        return points[0][1], "at most: the first sample has that error"
    for (_, t0, e0), (_, t1, e1) in zip(points, points[1:]):
        if e1 <= target:
            share = math.log(e0 / target) / math.log(e0 / e1)
            return t0 * (t1 / t0) ** share, ""
    # Noise falls as 1 / samples; a curve that has left that slope is on its way to a floor and says nothing of what lies below.
    # Beyond the last point the error goes on by its slope over samples, the seconds by what the last samples cost.
    (n0, t0, e0), (n1, t1, e1) = points[max(len(points) - 3, 0)], points[-1]
    slope = math.log(e1 / e0) / math.log(n1 / n0) if n1 > n0 else 0.0
    if slope < -0.7 and t1 > t0 and e1 <= 32 * target:
        more = n1 * (target / e1) ** (1 / slope) - n1
        return t1 + more * (t1 - t0) / (n1 - n0), f"extrapolated: from relMSE {e1:.2g} at {t1:.3g} s, slope {slope:.2f} over samples"
    return None, f"not reached: relMSE {e1:.2g} after {t1:.3g} s and {n1} samples, slope {slope:.2f} over samples"


def truth(scene, folder, options):
    path = folder / "truth.exr"
    bench_report.run_program("selvedge-render", scene, "-o", path, "--resolution", options.resolution, "--integrator", "direct", "--seed", TRUTH_SEED,
                             "--spp", options.truth_spp, "--time", options.truth_seconds, "-q")
    return path


def error(image, truth_path):
    """relMSE less the noise of the long reference, and the whole comparison."""
    # The verdict is not asked for: any finite error is a point of the curve, and a picture with NaN ends the suite.
    compare = bench_report.run_program("selvedge-compare", image, truth_path, "--fail", "max_abs=inf")
    return compare["relmse"] - (compare["relmse_reference_noise"] or 0.0), compare


def run(series, scene, count, seed, truth_path, folder, options):
    image = folder / "image.exr"
    start = time.monotonic()
    report = bench_report.run_program(*RENDERERS[series.renderer](scene, count), "-o", image, "--resolution", options.resolution,
                                      "--integrator", "direct", "--seed", seed, "-q")
    wall = time.monotonic() - start
    relmse, compare = error(image, truth_path)
    if report.get("gl"):
        options.gl = ", ".join(str(report["gl"][key]) for key in ("renderer", "version", "backend") if key in report["gl"])
    series.left_s -= time.monotonic() - start
    series.wall_s[count] = wall
    seconds = report["seconds"]["render"] + report["seconds"].get("denoise", 0.0)
    series.details.append({"count": count, "seed": seed, "seconds": seconds, "wall_seconds": wall, "relmse": relmse,
                           **{name: compare[name] for name in ("mean_relative_bias", "mean_relative_bias_sigma", "z_outliers", "z_std")}})
    series.runs.setdefault(count, []).append((seconds, relmse))


def measure(scene, folder, options):
    """The series of a scene, in passes that take turns."""
    truth_path = truth(scene, folder, options)
    noise = error(truth_path, truth_path)[1]["relmse_reference_noise"]
    every = [Series(renderer, options.series_seconds) for renderer in RENDERERS]
    for series in every:   # warms the bake's and the shaders' caches, and is thrown away
        run(series, scene, 1, 1, truth_path, folder, options)
        series.runs.clear()
        series.details.clear()
        series.left_s = options.series_seconds
    count = 1
    while not all(series.finished for series in every):   # first pass: on until the error is low or the next run too long
        for series in every:
            if series.finished:
                continue
            run(series, scene, count, 1, truth_path, folder, options)
            enough = series.runs[count][0][1] <= options.stop
            series.finished = enough or series.cost_of_next(count, options.step) > series.left_s
        count *= options.step
    for repetition in range(2, options.passes + 1):
        for count in sorted(set().union(*(series.runs for series in every))):
            for series in every:
                if count in series.runs and series.wall_s[count] < series.left_s:
                    run(series, scene, count, repetition, truth_path, folder, options)
    return every, noise


def speedup_target(scene):
    """Issue 6: 5 where all lights are delta lights, elsewhere the preview is never later."""
    lights = json.loads(pathlib.Path(scene).read_text())["lights"]
    return 5.0 if all(light["type"] in DELTA_LIGHTS for light in lights) else 1.0


def figures_of(name, every, noise, target):
    figures, seconds = {}, {}
    for series in every:
        runs = min(len(runs) for runs in series.runs.values())
        for label, relmse in TARGETS.items():
            value, note = seconds_to(series.points(), relmse)
            if noise is not None and noise > .2 * relmse:
                note += f"{'; ' if note else ''}noisy long reference: its own relMSE is {noise:.1g}"
            seconds[series.renderer, label] = value
            figures[f"{name}.{series.renderer}.seconds_to_relmse_{label}"] = bench_report.figure(value, "s", "lower", runs=runs, note=note)
    # The picture as it is against the reference's, like with like; and what is shown against it.
    for label in TARGETS:
        for shown, figure in (("preview", "speedup"), ("denoised", "denoised_speedup")):
            ratio = None
            pair = {renderer: figures[f"{name}.{renderer}.seconds_to_relmse_{label}"] for renderer in (shown, "reference")}
            if seconds[shown, label] and seconds["reference", label]:
                ratio = seconds["reference", label] / seconds[shown, label]
            notes = {renderer: value["note"].partition(":")[0] for renderer, value in pair.items()}
            figures[f"{name}.{figure}_at_relmse_{label}"] = bench_report.figure(
                ratio, "x", "higher", target=target, runs=min(value["runs"] for value in pair.values()),
                note="; ".join(f"{renderer} {word}" for renderer, word in notes.items() if word))
    return figures


def parse_options():
    parser = argparse.ArgumentParser(description="Seconds to a given relMSE, preview and reference.")
    parser.add_argument("--quick", action="store_true", help="the short form: less than 4 minutes")
    parser.add_argument("--scene", action="append", help=f"repeatable; default {', '.join(SCENES)}")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report and the plots")
    for name, value in LONG.items():
        parser.add_argument("--" + name.replace("_", "-"), type=type(value), help=f"default {value}, short form {SHORT[name]}")
    options = parser.parse_args()
    for name, value in (SHORT if options.quick else LONG).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    options.resolution = f"{options.resolution},{options.resolution}"
    options.scene = options.scene or [str(bench_report.ROOT / scene) for scene in SCENES]
    options.gl = ""
    return options


def main():
    options = parse_options()
    figures, curves, groups, details = {}, {}, {}, {}
    load = bench_report.other_load()
    with tempfile.TemporaryDirectory(prefix="selvedge-bench-") as folder:
        for scene in options.scene:
            name = pathlib.Path(scene).stem
            print(f"error-time: {name}", file=sys.stderr)
            every, noise = measure(scene, pathlib.Path(folder), options)
            figures |= figures_of(name, every, noise, speedup_target(scene))
            groups[name] = [f"{name}.{series.renderer}" for series in every]
            for series in every:
                curves[f"{name}.{series.renderer}"] = series.curve()
                details[f"{name}.{series.renderer}"] = series.details
    bench_report.write("error-time", figures, curves, out=options.out, load=load, gl=options.gl, groups=groups, axes=("seconds", "relMSE"),
                       quick=options.quick, resolution=options.resolution, runs=details)


if __name__ == "__main__":
    main()
