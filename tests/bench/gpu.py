"""Suite gpu: what the preview does on a graphics card. Run by ./dev bench gpu; where OpenGL is software it says so and measures nothing.

Cards need pictures large enough to fill them, and are measured at those that people look at."""
import argparse
import pathlib
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_report  # noqa: E402
import error_time  # noqa: E402
import preview  # noqa: E402
from bench_report import figure  # noqa: E402

FULL_HD = "1920,1080"
# frames and turns of a measurement; sides of what is drawn in turn, and of what is compared with the reference; seconds for the error's
# long reference and for each renderer's runs, to relMSE `stop`
LONG = {"frames": 400, "rounds": 5, "turns": 200, "side": 1024, "bare_side": 4096, "resolutions": preview.LONG["resolutions"], "pixels": 2.0e9,
        "equal_frames": 4096, "equal_size": 128, "truth_seconds": 60.0, "series_seconds": 30.0, "passes": 5}
SHORT = LONG | {"frames": 60, "rounds": 3, "turns": 40, "pixels": 2.0e8, "equal_frames": 1024, "truth_seconds": 15.0, "series_seconds": 8.0, "passes": 3}
COMMON = {"resolution": FULL_HD, "truth_spp": 4096, "stop": 3e-3, "step": 2, "gl": ""}
# Issue 6, "on a GPU": a drape in environment light at 1920 x 1080.
FRAMES_PER_SECOND, SECONDS_TO_ERROR = 60.0, 0.25


class Bench(preview.Bench):
    curves = {}

    def is_software(self):
        """Also learns which OpenGL there is."""
        report = bench_report.run_program("selvedge-turns", preview.SCENES["cylinder_satin"], "--renderer", "preview", "--side", 16, "--rounds", 2, "--model", "it:")
        self.gl = report["gl"]
        return report["software"]

    def frame_rates(self):
        figures = {}
        for name, entry in self.frames_of_scenes().items():
            scene, _, label = name.removeprefix("milliseconds_per_frame.").rpartition(".")
            target = FRAMES_PER_SECOND if (scene, label) == ("demo", "1080p") else None
            figures[f"frames_per_second.{scene}.{label}"] = figure(1e3 / entry["value"], "1/s", "higher", target=target, runs=entry["runs"],
                                                                   note=f"{entry['value']:.3g} ms a frame")
        return figures

    def ingredients(self):
        return {f"meso_over_micro.{name}": self.ratio(scene, "mode=ours", "bsdf=micro", target=1.1) for name, scene in preview.SCENES.items()}

    def error(self):
        """Seconds to an error at 1920 x 1080, the card beside all the machine's cores."""
        every, noise = error_time.measure(preview.SCENES["demo"], self.folder, self.options)
        figures = error_time.figures_of("demo", every, noise, 1.0)
        for name in ("demo.preview.seconds_to_relmse_1e-2", "demo.denoised.seconds_to_relmse_1e-2"):
            figures[name]["target"] = SECONDS_TO_ERROR
        self.curves = {f"demo.{series.renderer}": series.curve() for series in every}
        return {name: entry for name, entry in figures.items() if name.endswith("1e-2")}


def main():
    parser = argparse.ArgumentParser(description="Frame rates, costs and time to an error on a graphics card.")
    parts = ("frames", "error", "ingredients", "skips", "stripped", "first", "edits", "equality")
    parser.add_argument("--quick", action="store_true", help="the short form")
    parser.add_argument("--only", action="append", choices=parts, help="repeatable; default all")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    options = parser.parse_args()
    for name, value in ((SHORT if options.quick else LONG) | COMMON).items():
        setattr(options, name, value)
    load = bench_report.other_load()
    with tempfile.TemporaryDirectory(prefix="selvedge-bench-") as folder:
        bench = Bench(folder, options)
        if bench.is_software():
            print(f"gpu: OpenGL is {bench.gl}, no graphics card: nothing is measured", file=sys.stderr)
            return
        functions = (bench.frame_rates, bench.error, bench.ingredients, bench.skips, bench.stripped, bench.first_picture, bench.edits, bench.equality)
        figures = preview.measure("gpu", dict(zip(parts, functions)), options.only)
        bench_report.write("gpu", figures, bench.curves, out=options.out, load=load, gl=bench.gl, groups={"demo": list(bench.curves)} if bench.curves else {},
                           axes=("seconds", "relMSE"), quick=options.quick)


if __name__ == "__main__":
    main()
