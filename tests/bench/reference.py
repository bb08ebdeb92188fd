"""Suite reference: what the path tracer costs against bare Embree, what its parts gain, and its efficiency against Mitsuba 3. Run by
./dev bench reference."""
import argparse
import pathlib
import statistics
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_mitsuba  # noqa: E402
import bench_report  # noqa: E402

# What is held to bare Embree: scene, overrides. One light each, as the target is for one sample of a light; the demo also with both of
# its lights, which all its camera rays ask.
RATES = {"cylinder_satin": ("cylinder_satin",), "demo_sky": ("demo", "-D", "lights.1.irradiance=[0,0,0]"), "demo_sun": ("demo", "-D", "lights.0.scale=0"),
         "demo": ("demo",)}
SEVERAL_LIGHTS = ("demo",)
CURVE_SCENE = "cylinder_satin"
TRUTH_SEED = 90001   # apart from those of the runs
TRIANGLES = [10**3, 10**4, 10**5, 10**6]
# Points of a curve: samples a pixel where sampling is uniform, targets of relMSE where it is adaptive. Above 1.5e-2 all tiles of the scene
# stop at the pilot, which is uniform.
LONG = {"rounds": 15, "side": 256, "runs": 7, "spp": 64, "resolution": 192, "truth_seconds": 60, "counts": (8, 32, 128, 512),
        "targets": (1e-2, 4e-3, 2e-3, 1e-3)}
SHORT = {"rounds": 5, "side": 96, "runs": 3, "spp": 16, "resolution": 64, "truth_seconds": 8, "counts": (8, 32, 128), "targets": (1e-2, 6e-3, 4e-3)}
INTEGRATORS = ("direct", "path")


def say(text):
    print(f"reference: {text}", file=sys.stderr)


def scene_file(name):
    return bench_report.ROOT / "assets" / "scenes" / f"{name}.json"


def raw_rates(options):
    """Figures of samples against bare rays, one thread; that of the contract is of the worst scene with one light."""
    figures, ratios = {}, {}
    for scene, (name, *overrides) in RATES.items():
        say(f"raw Embree, {scene}")
        report = bench_report.run_program("selvedge-rates", "samples", scene_file(name), "--side", options["side"], "--rounds", options["rounds"], *overrides)
        ratios[scene] = report["samples_over_raw_embree"]
        note = (f"{report['sample_ns']:.0f} ns a sample; bare: camera ray {report['closest_ns']:.0f} ns, shadow ray {report['occluded_ns']:.0f} ns, "
                f"{report['shadow_rays_per_sample']:.2f} of them a sample")
        figures[f"{scene}.samples_over_raw_embree"] = bench_report.figure(ratios[scene], "x", "higher", runs=options["rounds"], note=note)
        rate = 1e9 * report["rays_per_sample"] / report["sample_ns"] + 1e9 * report["shadow_rays_per_sample"] / report["sample_ns"]
        figures[f"{scene}.samples_per_second"] = bench_report.figure(1e9 / report["sample_ns"], "1/s", "higher", runs=options["rounds"])
        figures[f"{scene}.rays_per_second"] = bench_report.figure(rate, "1/s", "higher", runs=options["rounds"])
    worst = min(ratios.keys() - set(SEVERAL_LIGHTS), key=ratios.get)
    return {"samples_over_raw_embree": bench_report.figure(ratios[worst], "x", "higher", target=.4, runs=options["rounds"],
                                                           note=f"{worst}; the aim is 0.6")} | figures


def render(scene, folder, options, *arguments):
    side = options["resolution"]
    return bench_report.run_program("selvedge-render", scene_file(scene), "-o", folder / "image.exr", "--resolution", f"{side},{side}", "-q", *arguments)


def ratio_of(scene, folder, options, first, second):
    """Median over the runs of the seconds that `first` takes over those of `second`, which take turns."""
    def seconds(arguments):
        return render(scene, folder, options, "--spp", options["spp"], *arguments)["seconds"]["render"]
    seconds(first)   # bakes; thrown away
    return statistics.median(seconds(first) / seconds(second) for _ in range(options["runs"]))


def ratios(folder, options):
    say("meso over micro, threads")
    meso = ratio_of(CURVE_SCENE, folder, options, ["--bsdf", "meso"], ["--bsdf", "micro"])
    threads = ratio_of(CURVE_SCENE, folder, options, ["--threads", "1"], ["--threads", "2"])
    return {"meso_over_micro": bench_report.figure(meso, "x", "lower", runs=options["runs"], note=f"seconds, {CURVE_SCENE}, direct"),
            "speedup_2_threads": bench_report.figure(threads, "x", "higher", runs=options["runs"], note=f"{CURVE_SCENE}, direct")}


def builds(options):
    figures, bytes_curve, seconds_curve = {}, [], []
    for triangles in TRIANGLES:
        say(f"{triangles} triangles")
        runs = [bench_report.run_program("selvedge-rates", "build", "--triangles", triangles) for _ in range(options["runs"])]
        for key, curve in (("bytes_per_triangle", bytes_curve), ("seconds", seconds_curve)):
            values = [run[key] for run in runs]
            curve.append([runs[0]["triangles"], statistics.median(values), min(values), max(values)])
    note = "mesh and tree resident, sphere of a million; few triangles share Embree's first block"
    figures["bytes_per_triangle"] = bench_report.figure(bytes_curve[-1][1], "B", "lower", runs=options["runs"], note=note)
    figures["build_seconds_1e6"] = bench_report.figure(seconds_curve[-1][1], "s", "lower", runs=options["runs"], note="one thread builds")
    return figures, {"bytes_per_triangle": bytes_curve, "build_seconds": seconds_curve}


def error_curves(folder, options):
    """relMSE over seconds for both integrators, with adaptive sampling and without; and efficiency of adaptive over uniform."""
    figures, curves = {}, {}
    for integrator in INTEGRATORS:
        say(f"error over time, {integrator}")
        common = ["--integrator", integrator]
        render(CURVE_SCENE, folder, options, *common, "--seed", TRUTH_SEED, "--spp", 1 << 16, "--time", options["truth_seconds"])
        truth = folder / "truth.exr"
        (folder / "image.exr").rename(truth)
        work = {}
        for name, option, values in (("uniform", "--spp", options["counts"]), ("adaptive", "--target-error", options["targets"])):
            curve = curves[f"{CURVE_SCENE}.{integrator}.{name}"] = []
            for value in values:
                points = []
                for run in range(options["runs"]):
                    report = render(CURVE_SCENE, folder, options, *common, "--seed", run + 1, option, value)
                    compare = bench_report.run_program("selvedge-compare", folder / "image.exr", truth, "--fail", "max_abs=inf")
                    points.append((report["seconds"]["render"], compare["relmse"] - (compare["relmse_reference_noise"] or 0.0)))
                errors = [error for _, error in points]
                curve.append([statistics.median(seconds for seconds, _ in points), statistics.median(errors), min(errors), max(errors)])
            work[name] = curve[-1][0] * curve[-1][1]
        figures[f"{integrator}.adaptive_efficiency"] = bench_report.figure(
            work["uniform"] / work["adaptive"], "x", "higher", runs=options["runs"],
            note=f"1 / (relMSE x seconds) of --target-error over --spp at the curves' ends, {CURVE_SCENE}")
    return figures, curves


def main():
    parser = argparse.ArgumentParser(description="The reference against bare Embree and Mitsuba 3; models, threads, memory, error over time.")
    parser.add_argument("--quick", action="store_true", help="the short form: about 5 minutes")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    arguments = parser.parse_args()
    options = SHORT if arguments.quick else LONG
    load = bench_report.other_load()
    with tempfile.TemporaryDirectory(prefix="selvedge-bench-") as name:
        folder = pathlib.Path(name)
        figures = raw_rates(options) | ratios(folder, options)
        build_figures, curves = builds(options)
        error_figures, errors = error_curves(folder, options)
    figures |= build_figures | error_figures | bench_mitsuba.figures(arguments.quick)
    bench_report.write("reference", figures, errors | curves, out=arguments.out, load=load,
                       groups={CURVE_SCENE: list(errors)} | {name: [name] for name in curves}, axes=("seconds", "relMSE"),
                       own_axes={"build_seconds": ("triangles", "seconds"), "bytes_per_triangle": ("triangles", "bytes a triangle")},
                       quick=arguments.quick)


if __name__ == "__main__":
    main()
